"""Small files of numbers beside a capture (poses, gains, calibrations): hostile until proved otherwise.

Text is read up to a limit; JSON and YAML become plain data (dict, list, str, int, float, bool, None) or
an InputError, whatever they hold.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from mrbatch.document import read_document, shorten
from mrbatch.errors import InputError, JobErrors, Place

MAX_BYTES = 4 << 20
MAX_DIGITS = 18
"""Longer whole numbers are read as floats: nothing counts so far, and `int` takes its time over them."""


def read_text(path: Path, what: str, *, max_bytes: int = MAX_BYTES) -> str:
    """The text of a file. `what` names its kind in messages. Raises InputError: missing, large, no UTF-8."""
    place = Place(file=str(path))
    if not path.is_file():
        raise InputError(f"the {what} does not exist", place=place)
    try:
        with path.open("rb") as stream:
            raw = stream.read(max_bytes + 1)
    except OSError as error:
        raise InputError(f"the {what} cannot be read ({error.strerror})", place=place) from None
    if len(raw) > max_bytes:
        raise InputError(f"the {what} is larger than {max_bytes >> 20} MiB", place=place)
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        at = Place(file=str(path), byte=error.start)
        raise InputError(f"the {what} cannot be read: it is not UTF-8 text", place=at) from None


def parse_json(text: str, what: str, place: Place) -> Any:
    """Plain data from JSON. Raises InputError: no JSON, nested too deeply, a key given twice."""
    try:
        return json.loads(text, parse_int=_whole, object_pairs_hook=_mapping)
    except RecursionError:
        raise InputError(f"the {what} cannot be read: it is nested too deeply", place=place) from None
    except json.JSONDecodeError as error:
        at = Place(file=place.file, line=error.lineno, column=error.colno)
        raise InputError(f"the {what} cannot be read: {error.msg}", place=at) from None
    except ValueError as error:
        raise InputError(f"the {what} cannot be read: {error}", place=place) from None


def parse_yaml(text: str, what: str, place: Place) -> Any:
    """Plain data from YAML, by the limits (1 MiB) and rules of job files. Raises InputError."""
    try:
        return read_document(text, place.file or "").data
    except JobErrors as several:
        first = several.errors[0]
        raise InputError(
            f"the {what} cannot be read: {first.message}", place=first.place or place, hint=first.hint
        ) from None


def _whole(digits: str) -> int | float:
    return int(digits) if len(digits) <= MAX_DIGITS else float(digits)


def _mapping(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    result: dict[str, Any] = {}
    for name, value in pairs:
        if name in result:
            raise ValueError(f"the key `{shorten(name)}` is given twice")
        result[name] = value
    return result
