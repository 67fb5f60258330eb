"""Statistics on simulated data: stated error rates are met, stated effects are found."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from mrbatch.metrics import statistics as s


def test_moments_merge_to_the_moments_of_all():
    rng = np.random.default_rng(0)
    data = rng.normal(1e6, 1.0, (100, 4))
    merged = s.Moments.of(data[:1])
    for row in data[1:37]:  # Welford: one at a time
        merged = merged.merged(s.Moments.of(row[None]))
    merged = merged.merged(s.Moments.of(data[37:]))
    np.testing.assert_allclose(merged.mean, data.mean(axis=0), rtol=1e-14)
    np.testing.assert_allclose(merged.variance, data.var(axis=0, ddof=1), rtol=1e-9)
    np.testing.assert_allclose(merged.variance_of_mean, data.var(axis=0, ddof=1) / 100, rtol=1e-9)
    assert np.isnan(s.Moments.of(data[:1]).variance).all()


def test_moments_of_a_huge_offset_where_sums_of_squares_fail():
    """Mean 1e8, deviation 1: E[x^2] - E[x]^2 in float64 keeps no digit of the variance."""
    rng = np.random.default_rng(0)
    data = 1e8 + rng.normal(0, 1.0, 1000)
    naive = (data**2).mean() - data.mean() ** 2
    parts = [s.Moments.of(part) for part in np.split(data, 10)]
    while len(parts) > 1:
        parts = [a.merged(b) for a, b in zip(parts[::2], parts[1::2])] + parts[len(parts) // 2 * 2 :]
    truth = math.fsum((x - math.fsum(data) / 1000) ** 2 for x in data) / 999
    assert float(parts[0].variance) == pytest.approx(truth, rel=1e-7)
    assert abs(naive - truth) > 0.05


def simulated(rng, shift=0.0, size=(64, 80, 3), deviation=0.05):
    truth = 0.5 + 0.4 * np.sin(np.arange(size[1]) / 9.0)[None, :, None] + np.zeros(size)
    sd = deviation * truth
    a = truth * (1 + shift) + rng.normal(size=size) * sd
    b = truth + rng.normal(size=size) * sd
    return a, b, sd**2


def test_tile_test_raises_false_alarms_at_the_stated_rate():
    """At 2 sigma family-wise, 4.55 % of 600 pairs of equal pictures may fail: 27 +- 5.1 (4 sigma: 7..48)."""
    rng = np.random.default_rng(11)
    results = []
    for _ in range(600):
        a, b, v = simulated(rng, size=(32, 48, 3))
        results.append(s.tile_z_test(a, b, v, v, sigma=2.0))
    alarms = sum(not r.passed for r in results)
    assert 7 <= alarms <= 48
    assert np.sqrt(np.mean([r.rms**2 for r in results])) == pytest.approx(1.0, abs=0.03)
    # The family-wise p-value is uniform under the hypothesis.
    assert stats.kstest([r.p for r in results], "uniform").pvalue > 1e-4
    assert results[0].tests == 2 * 3 * 3


def test_tile_test_finds_a_shift_of_one_per_cent_and_says_so():
    rng = np.random.default_rng(12)
    a, b, v = simulated(rng, size=(128, 160, 3))
    assert s.tile_z_test(a, b, v, v).passed
    a, b, v = simulated(rng, shift=0.01, size=(128, 160, 3), deviation=0.01)
    found = s.tile_z_test(a, b, v, v)
    assert not found.passed and found.largest > found.limit
    assert found.difference.low <= 0.01 <= found.difference.high
    assert found.difference.half_width < 0.002


def test_interval_of_the_difference_is_honest_for_correlated_channels():
    """Channels that share their noise: the 99 % interval still covers (>= 97 % of 300 runs)."""
    rng = np.random.default_rng(13)
    covered = 0
    for _ in range(300):
        noise = rng.normal(size=(32, 32, 1)) * 0.1
        a = 1.0 + np.repeat(noise, 3, axis=2)
        d = s.tile_z_test(a, np.ones_like(a), np.full(a.shape, 0.01)).difference
        covered += d.low <= 0.0 <= d.high
    assert 0.97 <= covered / 300 <= 1.0


def test_tile_test_finds_one_bad_tile_only_inside_the_region():
    rng = np.random.default_rng(14)
    a, b, v = simulated(rng, size=(64, 64, 3))
    a[16:32, 48:64] *= 1.05
    found = s.tile_z_test(a, b, v, v)
    assert not found.passed and found.worst_tile == (1, 3)
    region = np.ones((64, 64), bool)
    region[16:32, 48:64] = False
    rest = s.tile_z_test(a, b, v, v, region=region)
    assert rest.passed and rest.tests == 15 * 3 and np.isnan(rest.z[1, 3]).all()


def test_tiles_without_noise_are_compared_to_their_rounding():
    reference = np.full((16, 32, 3), 0.7001)
    stored = reference.astype(np.float16).astype(np.float64)
    none = np.zeros_like(reference)
    assert not s.tile_z_test(stored, reference, none).passed
    assert s.tile_z_test(stored, reference, none, rounding=2.0**-11).passed
    assert not s.tile_z_test(reference * 1.002, reference, none, rounding=2.0**-11).passed
    assert s.tile_z_test(reference, reference, none).passed


def test_sidak_limit_is_the_law_of_the_largest():
    """P(max of n |z| > limit) equals the two-sided probability of sigma, in closed form."""
    for n in (1, 10, 3000):
        limit = s.sidak_limit(3.0, n)
        p = 1 - (2 * stats.norm.cdf(limit) - 1) ** n
        assert p == pytest.approx(2 * stats.norm.sf(3.0), rel=1e-6)


@pytest.mark.parametrize(
    "change",
    [
        lambda a, b, v: (a, b, -v),
        lambda a, b, v: (a, b, v * np.nan),
        lambda a, b, v: (a * np.nan, b, v),
        lambda a, b, v: (a[1:], b, v),
    ],
)
def test_tile_test_refuses_nonsense(change):
    with pytest.raises(ValueError):
        s.tile_z_test(*change(*simulated(np.random.default_rng(0), size=(16, 16, 3))))


@pytest.mark.parametrize("method, least", [("percentile", 0.87), ("bca", 0.88)])
def test_bootstrap_interval_covers(method, least):
    """Mean of 40 exponentials: a 95 % interval covers 88 to 98 % in 400 runs (skewed, so somewhat less)."""
    rng = np.random.default_rng(2)
    covered = 0
    for run in range(400):
        data = rng.exponential(1.0, 40)
        got = s.bootstrap_interval(np.mean, data, seed=run, resamples=499, method=method)
        covered += got.low <= 1.0 <= got.high
    assert least <= covered / 400 <= 0.985


def test_bootstrap_is_paired_and_seeded():
    """Two noisy series whose difference is exact: unpaired resampling could not give a narrow interval."""
    rng = np.random.default_rng(3)
    common = rng.normal(0, 100.0, 30)
    a, b = common + 1.0 + rng.normal(0, 0.01, 30), common

    def difference(x, y, axis=-1):
        return np.mean(x - y, axis=axis)

    first = s.bootstrap_interval(difference, a, b, seed=1)
    assert first.half_width < 0.01 and first.low < 1.0 + 0.01 and first.high > 1.0 - 0.01
    assert first == s.bootstrap_interval(difference, a, b, seed=1)
    assert first != s.bootstrap_interval(difference, a, b, seed=2)


def test_bootstrap_of_equal_figures_is_the_figure():
    got = s.bootstrap_interval(np.mean, [2.0, 2.0, 2.0], seed=0)
    assert (got.low, got.value, got.high) == (2.0, 2.0, 2.0)
    with pytest.raises(ValueError):
        s.bootstrap_interval(np.mean, [2.0], seed=0)
    with pytest.raises(ValueError):
        s.bootstrap_interval(lambda x, y, axis: np.mean(x - y, axis=axis), [2.0, 1.0], [1.0], seed=0)


def test_paired_ratio_covers_and_forgets_the_machines_drift():
    rng = np.random.default_rng(4)
    covered = 0
    for run in range(200):
        drift = np.exp(np.cumsum(rng.normal(0, 0.3, 21)))
        a, b = (factor * drift * np.exp(rng.normal(0, 0.02, 21)) for factor in (1.5, 1.0))
        got = s.paired_ratio(a, b, seed=run, resamples=999)
        covered += got.low <= 1.5 <= got.high
        assert got.half_width < 0.1
    assert covered / 200 >= 0.90
    with pytest.raises(ValueError):
        s.paired_ratio([1.0, 0.0], [1.0, 1.0], seed=0)


def test_chi_square_agrees_with_scipy_where_nothing_is_pooled():
    rng = np.random.default_rng(5)
    expected = np.full(20, 50.0)
    observed = rng.multinomial(1000, expected / 1000)
    got = s.chi_square_test(observed, expected)
    truth = stats.chisquare(observed, expected)
    assert got.statistic == pytest.approx(truth.statistic) and got.p == pytest.approx(truth.pvalue)
    assert got.degrees == 19 and got.cells == 20


def test_chi_square_pools_small_cells_and_keeps_its_rate():
    """p is uniform for a law with many tiny cells; unpooled it is far from it."""
    rng = np.random.default_rng(6)
    p = np.concatenate([np.full(30, 0.03), np.full(2000, 0.1 / 2000)])
    ps = []
    for _ in range(400):
        got = s.chi_square_test(rng.multinomial(2000, p), 2000 * p)
        assert got.cells < 75
        ps.append(got.p)
    assert stats.kstest(ps, "uniform").pvalue > 1e-4
    wrong = p.copy()
    wrong[:15] *= 1.2
    wrong[15:30] *= 0.8
    assert s.chi_square_test(rng.multinomial(2000, wrong / wrong.sum()), 2000 * p).p < 1e-4


def test_chi_square_refuses_counts_where_nothing_is_expected():
    assert s.chi_square_test([10, 1], [11, 0]).p == 0.0
    assert s.chi_square_test([3], [3.0]).p == 1.0
    with pytest.raises(ValueError):
        s.chi_square_test([10, 10], [10, 5])


def test_slope_covers_and_is_exact_without_noise():
    x = np.array([1, 4, 16, 64, 256.0])
    exact = s.log_log_slope(x, 3.0 / x)
    assert exact.slope.value == pytest.approx(-1.0) and exact.factor == pytest.approx(3.0)
    rng = np.random.default_rng(7)
    covered = 0
    for _ in range(500):
        slope = s.log_log_slope(x, x**-1.0 * np.exp(rng.normal(0, 0.1, x.size))).slope
        covered += slope.low <= -1.0 <= slope.high
    assert 0.91 <= covered / 500 <= 0.985  # 95 % +- 4 standard errors of 500 runs
    with pytest.raises(ValueError):
        s.log_log_slope([1, 2], [1, 2])


@pytest.mark.parametrize(
    "difference, error, outcome",
    [
        (0.000, 0.001, "pass"),
        (0.007, 0.001, "pass"),
        (0.000, 0.010, "inconclusive"),
        (0.009, 0.001, "inconclusive"),
        (0.050, 0.001, "fail"),
        (-0.050, 0.001, "fail"),
        (0.050, 0.100, "inconclusive"),
        (0.010, 0.0, "pass"),
    ],
)
def test_equivalence_needs_power(difference, error, outcome):
    got = s.equivalence_test(difference, error, 0.01)
    assert got.outcome == outcome and got.passed == (outcome == "pass")
    assert got.difference.half_width == pytest.approx(2.5758293 * error)


def test_equivalence_of_few_runs_uses_students_law():
    got = s.equivalence_test(0.0, 0.001, 0.01, observations=4)
    assert got.difference.half_width == pytest.approx(0.001 * stats.t.ppf(0.995, 3))
    with pytest.raises(ValueError):
        s.equivalence_test(math.nan, 0.001, 0.01)
