"""Statistics for claims about pictures and seconds: every claim carries an interval or a p-value.

Seeds are arguments: the same call gives the same interval. Sums run in float64.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from mrbatch.metrics.tiles import tile_sums


@dataclass(frozen=True)
class Interval:
    """A figure with its confidence interval."""

    value: float
    low: float
    high: float
    confidence: float
    repetitions: int
    """How many observations stand behind the figure."""

    @property
    def half_width(self) -> float:
        return 0.5 * (self.high - self.low)


# --- moments -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Moments:
    """Count, mean and sum of squared deviations of each element of arrays seen so far.

    `merged` is the pairwise update of Chan, Golub and LeVeque (1979), which with one value on the
    right is Welford's; both are stable where the mean is large against the deviation. `mean` and `m2`
    are float64 arrays of one shape, or scalars.
    """

    count: int
    mean: np.ndarray
    m2: np.ndarray

    @staticmethod
    def of(samples: np.ndarray) -> Moments:
        """Over the first axis of `samples`."""
        a = np.asarray(samples, dtype=np.float64)
        if a.ndim == 0 or a.shape[0] == 0:
            raise ValueError("moments need at least one sample")
        mean = a.mean(axis=0)
        return Moments(a.shape[0], mean, ((a - mean) ** 2).sum(axis=0))

    def merged(self, other: Moments) -> Moments:
        count = self.count + other.count
        delta = other.mean - self.mean
        mean = self.mean + delta * (other.count / count)
        m2 = self.m2 + other.m2 + delta * delta * (self.count * other.count / count)
        return Moments(count, mean, m2)

    @property
    def variance(self) -> np.ndarray:
        """Unbiased variance of one sample; NaN after a single one."""
        if self.count < 2:
            return np.full(np.shape(self.mean), np.nan)
        return np.asarray(self.m2 / (self.count - 1))

    @property
    def variance_of_mean(self) -> np.ndarray:
        return self.variance / self.count


# --- two pictures ------------------------------------------------------------------------------


@dataclass(frozen=True)
class TileTest:
    """Outcome of `tile_z_test`.

    `z`: (tile rows, tile columns, channels) float64, NaN where a tile has no pixel in the region.
    `limit`: the |z| that one of `tests` may reach; `p`: family-wise p-value of the largest |z|.
    `worst_tile`: (row, column) of it. `rms`: root mean square of z, 1 where the variances are right.
    `difference`: mean of a - b over the region and channels relative to the mean of b, with interval.
    """

    passed: bool
    z: np.ndarray
    largest: float
    limit: float
    p: float
    tests: int
    worst_tile: tuple[int, int]
    rms: float
    difference: Interval


def tile_z_test(
    a: np.ndarray,
    b: np.ndarray,
    variance_a: np.ndarray,
    variance_b: np.ndarray | float = 0.0,
    *,
    region: np.ndarray | None = None,
    origin: tuple[int, int] = (0, 0),
    sigma: float = 4.0,
    rounding: float = 0.0,
    confidence: float = 0.99,
) -> TileTest:
    """Do two pictures (height, width, 3) differ by more than their noise, on any 16x16 tile?

    `variance_a`, `variance_b`: variance of each pixel's *mean*, shaped like the pictures; pixels must
    be independent (true for importance-sampled filters, not after a reconstruction filter or a
    denoiser). z is the tile's summed difference over the root of its summed variances, a figure for
    each channel. With n figures, the largest may reach the two-sided Sidak limit that one figure
    exceeds with probability 1 - (1 - p)^(1/n), p the two-sided probability of `sigma`. Channels share
    their paths; Sidak's inequality keeps the limit valid for dependent Gaussians.

    `rounding`: half the relative spacing of a stored value (2^-11 for half floats). It is a bias that
    does not average out over equal pixels, so it is taken off the tile's difference instead of being
    added to its variance. A tile without variance is then compared exactly.

    Raises ValueError for shapes that differ, negative or non-finite variances, or an empty region.
    """
    from scipy.stats import norm

    x, y = _planes(a), _planes(b)
    if x.shape != y.shape:
        raise ValueError(f"pictures of shapes {x.shape} and {y.shape}")
    variance = np.broadcast_to(_planes(variance_a), x.shape) + np.broadcast_to(_planes(variance_b), x.shape)
    inside = np.ones(x.shape[:2], bool) if region is None else np.asarray(region, bool)
    if not inside.any():
        raise ValueError("the region is empty")
    if not np.all(np.isfinite(x[inside]) & np.isfinite(y[inside])):
        raise ValueError("a picture has values that are not finite")
    if not np.all((variance[inside] >= 0) & np.isfinite(variance[inside])):
        raise ValueError("variances must be finite and not negative")
    keep = inside[..., None]
    difference = tile_sums(np.where(keep, x - y, 0.0), origin)
    spread = tile_sums(np.where(keep, variance, 0.0), origin)
    slack = rounding * tile_sums(np.where(keep, np.abs(x) + np.abs(y), 0.0), origin)
    filled = tile_sums(inside, origin) > 0
    beyond = np.sign(difference) * np.maximum(np.abs(difference) - slack, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        z = np.where(
            spread > 0, beyond / np.sqrt(spread), np.where(beyond == 0, 0.0, np.sign(beyond) * np.inf)
        )
    z[~filled] = np.nan

    tests = int(filled.sum()) * x.shape[2]
    limit = sidak_limit(sigma, tests)
    magnitude = np.where(np.isnan(z), -1.0, np.abs(z)).max(axis=2)
    row, column = np.unravel_index(int(np.argmax(magnitude)), magnitude.shape)
    largest = float(magnitude[row, column])
    p_one = 2.0 * norm.sf(largest)
    p = float(-np.expm1(tests * np.log1p(-p_one))) if p_one < 1.0 else 1.0

    n = inside.sum() * x.shape[2]
    scale = float(np.abs(y[inside]).mean())
    mean = float(difference.sum() / n)
    # Channels of one pixel share paths: their errors are taken as fully correlated (no covariance is known).
    error = math.sqrt(float((np.sqrt(variance[inside]).sum(axis=1) ** 2).sum())) / n
    half = float(norm.isf(0.5 * (1 - confidence))) * error
    unit = 1.0 / scale if scale > 0 else (0.0 if mean == 0 and half == 0 else math.inf)
    relative = Interval(
        mean * unit, (mean - half) * unit, (mean + half) * unit, confidence, int(inside.sum())
    )
    rms = float(np.sqrt(np.nanmean(z * z)))
    return TileTest(largest <= limit, z, largest, limit, p, tests, (int(row), int(column)), rms, relative)


def sidak_limit(sigma: float, tests: int) -> float:
    """|z| that the largest of `tests` figures exceeds as rarely as one figure exceeds `sigma`."""
    from scipy.stats import norm

    p = 2.0 * float(norm.sf(sigma))
    one = -math.expm1(math.log1p(-p) / max(tests, 1))
    return float(norm.isf(0.5 * one))


# --- intervals ---------------------------------------------------------------------------------


def bootstrap_interval(
    statistic: Callable[..., np.ndarray],
    *samples: Sequence[float] | np.ndarray,
    seed: int,
    confidence: float = 0.95,
    resamples: int = 9999,
    method: Literal["percentile", "bca"] = "bca",
) -> Interval:
    """Bootstrap interval of `statistic(*samples, axis=-1)`; several samples are resampled in pairs.

    BCa (Efron 1987) corrects bias and skew of smooth statistics; for medians and other quantiles the
    percentile interval is the sound one. Where no resample differs, the interval is the value.

    Raises ValueError for samples of different lengths or fewer than two observations.
    """
    from scipy.stats import bootstrap

    arrays = [np.asarray(s, dtype=np.float64).ravel() for s in samples]
    n = arrays[0].size if arrays else 0
    if n < 2 or any(s.size != n for s in arrays):
        raise ValueError("a paired bootstrap needs two or more observations, as many in each sample")
    value = float(statistic(*arrays, axis=-1))
    if all(np.all(s == s[0]) for s in arrays):
        return Interval(value, value, value, confidence, n)
    found = bootstrap(
        arrays,
        statistic,
        paired=len(arrays) > 1,
        vectorized=True,
        n_resamples=resamples,
        batch=max(1, 2_000_000 // n),
        confidence_level=confidence,
        method="BCa" if method == "bca" else "percentile",
        rng=np.random.default_rng(seed),
    )
    low, high = (float(v) for v in found.confidence_interval)
    if math.isnan(low) or math.isnan(high):
        # BCa has no acceleration where all jackknife values agree; every resample then tells the same.
        spread = found.bootstrap_distribution
        tail = 50.0 * (1.0 - confidence)
        low, high = (float(v) for v in np.percentile(spread, [tail, 100.0 - tail]))
    return Interval(value, low, high, confidence, n)


def _median_of_ratios(a: np.ndarray, b: np.ndarray, axis: int = -1) -> np.ndarray:
    return np.median(a / b, axis=axis)


def paired_ratio(
    a: Sequence[float],
    b: Sequence[float],
    *,
    seed: int,
    confidence: float = 0.95,
    resamples: int = 9999,
) -> Interval:
    """Median of a[i] / b[i] with its bootstrap interval: how many times more A takes than B.

    The pairs are timed interleaved, so that what slows the machine down slows both.
    Raises ValueError unless all figures are positive.
    """
    x, y = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    if np.any(x <= 0) or np.any(y <= 0):
        raise ValueError("ratios need positive figures")
    return bootstrap_interval(
        _median_of_ratios, x, y, seed=seed, confidence=confidence, resamples=resamples, method="percentile"
    )


# --- tests -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class ChiSquare:
    """Outcome of `chi_square_test`; `cells` counts those left after pooling."""

    statistic: float
    degrees: int
    p: float
    cells: int


def chi_square_test(
    observed: np.ndarray, expected: np.ndarray, *, minimum: float = 5.0, fitted: int = 0
) -> ChiSquare:
    """Goodness of fit of counts to expected counts (any shape), small cells pooled first.

    Cells are pooled in order of expectation until each pool expects `minimum`, as the chi-square law
    asks for; a rest below it joins the last pool. A count in a cell that expects nothing refutes the
    model (p = 0). `expected` is scaled to the observed total only where it agrees within 1e-6;
    `fitted`: parameters estimated from the data.

    Raises ValueError for negative or non-finite figures, or totals that disagree.
    """
    from scipy.stats import chi2

    o = np.asarray(observed, dtype=np.float64).ravel()
    e = np.asarray(expected, dtype=np.float64).ravel()
    if o.shape != e.shape or not np.all(np.isfinite(o) & np.isfinite(e) & (o >= 0) & (e >= 0)):
        raise ValueError("observed and expected counts must be finite, not negative, and as many")
    if o.sum() <= 0 or abs(o.sum() - e.sum()) > 1e-6 * o.sum():
        raise ValueError(f"totals disagree: observed {o.sum():g}, expected {e.sum():g}")
    if np.any(o[e == 0] > 0):
        return ChiSquare(math.inf, 0, 0.0, int((e > 0).sum()))
    o, e = o[e > 0], e[e > 0] * (o.sum() / e.sum())
    order = np.argsort(e, kind="stable")
    pools: list[list[float]] = []
    got = want = 0.0
    for i in order:
        got, want = got + o[i], want + e[i]
        if want >= minimum:
            pools.append([got, want])
            got = want = 0.0
    if want > 0.0:
        if pools:
            pools[-1][0] += got
            pools[-1][1] += want
        else:
            pools.append([got, want])
    table = np.array(pools)
    degrees = len(pools) - 1 - fitted
    if degrees < 1:
        return ChiSquare(0.0, 0, 1.0, len(pools))
    statistic = float(((table[:, 0] - table[:, 1]) ** 2 / table[:, 1]).sum())
    return ChiSquare(statistic, degrees, float(chi2.sf(statistic, degrees)), len(pools))


@dataclass(frozen=True)
class Slope:
    """y = factor x^slope, with the slope's interval."""

    slope: Interval
    factor: float


def log_log_slope(x: Sequence[float], y: Sequence[float], *, confidence: float = 0.95) -> Slope:
    """Least-squares slope of log y over log x with its Student interval (three points or more)."""
    from scipy.stats import linregress, t

    a, b = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
    if a.size < 3 or a.size != b.size or np.any(a <= 0) or np.any(b <= 0):
        raise ValueError("a slope needs three or more points with positive coordinates")
    fit = linregress(np.log(a), np.log(b))
    half = float(t.isf(0.5 * (1 - confidence), a.size - 2)) * float(fit.stderr)
    slope = float(fit.slope)
    return Slope(
        Interval(slope, slope - half, slope + half, confidence, a.size), float(np.exp(fit.intercept))
    )


@dataclass(frozen=True)
class Equivalence:
    """Outcome of `equivalence_test`: `pass`, `fail`, or `inconclusive` (which must not count as passed)."""

    outcome: Literal["pass", "fail", "inconclusive"]
    difference: Interval
    tolerance: float

    @property
    def passed(self) -> bool:
        return self.outcome == "pass"


def equivalence_test(
    difference: float,
    standard_error: float,
    tolerance: float,
    *,
    confidence: float = 0.99,
    observations: int | None = None,
) -> Equivalence:
    """Is a difference shown to be within +-tolerance? Its interval must lie inside.

    `pass`: the interval lies within the tolerance; `fail`: it lies wholly outside; `inconclusive`: it
    reaches across, so that the measurement has not the power to tell. With `observations` n, Student's
    law with n - 1 degrees replaces the normal one. Raises ValueError for a negative or NaN figure.
    """
    from scipy.stats import norm, t

    if not (standard_error >= 0 and tolerance >= 0 and math.isfinite(difference)):
        raise ValueError("expected a finite difference and errors and tolerances that are not negative")
    tail = 0.5 * (1.0 - confidence)
    if observations is not None and observations < 2:
        raise ValueError("an interval needs two or more observations")
    z = float(norm.isf(tail) if observations is None else t.isf(tail, observations - 1))
    half = z * standard_error
    low, high = difference - half, difference + half
    if -tolerance <= low and high <= tolerance:
        outcome: Literal["pass", "fail", "inconclusive"] = "pass"
    elif low > tolerance or high < -tolerance:
        outcome = "fail"
    else:
        outcome = "inconclusive"
    return Equivalence(outcome, Interval(difference, low, high, confidence, observations or 0), tolerance)


def _planes(values: np.ndarray | float) -> np.ndarray:
    a = np.asarray(values, dtype=np.float64)
    return a[..., None] if a.ndim == 2 else a
