"""Sums of very many samples."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from mrbatch.film.accumulator import FilmData, FilmLayout, film_add, film_load, film_store, picture_data
from mrbatch.film.window import Window


@wp.kernel(enable_backward=False, module="unique")
def add_many(film: FilmData, value: float, count: int, out: wp.array(dtype=float)):
    total = film_load(film, 0, 0)
    naive = float(0.0)
    v = wp.vec3(value, -value, 0.5 * value)
    for _ in range(count):
        total = film_add(total, v, 0.0, v, wp.vec3(0.0, 0.0, 0.0))
        naive += value
    film_store(film, 0, 0, total, count)
    out[0] = naive


@pytest.mark.case("MC-06")
def test_a_million_samples_are_added_without_drift():
    """1e6 times .1 is 1e5 to 1e-6; a running sum in float32 gives 100958.34."""
    window = Window(0, 0, 1, 1)
    layout = FilmLayout(window)
    types = {"float64": wp.float64, "int32": wp.int32}
    buffers = {b.name: wp.zeros(b.shape, dtype=types[b.dtype], device="cpu") for b in layout.buffers()}
    black = np.zeros((1, 1, 3), np.float32)
    film = picture_data(window, black, "cpu")
    film = layout.data(buffers, black)
    naive = wp.zeros(1, dtype=float, device="cpu")
    wp.launch(add_many, 1, [film, 0.1, 1_000_000, naive], device="cpu")
    assert naive.numpy()[0] == pytest.approx(100958.34, abs=0.01)
    found = layout.develop(buffers, black)
    tenth = float(np.float32(0.1))
    np.testing.assert_allclose(found.P[0, 0], [tenth, -tenth, 0.5 * tenth], rtol=1e-9)
    assert found.P[0, 0, 0] * 1e6 == pytest.approx(1e5, rel=1e-6)
    assert found.samples[0, 0] == 1_000_000
