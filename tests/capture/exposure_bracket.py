"""Brackets whose truth is known: radiance, a camera with a curve and noise, and nine exposures."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

STOPS = 2
TIMES = [2.0 ** (STOPS * k) / 4096.0 for k in range(9)]
"""Nine shots two stops apart, 1/4096 s to 16 s."""


def room(height: int = 96, width: int = 192, seed: int = 3, sun: float = 300.0) -> np.ndarray:
    """(height, width, 3) radiance of a made-up room: walls, texture, a bright window and a small lamp."""
    rng = np.random.default_rng(seed)
    smooth = cv2.GaussianBlur(rng.normal(size=(height, width, 3)), (0, 0), 7.0)
    detail = cv2.GaussianBlur(rng.normal(size=(height, width, 3)), (0, 0), 1.0)
    value = 0.3 * np.exp(12.0 * smooth + 0.8 * detail)
    value[10:40, 30:60] *= 30.0
    value[20:24, 120:124] = sun
    return value


def srgb(linear: np.ndarray) -> np.ndarray:
    """sRGB's curve on 0..1 (IEC 61966-2-1), written out here so that the test has its own."""
    x = np.clip(linear, 0.0, 1.0)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.power(x, 1.0 / 2.4) - 0.055)


def shoot(
    radiance: np.ndarray, seconds: float, *, curve=srgb, noise: float = 0.6, seed: int = 0, top: int = 255
) -> np.ndarray:
    """Codes of one exposure, 8 bits (16 with `top` 65535), with `noise` codes of Gaussian noise."""
    code = top * curve(radiance * seconds)
    code = code + np.random.default_rng(seed).normal(0.0, noise, code.shape) * (code < top - 1e-6)
    return np.clip(np.rint(code), 0, top).astype(np.uint8 if top == 255 else np.uint16)


def save(
    path: Path, codes: np.ndarray, seconds: float | None = None, *, quality: int = 98, subsampling: int = 0
) -> Path:
    """A PNG, or a JPEG (`subsampling` 2: 4:2:0) with EXIF's exposure time where `seconds` is given."""
    if codes.dtype == np.uint16 or path.suffix == ".png":
        assert cv2.imwrite(str(path), codes[..., ::-1])
        return path
    picture = Image.fromarray(codes)
    exif = Image.Exif()
    if seconds is not None:
        exif[0x8769] = {0x829A: IFDRational(Fraction(seconds).limit_denominator(10**6)), 0x8827: 100}
    picture.save(path, quality=quality, subsampling=subsampling, exif=exif)
    return path


def nine(folder: Path, radiance: np.ndarray, **options) -> list[Path]:
    """The nine shots of `TIMES` as PNG files."""
    return [
        save(folder / f"shot_{k}.png", shoot(radiance, t, seed=k, **options)) for k, t in enumerate(TIMES)
    ]
