"""The noise that is left in a picture without a reference: from the difference of its two halves.

Both halves of a picture's samples have their own random numbers, so a quarter of their squared difference
is an unbiased estimate of the variance of their mean, however evenly the samples of each half are spread
(their own scatter would overstate it). The estimate is the relMSE of `errors.py` with that variance in
place of the squared error and the picture in place of the reference, over the pixels that changed. Its
square root is an amplitude: 0.02 says that a pixel is off by 2 % of its own brightness (root mean square).
"""

from __future__ import annotations

import base64
import binascii
import math
import zlib
from dataclasses import dataclass

import numpy as np

from mrbatch.metrics.tiles import tile_sums

CONFIDENCE = 0.95
Z = 1.959964
"""Standard errors on either side of a 95 % interval."""
MAX_BLOCKS = 4096
"""Blocks are 4 x 4 pixels or larger: the noise of a single pixel tells nothing of it."""
LOWEST, HIGHEST, LEVELS = 1e-3, 1.0, 63
"""A map's codes: 0 is unchanged, 1 to 63 are amplitudes from 0.1 % to 100 % in equal ratios."""


@dataclass(frozen=True)
class Noise:
    """`relmse` with its 95 % interval [`low`, `high`]; `pixels` and 16x16 `tiles` that it comes from."""

    relmse: float
    low: float
    high: float
    pixels: int
    tiles: int

    @property
    def interval(self) -> list[float] | None:
        """JSON-ready; None where a single tile tells nothing of the spread."""
        return None if self.tiles == 1 else [self.low, self.high]


@dataclass(frozen=True)
class NoiseMap:
    """Relative amplitude by blocks of `block` x `block` pixels: `codes` (rows, columns) uint8, 0..63."""

    block: int
    codes: np.ndarray

    def as_dict(self) -> dict[str, object]:
        """JSON-ready."""
        rows, columns = self.codes.shape
        packed = base64.b64encode(zlib.compress(self.codes.tobytes(), 9)).decode("ascii")
        return {"block": self.block, "columns": columns, "rows": rows, "codes": packed}

    @staticmethod
    def amplitudes(codes: np.ndarray) -> np.ndarray:
        """Codes to relative amplitudes, float64; NaN where nothing changed."""
        ratio = (np.asarray(codes, dtype=np.float64) - 1.0) / (LEVELS - 1)
        return np.where(codes == 0, np.nan, LOWEST * (HIGHEST / LOWEST) ** ratio)


def unpack_codes(columns: int, rows: int, packed: str) -> np.ndarray:
    """The codes of `NoiseMap.as_dict`, (rows, columns) uint8. Raises ValueError for what is none."""
    if not (0 < rows <= MAX_BLOCKS and 0 < columns <= MAX_BLOCKS and rows * columns <= MAX_BLOCKS):
        raise ValueError(f"a map of {columns} x {rows} blocks")
    try:
        unpacker = zlib.decompressobj()
        data = unpacker.decompress(base64.b64decode(packed, validate=True), rows * columns + 1)
    except (zlib.error, binascii.Error) as error:
        raise ValueError(f"a damaged map: {error}") from error
    if len(data) != rows * columns:
        raise ValueError(f"a map of {len(data)} codes, not {rows * columns}")
    return np.minimum(np.frombuffer(data, np.uint8).reshape(rows, columns), LEVELS)


def noise_between(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """The variance of the mean of two independent halves: a quarter of their squared difference."""
    difference = np.asarray(first, dtype=np.float64) - np.asarray(second, dtype=np.float64)
    return 0.25 * difference**2


def relative_square(picture: np.ndarray, variance: np.ndarray, changed: np.ndarray) -> np.ndarray:
    """(h, w) float64: variance over (C^2 + 0.01 mean C^2), channels averaged; 0 where nothing changed.

    `picture`, `variance` (h, w, 3); `changed` (h, w) bool. The mean is that of the changed pixels.
    """
    found = np.zeros(changed.shape)
    square = np.asarray(picture, dtype=np.float64)[changed] ** 2
    if square.size:
        ratio = np.asarray(variance, dtype=np.float64)[changed] / (square + 1e-2 * square.mean() + 1e-30)
        found[changed] = ratio.mean(axis=-1)
    return found


def noise_of(relative: np.ndarray, changed: np.ndarray, origin: tuple[int, int] = (0, 0)) -> Noise:
    """The mean of `relative_square` over the changed pixels, with an interval from the spread of its tiles.

    Tiles differ in noise as well as by chance, so the interval is wider than chance alone asks for. With one
    tile there is no spread: the interval is then [0, infinity]. `origin`: absolute pixel (x, y) of the first.
    """
    counts = tile_sums(changed, origin)
    sums = tile_sums(relative, origin)[counts > 0]
    counts = counts[counts > 0]
    pixels, tiles = int(counts.sum()), len(counts)
    if not pixels:
        return Noise(0.0, 0.0, 0.0, 0, 0)
    mean = float(sums.sum() / pixels)
    if tiles == 1:
        return Noise(mean, 0.0, math.inf, pixels, 1)
    # The standard error of a ratio of sums (Cochran, Sampling Techniques, 1977, eq. 6.13).
    spread = float(((sums - mean * counts) ** 2).sum()) * tiles / (tiles - 1)
    half = Z * math.sqrt(spread) / pixels
    return Noise(mean, max(0.0, mean - half), mean + half, pixels, tiles)


def noise_map(relative: np.ndarray, changed: np.ndarray, most: int = MAX_BLOCKS) -> NoiseMap:
    """The amplitude (rms of changed pixels), by the smallest blocks that are `most` or fewer."""
    height, width = changed.shape
    block = 4
    while -(-height // block) * -(-width // block) > most:
        block *= 2
    rows, columns = np.arange(0, height, block), np.arange(0, width, block)

    def blocks(values: np.ndarray) -> np.ndarray:
        a = np.asarray(values, dtype=np.float64)
        return np.add.reduceat(np.add.reduceat(a, rows, axis=0), columns, axis=1)

    counts = blocks(changed)
    amplitude = np.sqrt(blocks(relative) / np.maximum(counts, 1.0))
    with np.errstate(divide="ignore"):
        level = np.log(amplitude / LOWEST) / math.log(HIGHEST / LOWEST)
    codes = 1 + np.floor(np.clip(level, 0.0, 1.0) * (LEVELS - 1) + 0.5)
    return NoiseMap(block, np.where(counts > 0, codes, 0).astype(np.uint8))
