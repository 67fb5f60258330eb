"""The small types that travel between rooms. Nothing here computes.

A *method* (and a *participant*, such as a volume) describes itself by one frozen object; its
`build` turns scene, plan and settings into a `Pipeline`, four lists of passes. The batch room runs
pipelines; the film room adds up what they estimate.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol

Lifetime = Literal["pass", "frame", "shot", "history"]
State = Literal["absent", "negligible", "needed", "unresolved", "forced-on", "forced-off"]
TILE = 16
"""Side of a decision tile in pixels; tiles count from absolute pixel (0, 0), whatever is launched."""


@dataclass(frozen=True)
class Counter:
    """An exactly repeatable count of work, for example rays of one kind."""

    name: str
    unit: str
    meaning: str


@dataclass(frozen=True)
class Buffer:
    """An array that passes share.

    `lifetime`: `pass` (scratch), `frame`, `shot` (kept from frame to frame, a function of the shot
    alone) or `history` (committed with each frame and handed to the next of the same segment).
    """

    name: str
    shape: tuple[int, ...]
    dtype: str
    lifetime: Lifetime


@dataclass(frozen=True)
class Domain:
    """What a pass runs over, cut into units that a launch may group but never split.

    For `pixels` a unit is one decision tile of 16x16 pixels of `view`; for others a block of
    `unit_size` consecutive elements (the last may be short).
    """

    kind: Literal["pixels", "texels", "voxels", "points", "nodes"]
    units: int
    unit_size: int
    elements: int
    view: str = ""


@dataclass(frozen=True)
class Span:
    """A run of positions in the list of units that one launch takes."""

    first: int
    count: int


class PassContext(Protocol):
    """What a running pass sees."""

    @property
    def bound(self) -> Any:
        """What `Pipeline.bind` made for this frame; None in the passes of the shot."""

    @property
    def buffers(self) -> Mapping[str, Any]:
        """Arrays by buffer name (`warp.array`)."""

    @property
    def units(self) -> Any:
        """`warp.array` of int32: ids of the units to do; a span indexes into it."""

    @property
    def counters(self) -> Any:
        """`warp.array` of int64, one entry for each of the pass's counters, of this launch alone."""

    @property
    def half(self) -> int:
        """0 or 1: which half-buffer a `refine` pass adds to; 0 elsewhere."""

    @property
    def first_sample(self) -> int:
        """Index of the first sample of this batch within the half."""

    @property
    def samples(self) -> int:
        """Samples of this batch for each element."""


@dataclass(frozen=True)
class Pass:
    """One step of a pipeline: kernels over one domain.

    `launch(context, span)` runs the kernels over the units of one span and may be called from any
    thread; a pass gathers (an element owns what it writes), so the cut into spans never shows.
    `halo`: how many elements around its own a pass reads from the buffers in `reads`.
    `kernels`: every kernel it can launch; all are compiled before the first launch. `everywhere`: it
    runs over its whole domain, also over tiles that nothing virtual touches; `seen`: only over those where
    something virtual may be seen. `each_moment`: a pass of
    `finish` that looks at the scene: where the shutter is open it runs at each moment of the exposure.
    """

    name: str
    domain: Domain
    launch: Callable[[PassContext, Span], None]
    reads: tuple[str, ...] = ()
    writes: tuple[str, ...] = ()
    kernels: tuple[Any, ...] = ()
    counters: tuple[Counter, ...] = ()
    halo: int = 0
    everywhere: bool = False
    seen: bool = False
    each_moment: bool = False


@dataclass(frozen=True)
class Pipeline:
    """Four lists of passes: once a shot, once a frame, once a batch of samples, once at the end.

    Each call of `refine` adds `batch` samples to one half of the film. `bind(frame)` is called once
    a frame before its passes and gives the host-side data that they read; of a frame that is looked at at
    several moments of an exposure, again before the samples of each.
    """

    shot: tuple[Pass, ...] = ()
    frame: tuple[Pass, ...] = ()
    refine: tuple[Pass, ...] = ()
    finish: tuple[Pass, ...] = ()
    buffers: tuple[Buffer, ...] = ()
    batch: int = 4
    bind: Callable[[Any], Any] = lambda frame: frame

    def passes(self) -> tuple[Pass, ...]:
        return self.shot + self.frame + self.refine + self.finish


@dataclass(frozen=True)
class Verdict:
    """What a rule found about an effect: its state, the evidence in words and numbers, the bound.

    `bound`: relative amplitude on the region of interest that leaving the effect out may cost;
    None where there is no bound, 0 where the effect is absent.
    """

    state: State
    why: str
    numbers: Mapping[str, float] = field(default_factory=dict)
    bound: float | None = None


@dataclass(frozen=True)
class Rule:
    """The cheap test that proves an effect absent, or bounds it. `decide` gets the shot's facts."""

    effect: str
    meaning: str
    decide: Callable[[Any], Verdict]


@dataclass(frozen=True)
class Axis:
    """A setting whose values trade accuracy for time, with the law expected and what explains it."""

    name: str
    setting: str
    values: tuple[Any, ...]
    law: str
    counter: str


@dataclass(frozen=True)
class Measurement:
    """Outcome of a hard case: what was measured against what oracle, within which tolerance.

    `conclusive`: the measurement had the power to tell a difference of the tolerance; without it nothing is
    passed. `radiance`, `signed`: the arrays behind it; any value that is no finite number fails the case, and
    in `radiance` any below 0, whatever else was measured.
    """

    passed: bool
    measured: str
    oracle: str
    tolerance: str
    conclusive: bool = True
    radiance: tuple[Any, ...] = field(default=(), compare=False, repr=False)
    signed: tuple[Any, ...] = field(default=(), compare=False, repr=False)


@dataclass(frozen=True)
class Case:
    """A hard case: `run(seed)` sets it up, measures and judges.

    `name`: the row of the catalogue (docs/hard_cases.md) that it is of; `rows`: others that it shows too.
    `setup`: the set-up in a few words. `statistical`: chance may fail it, so it is tried once more on another
    seed where it fails. `quick`: in the quick set.
    """

    name: str
    title: str
    run: Callable[[int], Measurement]
    quick: bool = True
    setup: str = field(default="", kw_only=True)
    rows: tuple[str, ...] = field(default=(), kw_only=True)
    statistical: bool = field(default=False, kw_only=True)


@dataclass(frozen=True)
class Method:
    """How the captured picture changes: one a job.

    `build(scene, plan, settings, outputs)` gives the pipeline of one shot; it is called once a shot.
    `history`: its pipelines may hold buffers that go from frame to frame. `segment(settings)`: at most
    how many frames (None: any number) a state is carried over, and how many earlier frames warm up
    what follows such a cut.
    """

    name: str
    meaning: str
    capture_kinds: tuple[str, ...]
    settings: type
    build: Callable[[Any, Any, Any, Any], Pipeline]
    layers: tuple[str, ...]
    rules: tuple[Rule, ...] = ()
    axes: tuple[Axis, ...] = ()
    cases: tuple[Case, ...] = ()
    history: bool = False
    segment: Callable[[Any], tuple[int | None, int]] = lambda settings: (None, 0)


@dataclass(frozen=True)
class Participant:
    """Something besides the method that adds P, a and D, such as a volume: any number a job.

    What participants estimate is laid over what the method estimates, in the job's order:
    P = Pp + (1 - ap) Pm, a = ap + (1 - ap) am, D = Dp + (1 - ap) Dm. `outputs.source` is the name that
    its film and buffers go by. `history` and `segment` as for a method.
    """

    name: str
    meaning: str
    settings: type
    build: Callable[[Any, Any, Any, Any], Pipeline]
    rules: tuple[Rule, ...] = ()
    axes: tuple[Axis, ...] = ()
    cases: tuple[Case, ...] = ()
    history: bool = False
    segment: Callable[[Any], tuple[int | None, int]] = lambda settings: (None, 0)


@dataclass(frozen=True)
class Told:
    """What a capture's table tells a person.

    `facts`: name, words, meaning. `frames`: by number, what was measured of it: name to value and unit.
    """

    facts: tuple[tuple[str, str, str], ...] = ()
    frames: Mapping[int, Mapping[str, tuple[float, str]]] = field(default_factory=dict)


def _nothing(table: Mapping[str, Any]) -> Told:
    return Told()


@dataclass(frozen=True)
class CaptureKind:
    """A kind of captured dataset. `open(settings, folder)` gives an object with the calls of `Capture`;
    `told(table)` tells what its table holds, without the capture's files."""

    name: str
    meaning: str
    settings: type
    open: Callable[[Any, Any], "Capture"]
    told: Callable[[Mapping[str, Any]], Told] = _nothing


class Progress(Protocol):
    """How far something slow is: `done` of `total` parts of a step; `detail` in words, if there is any."""

    def __call__(self, step: str, done: int, total: int, detail: str = "") -> None: ...


class Capture(Protocol):
    """An opened capture: knows its frames, prepares its tables once a shot, gives frames one at a time."""

    def frame_numbers(self) -> Sequence[int]:
        """Numbers of all usable frames, in order."""

    def announced_numbers(self) -> Sequence[int]:
        """Numbers of all frames that the shot should have, in order, those that are missing included; known
        before anything is prepared."""

    def prepare(self, progress: Progress) -> Mapping[str, Any]:
        """Sees the whole shot once; gives a JSON-ready table (frame times, poses, gains, ...).

        `cuts` in it, if there: numbers of first frames of new scenes, over which no history goes.
        `absent`, if there: by number (as text) why an announced frame can never be rendered.
        """

    def facts(self, table: Mapping[str, Any]) -> Any:
        """What holds for the whole shot, as `mrbatch.capture.frame.CaptureFacts`."""

    def geometry(self, number: int, table: Mapping[str, Any]) -> Mapping[str, Any]:
        """Cameras and gains of a frame by view (`ViewGeometry`), without reading its picture."""

    def frame(self, number: int, table: Mapping[str, Any]) -> Any:
        """One frame as `mrbatch.capture.frame.FrameData`; a pure function of capture, number and table."""

    def inputs(self) -> Sequence[Any]:
        """Paths of every file whose content the pixels depend on."""
