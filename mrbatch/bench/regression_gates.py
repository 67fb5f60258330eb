"""The gates between two renderings of a job: exact ones, and Welch's t-test over the seeds."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from mrbatch.bench.baseline import Baseline, FrameBaseline
from mrbatch.report import numbers
from mrbatch.report.model import Gate, Value

FALSE_ALARM = 1e-3
"""Chance of a false alarm of all tests of a job together."""
WORK = 0.01
"""Relative change of a counter that other seeds may make, beside six standard errors."""


def judge(stored: Baseline, made: Baseline) -> list[Gate]:
    """All gates but that of finite numbers."""
    gates = [_effects(stored, made)]
    same = stored.seeds == made.seeds and stored.spp == made.spp
    tests = sum(len(frame.means) for frame in stored.frames.values())
    tiles = sum(len(frame.tile_places) for frame in stored.frames.values())
    for number, was in stored.frames.items():
        now = made.frames.get(number)
        if now is None:
            gates.append(Gate(name="there", passed=False, text="the frame is rendered", frame=number))
            continue
        for name in sorted({*was.counters, *now.counters}):
            before, after = was.counters.get(name, (0,)), now.counters.get(name, (0,))
            gates.append(_work(name, np.array(before), np.array(after), same, number))
        if not now.tile_places:
            continue  # a number of it is not finite, which has a gate of its own
        for name in sorted({*was.means, *now.means}):
            gates.append(_mean(name, was.means.get(name), now.means.get(name), tests, number))
        gates.append(_worst_tile(was, now, tiles, number))
    return gates


def _effects(stored: Baseline, made: Baseline) -> Gate:
    other = [
        f"{name} was {stored.effects.get(name, 'unknown')}, is {made.effects.get(name, 'unknown')}"
        for name in sorted({*stored.effects, *made.effects})
        if stored.effects.get(name) != made.effects.get(name)
    ]
    return Gate(
        name="effects", passed=not other, text="; ".join(other) or "the plan calls for the same effects"
    )


def _work(name: str, was: np.ndarray, now: np.ndarray, same: bool, number: int) -> Gate:
    before, after = float(was.mean()), float(now.mean())
    ratio = after / before if before else (1.0 if after == before else math.inf)
    if same:
        passed, limit, side = bool(np.array_equal(was, now)), 1.0, "the same to the digit"
    else:
        spread = sum(float(x.var(ddof=1)) / len(x) for x in (was, now) if len(x) > 1)
        limit = 1.0 + WORK + (6 * math.sqrt(spread) / before if before else 0.0)
        passed, side = 1 / limit <= ratio <= limit, f"within {numbers.number(100 * (limit - 1))} %"
    return Gate(
        name=f"work: {name}",
        passed=passed,
        text=f"{name} are {side}",
        measured=Value(value=ratio, unit="times the baseline's", repetitions=len(now)),
        limit=Value(value=limit, unit="times the baseline's"),
        frame=number,
    )


def _mean(
    name: str, was: tuple[float, ...] | None, now: tuple[float, ...] | None, tests: int, number: int
) -> Gate:
    if was is None or now is None:
        return Gate(
            name=f"mean: {name}", passed=False, text=f"the layer's channel {name} is there", frame=number
        )
    difference, p, error = welch(np.array(was), np.array(now))
    scale = abs(float(np.mean(was)))
    unit = "% of the baseline's" if scale > 0 else "of radiance"
    times = 100 / scale if scale > 0 else 1.0
    return Gate(
        name=f"mean: {name}",
        passed=bool(p >= FALSE_ALARM / 2 / tests),
        text=f"the mean of {name} differs by no more than noise (p = {p:.2g})",
        measured=Value(
            value=times * float(difference),
            unit=unit,
            low=times * float(difference - 1.96 * error),
            high=times * float(difference + 1.96 * error),
            confidence=0.95,
            repetitions=len(now),
        ),
        frame=number,
    )


def _worst_tile(was: FrameBaseline, now: FrameBaseline, tests: int, number: int) -> Gate:
    if was.tile_places != now.tile_places:
        return Gate(name="tiles", passed=False, text="the frame has the same tiles", frame=number)
    difference, p, error = welch(np.array(was.tiles), np.array(now.tiles))
    worst = int(np.argmin(p))
    return Gate(
        name="tiles",
        passed=bool(p[worst] >= FALSE_ALARM / 2 / tests),
        text=f"no 16 x 16 tile differs by more than noise; least likely: {now.tile_places[worst]} "
        f"(p = {p[worst]:.2g})",
        measured=Value(
            value=float(difference[worst]),
            unit="of radiance",
            low=float(difference[worst] - 1.96 * error[worst]),
            high=float(difference[worst] + 1.96 * error[worst]),
            confidence=0.95,
        ),
        frame=number,
    )


def welch(was: np.ndarray, now: np.ndarray) -> tuple[Any, Any, Any]:
    """Difference of means, its p-value and its standard error, along the first axis (seeds).

    Welch's t-test. Where neither scatters, p is 1 for equal means and 0 for others.
    """
    from scipy.stats import ttest_ind_from_stats

    means, spreads = [x.mean(axis=0) for x in (now, was)], [x.std(axis=0, ddof=1) for x in (now, was)]
    difference = means[0] - means[1]
    error = np.sqrt(spreads[0] ** 2 / len(now) + spreads[1] ** 2 / len(was))
    # Below this, sums in another order make the difference.
    rounding = 1e-9 * (np.abs(was).mean(axis=0) + np.abs(now).mean(axis=0))
    with np.errstate(divide="ignore", invalid="ignore"):
        p = ttest_ind_from_stats(
            means[0], spreads[0], len(now), means[1], spreads[1], len(was), equal_var=False
        ).pvalue
    p = np.where(error > 0.0, p, 0.0)
    return difference, np.where(np.abs(difference) <= rounding, 1.0, p), error
