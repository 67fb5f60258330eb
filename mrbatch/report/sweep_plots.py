"""Charts of a sweep's page as numbers: error against seconds, ratios, bias and noise, targets."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from mrbatch.report import numbers
from mrbatch.report.plots import LogAxis, LogPlot, decimals, round_times, time_text
from mrbatch.report.sweep import Sweep, SweepPoint, SweepTarget
from mrbatch.report.sweep_table import target_words, times
from mrbatch.report.values import Value

FLOOR = 3.0
"""Times the truth's own error: what is below is not told apart."""


@dataclass(frozen=True)
class Dot:
    """A point of the plot: place, whiskers (x low, x high, y low, y high), what a pointer shows."""

    x: float
    y: float
    span: tuple[float, float, float, float]
    text: str
    label: str
    kind: str
    """`own`, `front` or `other`."""
    knee: bool
    at: tuple[float, float, str] = (0.0, 0.0, "start")
    """Where the label stands, and on which side of that place."""


@dataclass(frozen=True)
class CostPlot(LogPlot):
    """Error against seconds; `line`: the front; `floor`: height of what the truth tells."""

    dots: tuple[Dot, ...]
    line: tuple[tuple[float, float], ...]
    floor: float | None


def cost_plot(told: Sweep, *, width: int = 760, height: int = 440) -> CostPlot | None:
    """None where no point has an error."""
    points = [p for p in told.points if p.relmse and p.relmse.value > 0 and p.seconds.value > 0]
    if not points:
        return None
    left, right, top, bottom = 62.0, width - 16.0, 14.0, height - 40.0
    spent = {p.name: told.seconds_of(p) for p in points}
    seconds = [v for value in spent.values() for v in _ends(value)]
    errors = [v for p in points for v in _ends(p.relmse)]
    x_axis = LogAxis(min(seconds) / 1.25, max(seconds) * 1.25, left, right)
    y_axis = LogAxis(min(errors) / 1.4, max(errors) * 1.4, bottom, top)
    dots = []
    for p in sorted(points, key=lambda p: (p.own, p.front)):
        assert p.relmse is not None
        (x0, x1), (y0, y1) = _ends(spent[p.name]), _ends(p.relmse)
        x, y = x_axis.at(spent[p.name].value), y_axis.at(p.relmse.value)
        what = p.name if p.own else f"{p.axis} {p.value}"
        kind = "own" if p.own else "front" if p.front else "other"
        dots.append(
            Dot(
                x,
                y,
                (x_axis.at(x0), x_axis.at(x1), y_axis.at(y0), y_axis.at(y1)),
                f"{what}: {numbers.quantity(spent[p.name])}, relMSE {numbers.quantity(p.relmse)}",
                what if kind != "other" else "",
                kind,
                p.name == told.knee,
            )
        )
    on_front = sorted(
        (d for d, p in zip(dots, sorted(points, key=lambda p: (p.own, p.front))) if p.front), key=_x
    )
    own = told.truth.own.value * FLOOR if told.truth.own else 0.0
    dots = _labelled(dots, (left, right, top, bottom))
    return CostPlot(
        width,
        height,
        left,
        right,
        top,
        bottom,
        x_axis.ticks(time_text, round_times),
        y_axis.ticks(numbers.number, decimals),
        tuple(dots),
        tuple((d.x, d.y) for d in on_front),
        y_axis.at(own) if y_axis.low < own < y_axis.high else None,
    )


LETTER, LINE = 6.4, 13.0
"""Width of a letter and height of a line of the labels, roughly."""


def _labelled(dots: Sequence[Dot], bounds: tuple[float, float, float, float]) -> list[Dot]:
    """Puts the labels where they hide neither each other nor a dot, the own one first; others have none."""
    left, right, top, bottom = bounds
    taken = [(d.x - 5, d.y - 5, d.x + 5, d.y + 5) for d in dots if d.kind != "other"]
    found = list(dots)
    for index in sorted(range(len(dots)), key=lambda i: (dots[i].kind != "own", dots[i].x)):
        dot = dots[index]
        long = LETTER * len(dot.label)
        places = [
            (dot.x + side * 9, dot.y + down, "start" if side > 0 else "end")
            for down in (-7.0, 16.0)
            for side in (1, -1)
        ]
        chosen = None
        for x, y, anchor in places if dot.label else ():
            box = (x if anchor == "start" else x - long, y - LINE, x + long if anchor == "start" else x, y)
            inside = left <= box[0] and box[2] <= right and top <= box[1] and box[3] <= bottom
            if inside and not any(
                box[0] < t[2] and t[0] < box[2] and box[1] < t[3] and t[1] < box[3] for t in taken
            ):
                chosen = (x, y, anchor)
                taken.append(box)
                break
        found[index] = replace(dot, at=chosen) if chosen else replace(dot, label="")
    return found


def _x(dot: Dot) -> float:
    return dot.x


def _ends(value: Value | None) -> tuple[float, float]:
    """Positive ends of an interval."""
    assert value is not None
    low = value.low if value.low is not None and value.low > 0 else value.value
    return low, value.high if value.high is not None else value.value


@dataclass(frozen=True)
class Whisker:
    """A figure with its interval on a logarithmic scale: places in per cent; `one`: where x 1 is."""

    at: float
    low: float
    high: float
    text: str


@dataclass(frozen=True)
class Scale:
    """A logarithmic scale that holds all figures of a column."""

    low: float
    high: float

    def at(self, value: float) -> float:
        """Per cent of the width."""
        if value <= 0:
            return 0.0
        share = math.log(value / self.low) / math.log(self.high / self.low)
        return 100.0 * min(1.0, max(0.0, share))

    def whisker(self, value: Value | None, text: str) -> Whisker | None:
        if value is None or value.value <= 0:
            return None
        low, high = _ends(value)
        return Whisker(self.at(value.value), self.at(low), self.at(high), text)


def ratio_scale(told: Sweep, kind: str) -> Scale:
    """For the ratios `time` or `error` of all points."""
    ends = [v for p in told.points if (r := getattr(p, kind)) is not None and r.value > 0 for v in _ends(r)]
    return Scale(min([*ends, 0.8]) / 1.15, max([*ends, 1.25]) * 1.15)


def ratio(scale: Scale, value: Value | None) -> Whisker | None:
    return scale.whisker(value, times(value))


@dataclass(frozen=True)
class PartsRow:
    """Noise and bias of a point as relative amplitudes; None where the interval reaches 0."""

    name: str
    own: bool
    noise: Whisker | None
    bias: Whisker | None
    words: str
    """Of the bias where it is none: below what."""


@dataclass(frozen=True)
class PartsChart:
    rows: tuple[PartsRow, ...]
    ticks: tuple[tuple[float, str], ...]


def parts_chart(told: Sweep) -> PartsChart:
    """Amplitudes in per cent of a pixel's own brightness."""
    points = [p for p in told.points if p.noise and p.bias]
    every = [100 * math.sqrt(v) for p in points for w in (p.noise, p.bias) if _told(w) for v in _ends(w)]
    if not every:
        return PartsChart((), ())
    scale = Scale(min(every) / 1.3, max(every) * 1.3)
    rows = []
    for p in points:
        assert p.noise is not None and p.bias is not None
        words = ""
        if not _told(p.bias):
            words = f"bias below {numbers.roughly(100 * math.sqrt(max(p.bias.high or 0.0, 0.0)))} %"
        rows.append(
            PartsRow(p.name if p.own else f"{p.axis} {p.value}", p.own, *_amplitudes(scale, p), words)
        )
    marks = [v for v in decimals(scale.low, scale.high, 2) if scale.low < v < scale.high]
    return PartsChart(tuple(rows), tuple((scale.at(v), f"{v:g} %") for v in marks))


def _told(value: Value | None) -> bool:
    """Whether a part is there: its interval does not reach 0."""
    return value is not None and value.value > 0 and (value.low or 0.0) > 0


def _amplitudes(scale: Scale, point: SweepPoint) -> tuple[Whisker | None, Whisker | None]:
    found: list[Whisker | None] = []
    for name in ("noise", "bias"):
        value: Value = getattr(point, name)
        if not _told(value):
            found.append(None)
            continue
        low, high = (100 * math.sqrt(v) for v in _ends(value))
        middle = 100 * math.sqrt(value.value)
        text = f"{name} {numbers.number(middle)} % [{numbers.number(low)}, {numbers.number(high)}]"
        found.append(Whisker(scale.at(middle), scale.at(low), scale.at(high), text))
    return found[0], found[1]


@dataclass(frozen=True)
class TargetBar:
    """How long a point's settings take to the target; `width` in per cent of the longest."""

    name: str
    own: bool
    width: float
    text: str
    target: SweepTarget


def target_bars(told: Sweep) -> tuple[TargetBar, ...]:
    """Fastest first, then those that never get there."""
    known = [t for t in told.targets if t.seconds is not None]
    longest = max((t.seconds.value for t in known if t.seconds), default=1.0)
    order = sorted(told.targets, key=lambda t: t.seconds.value if t.seconds else math.inf)
    bars = []
    for t in order:
        p = told.point(t.point)
        width = 100.0 * t.seconds.value / longest if t.seconds else 0.0
        bars.append(TargetBar(p.name if p.own else f"{p.axis} {p.value}", p.own, width, target_words(t), t))
    return tuple(bars)
