"""The region of interest against distances written out."""

from __future__ import annotations

import numpy as np
import pytest

from mrbatch.errors import InputError
from mrbatch.metrics.region import (
    dilate,
    noise_deviation,
    noisy_region_of_interest,
    region_of_interest,
)


def test_region_is_the_change_and_a_disc_of_eight_pixels():
    without = np.full((40, 60, 3), 0.5)
    with_objects = without.copy()
    with_objects[20, 30, 2] += 0.01
    mask = region_of_interest(with_objects, without)
    rows, columns = np.mgrid[:40, :60]
    np.testing.assert_array_equal(mask, (rows - 20) ** 2 + (columns - 30) ** 2 <= 64)


def test_threshold_is_half_a_per_cent_of_the_mean_in_the_largest_channel():
    without = np.full((30, 30, 3), 1.0)
    just_under, just_over = without.copy(), without.copy()
    just_under[5, 5, 0] -= 0.0049
    just_over[5, 5, 0] -= 0.0051
    assert not region_of_interest(just_under, without).any()
    assert region_of_interest(just_over, without, dilation=0).sum() == 1


def test_noise_does_not_become_region_where_its_deviation_is_known():
    rng = np.random.default_rng(5)
    without = np.full((48, 48, 3), 1.0)
    noisy = without + rng.normal(0, 0.01, without.shape)
    noisy[10:14, 10:14] -= 0.3
    naive = region_of_interest(noisy, without)
    mask = region_of_interest(noisy, without, deviation=np.full(without.shape, 0.01))
    assert naive.mean() > 0.99
    assert mask[12, 12] and mask.mean() < 0.25


def test_panorama_is_dilated_across_its_seam_and_weighted():
    without = np.full((32, 64, 3), 1.0)
    with_objects = without.copy()
    with_objects[16, 0] = 2.0
    mask = region_of_interest(with_objects, without, projection="equirectangular")
    assert mask[16, 63] and mask[16, 56] and not mask[16, 55]
    assert not region_of_interest(with_objects, without)[16, 63]


def test_dilation_wider_than_the_picture():
    mask = np.zeros((3, 5), bool)
    mask[1, 1] = True
    assert dilate(mask, 100, wraps=True).all()
    assert not dilate(np.zeros((3, 5), bool), 8).any()


def test_sizes_must_agree():
    with pytest.raises(InputError, match="differ in size"):
        region_of_interest(np.ones((4, 4, 3)), np.ones((4, 5, 3)))


def test_noise_is_read_off_a_slope_and_a_step():
    rng = np.random.default_rng(8)
    rows, columns = np.mgrid[:240, :320]
    picture = 0.02 * rows + 0.01 * columns + 5.0 * (columns > 40)
    noisy = (picture + rng.normal(0, 0.05, picture.shape))[..., None]
    got = noise_deviation(noisy)[10:-10, 10:-10]
    assert np.median(got) == pytest.approx(0.05, rel=0.05)
    assert noise_deviation(picture[..., None])[10:-10, 10:-10].max() < 1e-6


def test_noisy_references_give_the_region_of_clean_ones():
    rng = np.random.default_rng(9)
    rows, columns = np.mgrid[:96, :128]
    shadow = 0.4 * np.exp(-((rows - 48) ** 2 + (columns - 64) ** 2) / (2 * 6.0**2))
    without = np.full((96, 128, 3), 0.5)
    clean = without * (1 - shadow[..., None])
    noisy = [p * (1 + rng.normal(0, 0.02, p.shape)) for p in (clean, without)]
    truth = region_of_interest(clean, without)
    got = noisy_region_of_interest(*noisy)
    assert region_of_interest(*noisy).mean() > 0.99
    # The faint rim lies below the noise: most of the region, and almost nothing besides it.
    assert (got & truth).sum() > 0.7 * truth.sum()
    assert (got & ~dilate(truth, 7)).sum() < 0.01 * got.size
