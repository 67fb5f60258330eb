"""How long each choice of a sweep takes until the error is as asked."""

from __future__ import annotations

import math

import numpy as np

from mrbatch.bench.sweep_report import GRID, Outcome
from mrbatch.bench.time_to_error import samples_to_reach
from mrbatch.metrics.statistics import bootstrap_interval
from mrbatch.report.model import Report
from mrbatch.report.sweep import Sweep, SweepPoint, SweepTarget
from mrbatch.report.values import Value

MEASURED = "method.name"
"""The axis whose values are rendered until the target is reached, where one is asked for."""
TURNS = 5


def targets_of(outcome: Outcome, report: Report, target: float | None) -> Report:
    """Adds the times to `target` (relMSE of the region; None: what the job's own settings reach).

    They are foreseen from each point's noise, bias and the slope of the error with samples; with a target,
    those of the estimators are measured.
    """
    told = report.sweep
    assert told is not None
    wanted = target or (told.own.relmse.value if told.own.relmse else 0.0)
    if wanted <= 0.0:
        return report
    slope = samples_slope(told)
    along = {c.axis.name: c.axis.setting for c in outcome.chosen}
    found = []
    for point in told.points:
        # Other samples are what the target is reached with.
        if (
            point.axis == GRID
            or along.get(point.axis) == "method.spp"
            or point.noise is None
            or point.bias is None
        ):
            continue
        if target is not None and (point.own or along.get(point.axis) == MEASURED):
            found.append(_measured(outcome, point, wanted))
        else:
            found.append(_foreseen(told, point, wanted, slope))
    swept = told.model_copy(update={"target": wanted, "targets": tuple(found)})
    return report.model_copy(update={"sweep": swept})


def samples_slope(told: Sweep) -> float:
    """By which power of the samples relMSE falls: as measured, at least 0.5; else as independent ones do."""
    measured = next((-s.slope.value for s in told.slopes if s.against == "samples"), 1.0)
    return max(0.5, measured)


def times_the_samples(noise: float, bias: float, target: float, slope: float) -> float:
    """Factor on the samples that brings noise + bias to the target; infinite where bias alone is more."""
    rest = target - max(0.0, bias)
    return (noise / rest) ** (1.0 / slope) if rest > 0.0 else math.inf


def _foreseen(told: Sweep, point: SweepPoint, target: float, slope: float) -> SweepTarget:
    assert point.noise is not None and point.bias is not None
    least = point.bias.low or 0.0
    # A bias whose interval reaches 0 is taken for none.
    factor = times_the_samples(point.noise.value, point.bias.value if least > 0.0 else 0.0, target, slope)
    if not math.isfinite(factor):
        # Under much noise, light that is hardly ever found and the cut at 0 look like bias.
        sure = least >= target and point.bias.value > point.noise.value
        return SweepTarget(point=point.name, outcome="converged-floor" if sure else "undecided")
    share = min(1.0, point.pass_seconds.value / point.seconds.value)
    by = 1.0 - share + share * factor
    now = told.seconds_of(point)
    seconds = {key: None if (v := getattr(now, key)) is None else v * by for key in ("value", "low", "high")}
    return SweepTarget(
        point=point.name,
        outcome="reached",
        samples=max(2, 2 * round((point.samples or 2) * factor / 2)),
        seconds=now.model_copy(update=seconds),
        relmse=target,
    )


def _measured(outcome: Outcome, point: SweepPoint, target: float) -> SweepTarget:
    """Renders until the error is near the target."""
    one = outcome.choices.get(point.name)
    settings, threads = (one.settings, one.threads) if one else ((), outcome.threads)

    def error_of(spp: int) -> float:
        with outcome.variants.subject(*settings, f"method.spp={spp}", threads=threads) as subject:
            found = outcome.truth.errors(subject.run().composite)
        return found.region.relmse if found.region else math.nan

    if point.bias is not None and (point.bias.low or 0.0) > target:
        return SweepTarget(point=point.name, outcome="converged-floor", foreseen=False)
    most = 64 * max(2, point.samples or 2)
    spp, relmse = samples_to_reach(target, point.samples or 2, error_of, most=most)[-1]
    with outcome.variants.subject(*settings, f"method.spp={spp}", threads=threads) as subject:
        subject.run()
        spent = [subject.run().frame_seconds for _ in range(TURNS)]
    interval = bootstrap_interval(np.median, spent, seed=1, method="percentile", resamples=1999)
    return SweepTarget(
        point=point.name,
        outcome="reached" if relmse <= 2.0 * target else "converged-floor",
        samples=spp,
        seconds=Value(
            value=interval.value,
            unit="s",
            low=interval.low,
            high=interval.high,
            confidence=interval.confidence,
            repetitions=TURNS,
        ),
        relmse=relmse,
        foreseen=False,
    )
