"""Noise without a reference: against noise that is known, and maps that come back as they were."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from mrbatch.metrics.noise import (
    LEVELS,
    MAX_BLOCKS,
    NoiseMap,
    noise_between,
    noise_map,
    noise_of,
    relative_square,
    unpack_codes,
)


def measured(truth, deviation, changed, seed, samples=64):
    """A picture as the mean of samples of known noise, with the variance of that mean."""
    rng = np.random.default_rng(seed)
    drawn = truth + deviation * rng.standard_normal((samples, *truth.shape))
    return drawn.mean(axis=0), drawn.var(axis=0, ddof=1) / samples


def test_the_estimate_is_the_error_against_the_truth():
    shape = (48, 64, 3)
    truth = np.random.default_rng(7).uniform(0.5, 2.0, shape)
    changed = np.zeros(shape[:2], bool)
    changed[5:40, 10:60] = True
    picture, variance = measured(truth, 0.4, changed, 1)
    found = noise_of(relative_square(picture, variance, changed), changed)
    mean = (truth[changed] ** 2).mean()
    weight = 1 / (truth[changed] ** 2 + 0.01 * mean)
    # What came out by chance (2 % standard deviation), and what was to be expected.
    assert found.relmse == pytest.approx(((picture - truth)[changed] ** 2 * weight).mean(), rel=0.08)
    assert found.low < 0.4**2 / 64 * weight.mean() < found.high
    assert found.pixels == changed.sum() and found.tiles == 12


def test_the_interval_holds_the_expectation_in_nearly_all_runs():
    shape, runs = (64, 64, 3), 200
    truth = np.full(shape, 1.0)
    changed = np.ones(shape[:2], bool)
    expected = 0.3**2 / 16 / 1.01
    inside = 0
    for seed in range(runs):
        picture, variance = measured(truth, 0.3, changed, seed, samples=16)
        # The picture's own noise moves the denominators: kept out of what is tested here.
        found = noise_of(relative_square(truth, variance, changed), changed)
        inside += found.low <= expected <= found.high
    # 95 %, with 16 tiles and a normal law a little less; at least 3 standard deviations of the binomial.
    assert inside / runs > 0.93 - 3 * math.sqrt(0.95 * 0.05 / runs)


def test_nothing_changed_and_one_tile():
    nothing = np.zeros((32, 32), bool)
    assert noise_of(np.zeros((32, 32)), nothing).relmse == 0.0
    one = nothing.copy()
    one[3, 3] = True
    found = noise_of(np.where(one, 0.25, 0.0), one)
    assert (found.relmse, found.low, found.high, found.tiles) == (0.25, 0.0, math.inf, 1)


def test_tiles_count_from_the_frames_first_pixel():
    changed = np.ones((16, 16), bool)
    assert noise_of(np.ones((16, 16)), changed, (8, 8)).tiles == 4


def test_a_map_comes_back_through_json():
    changed = np.zeros((270, 480), bool)
    changed[100:200, 50:300] = True
    relative = np.where(changed, 0.04, 0.0)
    found = noise_map(relative, changed)
    assert found.block == 8 and found.codes.shape == (34, 60)
    stored = json.loads(json.dumps(found.as_dict()))
    codes = unpack_codes(stored["columns"], stored["rows"], stored["codes"])
    np.testing.assert_array_equal(codes, found.codes)
    amplitudes = NoiseMap.amplitudes(codes)
    assert np.isnan(amplitudes[0, 0])
    # Levels are 11.8 % apart, so a code is off by 6 % at most.
    np.testing.assert_allclose(amplitudes[np.isfinite(amplitudes)], 0.2, rtol=0.06)


def test_maps_of_large_and_odd_pictures_stay_small():
    for shape in ((1, 1), (2161, 4097), (1, 100_000)):
        found = noise_map(np.full(shape, 9.0), np.ones(shape, bool))
        assert found.codes.size <= MAX_BLOCKS and (found.codes == LEVELS).all()


@pytest.mark.parametrize("codes", ["", "&&&", "eJw=", "AAAA"])
def test_damaged_maps_are_refused(codes):
    with pytest.raises(ValueError, match="map"):
        unpack_codes(4, 4, codes)
    with pytest.raises(ValueError, match="map"):
        unpack_codes(10**6, 10**6, codes)


def test_halves_tell_the_variance_of_their_mean():
    rng = np.random.default_rng(3)
    a, b = rng.normal(2.0, 0.5, (2, 200, 300, 3))
    expected = 0.5**2 / 2
    # 180,000 values of a chi-square law with one degree of freedom: 4 standard deviations.
    assert noise_between(a, b).mean() == pytest.approx(expected, rel=4 * math.sqrt(2 / a.size))
