"""The part of the report that a sweep fills: what each setting costs in time and gives in accuracy.

Errors are relMSE on the region of interest unless a name says otherwise; ratios have the unit `x`.
"""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from mrbatch.report.values import Model, Score, Value

Kind = Literal["time", "error"]
Verdict = Literal["less", "more", "undecided"]


class SweepAxis(Model):
    """A setting that was varied, from the job's own value `own`.

    `law`, `counter`: what was expected of it. `left_out`: values that were not measured, with the reason.
    `again`: the job's own settings over themselves, timed in the same turns, which is the machine's noise;
    `told_apart`: the ratio of times from which `repeats` turns tell two values apart with probability 0.9.
    """

    name: str
    setting: str
    own: str
    law: str = ""
    counter: str = ""
    left_out: dict[str, str] = Field(default_factory=dict)
    repeats: int = 0
    again: Value | None = None
    told_apart: float | None = None


class SweepPoint(Model):
    """One rendering of the frame with some settings, many times.

    `values`: by axis. `time`, `error`: as ratios to the job's own settings, in pairs. `seconds`: of a frame,
    reading and developing included; `pass_seconds`: of the passes that add samples alone. `noise`: the part
    of the error that more samples take away, from seeds; `bias`: the rest, without the truth's own error.
    `front`: no other point is both as fast and as exact, by the figures. `beaten_by`: a point of its axis
    that is claimed to be faster, and more exact unless the error is the very same.
    """

    name: str
    axis: str
    value: str
    own: bool = False
    values: dict[str, str] = Field(default_factory=dict)
    samples: int | None = None
    seconds: Value
    pass_seconds: Value
    time: Value
    error: Value | None = None
    relmse: Value | None = None
    noise: Value | None = None
    bias: Value | None = None
    below_truth: bool = False
    """The error is below three times the truth's own: how far below cannot be told."""
    scores: tuple[Score, ...] = ()
    counters: dict[str, int] = Field(default_factory=dict)
    repeats_bits: bool = True
    """A second rendering gave the same bits as the one whose work was counted."""
    front: bool = False
    beaten_by: str = ""


class SweepClaim(Model):
    """Which of two points of an axis takes `less` or `more` time, or has `less` or `more` error."""

    axis: str
    kind: Kind
    first: str
    second: str
    outcome: Verdict
    ratio: Value
    p: float


class SweepTruth(Model):
    """What errors are measured against. `own`: its own relMSE on the region of interest; None: not known, so
    that nothing is claimed on errors. `independent`: not made by this program."""

    source: str
    independent: bool = False
    settings: tuple[str, ...] = ()
    samples: int | None = None
    own: Value | None = None
    pixels: int = 0


class SweepSlope(Model):
    """`of` falls as `against` to the power of `slope`, along the samples of a pixel."""

    of: str
    against: str
    slope: Value
    points: int


class SweepTarget(Model):
    """What it takes a point's settings to bring the error to the target.

    `outcome`: `reached`; `converged-floor`: its bias is larger; `undecided`: it may be. `foreseen`:
    from its noise and the slope of the error with samples; else rendered with these samples.
    """

    point: str
    outcome: Literal["reached", "converged-floor", "undecided"]
    samples: int | None = None
    seconds: Value | None = None
    relmse: float | None = None
    foreseen: bool = True


class SweepGrid(Model):
    """Two axes at once: names of points by the values of both (rows: the first)."""

    first: str
    second: str
    rows: tuple[str, ...]
    columns: tuple[str, ...]
    points: tuple[tuple[str, ...], ...]


class SweepCrop(Model):
    """A picture at the samples with which a point takes as much time, or has as much error, as the job's own
    settings do (foreseen from ratio and slope). `seconds`, `relmse`: of this one rendering."""

    point: str
    kind: Literal["equal time", "equal error"]
    path: str
    samples: int
    seconds: float
    relmse: float


class Sweep(Model):
    """Everything that was measured of one frame. `again`: over all axes; `confidence` of all claims together;
    `margin`: what a ratio must be beyond to be claimed; `target`: relMSE that `targets` are for."""

    frame: int
    width: int = 0
    height: int = 0
    threads: int = 1
    seconds: Value
    truth: SweepTruth
    axes: tuple[SweepAxis, ...] = ()
    points: tuple[SweepPoint, ...] = ()
    claims: tuple[SweepClaim, ...] = ()
    again: Value
    confidence: float = 0.99
    margin: float = 0.0
    slopes: tuple[SweepSlope, ...] = ()
    knee: str = ""
    target: float | None = None
    targets: tuple[SweepTarget, ...] = ()
    grid: SweepGrid | None = None
    crops: tuple[SweepCrop, ...] = ()

    def point(self, name: str) -> SweepPoint:
        """The point of that name. Raises KeyError."""
        return {p.name: p for p in self.points}[name]

    def seconds_of(self, point: SweepPoint) -> Value:
        """Of a frame, by the ratio to the job's own settings: what the machine did meanwhile is left out, so
        that points of different axes, which were measured one after another, can stand in one plot."""
        own = self.own.seconds
        if point.own:
            return own
        parts = {
            key: None if (v := getattr(point.time, key)) is None else own.value * v
            for key in ("value", "low", "high")
        }
        return point.time.model_copy(update={**parts, "unit": own.unit})

    @property
    def own(self) -> SweepPoint:
        """The job's own settings."""
        return next(p for p in self.points if p.own)
