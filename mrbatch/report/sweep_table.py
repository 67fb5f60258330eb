"""A sweep's price list in words: rows for terminal, page and CSV, and what may be said of each."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from pathlib import Path

from mrbatch.report.model import Report, write_text
from mrbatch.report.numbers import number, quantity, seconds
from mrbatch.report.sweep import Kind, Sweep, SweepPoint, SweepTarget
from mrbatch.report.values import Value

CLAIMED = {
    ("time", "less"): "faster",
    ("time", "more"): "slower",
    ("error", "less"): "more exact",
    ("error", "more"): "less exact",
}


@dataclass(frozen=True)
class Row:
    """A line of the price list: a value of an axis over the job's own settings."""

    point: SweepPoint
    time: str
    error: str
    says: tuple[str, ...]
    """What is claimed of it over the job's own settings."""


@dataclass(frozen=True)
class Section:
    """An axis: its lines, and the order that is claimed among its values beyond those with the job's own."""

    name: str
    setting: str
    own: str
    law: str
    again: Value | None
    repeats: int
    told_apart: float | None
    rows: tuple[Row, ...]
    left_out: tuple[tuple[str, str], ...]
    same_bits: bool


def times(value: Value | None) -> str:
    """A ratio with its interval: `x 1.52 [1.49, 1.55]`."""
    if value is None:
        return ""
    text = f"x {number(value.value)}"
    if value.low is not None and value.high is not None:
        text += f" [{number(value.low)}, {number(value.high)}]"
    return text


def claims_on(told: Sweep, point: SweepPoint) -> tuple[str, ...]:
    """`faster`, `less exact`, ... than the job's own settings, as far as that is claimed."""
    found = []
    own = told.own.name
    for claim in told.claims:
        if claim.axis != point.axis or {claim.first, claim.second} != {own, point.name}:
            continue
        outcome: str = claim.outcome
        if claim.first == own and outcome != "undecided":
            outcome = "more" if outcome == "less" else "less"
        if outcome != "undecided":
            found.append(CLAIMED[claim.kind, outcome])
    return tuple(found)


def ranked(told: Sweep, kind: Kind, apart: float = 1.25) -> tuple[int, int]:
    """Claims made, and pairs whose figures are further apart than `apart`."""
    far = [c for c in told.claims if c.kind == kind and not 1 / apart <= c.ratio.value <= apart]
    return sum(c.outcome != "undecided" for c in far), len(far)


def price_list(told: Sweep) -> tuple[Section, ...]:
    """By axis in the order of the sweep."""
    found = []
    for axis in told.axes:
        rows = []
        same = True
        for point in (p for p in told.points if p.axis == axis.name):
            rows.append(Row(point, times(point.time), _error(point), claims_on(told, point)))
            same = same and point.repeats_bits
        left_out = tuple(axis.left_out.items())
        found.append(
            Section(
                axis.name,
                axis.setting,
                axis.own,
                axis.law,
                axis.again,
                axis.repeats,
                axis.told_apart,
                tuple(rows),
                left_out,
                same,
            )
        )
    return tuple(found)


def _error(point: SweepPoint) -> str:
    if point.error is None:
        return ""
    return f"{times(point.error)}{' (below what the truth tells)' if point.below_truth else ''}"


def headline(told: Sweep) -> tuple[str, ...]:
    """What everything hangs on, in sentences."""
    own, truth = told.own, told.truth
    threads = "1 thread" if told.threads == 1 else f"{told.threads} threads"
    error = f", relMSE {quantity(own.relmse)} on {truth.pixels:,} pixels" if own.relmse else ""
    found = [
        f"The job as it is: {quantity(own.seconds)} a frame, {own.samples} samples a pixel, "
        f"{told.width} x {told.height} pixels, {threads}{error}.",
        f"Noise of this machine now: the same settings over themselves took {times(told.again)} the time.",
    ]
    own_error = f"its own relMSE is {number(truth.own.value)}" if truth.own else "its own error is not known"
    by = f", {truth.samples} samples a pixel" if truth.samples else ""
    consequence = (
        "nothing below three times that is told apart" if truth.own else "so nothing is claimed on errors"
    )
    whose = "not made by this program" if truth.independent else "by this program: its own faults do not show"
    found.append(f"Truth: {truth.source}{by} ({whose}); {own_error}: {consequence}.")
    seeds = own.noise.repetitions if own.noise else None
    if seeds:
        found.append(
            f"Noise: of each setting against its own mean over {seeds} seeds, whose own error is taken off; "
            "bias: what of the error is left."
        )
    said = sum(c.outcome != "undecided" for c in told.claims)
    found.append(
        f"{said} of {len(told.claims)} pairs are ranked; all of that together holds with "
        f"{told.confidence:.0%} confidence, of differences over {told.margin:.0%}."
    )
    return tuple(found)


def target_words(target: SweepTarget) -> str:
    """`3.2 s with 96 samples (foreseen)`."""
    if target.outcome == "converged-floor":
        return "never: its bias is larger"
    if target.outcome == "undecided":
        return "not known: what looks like bias may be noise"
    text = seconds(target.seconds.value) if target.seconds else ""
    if target.samples:
        text += f" with {target.samples} samples"
    return text + (" (foreseen)" if target.foreseen else "")


def print_sweep(report: Report) -> None:
    """The price list and what it hangs on."""
    from rich.box import SIMPLE
    from rich.console import Console
    from rich.table import Table

    told = report.sweep
    assert told is not None
    console = Console(markup=False, highlight=False)
    if not console.is_terminal:
        console.width = 160  # what is piped into a file is as wide as it needs to be
    for line in headline(told):
        console.print(line)
    table = Table(box=SIMPLE, pad_edge=False)
    for head in ("setting", "value", "time", "error (relMSE)", "claimed over the job's own"):
        table.add_column(head, no_wrap=head not in ("setting", "claimed over the job's own"))
    for section in price_list(told):
        table.add_row(section.name, f"{section.own} (own)", "x 1", "x 1", "")
        for at, row in enumerate(section.rows, 1):
            front = ("on the front",) if row.point.front else ()
            table.add_row(
                section.setting if at == 1 and section.setting != section.name else "",
                row.point.value,
                row.time,
                row.error,
                ", ".join((*row.says, *front)),
                end_section=at == len(section.rows),
            )
    if table.row_count:
        console.print(table)
    _print_grid(told, console)
    for slope in told.slopes:
        console.print(f"{slope.of} falls as {slope.against} to the power of {quantity(slope.slope)}")
    if told.knee:
        console.print(f"Knee of the front: {told.knee}")
    if told.target and told.targets:
        console.print(f"To relMSE {number(told.target)}:")
        for target in told.targets:
            console.print(f"  {target.point}: {target_words(target)}")
    for axis in told.axes:
        for value, why in axis.left_out.items():
            console.print(f"{axis.name} {value} left out: {why}")


def _print_grid(told: Sweep, console) -> None:
    from rich.box import SIMPLE
    from rich.table import Table

    if told.grid is None:
        return
    by_name = {p.name: p for p in told.points}
    table = Table(
        title=f"{told.grid.first} by {told.grid.second}: time, error", title_justify="left", box=SIMPLE
    )
    for column in ("", *told.grid.columns):
        table.add_column(column)
    for row, names in zip(told.grid.rows, told.grid.points, strict=True):
        cells = []
        for name in names:
            p = by_name.get(name)
            cells.append(f"{times(p.time)}\n{_error(p)}" if p else "left out")
        table.add_row(row, *cells, end_section=True)
    console.print(table)


_PLAIN = ("axis", "value", "own", "samples", "front", "beaten_by", "below_truth", "repeats_bits")
_VALUES = ("time", "error", "seconds", "pass_seconds", "relmse", "noise", "bias")


def render_csv(report: Report) -> str:
    """A line a point: what it is, figures with their intervals, all scores, counters, and what is claimed."""
    told = report.sweep
    assert told is not None
    scores = list(dict.fromkeys((s.metric, s.scope) for p in told.points for s in p.scores))
    counters = sorted({name for p in told.points for name in p.counters})
    heads = [*_PLAIN, "claimed"]
    heads += [f"{name}{part}" for name in _VALUES for part in ("", "_low", "_high")]
    heads += [f"{metric}_{scope}" for metric, scope in scores] + [f"count {name}" for name in counters]
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(heads)
    for point in told.points:
        cells: list[object] = [_safe(getattr(point, name)) for name in _PLAIN]
        cells.append("; ".join(claims_on(told, point)))
        for name in _VALUES:
            value = getattr(point, name)
            cells += [value.value, value.low, value.high] if value else ["", "", ""]
        found = {(s.metric, s.scope): s.value.value for s in point.scores}
        cells += [found.get(key, "") for key in scores] + [point.counters.get(name, "") for name in counters]
        writer.writerow(cells)
    return stream.getvalue()


def _safe(value: object) -> object:
    """Text that no spreadsheet takes for a formula."""
    return f"'{value}" if isinstance(value, str) and value[:1] in ("=", "+", "-", "@") else value


def write_csv(report: Report, path: Path) -> None:
    """Writes `render_csv` in one step. Raises ResourceError where it cannot be written."""
    write_text(Path(path), render_csv(report))
