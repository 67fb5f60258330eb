"""The paths of a job: in its models, and in the plain data of one that has errors."""

from __future__ import annotations

import types
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, Union, get_args, get_origin

from pydantic import BaseModel

from mrbatch.job.choice import Choice, Loc
from mrbatch.job.model import Job
from mrbatch.quantities import INPUT_PATH


def job_paths(job: Job) -> Iterator[tuple[Loc, Path, bool]]:
    """Every path in the job: its place, the path, and whether it is written rather than read."""
    found: list[tuple[Loc, Path]] = []

    def note(value: Path, loc: Loc) -> Path:
        found.append((loc, value))
        return value

    map_paths(job, note)
    for loc, path in found:
        yield loc, path, loc == ("output", "directory")


def map_paths(value: Any, change: Callable[[Path, Loc], Path], loc: Loc = ()) -> Any:
    """`value` with `change` applied to every path in it, however deep."""
    if isinstance(value, Path):
        return change(value, loc)
    if isinstance(value, BaseModel):
        update = {}
        for name in type(value).model_fields:
            old = getattr(value, name)
            new = map_paths(old, change, (*loc, name))
            if new is not old:
                update[name] = new
        return value.model_copy(update=update) if update else value
    if isinstance(value, (tuple, list)):
        items = [map_paths(item, change, (*loc, i)) for i, item in enumerate(value)]
        return type(value)(items) if any(a is not b for a, b in zip(items, value)) else value
    if isinstance(value, dict):
        pairs = {key: map_paths(item, change, (*loc, key)) for key, item in value.items()}
        return pairs if any(pairs[key] is not value[key] for key in value) else value
    return value


def input_paths(data: Any) -> Iterator[tuple[Loc, Path]]:
    """Every path that a job reads, out of its plain data, whatever else may be wrong with them.

    Places are those that the same path has in a `Job`; a part whose kind cannot be told has none.
    """
    seen: set[Loc] = set()
    for loc, path in _walk(Job, (), data, ()):
        if loc not in seen:
            seen.add(loc)
            yield loc, path


def _walk(annotation: Any, metadata: Sequence[Any], value: Any, loc: Loc) -> Iterator[tuple[Loc, Path]]:
    if INPUT_PATH in metadata:
        if isinstance(value, str) and value.strip():
            yield loc, Path(value)
        return
    for item in metadata:
        if isinstance(item, Choice):
            chosen = item.model_for(value)
            if chosen is not None:
                yield from _walk(chosen, (), value, loc)
            return
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        yield from _walk(arguments[0], arguments[1:], value, loc)
    elif origin in (Union, types.UnionType):
        for arm in arguments:
            yield from _walk(arm, (), value, loc)
    elif origin in (tuple, list) and arguments:
        # One path may stand for a list of one.
        items = value if isinstance(value, list) else [value] if isinstance(value, str) else []
        for index, item in enumerate(items):
            kind = arguments[index] if index < len(arguments) else arguments[0]
            yield from _walk(arguments[0] if kind is Ellipsis else kind, (), item, (*loc, index))
    elif origin is dict and isinstance(value, dict):
        for key, item in value.items():
            yield from _walk(arguments[1], (), item, (*loc, key))
    elif isinstance(annotation, type) and issubclass(annotation, BaseModel):
        if isinstance(value, (str, list)) and hasattr(annotation, "expand"):
            value = annotation.expand(value)  # the short form of a part
        if isinstance(value, dict):
            for name, field in annotation.model_fields.items():
                if name in value:
                    yield from _walk(field.annotation, field.metadata, value[name], (*loc, name))
