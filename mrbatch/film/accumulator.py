"""The film: what a method estimates, summed in two independent halves.

For every pixel and half: sums of P (virtual, premultiplied), a (coverage) and D (light change on
real surfaces, weighted by what of the background stays visible), squares of what the sample changes
in the composite, and the number of samples. Sums are float64 and run in sample order, so neither
batches nor tiles show in the bits. Samples own their pixel (filters by importance sampling).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from mrbatch.contracts import Buffer
from mrbatch.film.window import Window

P, A, D = 0, 3, 4
BASE_CHANNELS = 7
SPLIT_CHANNELS = 13
"""With the split of D: light that is blocked (7..9) and light that comes indirectly (10..12)."""


@wp.struct
class FilmData:
    """One view's film as kernels take it. `background` (height * width) in photo units."""

    x: wp.int32
    y: wp.int32
    width: wp.int32
    height: wp.int32
    tile_x: wp.int32
    tile_y: wp.int32
    tile_columns: wp.int32
    sums: wp.array3d(dtype=wp.float64)
    squares: wp.array3d(dtype=wp.float64)
    counts: wp.array2d(dtype=wp.int32)
    background: wp.array(dtype=wp.vec3)


@wp.struct
class Pixel:
    """Absolute coordinates, and the index in the window's arrays; -1 outside the window."""

    x: wp.int32
    y: wp.int32
    index: wp.int32


@wp.func
def film_pixel(film: FilmData, unit: wp.int32, lane: wp.int32) -> Pixel:
    """The pixel of a lane (0..255) of a decision tile."""
    pixel = Pixel()
    row = unit // film.tile_columns
    column = unit - row * film.tile_columns
    pixel.x = (film.tile_x + column) * 16 + (lane & 15)
    pixel.y = (film.tile_y + row) * 16 + (lane >> 4)
    i = pixel.x - film.x
    j = pixel.y - film.y
    pixel.index = j * film.width + i
    if i < 0 or j < 0 or i >= film.width or j >= film.height:
        pixel.index = wp.int32(-1)
    return pixel


vec7d = wp.types.vector(length=7, dtype=wp.float64)


@wp.struct
class PixelSums:
    """Running sums of one pixel and half, in registers while a kernel adds samples."""

    sums: vec7d
    squares: wp.vec3d


@wp.func
def film_load(film: FilmData, half: wp.int32, index: wp.int32) -> PixelSums:
    """The sums so far: a kernel goes on from them, so the batch in which a sample came does not show."""
    total = PixelSums()
    for c in range(7):
        total.sums[c] = film.sums[half, index, c]
    for c in range(3):
        total.squares[c] = film.squares[half, index, c]
    return total


@wp.func
def film_add(
    total: PixelSums, value: wp.vec3, covered: float, delta: wp.vec3, background: wp.vec3
) -> PixelSums:
    """Adds one sample: premultiplied virtual light, coverage 0 or 1, light change."""
    result = total
    change = value - background * covered + delta
    for c in range(3):
        result.sums[c] += wp.float64(value[c])
        result.sums[4 + c] += wp.float64(delta[c])
        result.squares[c] += wp.float64(change[c]) * wp.float64(change[c])
    result.sums[3] += wp.float64(covered)
    return result


@wp.func
def film_store(film: FilmData, half: wp.int32, index: wp.int32, total: PixelSums, samples: wp.int32):
    for c in range(7):
        film.sums[half, index, c] = total.sums[c]
    for c in range(3):
        film.squares[half, index, c] = total.squares[c]
    film.counts[half, index] = film.counts[half, index] + samples


@dataclass(frozen=True)
class Developed:
    """What a film holds, developed: means over both halves, float64, on the data window.

    P (h, w, 3), a (h, w), D (h, w, 3); `variance` (h, w, 3) of the composite's mean, from the
    samples' own scatter (an upper bound where samples are stratified); `samples` (h, w) int;
    `halves` (2, h, w, 7) the halves' means, `blocked`, `indirect` (h, w, 3) or None;
    `scatter` (2, h, w, 3) the variances of the halves (as `variance`, 0 for a single sample), if asked for.

    Where one half has more samples than the other, both still weigh the same: each half's number was
    decided by the other's samples, and a weight that depends on what it weighs is a bias.
    """

    window: Window
    P: np.ndarray
    a: np.ndarray
    D: np.ndarray
    variance: np.ndarray
    samples: np.ndarray
    halves: np.ndarray
    blocked: np.ndarray | None = None
    indirect: np.ndarray | None = None
    scatter: np.ndarray | None = None


def picture_data(window: Window, background: np.ndarray, device: Any) -> Any:
    """`FilmData` of a picture (h, w, 3) float32 on a window, without sums: for passes that only read it."""
    if background.shape != (window.height, window.width, 3):
        raise ValueError(f"a picture of shape {background.shape} on a window of {window}")
    film = FilmData()
    film.x, film.y = window.x, window.y
    film.width, film.height = window.width, window.height
    film.tile_x, film.tile_y = window.first_tile
    film.tile_columns = window.tiles[0]
    film.sums = wp.zeros((1, 1, 1), dtype=wp.float64, device=device)
    film.squares = wp.zeros((1, 1, 1), dtype=wp.float64, device=device)
    film.counts = wp.zeros((1, 1), dtype=wp.int32, device=device)
    film.background = wp.array(
        np.ascontiguousarray(background, dtype=np.float32).reshape(-1, 3), dtype=wp.vec3, device=device
    )
    return film


@dataclass(frozen=True)
class FilmLayout:
    """Names and shapes of one view's film buffers. `source`: whose estimate (`method` or a participant)."""

    window: Window
    view: str = ""
    source: str = "method"
    channels: int = BASE_CHANNELS

    def name(self, part: str) -> str:
        return f"film/{self.view}/{self.source}/{part}"

    def buffers(self) -> tuple[Buffer, ...]:
        n = self.window.pixels
        return (
            Buffer(self.name("sums"), (2, n, self.channels), "float64", "frame"),
            Buffer(self.name("squares"), (2, n, 3), "float64", "frame"),
            Buffer(self.name("counts"), (2, n), "int32", "frame"),
        )

    def data(self, buffers: Any, background: np.ndarray) -> Any:
        """`FilmData` over allocated buffers; `background` (h, w, 3) float32 on the window."""
        sums = buffers[self.name("sums")]
        film = picture_data(self.window, background, sums.device)
        film.sums = sums
        film.squares = buffers[self.name("squares")]
        film.counts = buffers[self.name("counts")]
        return film

    def clear(self, buffers: Any) -> None:
        for part in ("sums", "squares", "counts"):
            buffers[self.name(part)].zero_()

    def develop(self, buffers: Any, background: np.ndarray, *, scatter: bool = False) -> Developed:
        """The estimate that the buffers hold; `background` as given to `data`. `scatter`: that as well."""
        h, w = self.window.height, self.window.width
        sums = buffers[self.name("sums")].numpy()
        squares = buffers[self.name("squares")].numpy()
        counts = buffers[self.name("counts")].numpy().astype(np.float64)
        total = counts.sum(axis=0)
        divisor = np.maximum(total, 1.0)[:, None]
        each = np.maximum(counts, 1.0)[:, :, None]
        mean = sums.sum(axis=0) / divisor
        halves = sums[:, :, :BASE_CHANNELS] / each
        # A sample changes the composite by P - a B + D, whose squares the kernel adds up.
        b = np.asarray(background, dtype=np.float64).reshape(-1, 3)

        def change(m: np.ndarray) -> np.ndarray:
            return m[..., P : P + 3] - m[..., A : A + 1] * b + m[..., D : D + 3]

        uneven = (counts[0] != counts[1]) & (counts.min(axis=0) > 0)
        own = None
        if scatter or uneven.any():
            own = np.maximum(squares / each - change(halves) ** 2, 0.0) / np.maximum(each - 1.0, 1.0)
        variance = np.zeros((len(total), 3))
        enough = total > 1
        spread = np.maximum(squares.sum(axis=0) / divisor - change(mean) ** 2, 0.0)
        variance[enough] = spread[enough] / (total[enough] - 1.0)[:, None]
        if own is not None:
            mean[uneven] = (sums[:, uneven] / each[:, uneven]).mean(axis=0)
            variance[uneven] = own[:, uneven].mean(axis=0) / 2.0

        def image(x: np.ndarray) -> np.ndarray:
            return x.reshape(h, w, -1)

        split = self.channels >= SPLIT_CHANNELS
        return Developed(
            window=self.window,
            P=image(mean[:, P : P + 3]),
            a=mean[:, A].reshape(h, w),
            D=image(mean[:, D : D + 3]),
            variance=image(variance),
            samples=total.reshape(h, w).astype(np.int64),
            halves=halves.reshape(2, h, w, BASE_CHANNELS),
            blocked=image(mean[:, 7:10]) if split else None,
            indirect=image(mean[:, 10:13]) if split else None,
            scatter=own.reshape(2, h, w, 3) if own is not None else None,
        )
