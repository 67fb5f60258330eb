"""Which of two is faster, or more exact: claims from figures taken in turns, all of a family together.

Every turn measures each candidate once, in an order drawn at random. If two candidates take equally long,
which of both gets the slower moment of a turn is then a fair coin, whatever the machine does: drift, bursts
and heavy tails are in the moments, not in the coins. Wilcoxon's signed-rank test of the logarithms of the
paired ratios (Wilcoxon 1945), with its exact distribution over the coins, is therefore exact, and one turn
that went wrong by any amount counts as one rank. Two candidates that differ by a factor shift the ratios
by it.

A claim says more than "not equal": that the ratio is beyond a margin. Where a program's code and data come
to lie makes about a per cent of difference that another run does not repeat.

All claims of a family hold together: Holm's procedure (1979) over both directions of every pair keeps the
probability that any of them is wrong below `ALPHA`, however the figures depend on each other.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from mrbatch.metrics.statistics import Interval, paired_ratio

ALPHA = 0.01
MARGIN = 0.03
"""A ratio within 1 +- this is no difference."""
TELLING = 1.25
"""The ratio that turns are counted for: pairs further apart than that should be told apart."""
POWER = 0.9
Outcome = Literal["less", "more", "undecided"]


@dataclass(frozen=True)
class Claim:
    """What can be said of `first` over `second`: it is `less` or `more` by over the margin, or `undecided`.

    `ratio`: median of the paired ratios with its 95 % interval. `p`: of the direction that the figures lean
    to, after Holm's correction.
    """

    first: str
    second: str
    outcome: Outcome
    ratio: Interval
    p: float


def signed_rank_p(x: Sequence[float] | np.ndarray) -> float:
    """One-sided p-value of "the centre of x is above 0" by Wilcoxon's signed-rank test.

    Exact over the signs, conditional on the magnitudes, with ties as they are; zeros are left out.
    Raises ValueError for values that are not finite.
    """
    values = np.asarray(x, dtype=np.float64).ravel()
    if not np.all(np.isfinite(values)):
        raise ValueError("a signed-rank test needs finite values")
    values = values[values != 0.0]
    if values.size == 0:
        return 1.0
    # Twice the mean ranks are whole numbers.
    _, group, counts = np.unique(np.abs(values), return_inverse=True, return_counts=True)
    last = np.cumsum(counts)
    doubled = (2 * last - counts + 1)[group]
    return _tail(tuple(sorted(doubled.tolist())), int(doubled[values > 0].sum()))


@functools.lru_cache(maxsize=256)
def _survival(ranks: tuple[int, ...]) -> np.ndarray:
    """P(sum of the ranks that a fair coin keeps >= s) for s = 0 .. sum + 1."""
    mass = np.zeros(sum(ranks) + 1)
    mass[0] = 1.0
    for rank in ranks:
        mass[rank:] = 0.5 * (mass[rank:] + mass[: mass.size - rank])
        mass[:rank] *= 0.5
    return np.append(np.cumsum(mass[::-1])[::-1], 0.0)


def _tail(ranks: tuple[int, ...], at_least: int) -> float:
    return float(min(1.0, _survival(ranks)[at_least]))


def holm(p: Sequence[float]) -> np.ndarray:
    """Holm's adjusted p-values (1979): those at most a get rejected at the family-wise level a."""
    given = np.asarray(p, dtype=np.float64)
    order = np.argsort(given, kind="stable")
    stepped = given[order] * (given.size - np.arange(given.size))
    adjusted = np.empty_like(given)
    adjusted[order] = np.minimum(1.0, np.maximum.accumulate(stepped))
    return adjusted


Pair = tuple[str, str, Sequence[float], Sequence[float]]
"""First, second, figures of the first, of the second, by turn."""


def verdicts(
    pairs: Sequence[Pair], *, alpha: float = ALPHA, margin: float = MARGIN
) -> list[tuple[Outcome, float]]:
    """Outcome and corrected p-value of every pair; all of them are one family.

    Figures must be positive and taken in the same turns. Raises ValueError where they are not.
    """
    step = math.log1p(margin)
    one_sided: list[float] = []
    for _, _, a, b in pairs:
        x, y = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
        if x.shape != y.shape or not (np.all(x > 0) and np.all(y > 0)):
            raise ValueError("claims need positive figures of the same turns")
        ratio = np.log(x / y)
        one_sided += [signed_rank_p(ratio - step), signed_rank_p(-ratio - step)]
    adjusted = holm(one_sided)
    found: list[tuple[Outcome, float]] = []
    for more, less in zip(adjusted[::2], adjusted[1::2], strict=True):
        outcome: Outcome = "more" if more <= alpha else "less" if less <= alpha else "undecided"
        found.append((outcome, float(min(more, less))))
    return found


def judge(
    pairs: Sequence[Pair], *, alpha: float = ALPHA, margin: float = MARGIN, seed: int = 1
) -> tuple[Claim, ...]:
    """Claims on all pairs at once: `verdicts` with the ratios that they are about."""
    return tuple(
        Claim(first, second, outcome, paired_ratio(a, b, seed=seed, resamples=1999), p)
        for (first, second, a, b), (outcome, p) in zip(
            pairs, verdicts(pairs, alpha=alpha, margin=margin), strict=True
        )
    )


def level(claims: int, alpha: float = ALPHA) -> float:
    """The one-sided level of a single test where `claims` pairs are judged: the strictest that Holm asks."""
    return alpha / (2 * max(1, claims))


@functools.lru_cache(maxsize=64)
def fewest_turns(claims: int, alpha: float = ALPHA) -> int:
    """Turns with which a claim can be made although one of them went wrong by any amount."""
    turns = 2
    # The largest rank may have the wrong sign: the others' sum is still rare enough.
    while _survival(tuple(range(2, 2 * turns + 1, 2)))[turns * (turns - 1)] > level(claims, alpha):
        turns += 1
    return turns


def turns_for(
    noise: float, claims: int, *, telling: float = TELLING, margin: float = MARGIN, alpha: float = ALPHA
) -> int:
    """Turns that tell a ratio of `telling` from the margin with probability `POWER`.

    `noise`: standard deviation of the logarithm of a paired ratio. By the normal approximation of the
    signed-rank test, whose efficiency is 3 / pi of the t-test's for normal noise, more for heavy tails.
    """
    from scipy.stats import norm

    effect = math.log(telling / (1.0 + margin))
    need = (float(norm.isf(level(claims, alpha))) + float(norm.ppf(POWER))) * noise / effect
    return max(fewest_turns(claims, alpha), math.ceil(need * need * math.pi / 3.0))


def told_apart(
    noise: float, claims: int, turns: int, *, margin: float = MARGIN, alpha: float = ALPHA
) -> float:
    """The ratio that `turns` tell from the margin with probability `POWER`; see `turns_for`."""
    from scipy.stats import norm

    need = float(norm.isf(level(claims, alpha))) + float(norm.ppf(POWER))
    return (1.0 + margin) * math.exp(need * noise * math.sqrt(math.pi / (3.0 * turns)))


def noise_of_pairs(a: Sequence[float], b: Sequence[float]) -> float:
    """Standard deviation of log(a / b) where both are of one kind, from its median magnitude.

    Only magnitudes enter, so that what is decided by it leaves the signs, of which tests are made, free.
    """
    ratio = np.log(np.asarray(a, dtype=np.float64) / np.asarray(b, dtype=np.float64))
    return float(np.median(np.abs(ratio))) / 0.6744898


def all_pairs(figures: Mapping[str, Sequence[float]]) -> list[Pair]:
    """Every pair of candidates once, for `judge`."""
    names = list(figures)
    return [(a, b, figures[a], figures[b]) for i, a in enumerate(names) for b in names[i + 1 :]]
