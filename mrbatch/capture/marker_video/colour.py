"""From a picture's planes to scene-linear Rec.709: ranges, matrices, chroma siting, primaries.

Y'CbCr to R'G'B' is done here, not by a scaler: E'R = E'Y + 2 (1 - Kr) E'Cr, E'B = E'Y + 2 (1 - Kb) E'Cb,
E'G from E'Y = Kr E'R + Kg E'G + Kb E'B (ITU-R BT.601, BT.709, BT.2020; codes of table E.5 of
ITU-T H.273). Subsampled chroma is interpolated linearly at the phase that its siting names.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from mrbatch.capture.marker_video.settings import ColourSettings
from mrbatch.errors import InputError, Place
from mrbatch.kernels.transfer import rec709_from_primaries, to_linear, to_linear_between, to_rec709

LUMA = {
    "bt601": (0.299, 0.114),
    "bt709": (0.2126, 0.0722),
    "bt2020": (0.2627, 0.0593),
    "fcc": (0.30, 0.11),
    "smpte240m": (0.212, 0.087),
}
"""Kr and Kb of each matrix."""
SITING = {
    "left": (0.0, 0.5),
    "centre": (0.5, 0.5),
    "top-left": (0.0, 0.0),
    "top": (0.5, 0.0),
    "bottom-left": (0.0, 1.0),
    "bottom": (0.5, 1.0),
}
"""Offset (x, y) in luma pixels of the first chroma sample from the first luma sample, for 4:2:0."""


@dataclass(frozen=True)
class Picture:
    """A picture as it was filmed.

    `linear` (height, width, 3) float32: scene-linear Rec.709. `codes` (height, width, 3) uint8 or
    uint16: its own RGB code values, else None. `flags`: what a person should know of it.
    """

    linear: np.ndarray
    codes: np.ndarray | None = None
    flags: tuple[str, ...] = ()


@dataclass(frozen=True)
class Colour:
    """How all pictures of a footage are read; each value is a name of `ColourSettings`, never `auto`.

    `rec709_from_source` (3 rows of 3): linear light of the footage's primaries to Rec.709; its
    inverse leads back. `bits` of a code. `matrix`, `range` and `chroma` say nothing of RGB files.
    """

    transfer: str
    bits: int
    primaries: str = "bt709"
    rec709_from_source: tuple[tuple[float, ...], ...] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    matrix: str = "none"
    range: str = "full"
    chroma: str = "none"

    def as_json(self) -> dict[str, Any]:
        return {
            "transfer": self.transfer,
            "bits": self.bits,
            "primaries": self.primaries,
            "rec709_from_source": [list(row) for row in self.rec709_from_source],
            "matrix": self.matrix,
            "range": self.range,
            "chroma": self.chroma,
        }

    @staticmethod
    def from_json(data: dict[str, Any]) -> Colour:
        rows = tuple(tuple(float(x) for x in row) for row in data["rec709_from_source"])
        return Colour(**{**data, "rec709_from_source": rows})


def rows_of(matrix: np.ndarray) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(float(x) for x in row) for row in matrix)


_H273_MATRICES = {1: "bt709", 4: "fcc", 5: "bt601", 6: "bt601", 7: "smpte240m", 9: "bt2020"}
_H273_TRANSFERS = {1: "bt709", 6: "bt709", 7: "bt709", 14: "bt709", 15: "bt709", 11: "bt709"}
_H273_TRANSFERS |= {4: "gamma22", 5: "gamma28", 8: "linear", 13: "srgb", 16: "pq", 18: "hlg"}
_H273_PRIMARIES = {1: "bt709", 5: "bt601-625", 6: "bt601-525", 7: "bt601-525", 9: "bt2020", 12: "p3"}
_UNSPECIFIED = (0, 2, 3)


@dataclass(frozen=True)
class VideoTags:
    """Code points of ITU-T H.273 as a video's first frame carries them (2: unspecified).

    `range`: 0 unspecified, 1 limited, 2 full. `chroma`: a name of `SITING` or None. `layout`: `yuv`,
    `rgb` or `gray`.
    """

    layout: str
    bits: int
    height: int
    matrix: int = 2
    transfer: int = 2
    primaries: int = 2
    range: int = 0
    chroma: str | None = None
    jpeg: bool = False
    subsampled: bool = False


def _tagged(what: str, code: int, known: dict[int, str], setting: str, place: Place) -> str | None:
    """The tag's name, None where it is unspecified. Raises InputError for one that is not known here."""
    if code in known:
        return known[code]
    if code in _UNSPECIFIED:
        return None
    raise InputError(
        f"the video is tagged with {what} {code} of ITU-T H.273, which is not supported",
        place=place,
        hint=f"name the nearest one as `capture.colour.{setting}`",
    )


def decide_colour(tags: VideoTags, settings: ColourSettings, place: Place) -> tuple[Colour, tuple[str, ...]]:
    """How a video is read: settings before tags before custom; with a note for each thing assumed.

    Untagged: full-range Motion JPEG and RGB are sRGB, everything else bt709; the matrix is bt709 from
    577 lines up and bt601 below; the range limited (full for RGB, grey and JPEG); chroma left (centre
    for JPEG). Raises InputError for a tag that is not supported and not overridden.
    """
    notes = []
    transfer: str | None = None if settings.transfer == "auto" else settings.transfer
    if transfer is None:
        transfer = _tagged("transfer", tags.transfer, _H273_TRANSFERS, "transfer", place)
    if transfer is None:
        transfer = "srgb" if tags.layout == "rgb" or tags.jpeg else "bt709"
        notes.append(f"transfer function not tagged: {transfer} assumed")
    primaries: str | None = None if settings.primaries == "auto" else settings.primaries
    if primaries is None:
        primaries = _tagged("primaries", tags.primaries, _H273_PRIMARIES, "primaries", place) or "bt709"
    range_ = None if settings.range == "auto" else settings.range
    if range_ is None and tags.layout != "rgb" and tags.range in (1, 2):
        range_ = "limited" if tags.range == 1 else "full"
    if range_ is None:
        range_ = "limited" if tags.layout == "yuv" and not tags.jpeg else "full"
        if tags.layout != "rgb":
            notes.append(f"code range not tagged: {range_} assumed")
    matrix = chroma = "none"
    if tags.layout == "yuv":
        chosen: str | None = None if settings.matrix == "auto" else settings.matrix
        if chosen is None:
            chosen = _tagged("matrix", tags.matrix, _H273_MATRICES, "matrix", place)
        if chosen is None:
            chosen = "bt601" if tags.jpeg or tags.height <= 576 else "bt709"
            notes.append(f"Y'CbCr matrix not tagged: {chosen} assumed")
        matrix = chosen
        if tags.subsampled:
            siting: str | None = None if settings.chroma == "auto" else settings.chroma
            siting = siting or tags.chroma
            if siting is None:
                siting = "centre" if tags.jpeg else "left"
                notes.append(f"chroma siting not tagged: {siting} assumed")
            chroma = siting
    moved = rows_of(rec709_from_primaries(primaries))
    return Colour(transfer, tags.bits, primaries, moved, matrix, range_, chroma), tuple(notes)


def _upsample(plane: np.ndarray, factor: int, offset: float, size: int, axis: int) -> np.ndarray:
    """Linear interpolation of samples at `offset + factor * i` to all integers below `size`."""
    if factor == 1:
        return plane
    at = np.clip((np.arange(size) - offset) / factor, 0.0, plane.shape[axis] - 1.0)
    low = np.minimum(np.floor(at).astype(np.intp), plane.shape[axis] - 1)
    high = np.minimum(low + 1, plane.shape[axis] - 1)
    weight = (at - low).astype(np.float32)
    shape = [1, 1]
    shape[axis] = size
    weight = weight.reshape(shape)
    return np.take(plane, low, axis) * (1.0 - weight) + np.take(plane, high, axis) * weight


def upsample_chroma(plane: np.ndarray, factors: tuple[int, int], siting: str, shape: tuple[int, int]):
    """A chroma plane (float32) at the resolution of luma, `shape` = (height, width).

    `factors`: luma samples to a chroma sample in x and y. Bilinear; a factor of 2 or 4 makes the
    weights exact in binary, so that a constant plane stays constant to the bit. Beyond the outermost
    samples their value is kept.
    """
    fx, fy = factors
    sx, sy = SITING.get(siting, (0.0, 0.0))
    # The offsets of SITING are for factor 2; a wider box has its centre at (factor - 1) / 2.
    rows = _upsample(plane, fy, sy * (fy - 1), shape[0], 0)
    return _upsample(rows, fx, sx * (fx - 1), shape[1], 1)


def signal_from_yuv(
    y: np.ndarray,
    cb: np.ndarray | None,
    cr: np.ndarray | None,
    colour: Colour,
    factors: tuple[int, int] = (1, 1),
) -> np.ndarray:
    """Codes of Y' and chroma (unsigned) to the R'G'B' signal, (height, width, 3) float32, clipped to 0..1.

    `cb`, `cr` are None for grey; `factors`: luma samples to one of theirs in x and y.
    """
    scale = float(2 ** (colour.bits - 8))
    limited = colour.range == "limited"
    luma_zero, luma_span = (16.0 * scale, 219.0 * scale) if limited else (0.0, 2.0**colour.bits - 1.0)
    luma = (y.astype(np.float32) - np.float32(luma_zero)) / np.float32(luma_span)
    out = np.empty((*y.shape, 3), dtype=np.float32)
    if cb is None or cr is None:
        out[:] = luma[..., None]
        return np.clip(out, 0.0, 1.0, out=out)
    middle = np.float32(2 ** (colour.bits - 1))
    span = np.float32(224.0 * scale if limited else 2.0**colour.bits - 1.0)
    blue, red = (
        upsample_chroma(c.astype(np.float32) - middle, factors, colour.chroma, y.shape) / span
        for c in (cb, cr)
    )
    kr, kb = LUMA[colour.matrix]
    kg = 1.0 - kr - kb
    out[..., 0] = luma + np.float32(2.0 * (1.0 - kr)) * red
    out[..., 1] = luma - (
        np.float32(2.0 * kb * (1.0 - kb) / kg) * blue + np.float32(2.0 * kr * (1.0 - kr) / kg) * red
    )
    out[..., 2] = luma + np.float32(2.0 * (1.0 - kb)) * blue
    return np.clip(out, 0.0, 1.0, out=out)


def linear_from_signal(signal: np.ndarray, colour: Colour) -> Picture:
    """R'G'B' signal (float, 0..1) to a picture without codes."""
    return _moved(to_linear_between(signal, colour.transfer), None, colour)


def linear_from_codes(codes: np.ndarray, colour: Colour) -> Picture:
    """RGB codes (height, width, 3) to a picture that keeps them; exact for every code."""
    return _moved(to_linear(codes, colour.transfer, colour.bits), codes, colour)


def linear_from_light(light: np.ndarray, colour: Colour) -> Picture:
    """Linear light (float32) in the footage's primaries to a picture."""
    return _moved(np.ascontiguousarray(light, dtype=np.float32), None, colour)


def _moved(linear: np.ndarray, codes: np.ndarray | None, colour: Colour) -> Picture:
    """Into Rec.709; light that it cannot express, or that a file has below zero, becomes 0."""
    linear = to_rec709(linear, np.array(colour.rec709_from_source))
    flags: tuple[str, ...] = ()
    negative = linear < 0.0
    if negative.any():
        linear = np.where(negative, np.float32(0.0), linear)
        flags = ("negative-light-clamped",)
    return Picture(linear, codes, flags)
