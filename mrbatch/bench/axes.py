"""Which settings a sweep varies, and over which values: the method's axes, common ones, what is asked for.

A method adds an axis by a line in its `axes.py`; nothing here has to know of it.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from mrbatch.contracts import Axis
from mrbatch.device.rays import resolve_engine
from mrbatch.device.runner import usable_cores
from mrbatch.document import read_document
from mrbatch.errors import JobError, JobErrors
from mrbatch.job.model import Job

THREADS = "threads"
"""The one axis that is no setting of the job."""
NEAR = 8.0
"""Registered numbers further than this factor from the job's own are left out: they would take long."""
ESTIMATORS = ("delta-path-tracing", "one-pass", "two-pass")

COMMON = (
    Axis("spp", "method.spp", (4, 16, 64, 256, 1024), "time ~ N, error ~ N^-1/2 or faster", "camera rays"),
    Axis("resolution", "output.scale", (0.25, 0.5, 1.0), "time ~ pixels", "camera rays"),
    Axis("filter", "output.filter.kind", ("none", "bilateral", "variance", "oidn"), "noise for bias", ""),
    Axis("ray engine", "engine", ("embree", "warp"), "same picture, other time", "scatter rays"),
    Axis("estimator", "method.name", ESTIMATORS, "noise of a difference", "lookups"),
)
"""Axes of every method that has the setting."""


@dataclass(frozen=True)
class Choice:
    """A value of an axis: the changes of the job that make it, and how many threads."""

    axis: str
    label: str
    settings: tuple[str, ...]
    threads: int
    values: Mapping[str, str]

    @property
    def name(self) -> str:
        return f"{self.axis} {self.label}"


@dataclass(frozen=True)
class Chosen:
    """An axis as it is swept: `own` is the job's value, `choices` all others."""

    axis: Axis
    own: str
    choices: tuple[Choice, ...]
    left_out: Mapping[str, str] = field(default_factory=dict)


def axes_of(job: Job) -> tuple[Axis, ...]:
    """The method's axes and its participants', then those of all methods; one a setting, names are unique."""
    found: dict[str, Axis] = {}
    of_participants = [
        _of_participant(axis, index)
        for index, participant in enumerate(job.participant_objects)
        for axis in participant.axes
    ]
    threads = Axis(
        THREADS, THREADS, tuple(dict.fromkeys((1, usable_cores()))), "same picture, other time", ""
    )
    for axis in (*job.method_object.axes, *of_participants, *COMMON, threads):
        if axis.setting not in found and not any(axis.name == other.name for other in found.values()):
            found[axis.setting] = axis
    return tuple(found.values())


def _of_participant(axis: Axis, index: int) -> Axis:
    """Settings of a participant are named from its own root."""
    path = f"participants.{index}.{axis.setting.removeprefix('participant.')}"
    return Axis(f"{axis.name} {index}", path, axis.values, axis.law, axis.counter)


def choose(job: Job, asked: Sequence[str], threads: int) -> tuple[Chosen, ...]:
    """The axes that are asked for (`name`, `setting`, or either with `=values`); all where none is.

    Values that the job cannot take are checked where they are rendered. Raises JobErrors for words that name
    no axis and no setting, or values that cannot be read.
    """
    known = axes_of(job)
    if not asked:
        # An axis of a setting that this method does not have is none of its axes.
        return tuple(c for axis in known if _has(job, axis) and (c := _chosen(job, axis, threads)).choices)
    errors: list[JobError] = []
    found = []
    for text in asked:
        try:
            found.append(_asked(job, known, text, threads))
        except JobError as error:
            errors.append(error)
    if errors:
        raise JobErrors(errors)
    taken = [chosen.axis.name for chosen in found]
    if len(set(taken)) < len(taken):
        raise JobErrors([JobError("an axis is asked for twice", hint="give all its values in one `--axis`")])
    return tuple(found)


def _asked(job: Job, known: Sequence[Axis], text: str, threads: int) -> Chosen:
    name, equals, listed = (part.strip() for part in text.partition("="))
    axis = next((a for a in known if name in (a.name, a.setting)), None)
    if axis is None and not equals:
        raise JobError(
            f"there is no axis `{name[:60]}`",
            hint=f"axes of this job: {', '.join(a.name for a in known)}; or give `setting=value,value`",
        )
    if axis is None:
        axis = Axis(name, name, (), "", "")
    if not equals:
        return _chosen(job, axis, threads)
    values = tuple(_values(text, listed))
    return _chosen(job, Axis(axis.name, axis.setting, values, axis.law, axis.counter), threads, near=False)


def _values(text: str, listed: str) -> list[Any]:
    try:
        values = read_document(f"[{listed}]", "--axis").data
    except JobErrors:
        values = None
    if not values:
        raise JobError(f"cannot read the values of `--axis {text[:80]}`", hint="write `method.spp=4,16,64`")
    return list(values)


def _has(job: Job, axis: Axis) -> bool:
    if axis.name == "estimator":
        return job.method_name in ESTIMATORS
    return axis.setting == THREADS or own_value(job, axis.setting, 1) is not _ABSENT


_ABSENT = object()


def own_value(job: Job, setting: str, threads: int) -> Any:
    """What the job has there: a setting by its dotted path, list items by number or name."""
    if setting == THREADS:
        return threads
    if setting == "engine":
        return resolve_engine(job.engine)
    at: Any = job
    for key in setting.split("."):
        if isinstance(at, tuple | list):
            named = [item for item in at if getattr(item, "name", None) == key]
            at = at[int(key)] if key.isdecimal() and int(key) < len(at) else named[0] if named else _ABSENT
        else:
            at = at.get(key, _ABSENT) if isinstance(at, Mapping) else getattr(at, key, _ABSENT)
    return at


def _chosen(job: Job, axis: Axis, threads: int, *, near: bool = True) -> Chosen:
    own = own_value(job, axis.setting, threads)
    values = []
    left_out: dict[str, str] = {}
    for value in axis.values:
        if label(value) == label(own):
            continue
        if near and _number(value) and _number(own) and not 1 / NEAR <= value / own <= NEAR:
            left_out[label(value)] = (
                f"more than {NEAR:g} times off the job's own; `--axis '{axis.setting}=...'` measures it"
            )
            continue
        values.append(value)
    choices = tuple(choice(axis.name, ((axis, value),), threads) for value in values)
    return Chosen(axis, "-" if own is _ABSENT else label(own), choices, left_out)


def choice(name: str, parts: Sequence[tuple[Axis, Any]], threads: int) -> Choice:
    """One or several settings at once."""
    settings = tuple(f"{axis.setting}={_written(value)}" for axis, value in parts if axis.setting != THREADS)
    count = next((int(value) for axis, value in parts if axis.setting == THREADS), threads)
    values = {axis.name: label(value) for axis, value in parts}
    return Choice(name, " x ".join(values.values()), settings, count, values)


def _number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and value > 0


def _written(value: Any) -> str:
    """As YAML reads it back (JSON is YAML)."""
    return (
        value
        if isinstance(value, str) and value.replace("-", "").isalnum()
        else json.dumps(value, default=str)
    )


def label(value: Any) -> str:
    """A value as people read it."""
    if value is None:
        return "none"
    if isinstance(value, bool):
        return "on" if value else "off"
    return f"{value:g}" if isinstance(value, float) else str(value)
