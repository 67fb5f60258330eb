"""A sweep's figures as the report: price list, claims of one family, slopes, front and knee."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mrbatch import __version__
from mrbatch.batch.job_report import machine, versions
from mrbatch.bench.axes import THREADS, Choice, Chosen
from mrbatch.bench.block import OWN, Block, Measured
from mrbatch.bench.truth import FLOOR, Truth, noise_and_bias
from mrbatch.bench.variants import Variants
from mrbatch.errors import EXIT_DONE, EXIT_GATE
from mrbatch.metrics.claims import (
    ALPHA,
    MARGIN,
    Claim,
    Pair,
    all_pairs,
    judge,
    noise_of_pairs,
    told_apart,
    verdicts,
)
from mrbatch.metrics.errors import METRICS
from mrbatch.metrics.frontier import front, knee
from mrbatch.metrics.statistics import Interval, bootstrap_interval, paired_ratio
from mrbatch.report.model import Gate, Job, Report, Totals
from mrbatch.report.sweep import (
    Sweep,
    SweepAxis,
    SweepClaim,
    SweepGrid,
    SweepPoint,
    SweepSlope,
    SweepTruth,
)
from mrbatch.report.values import Score, Value

GRID = "grid"


@dataclass(frozen=True)
class Outcome:
    """All that was measured; `choices` by the names of points."""

    variants: Variants
    truth: Truth
    chosen: tuple[Chosen, ...]
    choices: Mapping[str, Choice]
    gridded: tuple[Chosen, ...]
    blocks: Mapping[str, Block]
    threads: int

    def measured(self, name: str) -> Measured:
        """By a point's name."""
        return next(b.found[name] for b in self.blocks.values() if name in b.found)

    @property
    def own(self) -> Measured:
        """The job's own settings, over all axes."""
        whole = Measured()
        for block in self.blocks.values():
            one = block.found[OWN]
            whole.seconds += one.seconds
            whole.pass_seconds += one.pass_seconds
            whole.picture, whole.counters, whole.samples = one.picture, one.counters, one.samples
            whole.repeats_bits = whole.repeats_bits and one.repeats_bits
            # Every axis has the same seeds, so that more of them say no more of the error.
            if len(one.errors) > len(whole.errors):
                whole.errors, whole.differences = one.errors, one.differences
        return whole


def report_of(outcome: Outcome) -> Report:
    """The report without times to a target and without pictures."""
    variants, blocks = outcome.variants, outcome.blocks
    claims = _claims(outcome)
    made = len(claims)
    points = [_point(outcome, OWN, "", "", outcome.own, None)]
    for name, block in blocks.items():
        for key, found in block.found.items():
            if key != OWN:
                one = outcome.choices[key]
                points.append(_point(outcome, key, name, one.label, found, block, one.values))
    points = _judged(points, claims)
    drawn = {p.name: (p.time.value, p.error.value) for p in points if p.error and p.axis != THREADS}
    on_front = front(drawn)
    points = [p.model_copy(update={"front": p.name in on_front}) for p in points]
    first = [s for b in blocks.values() for s in b.found[OWN].seconds]
    again = [s for b in blocks.values() for s in b.again]
    height, width = outcome.truth.changed.shape
    told = Sweep(
        frame=variants.frame,
        width=width,
        height=height,
        threads=outcome.threads,
        seconds=Value(value=0.0, unit="s"),
        truth=_truth(outcome.truth),
        axes=tuple(
            _axis(chosen, blocks[chosen.axis.name], made)
            for chosen in outcome.chosen
            if chosen.axis.name in blocks
        ),
        points=tuple(points),
        claims=claims,
        again=_value(paired_ratio(again, first, seed=1), "x"),
        confidence=1.0 - ALPHA,
        margin=MARGIN,
        slopes=_slopes(outcome),
        knee=knee(drawn),
        grid=_grid(outcome),
    )
    job = variants.job
    gates = _gates(outcome, told)
    return Report(
        kind="sweep",
        job=Job(
            name=job.name,
            method=job.method_name,
            capture=job.capture_kind,
            seed=job.seed,
            settings={"changes": list(variants.settings)},
        ),
        versions=versions() | {"mrbatch": __version__},
        machine=machine(),
        totals=Totals(),
        gates=gates,
        sweep=told,
        exit=EXIT_DONE if all(g.passed for g in gates) else EXIT_GATE,
    )


def _gates(outcome: Outcome, told: Sweep) -> tuple[Gate, ...]:
    """What must hold for the figures to mean something."""
    changed = [p.name for p in told.points if not p.repeats_bits]
    pairs: list[Pair] = [("again", OWN, b.again, b.found[OWN].seconds) for b in outcome.blocks.values()]
    apart = [a for a, (v, _) in zip(outcome.blocks, verdicts(pairs), strict=True) if v != "undecided"]
    return (
        Gate(
            name="same bits",
            passed=not changed,
            text="a second rendering gives the picture and the work of the first"
            + (f", but not of {', '.join(changed)}" if changed else ""),
        ),
        Gate(
            name="same settings, same time",
            passed=not apart,
            text="the job's own settings take as long as they do themselves"
            + (f", but not along {', '.join(apart)}" if apart else ""),
            measured=told.again,
        ),
    )


def _value(interval: Interval, unit: str) -> Value:
    return Value(
        value=interval.value,
        unit=unit,
        low=interval.low,
        high=interval.high,
        confidence=interval.confidence,
        repetitions=interval.repetitions,
    )


def _middle(figures: Sequence[float], unit: str) -> Value:
    """The median with its bootstrap interval."""
    if len(figures) < 2 or not np.all(np.isfinite(figures)):
        return Value(value=float(np.median(figures)), unit=unit, repetitions=len(figures))
    return _value(bootstrap_interval(np.median, figures, seed=1, method="percentile", resamples=1999), unit)


def _point(
    outcome: Outcome,
    name: str,
    axis: str,
    value: str,
    found: Measured,
    block: Block | None,
    values: Mapping[str, str] | None = None,
) -> SweepPoint:
    truth = outcome.truth
    own = block.found[OWN] if block else found
    parts = noise_and_bias(found.differences, truth.own) if len(found.differences) > 2 else None
    relmse = _middle(found.relmse, "1")
    error = None
    if all(r > 0 for r in (*found.relmse, *own.relmse)):
        error = _value(paired_ratio(found.relmse, own.relmse, seed=1), "x")
    return SweepPoint(
        name=name,
        axis=axis,
        value=value,
        own=name == OWN,
        values=dict(values or {}),
        samples=found.samples,
        seconds=_middle(found.seconds, "s"),
        pass_seconds=_middle(found.pass_seconds, "s"),
        time=_value(paired_ratio(found.seconds, own.seconds, seed=1), "x"),
        error=error,
        relmse=relmse,
        noise=_value(parts.noise, "1") if parts else None,
        bias=_value(parts.bias, "1") if parts else None,
        below_truth=truth.own is not None and relmse.value < FLOOR * truth.own,
        scores=_scores(truth, found),
        counters=found.counters,
        repeats_bits=found.repeats_bits,
    )


def _scores(truth: Truth, found: Measured) -> tuple[Score, ...]:
    """Medians over seeds; FLIP, which takes longer than all others, of the untimed run."""
    whole = truth.errors(found.picture, flip=True)
    scores = []
    for scope in ("frame", "region", "tile"):
        for metric, once in getattr(whole, scope).items():
            figures = [once]
            if not metric.startswith("flip"):
                figures = [dict(getattr(e, scope).items())[metric] for e in found.errors]
            value = _middle(figures, METRICS[metric].unit)
            at = whole.tile_at[metric] if scope == "tile" else None
            scores.append(Score(metric=metric, scope=scope, value=value, at=at))  # type: ignore[arg-type]
    return tuple(scores)


def _pairs(name: str, figures: Mapping[str, Sequence[float]]) -> list[Pair]:
    """All pairs of an axis; of a grid, each with the job's own."""
    if name != GRID:
        return all_pairs(figures)
    return [(key, OWN, values, figures[OWN]) for key, values in figures.items() if key != OWN]


def _claims(outcome: Outcome) -> tuple[SweepClaim, ...]:
    """One family: times and errors of all axes. What is below the truth's own error counts as just that."""
    named: list[tuple[str, str]] = []
    pairs: list[Pair] = []
    for name, block in outcome.blocks.items():
        figures = {"time": {key: m.seconds for key, m in block.found.items()}}
        own = outcome.truth.own
        if own is not None:
            floor = max(FLOOR * own, 1e-30)
            figures["error"] = {key: [max(e, floor) for e in m.relmse] for key, m in block.found.items()}
        for kind, values in figures.items():
            made = _pairs(name, values)
            named += [(name, kind)] * len(made)
            pairs += made
    return tuple(_claim(axis, kind, c) for (axis, kind), c in zip(named, judge(pairs), strict=True))


def _claim(axis: str, kind: str, claim: Claim) -> SweepClaim:
    return SweepClaim(
        axis=axis,
        kind=kind,  # type: ignore[arg-type]
        first=claim.first,
        second=claim.second,
        outcome=claim.outcome,
        ratio=_value(claim.ratio, "x"),
        p=claim.p,
    )


def _judged(points: Sequence[SweepPoint], claims: Sequence[SweepClaim]) -> list[SweepPoint]:
    """Says which points are beaten: of another, less time is claimed, and less error or it has the same."""
    less: dict[str, set[tuple[str, str, str]]] = {"time": set(), "error": set()}
    for claim in claims:
        if claim.outcome == "less":
            less[claim.kind].add((claim.axis, claim.first, claim.second))
        elif claim.outcome == "more":
            less[claim.kind].add((claim.axis, claim.second, claim.first))
    by_name = {p.name: p for p in points}

    def beats(axis: str, one: str, two: str) -> bool:
        a, b = by_name[one].relmse, by_name[two].relmse
        same = a is not None and b is not None and (a.value, a.low, a.high) == (b.value, b.low, b.high)
        return (axis, one, two) in less["time"] and (same or (axis, one, two) in less["error"])

    found = []
    for p in points:
        others = [o.name for o in points if o.axis == p.axis or o.own] if p.axis not in ("", THREADS) else []
        beaten = next((o for o in others if o != p.name and beats(p.axis, o, p.name)), "")
        found.append(p.model_copy(update={"beaten_by": beaten}))
    return found


def _axis(chosen: Chosen, block: Block, claims: int) -> SweepAxis:
    own = block.found[OWN].seconds
    noise = noise_of_pairs(block.again, own)
    return SweepAxis(
        name=chosen.axis.name,
        setting=chosen.axis.setting,
        own=chosen.own,
        law=chosen.axis.law,
        counter=chosen.axis.counter,
        left_out={**chosen.left_out, **block.left_out},
        repeats=len(own),
        again=_value(paired_ratio(block.again, own, seed=1), "x"),
        told_apart=told_apart(noise, claims, len(own)),
    )


def _truth(truth: Truth) -> SweepTruth:
    return SweepTruth(
        source=truth.source,
        independent=truth.independent,
        settings=truth.settings,
        samples=truth.samples,
        own=None if truth.own is None else Value(value=truth.own, unit="1"),
        pixels=int(truth.changed.sum()),
    )


def rays(found: Measured) -> int:
    """The work of a rendering."""
    return sum(n for name, n in found.counters.items() if name.endswith("rays"))


def _slopes(outcome: Outcome) -> tuple[SweepSlope, ...]:
    """Of the error (relMSE of the region) along samples a pixel: one a turn, their median with interval."""
    chosen = next((c for c in outcome.chosen if c.axis.setting == "method.spp"), None)
    block = outcome.blocks.get(chosen.axis.name) if chosen else None
    if block is None or len(block.found) < 3 or len(block.again) < 2:
        return ()
    every = sorted(block.found.values(), key=lambda m: m.samples)
    floor = FLOOR * (outcome.truth.own or 0.0)
    kept = [m for m in every if min(m.relmse) > floor]
    if len(kept) < 3:
        return ()
    errors = np.log([m.relmse for m in kept])
    against = {
        "samples": np.log([[m.samples] * errors.shape[1] for m in kept]),
        "work (rays)": np.log([[max(1, rays(m))] * errors.shape[1] for m in kept]),
        "seconds": np.log([m.seconds for m in kept]),
    }
    found = []
    for name, x in against.items():
        centred = x - x.mean(axis=0)
        power = (centred * (errors - errors.mean(axis=0))).sum(axis=0) / (centred**2).sum(axis=0)
        found.append(
            SweepSlope(of="relMSE", against=name, slope=_middle(power.tolist(), "1"), points=len(kept))
        )
    return tuple(found)


def _grid(outcome: Outcome) -> SweepGrid | None:
    block = outcome.blocks.get(GRID)
    if block is None:
        return None
    one, two = outcome.gridded
    rows = [one.own, *(c.label for c in one.choices)]
    columns = [two.own, *(c.label for c in two.choices)]
    names = [[f"{GRID} {r} x {c}" for c in columns] for r in rows]
    names[0][0] = OWN
    return SweepGrid(
        first=one.axis.name,
        second=two.axis.name,
        rows=tuple(rows),
        columns=tuple(columns),
        points=tuple(tuple(n if n in block.found else "" for n in row) for row in names),
    )
