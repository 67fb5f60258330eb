"""Lone bright samples: no dots and no squares, the same light; and what is no speck stays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from filter_frames import apply, developed, real_frame, strip

from mrbatch.film.filter.signal import real_signal
from mrbatch.film.filter.specks import without_specks

H, W = 72, 96
KINDS = ["bilateral", "variance", "oidn"]


def speckled(height: float, places, light=-0.3, noise=0.02, seed=3, half=0):
    """An even change of light with noise, and specks that make one half brighter by `height` of light."""
    frame, guides = real_frame(np.full((H, W), light), noise, seed)
    halves = frame.halves.copy()
    for y, x in places:
        halves[half, y, x, 4:] += 0.8 * height
    return developed(halves), guides


def brought_back(frame):
    """D of each half after specks were brought back, or None."""
    found = without_specks(real_signal(*frame))
    return None if found is None else found.halves


@pytest.mark.parametrize("kind", KINDS)
def test_a_speck_leaves_neither_a_dot_nor_a_square_and_no_light_is_lost(kind):
    """It stands 5 above noise of 0.02. Spread over the filter's own window it would be 0.03 to 0.2."""
    places = [(30, 30), (38, 66)]
    before, after = real_frame(np.full((H, W), -0.3), 0.02, 3), speckled(5.0, places)
    clean, found = apply(kind, before).D, apply(kind, after).D
    added = found - clean
    # Two Gaussians of 8 pixels, each with the light of half a speck: 2.5 / (2 pi 64), and what noise does.
    assert np.abs(added).max() < 0.8 * (0.0062 + 0.006)
    kept = added.sum() / (after[0].D - before[0].D).sum()
    assert kept == pytest.approx(1.0, abs=0.02)


def test_all_light_of_specks_is_in_the_one_half_that_had_it():
    frame = speckled(5.0, [(20, 20), (21, 23), (50, 70)], half=1)
    halves = brought_back(frame)
    moved = np.argwhere(np.any(halves != frame[0].halves[..., 4:], axis=-1))
    assert moved.tolist() == [[1, 20, 20], [1, 21, 23], [1, 50, 70]]
    # Back to the other half, and off by no more than neighbours are.
    assert np.abs(halves[1] - halves[0])[20, 20].max() < 0.8 * 6 * 0.1


def test_dark_specks_are_told_from_their_bright_neighbours():
    frame = speckled(-5.0, [(20, 20)])
    halves = brought_back(frame)
    assert halves[0, 20, 20, 0] == pytest.approx(-0.24, abs=0.5)
    assert np.array_equal(halves[1], frame[0].halves[1, ..., 4:])


def test_what_both_halves_see_is_no_speck():
    """A highlight of one pixel, a line of one pixel, a step: all far above the noise."""
    light = np.full((H, W), -0.3)
    light[20, 20] = 50.0
    light[40, 10:80] = 8.0
    light[:, 85:] = -3.0
    assert brought_back(real_frame(light, 0.02)) is None


@pytest.mark.parametrize("kind", KINDS)
def test_two_specks_in_one_pixel_are_told_by_the_scatter_of_their_samples(kind):
    """Two samples of 32 bring all of it, one in each half: its variance is about half of its square. The same
    light from all samples alike is a highlight, and stays."""
    frame, guides = speckled(5.0, [(30, 40)])
    halves = frame.halves.copy()
    halves[1, 30, 40, 4:] += 0.8 * 5.1
    frame = developed(halves)
    variance = frame.variance.copy()
    variance[30, 40] = 2 * (16 * 4.0 / 32) ** 2
    found = apply(kind, (replace(frame, variance=variance), guides)).D
    assert np.abs(found[30, 40] + 0.24).max() < 0.03
    assert np.abs(found - apply(kind, real_frame(np.full((H, W), -0.3), 0.02, 3)).D).max() < 0.02
    if kind != "oidn":  # which takes single pixels away by itself, as far as the halves differ
        variance[30, 40] = (16 * 4.0 / 32) ** 2 / 10
        stays = apply(kind, (replace(frame, variance=variance), guides)).D
        assert stays[30, 40].min() > 2.0


@pytest.mark.parametrize("slope", [0.0, 0.37, 1.0])
def test_noise_along_the_edge_of_a_shadow_is_no_speck(slope):
    """Eight samples a half see the lamp or not; beside the pixels that the edge crosses all of them agree."""
    y, x = np.mgrid[:H, :W]
    below = y - 30 - slope * (x - 48)
    seen = np.clip(0.5 + below, 0.0, 1.0)
    crossed = (seen > 0) & (seen < 1)
    drawn = np.random.default_rng(4).binomial(8, np.broadcast_to(seen, (2, H, W))) / 8
    frame, guides = real_frame(np.zeros((H, W)), 1e-4)
    halves = frame.halves.copy()
    halves[..., 4:] += 0.8 * (-0.9 + 0.6 * drawn)[..., None]
    assert crossed.sum() > 30
    assert brought_back((developed(halves), guides)) is None


@pytest.mark.parametrize(("skew", "share"), [(False, 0.0), (True, 1e-3)])
def test_noise_that_is_alike_all_round_has_no_specks(skew, share):
    frame = real_frame(np.full((300, 400), -0.3), 0.05, seed=6, skew=skew)
    found = brought_back(frame)
    moved = 0 if found is None else np.any(found != frame[0].halves[..., 4:], axis=(0, -1)).mean()
    assert moved <= share


@pytest.mark.parametrize("kind", KINDS)
def test_a_speck_goes_out_of_the_part_that_brought_it(kind):
    """Direct light of -0.2 and indirect of -0.1, and a speck in the indirect one."""
    frame, guides = speckled(5.0, [(30, 40)])
    blocked = np.full(frame.D.shape, -0.16)
    frame = developed(frame.halves, indirect=frame.D - blocked, blocked=blocked)
    found = apply(kind, (frame, guides))
    np.testing.assert_allclose(found.blocked + found.indirect, found.D, rtol=1e-12)
    assert np.abs(found.blocked - blocked).max() < 0.02
    assert np.abs(found.indirect[30, 40] + 0.08).max() < 0.02


def test_specks_beside_a_shadow_do_not_move_its_edge():
    places = [(20, 44), (40, 45), (55, 43)]
    frame, guides = real_frame(strip(H, W, 48, W, -0.4), 0.02)
    halves = frame.halves.copy()
    for place in places:
        halves[0, place[0], place[1], 4:] += 4.0
    after = apply("variance", (developed(halves), guides)).D[..., 0]
    clean = apply("variance", (frame, guides)).D[..., 0]
    assert np.abs(after - clean).max() < 0.03
