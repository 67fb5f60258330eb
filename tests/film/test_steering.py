"""Rounds of samples that differ from tile to tile and from half to half."""

from __future__ import annotations

import numpy as np
import warp as wp

from mrbatch.film.accumulator import FilmLayout
from mrbatch.film.steering import groups
from mrbatch.film.window import Window


def test_tiles_with_equal_counts_go_together():
    done = np.array([4, 4, 8, 8, 4])
    more = np.array([2, 2, 2, 0, 4])
    found = [(first, count, tiles.tolist()) for first, count, tiles in groups(done, more)]
    assert found == [(4, 2, [0, 1]), (4, 4, [4]), (8, 2, [2])]
    assert groups(done, np.zeros(5, dtype=int)) == []


def film(counts: tuple[int, int], samples: list[np.ndarray]):
    """A window of one pixel on black, with these samples of P in its halves."""
    layout = FilmLayout(Window(0, 0, 1, 1))
    sums, squares = np.zeros((2, 1, 7)), np.zeros((2, 1, 3))
    for half in (0, 1):
        sums[half, 0, :3] = samples[half].sum(axis=0)
        squares[half, 0] = (samples[half] ** 2).sum(axis=0)
    arrays = {
        "sums": wp.array(sums, dtype=wp.float64),
        "squares": wp.array(squares, dtype=wp.float64),
        "counts": wp.array(np.array(counts, np.int32).reshape(2, 1), dtype=wp.int32),
    }
    buffers = {layout.name(part): value for part, value in arrays.items()}
    return layout.develop(buffers, np.zeros((1, 1, 3), np.float32), scatter=True)


def test_halves_weigh_alike_whatever_their_counts():
    random = np.random.default_rng(1)
    samples = [random.gamma(2.0, 1.0, (n, 3)) for n in (4, 20)]
    found = film((4, 20), samples)
    means = np.stack([s.mean(axis=0) for s in samples])
    np.testing.assert_allclose(found.P[0, 0], means.mean(axis=0), rtol=1e-12)
    own = np.stack([s.var(axis=0, ddof=1) / len(s) for s in samples])
    np.testing.assert_allclose(found.scatter[:, 0, 0], own, rtol=1e-10)
    np.testing.assert_allclose(found.variance[0, 0], own.sum(axis=0) / 4, rtol=1e-10)
    assert found.samples[0, 0] == 24


def test_even_halves_are_one_mean():
    random = np.random.default_rng(2)
    samples = [random.gamma(2.0, 1.0, (8, 3)) for _ in range(2)]
    found = film((8, 8), samples)
    every = np.concatenate(samples)
    np.testing.assert_allclose(found.P[0, 0], every.mean(axis=0), rtol=1e-12)
    np.testing.assert_allclose(found.variance[0, 0], every.var(axis=0, ddof=1) / 16, rtol=1e-10)
