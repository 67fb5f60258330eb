"""Charts of the page as numbers for inline SVG: bars over frames, and noise against seconds."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from mrbatch.report import numbers
from mrbatch.report.model import Frame, Report, Value
from mrbatch.report.quality import GOAL, amplitude, middle_seconds, quality_of


@dataclass(frozen=True)
class Bar:
    """A bar of a frame chart: position and height in per cent, with the text that a pointer shows."""

    x: float
    width: float
    height: float
    text: str
    failed: bool


@dataclass(frozen=True)
class BarChart:
    """`top`: what the highest bar stands for, in words."""

    bars: tuple[Bar, ...]
    top: str


def bar_chart(frames: Sequence[Frame], name: str, most: int = 240) -> BarChart:
    """`seconds` or `error` over frames; neighbours share a bar (the largest) where there are too many."""
    values = [amplitude(f.error) or f.error if name == "error" else f.seconds for f in frames]
    finite = [v for v in values if v is not None and math.isfinite(v.value)]
    if len(finite) < 2:
        return BarChart((), "")
    step = -(-len(frames) // most)
    highest = max(finite, key=lambda v: v.value)
    top = highest.value or 1.0
    count = -(-len(frames) // step)
    bars = []
    for i in range(count):
        group = frames[i * step : (i + 1) * step]
        known = [v for v in values[i * step : (i + 1) * step] if v is not None]
        largest = max(known, key=lambda v: v.value, default=None)
        first, last = group[0].number, group[-1].number
        label = f"frame {first}" if first == last else f"frames {first} to {last}"
        text = f"{label}: {numbers.quantity(largest) or 'not measured'}"
        height = 0.0 if largest is None else 100.0 * min(1.0, max(0.0, largest.value / top))
        failed = any(f.state == "failed" for f in group)
        if failed and largest is None:
            height, text = 100.0, f"{label}: failed"
        bars.append(Bar(100.0 * i / count, 80.0 / count, height, text, failed))
    return BarChart(tuple(bars), numbers.quantity(Value(value=highest.value, unit=highest.unit)))


@dataclass(frozen=True)
class Tick:
    at: float
    text: str


@dataclass(frozen=True)
class Mark:
    """A point of the plot; `text`: what a pointer shows, `label`: what stands beside it."""

    x: float
    y: float
    text: str
    label: str = ""


@dataclass(frozen=True)
class LogPlot:
    """The frame of a plot whose axes are both logarithmic, in the units of the drawing (y down)."""

    width: int
    height: int
    left: float
    right: float
    top: float
    bottom: float
    xs: tuple[Tick, ...]
    ys: tuple[Tick, ...]


@dataclass(frozen=True)
class NoisePlot(LogPlot):
    """Noise against seconds a frame.

    `frames`: what was measured. `line` and `steps`: what other sample counts would give, for the middle
    frame. `goal`: height of the line of a final picture.
    """

    frames: tuple[Mark, ...]
    line: tuple[tuple[float, float], ...]
    steps: tuple[Mark, ...]
    goal: float | None
    goal_text: str


def noise_plot(report: Report, *, width: int = 460, height: int = 270) -> NoisePlot | None:
    """None where no frame has both a time and an estimate of its noise."""
    quality = quality_of(report)
    seconds = middle_seconds(report.frames)
    measured = [
        (f, f.seconds.value, a.value)
        for f in report.frames
        if f.seconds is not None and f.seconds.value > 0 and (a := amplitude(f.error)) and a.value > 0
    ]
    if quality is None or not seconds or not measured or quality.noise.value <= 0:
        return None
    # Through the middle of both, which need not be one frame.
    steps = [2.0**k for k in range(-2, 7)]
    if quality.samples:
        steps = [k for k in steps if quality.samples * k >= 2]
    cost = {k: seconds * (1 - quality.share + quality.share * k) for k in steps}
    noise = {k: quality.noise.value / math.sqrt(k) for k in steps}
    every_x = [s for _, s, _ in measured] + list(cost.values())
    every_y = [a for _, _, a in measured] + list(noise.values())
    left, right, top, bottom = 46.0, width - 30.0, 14.0, height - 38.0
    x_axis = LogAxis(min(every_x) / 1.15, max(every_x) * 1.15, left, right)
    y_axis = LogAxis(min(every_y) / 1.25, max(every_y) * 1.25, bottom, top)
    marks = tuple(
        Mark(
            x_axis.at(s),
            y_axis.at(a),
            f"frame {f.number}: {numbers.number(a)} % in {numbers.seconds(s)}",
        )
        for f, s, a in measured
    )
    foreseen = []
    for k in steps:
        spp = f"{round(quality.samples * k)} samples" if quality.samples else f"{k:g} times the samples"
        text = f"{spp} a pixel: about {numbers.number(noise[k])} % in {numbers.seconds(cost[k])}"
        label = (f"{round(quality.samples * k)}" if quality.samples else f"{k:g}x") if k != 1 else ""
        foreseen.append(Mark(x_axis.at(cost[k]), y_axis.at(noise[k]), text, label))
    inside = y_axis.low <= 100 * GOAL <= y_axis.high
    return NoisePlot(
        width,
        height,
        left,
        right,
        top,
        bottom,
        x_axis.ticks(time_text, round_times),
        y_axis.ticks(lambda v: f"{v:g} %", decimals),
        marks,
        tuple((m.x, m.y) for m in foreseen),
        tuple(m for m in foreseen if m.label),
        y_axis.at(100 * GOAL) if inside else None,
        f"{100 * GOAL:g} %: about one 8-bit code",
    )


@dataclass(frozen=True)
class LogAxis:
    """Logarithmic, from `low` at `first` to `high` at `last`."""

    low: float
    high: float
    first: float
    last: float

    def at(self, value: float) -> float:
        share = math.log(value / self.low) / math.log(self.high / self.low)
        return self.first + share * (self.last - self.first)

    def ticks(
        self, write: Callable[[float], str], candidates: Callable[[float, float, int], list[float]]
    ) -> tuple[Tick, ...]:
        """At round numbers, fewer where they would be too many."""
        for density in (3, 2, 1):
            values = [v for v in candidates(self.low, self.high, density) if self.low <= v <= self.high]
            if len(values) <= 6:
                break
        return tuple(Tick(self.at(v), write(v)) for v in values)


def decimals(low: float, high: float, density: int) -> list[float]:
    """Round numbers about `low` to `high`, `density` (1, 2 or 3) of them in a decade."""
    steps = {3: (1, 2, 5), 2: (1, 3), 1: (1,)}[density]
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    return [m * 10.0**p for p in powers for m in steps]


def round_times(low: float, high: float, density: int) -> list[float]:
    """Round times in seconds: minutes and hours are round, too."""
    minutes = {3: (1, 2, 5, 10, 20, 30), 2: (1, 3, 10, 30), 1: (1, 10)}[density]
    return [
        *(s for s in decimals(low, high, density) if s < 60),
        *(60.0 * m for m in minutes),
        *(3600.0 * h for h in decimals(1.0, max(high / 3600, 1.0), density)),
    ]


def time_text(seconds: float) -> str:
    """`3 s`, `5 min`, `2 h`: for round times."""
    for unit, size in (("h", 3600.0), ("min", 60.0)):
        if seconds >= size:
            return f"{seconds / size:g} {unit}"
    return numbers.seconds(seconds)
