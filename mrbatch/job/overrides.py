"""`--set a.b=c`: changes single values of a job before it is checked.

A path runs through keys, through list positions counted from 0, or through the `name` of a list's
item: `virtual.0.material.roughness=0.2`, `virtual.bunny.material.roughness=0.2`. The value is YAML.
"""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from typing import Any

from mrbatch.document import Document, Loc, read_document, shorten
from mrbatch.errors import JobError, JobErrors, MrbatchError, Place

Override = str | tuple[str, str]
"""`key.key=value`; or that with how the user wrote it before, such as `("--frames 1-3", "frames=1-3")`."""


def apply_overrides(document: Document, overrides: Sequence[Override]) -> None:
    """Changes `document` in place, in order. Raises JobErrors with all that cannot be applied."""
    errors: list[MrbatchError] = []
    for override in overrides:
        written, change = (f"--set {override}", override) if isinstance(override, str) else override
        try:
            _apply(document, change, Place(file=shorten(written, 126)))
        except JobErrors as several:
            errors.extend(several.errors)
        except JobError as error:
            errors.append(error)
    if errors:
        raise JobErrors(errors)


def _apply(document: Document, override: str, place: Place) -> None:
    path, equals, text = override.partition("=")
    keys = [key.strip() for key in path.split(".")]
    if not equals or not all(keys):
        raise JobError(
            "cannot read this change", place=place, hint="write `--set key.key=value`, as in `--set seed=3`"
        )
    try:
        value = read_document(text, "--set").data
    except JobErrors as several:
        raise JobErrors([JobError(e.message, place=place, hint=e.hint) for e in several.errors]) from None

    if not isinstance(document.data, dict):
        document.data = {}
    at: Any = document.data
    loc: Loc = ()
    for key in keys[:-1]:
        step = _step(at, key, loc, place)
        if isinstance(at, dict) and at.get(key) is None:
            at[key] = {}
            document.keys[(*loc, key)] = document.values[(*loc, key)] = place
        loc = (*loc, step)
        at = at[step]
    step = _step(at, keys[-1], loc, place)
    at[step] = value
    loc = (*loc, step)
    _forget(document.keys, loc)
    _forget(document.values, loc)
    document.keys[loc] = document.values[loc] = place


def _step(at: Any, key: str, loc: Loc, place: Place) -> str | int:
    """The key or list position that `key` means in the node `at`."""
    where = ".".join(map(str, loc))
    if isinstance(at, dict):
        return key
    if not isinstance(at, list):
        raise JobError(
            f"`{where}` is a single value, so it holds no `{shorten(key)}`",
            place=place,
            hint=f"set `{where}` itself, for example `--set {where}={{{key}: ...}}`",
        )
    if key.isdecimal():
        if int(key) < len(at):
            return int(key)
        raise JobError(
            f"`{where}` has no item {key}: it has {len(at)}",
            place=place,
            hint="items are counted from 0",
        )
    names = [item["name"] for item in at if isinstance(item, dict) and isinstance(item.get("name"), str)]
    for index, item in enumerate(at):
        if isinstance(item, dict) and item.get("name") == key:
            return index
    near = difflib.get_close_matches(key, names, n=1)
    raise JobError(
        f"`{where}` has no item named `{shorten(key)}`",
        place=place,
        hint=f"did you mean `{near[0]}`?"
        if near
        else f"its names: {', '.join(map(shorten, names)) or 'none'}",
    )


def _forget(places: dict[Loc, Place], loc: Loc) -> None:
    for old in [old for old in places if old[: len(loc)] == loc]:
        del places[old]
