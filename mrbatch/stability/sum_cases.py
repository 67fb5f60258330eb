"""Hard cases of adding up (MC): a million samples in one pixel."""

from __future__ import annotations

import numpy as np
import warp as wp

from mrbatch.contracts import Case, Measurement
from mrbatch.film.accumulator import FilmData, FilmLayout, film_add, film_load, film_store
from mrbatch.film.window import Window
from mrbatch.metrics.judging import together, within


@wp.kernel(enable_backward=False, module="unique")
def _add_many(film: FilmData, value: float, count: int):
    total = film_load(film, 0, 0)
    v = wp.vec3(value, -value, 0.5 * value)
    for _ in range(count):
        total = film_add(total, v, 0.0, v, wp.vec3(0.0, 0.0, 0.0))
    film_store(film, 0, 0, total, count)


def million(count: int = 1_000_000) -> tuple[np.ndarray, int]:
    """(3,) mean of P of one pixel that gets .1, -.1, .05 a million times, and its samples."""
    layout = FilmLayout(Window(0, 0, 1, 1))
    types = {"float64": wp.float64, "int32": wp.int32}
    buffers = {b.name: wp.zeros(b.shape, dtype=types[b.dtype], device="cpu") for b in layout.buffers()}
    black = np.zeros((1, 1, 3), np.float32)
    wp.launch(_add_many, 1, [layout.data(buffers, black), 0.1, count], device="cpu")
    found = layout.develop(buffers, black)
    return found.P[0, 0], int(found.samples[0, 0])


def drift(seed: int) -> Measurement:
    """MC-06: 1e6 times .1 is 1e5, and every sample is counted."""
    mean, samples = million()
    tenth = float(np.float32(0.1))
    return together(
        within(mean, np.array([tenth, -tenth, 0.5 * tenth]), 1e-9, relative=True, what="mean"),
        within(mean[0] * 1e6, 1e5, 1e-6, relative=True, what="sum"),
        within(samples, 1_000_000, 0, what="samples"),
    )


CASES: tuple[Case, ...] = (
    Case("MC-06", "a million samples are added without drift", drift, setup="1e6 times .1 in one pixel"),
)
