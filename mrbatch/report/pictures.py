"""Pictures for pages: reading them from files, drawing error maps, and small copies to embed.

Reading is as strict as everywhere: the header's size is checked before anything is allocated, and a
file that cannot be read is one clear error.
"""

from __future__ import annotations

import base64
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mrbatch.errors import InputError, Place
from mrbatch.kernels.transfer import encode, to_linear
from mrbatch.metrics.noise import LEVELS
from mrbatch.scene.file_kind import PICTURES, unreadable
from mrbatch.scene.picture_library import library_error

SUFFIXES = (".exr", ".hdr", ".png", ".jpg", ".jpeg", ".tif", ".tiff", ".pfm")
MAX_VALUES = 1 << 28
"""Most values (width x height x channels) that are read of a picture: 1 GiB of float32."""
MAX_TOGETHER = 1 << 26
"""Layers whose channels, and those between them, are more values than that are read one by one."""


@dataclass(frozen=True)
class LinearPicture:
    """A picture as scene-linear float32 (height, width, channels), 1 or 3 channels.

    `origin`: absolute pixel (x, y) of its first pixel; `full_size`: (width, height) of the frame that
    it is a part of (an EXR's data and display windows).
    """

    values: np.ndarray
    origin: tuple[int, int]
    full_size: tuple[int, int]

    def cut_to(self, other: LinearPicture) -> LinearPicture | None:
        """The part that covers `other`'s pixels, or None where it does not cover them all."""
        x, y = other.origin[0] - self.origin[0], other.origin[1] - self.origin[1]
        height, width = other.values.shape[:2]
        if x < 0 or y < 0 or y + height > self.values.shape[0] or x + width > self.values.shape[1]:
            return None
        return LinearPicture(self.values[y : y + height, x : x + width], other.origin, self.full_size)


def read_picture(path: Path, layer: str = "", *, max_values: int = MAX_VALUES) -> LinearPicture:
    """A picture file as scene-linear values; integer codes go through the inverse sRGB curve.

    `layer`: `delta` reads `delta.R`, `delta.G`, `delta.B` (or X, Y, Z, or the one channel of that
    name) from the first part of an EXR that has them; empty reads R, G, B, or the one channel that
    there is. Alpha is left out.

    Raises InputError where the file is missing, broken, larger than `max_values`, or lacks the layer.
    """
    found, known = _read_layers(path, (layer,), max_values)
    if layer not in found:
        raise InputError(
            f"the picture has no layer `{layer or 'RGB'}`",
            place=Place(file=str(path)),
            hint=f"its channels are {', '.join(known[:24])}",
        )
    return found[layer]


def read_layers(
    path: Path, layers: Sequence[str], *, max_values: int = MAX_VALUES
) -> dict[str, LinearPicture]:
    """Several layers, as `read_picture` reads one; those that the file lacks are left out.

    A file is decoded once where what is wanted of it lies close together.
    """
    return _read_layers(path, layers, max_values)[0]


def _read_layers(
    path: Path, layers: Sequence[str], max_values: int
) -> tuple[dict[str, LinearPicture], list[str]]:
    """The layers that are there, and the names of all channels that were looked at."""
    import OpenImageIO as oiio

    if not Path(path).is_file():
        place = Place(file=str(path))
        raise InputError("there is no such picture", place=place, hint="check the name and the folder")
    source = oiio.ImageInput.open(os.fspath(path))
    if source is None:
        library_error(oiio)
        raise unreadable(path, "a picture", PICTURES)
    found: dict[str, LinearPicture] = {}
    known: list[str] = []
    try:
        part = 0
        while len(found) < len(set(layers)) and source.seek_subimage(part, 0):
            spec = source.spec()
            names = [str(name) for name in spec.channelnames]
            known += names
            chosen = {layer: _channels_of(names, layer) for layer in layers if layer not in found}
            chosen = {layer: indices for layer, indices in chosen.items() if indices}
            for together in _reads(chosen, spec.width * spec.height):
                found.update(_read_channels(source, part, spec, together, path, max_values))
            part += 1
        library_error(source)  # seeking past the last part leaves a message
    finally:
        source.close()
    return found, known


def _reads(chosen: Mapping[str, Sequence[int]], pixels: int) -> list[dict[str, Sequence[int]]]:
    """Layers that are read together: all, or each by itself where that would take much memory."""
    every = [i for indices in chosen.values() for i in indices]
    if every and pixels * (max(every) - min(every) + 1) <= MAX_TOGETHER:
        return [dict(chosen)]
    return [{layer: indices} for layer, indices in chosen.items()]


def _read_channels(
    source: Any, part: int, spec: Any, chosen: Mapping[str, Sequence[int]], path: Path, max_values: int
) -> dict[str, LinearPicture]:
    """Layers by the indices of their channels, with one look at the file."""
    import OpenImageIO as oiio

    every = [i for indices in chosen.values() for i in indices]
    first, last = min(every), max(every) + 1
    if spec.width <= 0 or spec.height <= 0 or spec.width * spec.height * (last - first) > max_values:
        raise InputError(
            f"the picture announces {spec.width}x{spec.height} pixels of {spec.nchannels} channels",
            place=Place(file=str(path)),
            hint=f"at most {max_values} values are read",
        )
    integers = {"uint8": 8, "uint16": 16}.get(str(spec.format), 0)
    wanted = (oiio.UINT8 if integers == 8 else oiio.UINT16) if integers else oiio.FLOAT
    values = source.read_image(part, 0, first, last, wanted)
    if values is None:
        library_error(source)
        raise unreadable(path, "a picture", PICTURES)
    values = np.asarray(values).reshape(spec.height, spec.width, last - first)
    origin, full = (spec.x - spec.full_x, spec.y - spec.full_y), (spec.full_width, spec.full_height)
    found = {}
    for layer, indices in chosen.items():
        own = values[:, :, [i - first for i in indices]]
        linear = to_linear(own, "srgb", integers) if integers else own.astype(np.float32)
        found[layer] = LinearPicture(linear, origin, full)
    return found


def reduced(values: np.ndarray, width: int) -> np.ndarray:
    """(height, width, channels) linear values, by area averages to at most `width` columns."""
    import cv2

    rows, columns = values.shape[:2]
    if columns <= width:
        return values
    size = (width, max(1, round(rows * width / columns)))
    small = np.asarray(cv2.resize(values, size, interpolation=cv2.INTER_AREA))
    return small[..., None] if small.ndim == 2 else small


def _channels_of(names: list[str], layer: str) -> list[int]:
    """Indices of a layer's one or three channels among `names`; empty where it is not there."""
    prefix = f"{layer}." if layer else ""
    for triple in ("RGB", "XYZ", "rgb"):
        wanted = [prefix + letter for letter in triple]
        if all(name in names for name in wanted):
            return [names.index(name) for name in wanted]
    for name in (layer, f"{layer}.Y", f"{layer}.Z", f"{layer}.A"):
        if layer and name in names:
            return [names.index(name)]
    if layer:
        return []
    for name in ("Y", "I", "L"):
        if name in names:
            return [names.index(name)]
    return [0] if len(names) <= 2 else []


def display_codes(linear: np.ndarray, gain: float | tuple[float, float, float] = 1.0) -> np.ndarray:
    """(height, width, 3) uint8: clip(gain x L) through the sRGB curve; NaN is drawn magenta."""
    a = np.asarray(linear, dtype=np.float64)
    a = a[..., None] if a.ndim == 2 else a
    a = np.repeat(a, 3, axis=2) if a.shape[2] == 1 else a
    bad = np.isnan(a).any(axis=2)
    shown = encode(np.clip(np.nan_to_num(a * np.asarray(gain, dtype=np.float64)), 0.0, 1.0), "srgb")
    codes = np.floor(shown * 255.0 + 0.5).astype(np.uint8)
    codes[bad] = (255, 0, 255)
    return codes


def map_scale(values: np.ndarray, quantile: float = 0.99) -> float:
    """A scale for a map of magnitudes that a few fireflies do not set; 1 where all is 0."""
    finite = np.abs(np.asarray(values, dtype=np.float64))
    finite = finite[np.isfinite(finite)]
    if finite.size == 0:
        return 1.0
    scale = float(np.quantile(finite, quantile)) or float(finite.max())
    return scale or 1.0


def magnitude_picture(values: np.ndarray, high: float) -> np.ndarray:
    """(height, width) magnitudes to uint8 RGB in magma: black is 0, pale yellow is `high` or more."""
    import cv2

    level = np.clip(np.nan_to_num(np.asarray(values, dtype=np.float64) / high, nan=1.0), 0.0, 1.0)
    codes = np.floor(level * 255.0 + 0.5).astype(np.uint8)
    return np.ascontiguousarray(cv2.applyColorMap(codes, cv2.COLORMAP_MAGMA)[..., ::-1])


def signed_picture(values: np.ndarray, high: float) -> np.ndarray:
    """Signed values to uint8 RGB around mid grey: brighter is more light, darker is less (square root).

    (height, width) or (height, width, channels): channels keep their colour. `high` reaches the ends.
    """
    a = np.asarray(values, dtype=np.float64)
    a = a[..., None] if a.ndim == 2 else a
    a = np.repeat(a, 3, axis=2) if a.shape[2] == 1 else a[..., :3]
    level = np.clip(np.nan_to_num(a / high), -1.0, 1.0)
    return (
        np.floor(127.5 + 127.5 * np.sign(level) * np.sqrt(np.abs(level)) + 0.5).clip(0, 255).astype(np.uint8)
    )


def noise_picture(codes: np.ndarray, block: float, backdrop: np.ndarray) -> np.ndarray:
    """A map of noise (see `mrbatch.metrics.noise.NoiseMap`) over a dark grey picture, uint8 RGB.

    `codes` (rows, columns): one a block of `block` x `block` pixels; 0 shows the `backdrop` (height, width,
    3) uint8. Magma from 0.1 % (dark) to 100 % (pale), logarithmic.
    """
    import cv2

    height, width = backdrop.shape[:2]
    grey = (backdrop.astype(np.float64) @ [0.2126, 0.7152, 0.0722])[..., None].repeat(3, axis=2)
    there = (codes > 0).astype(np.float64)
    level = there * (codes.astype(np.float64) - 1.0) / (LEVELS - 1)
    # A block is no whole number of pixels where the backdrop was reduced.
    size = (max(width, round(codes.shape[1] * block)), max(height, round(codes.shape[0] * block)))
    # Between blocks that have a level, in between; a block without one takes no part.
    weight, summed = (
        np.asarray(cv2.resize(a, size, interpolation=cv2.INTER_LINEAR), dtype=np.float64)[:height, :width]
        for a in (there, level)
    )
    level = np.divide(summed, weight, out=np.zeros_like(summed), where=weight > 0)
    colour = cv2.applyColorMap(np.floor(level * 255.0 + 0.5).astype(np.uint8), cv2.COLORMAP_MAGMA)[..., ::-1]
    # A little of the picture shines through, so that one sees where the noise is.
    mixed = np.where((weight >= 0.5)[..., None], 0.85 * colour + 0.15 * grey, 0.25 * grey + 24.0)
    return np.floor(mixed.clip(0, 255) + 0.5).astype(np.uint8)


def data_uri(codes: np.ndarray, *, width: int = 720, quality: int = 82, max_bytes: int = 400_000) -> str:
    """uint8 RGB (height, width, 3) as a `data:` address of a JPEG within `max_bytes`.

    Small pictures (icons, tiny test frames) become PNG, enlarged by whole pixels so that they can be
    judged; large ones are reduced by area averages, then in quality and size until they fit.
    """
    import cv2

    picture = np.ascontiguousarray(np.asarray(codes, dtype=np.uint8)[..., ::-1])
    height = picture.shape[0]
    if picture.shape[1] * 4 <= width and height * 4 <= width:
        zoom = width // 2 // max(picture.shape[1], height)
        picture = np.repeat(np.repeat(picture, zoom, axis=0), zoom, axis=1)
        return _uri("png", cv2.imencode(".png", picture)[1])
    while True:
        shrunk = picture
        if picture.shape[1] > width:
            size = (width, max(1, round(height * width / picture.shape[1])))
            shrunk = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
        data = cv2.imencode(".jpg", shrunk, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
        if data.size <= max_bytes or width <= 64:
            return _uri("jpeg", data)
        width, quality = width * 3 // 4, max(50, quality - 8)


def png_uri(codes: np.ndarray) -> str:
    """uint8 RGB (height, width, 3) as a `data:` address of a PNG, code for code."""
    import cv2

    return _uri("png", cv2.imencode(".png", np.ascontiguousarray(codes[..., ::-1]))[1])


def _uri(kind: str, data: np.ndarray) -> str:
    return f"data:image/{kind};base64,{base64.b64encode(data.tobytes()).decode('ascii')}"
