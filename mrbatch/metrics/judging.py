"""From numbers to the outcome of a hard case: means, largest differences, counts, bits."""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from mrbatch.contracts import Measurement

SIGMAS = 4.0
CONFIDENCE = 0.99
POWER = 0.01
"""Share of the oracle that a mean must be able to tell, where a case does not say another."""
RARE = 1e-4
"""p-value below which a distribution is refuted."""
Numbers = ArrayLike
Arrays = Sequence[np.ndarray] | np.ndarray


def mean_within(
    found: Numbers,
    error: Numbers,
    oracle: Numbers,
    tolerance: float,
    *,
    sees: float | None = None,
    observations: int = 64,
    radiance: tuple[np.ndarray, ...] = (),
    signed: tuple[np.ndarray, ...] = (),
) -> Measurement:
    """Whether |found - oracle| stays within the tolerance plus four standard errors, everywhere.

    And whether that could have told a difference of `sees` (an amount; by default 1 % of the oracle, but at
    least the tolerance): the 99 % interval of the difference must lie within it, else the measurement is
    inconclusive. `observations`: how many independent ones each error is of.
    """
    found, error, oracle = np.broadcast_arrays(
        *(np.atleast_1d(np.asarray(x, dtype=np.float64)) for x in (found, error, oracle))
    )
    finite = np.isfinite(found) & np.isfinite(error)
    difference = np.where(finite, np.abs(found - oracle), np.inf)
    spread = np.where(finite, error, 0.0)
    excess = difference - tolerance - SIGMAS * spread
    span = np.maximum(tolerance, POWER * np.abs(oracle) if sees is None else np.full(oracle.shape, sees))
    blind = difference + _quantile(observations) * spread - span
    passed, conclusive = bool(np.all(excess <= 0.0)), bool(np.all(blind <= 0.0))
    worst = int(np.argmax(blind if passed else excess))
    return Measurement(
        passed=passed,
        measured=f"{found.flat[worst]:+.6g} (SE {error.flat[worst]:.1e})",
        oracle=f"{oracle.flat[worst]:+.6g}",
        tolerance=f"{tolerance:.3g} + {SIGMAS:g} SE; tells {span.flat[worst]:.2g}",
        conclusive=conclusive,
        radiance=radiance,
        signed=signed,
    )


@functools.cache
def _quantile(observations: int) -> float:
    """Student's quantile of a two-sided interval of 99 %."""
    from scipy.stats import t

    return float(t.isf(0.5 * (1.0 - CONFIDENCE), observations - 1))


def within(
    found: Numbers, oracle: Numbers, tolerance: Numbers, *, relative: bool = False, what: str = ""
) -> Measurement:
    """Whether every |found - oracle| is at most `tolerance`, times |oracle| where `relative`.

    The worst is told: the one that comes nearest to its tolerance, or is farthest beyond. Raises ValueError
    where there is nothing to compare.
    """
    found, oracle, room = np.broadcast_arrays(
        *(np.atleast_1d(np.asarray(x, dtype=np.float64)) for x in (found, oracle, tolerance))
    )
    if found.size == 0:
        raise ValueError("there is nothing to compare")
    limit = room * np.abs(oracle) if relative else room
    same = found == oracle
    with np.errstate(invalid="ignore", divide="ignore"):
        difference = np.where(same, 0.0, np.abs(found - oracle))
        difference = np.where(np.isnan(difference), np.inf, difference)
        share = np.where(difference == 0.0, 0.0, difference / limit)
    worst = int(np.argmax(share))
    off = difference.flat[worst] / abs(oracle.flat[worst]) if relative and difference.flat[worst] else None
    many = f" ({found.size:,} values)" if found.size > 1 else ""
    text = f"{difference.flat[worst]:.3g}" if off is None else f"{off:.3g} of it"
    return Measurement(
        passed=bool(np.all(difference <= limit)),
        measured=f"{what}{': ' if what else ''}off by {text} at most{many}",
        oracle=f"{oracle.flat[worst]:.6g}" if np.ptp(oracle) == 0 else f"{oracle.size:,} values",
        tolerance=f"{room.flat[worst]:.3g}{' of it' if relative else ''}",
    )


def none(wrong: ArrayLike, what: str) -> Measurement:
    """Whether none of the truth values (any shape) is true; `what` they would be: `rays that escape`."""
    flags = np.asarray(wrong, dtype=bool)
    return Measurement(not flags.any(), f"{int(flags.sum()):,} of {flags.size:,} {what}", "0", "exact")


def same_bits(one: Arrays, other: Arrays) -> Measurement:
    """Whether arrays (pairwise) have the same shape, type and bits."""
    pairs = list(zip(_listed(one), _listed(other), strict=True))
    wrong = sum(
        a.size if a.shape != b.shape or a.dtype != b.dtype else int((_bits(a) != _bits(b)).sum())
        for a, b in pairs
    )
    total = sum(a.size for a, _ in pairs)
    return Measurement(wrong == 0, f"{wrong:,} of {total:,} values differ", "the same", "bits")


def _listed(arrays: Arrays) -> list[np.ndarray]:
    return [np.ascontiguousarray(a) for a in ([arrays] if isinstance(arrays, np.ndarray) else arrays)]


def _bits(a: np.ndarray) -> np.ndarray:
    return a.view(f"u{a.dtype.itemsize}")


def follows(p: float, what: str = "chi-square") -> Measurement:
    """Whether a p-value does not refute the distribution."""
    return Measurement(p > RARE, f"{what} p {p:.3g}", "the distribution", f"p > {RARE:g}")


def together(*parts: Measurement) -> Measurement:
    """All of them: where some failed they are told alone; of many the first ones are told."""
    broken = [p for p in parts if not p.passed] or [p for p in parts if not p.conclusive]
    told = broken or list(parts)
    return Measurement(
        passed=all(p.passed for p in parts),
        measured=_few([p.measured for p in told]),
        oracle=_few([p.oracle for p in told]),
        tolerance=_few([p.tolerance for p in told]),
        conclusive=all(p.conclusive for p in parts),
        radiance=tuple(a for p in parts for a in p.radiance),
        signed=tuple(a for p in parts for a in p.signed),
    )


def _few(texts: list[str], most: int = 3) -> str:
    found = list(dict.fromkeys(texts))
    return "; ".join([*found[:most], *([f"and {len(found) - most} more"] if len(found) > most else [])])
