"""The one report model: what a job did, how good it is and what it cost. All pages are drawn from it.

`report.json` is this model with a schema version. Every number that was measured is a `Value`: with
its unit, and with interval and repetitions where they exist. Nothing here measures.
"""

from __future__ import annotations

import contextlib
import json
import os
import uuid
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, ValidationError

from mrbatch.contracts import State
from mrbatch.errors import InputError, Place, ResourceError
from mrbatch.report.sweep import Sweep
from mrbatch.report.values import Model, Score, Value

SCHEMA_MAJOR = 1
SCHEMA_MINOR = 3
SCHEMA = f"{SCHEMA_MAJOR}.{SCHEMA_MINOR}"
"""Major: what a name means has changed. Minor: names were added, which older readers leave out."""
MAX_BYTES = 1 << 28


class Effect(Model):
    """What the plan decided about one effect and why; `bound` is a relative amplitude."""

    name: str
    state: State
    why: str
    meaning: str = ""
    frames: str = ""
    """Frames for which this holds, for example `1-40`; empty for the whole shot."""
    bound: float | None = None
    cost: Value | None = None
    """Seconds that the effect takes, or would take, as predicted."""
    numbers: dict[str, float] = Field(default_factory=dict)


class Plan(Model):
    """The effects of the shot, and what leaving some of them out saved, where that was measured."""

    effects: tuple[Effect, ...] = ()
    saved: Value | None = None


class File(Model):
    """A file that was written, relative to the report, with its content hash."""

    path: str
    hash: str = ""
    bytes: int | None = None


class Frame(Model):
    """One frame of the job.

    `state`: `done` now, `kept` from an earlier run, `failed`, or `skipped`. `outcome`: how its samples
    ended: `fixed` count, `reached` the target, `limit` of time, or `converged-floor` (bias: more
    samples will not help). `error`: the estimated error of the frame. `exit`: exit code it stands for.
    """

    number: int
    state: Literal["done", "kept", "failed", "skipped"]
    outcome: Literal["fixed", "reached", "limit", "converged-floor", "none"] = "none"
    time: float | None = None
    seconds: Value | None = None
    error: Value | None = None
    samples: int | None = None
    """Samples a pixel."""
    numbers: dict[str, Value] = Field(default_factory=dict)
    """What was measured of the frame, by its name for people: `marker rms`."""
    counters: dict[str, int] = Field(default_factory=dict)
    flags: tuple[str, ...] = ()
    files: tuple[File, ...] = ()
    scores: tuple[Score, ...] = ()
    message: str = ""
    hint: str = ""
    exit: int = 0


class TimingNode(Model):
    """A node of the timing tree, as `mrbatch.device.timing.TimingNode.as_dict()` gives it.

    `seconds`: wall time, children included; `thread_seconds`: summed over threads; `launches` of kernels.
    """

    name: str
    seconds: float
    thread_seconds: float = 0.0
    calls: int = 0
    launches: int = 0
    counters: dict[str, int] = Field(default_factory=dict)
    children: tuple[TimingNode, ...] = ()


class Run(Model):
    """One run of the job's command: wall `seconds` from start to end, `frames` it rendered, and what ended
    it early, if anything did."""

    created: str = ""
    seconds: Value
    frames: int = 0
    predicted_seconds: Value | None = None
    exit: int = 0
    message: str = ""


class Totals(Model):
    """`seconds`: wall time of all runs added up; `frame_seconds`: what the frames that are there took."""

    seconds: Value | None = None
    frame_seconds: Value | None = None
    predicted_seconds: Value | None = None
    frames_done: int = 0
    frames_kept: int = 0
    frames_failed: int = 0
    frames_skipped: int = 0
    rays_per_second: Value | None = None
    counters: dict[str, int] = Field(default_factory=dict)


class Note(Model):
    """What a person should know, such as a pose that was held."""

    level: Literal["info", "warning", "error"]
    text: str
    frame: int | None = None


Role = Literal[
    "composite", "photo", "delta", "error", "reference", "difference", "flip", "plot", "sheet", "other"
]


class NoiseBlocks(Model):
    """A map of the noise that is left, as `mrbatch.metrics.noise.NoiseMap.as_dict()` gives it."""

    block: int
    columns: int
    rows: int
    codes: str


class Legend(Model):
    """A colour bar: `signed` (black, grey, white) or `magma` (black to pale), with evenly spread ticks."""

    kind: Literal["signed", "magma"]
    ticks: tuple[str, ...]


class Picture(Model):
    """A picture to show, by its path relative to the report (or a name given to the drawer).

    `layer`: which layer of an EXR file; empty for its R, G, B. `noise`: a map that is laid over it.
    `legend`: of a picture that is given as it is to be shown; what the page draws itself gets its own.
    """

    role: Role
    path: str
    layer: str = ""
    frame: int | None = None
    view: str = ""
    caption: str = ""
    noise: NoiseBlocks | None = None
    legend: Legend | None = None


class Gate(Model):
    """A condition with its measured figure: passed or not."""

    name: str
    passed: bool
    text: str
    measured: Value | None = None
    limit: Value | None = None
    frame: int | None = None


Outcome = Literal["passed", "failed", "inconclusive", "skipped"]


class Attempt(Model):
    seed: int
    outcome: Outcome
    measured: str = ""


class HardCase(Model):
    """A hard case; `name`: the row of the catalogue; `owner`: the method it is of, or none where shared.
    `reason`: why it failed or was skipped. `attempts`: one a seed that it was tried on."""

    name: str
    outcome: Outcome
    owner: str = ""
    title: str = ""
    setup: str = ""
    oracle: str = ""
    tolerance: str = ""
    measured: str = ""
    reason: str = ""
    rows: tuple[str, ...] = ()
    tests: tuple[str, ...] = ()
    seconds: Value | None = None
    attempts: tuple[Attempt, ...] = ()

    @property
    def passed(self) -> bool:
        return self.outcome in ("passed", "skipped")


class Fact(Model):
    """Something that a person wants to know of the shot, in words; `meaning`: what it is."""

    name: str
    text: str
    meaning: str = ""


class Job(Model):
    """`settings` are the resolved, pixel-relevant ones: the same on every machine."""

    name: str
    hash: str = ""
    method: str = ""
    capture: str = ""
    seed: int | None = None
    settings: dict[str, Any] = Field(default_factory=dict)


class Report(Model):
    """Everything that the pages show; `machine` holds what may differ without changing a pixel."""

    schema_version: str = SCHEMA
    kind: Literal["render", "metrics", "plan", "sweep", "stability", "ci"] = "render"
    job: Job
    versions: dict[str, str] = Field(default_factory=dict)
    machine: dict[str, str] = Field(default_factory=dict)
    created: str = ""
    facts: tuple[Fact, ...] = ()
    files: tuple[File, ...] = ()
    """What a person may want to open beside the frames: the movie, the contact sheet."""
    plan: Plan = Plan()
    frames: tuple[Frame, ...] = ()
    timing: TimingNode | None = None
    totals: Totals = Totals()
    runs: tuple[Run, ...] = ()
    """Those that rendered something or ended early, in the order of their ends."""
    notes: tuple[Note, ...] = ()
    pictures: tuple[Picture, ...] = ()
    gates: tuple[Gate, ...] = ()
    cases: tuple[HardCase, ...] = ()
    sweep: Sweep | None = None
    exit: int = 0

    def to_json(self) -> str:
        """Stable text: fields in order of the model, infinities as strings (JSON has none)."""
        return self.model_dump_json(indent=1) + "\n"

    @property
    def passed(self) -> bool:
        judged = [g.passed for g in self.gates] + [c.passed for c in self.cases]
        return all(judged) and not any(f.state == "failed" for f in self.frames)


def save_report(report: Report, path: Path) -> None:
    """Write `report.json` in one step: a reader sees the old file or the whole new one.

    Raises ResourceError where the place cannot be written.
    """
    write_text(Path(path), report.to_json())


def write_text(path: Path, text: str) -> None:
    """Write a page in one step, UTF-8, line feeds. Raises ResourceError where it cannot be written."""
    temporary = path.with_name(f".{path.name}.{uuid.uuid4().hex}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with temporary.open("x", encoding="utf-8", newline="\n") as stream:
            stream.write(text)
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(temporary, path)
    except OSError as error:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
        raise ResourceError(
            f"cannot write the report: {error.strerror or error}",
            place=Place(file=str(path)),
            hint="check the folder's rights and free space",
        ) from error


def load_report(path: Path) -> Report:
    """Read a `report.json`, or the one in a folder.

    A report of a newer minor version is read without the names that this version does not know.
    Raises InputError where there is none, it is no report, or its major version differs.
    """
    path = Path(path)
    if path.is_dir():
        path = path / "report.json"
    place = Place(file=str(path))
    try:
        if path.stat().st_size > MAX_BYTES:
            raise InputError(f"the report is larger than {MAX_BYTES >> 20} MiB", place=place)
        data = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise InputError(
            "there is no report here", place=place, hint="give a job's output folder, or its report.json"
        ) from error
    except OSError as error:
        raise InputError(f"cannot read the report: {error.strerror or error}", place=place) from error
    except (json.JSONDecodeError, UnicodeDecodeError, RecursionError) as error:
        line = getattr(error, "lineno", None)
        raise InputError(
            f"not a JSON report: {getattr(error, 'msg', None) or error}",
            place=Place(file=str(path), line=line, column=getattr(error, "colno", None)),
            hint="render again, or restore the file",
        ) from error
    return parse_report(data, place)


def parse_report(data: Any, place: Place | None = None) -> Report:
    """JSON data to the model; see `load_report`."""
    version = data.get("schema_version") if isinstance(data, dict) else None
    parts = version.split(".") if isinstance(version, str) else []
    if len(parts) != 2 or not all(p.isascii() and p.isdigit() and len(p) < 6 for p in parts):
        raise InputError("this is no report: it names no schema version", place=place, hint="expected 1.0")
    major, minor = int(parts[0]), int(parts[1])
    if major != SCHEMA_MAJOR:
        raise InputError(
            f"the report has schema {version}, this version reads {SCHEMA_MAJOR}.x",
            place=place,
            hint="draw it with the version of mrbatch that wrote it (see its `versions`)",
        )
    try:
        try:
            return Report.model_validate(data)
        except ValidationError as error:
            if minor <= SCHEMA_MINOR:
                raise
            return Report.model_validate(_without_unknown(data, error))
    except (ValidationError, RecursionError) as error:
        raise InputError(f"the report is damaged: {_first(error)}", place=place) from error


def _without_unknown(data: Any, error: ValidationError) -> Any:
    """A copy of `data` without the names that a newer minor version added."""
    copy = json.loads(json.dumps(data))
    for found in error.errors():
        if found["type"] != "extra_forbidden":
            continue
        *steps, name = found["loc"]
        node = copy
        for step in steps:
            node = node[step]
        node.pop(name, None)
    return copy


def _first(error: Exception) -> str:
    if not isinstance(error, ValidationError):
        return "nested too deeply"
    found = error.errors()
    where = ".".join(str(step) for step in found[0]["loc"])
    more = f" (and {len(found) - 1} more)" if len(found) > 1 else ""
    return f"{where}: {found[0]['msg']}{more}"
