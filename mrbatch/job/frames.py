"""Which frames a job renders: `all`, `1001-1100x2,1200`, or a list.

A selection is kept as text in one canonical form, so that it reads the same in the job, on the
command line and in the report.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Annotated, Any

from pydantic import BeforeValidator, WithJsonSchema

from mrbatch.errors import JobError, Place

ALL = "all"
MAX_FRAME = 10**9
_PART = re.compile(r"\s*(-?\d{1,10})\s*(?:-\s*(-?\d{1,10})\s*(?:x\s*(\d{1,10}))?)?\s*\Z")


def _ranges(selection: str) -> list[tuple[int, int, int]]:
    """Parts as (first, last, step). Raises ValueError."""
    result = []
    for part in selection.split(","):
        match = _PART.match(part)
        if not match:
            raise ValueError(
                f"cannot read the frames `{part.strip()[:40]}`: expected `all`, numbers and ranges such as "
                "`1001-1100x2,1200`"
            )
        first, last, step = match.groups()
        a = int(first)
        b = a if last is None else int(last)
        n = 1 if step is None else int(step)
        if b < a:
            raise ValueError(f"the frames `{part.strip()}` run backwards")
        if n == 0:
            raise ValueError(f"the step of the frames `{part.strip()}` must be 1 or more")
        if max(abs(a), abs(b)) > MAX_FRAME:
            raise ValueError(f"frame numbers go up to {MAX_FRAME}")
        result.append((a, b, n))
    return result


def canonical_frames(value: Any) -> str:
    """Text, a number, or a list of both, to canonical text. Raises ValueError."""
    if isinstance(value, (list, tuple)):
        if not value:
            raise ValueError("the list of frames is empty")
        parts = [canonical_frames(item) for item in value]
        if ALL in parts:
            raise ValueError("`all` stands alone")
        return ",".join(parts)
    if isinstance(value, int) and not isinstance(value, bool):
        value = str(value)
    if not isinstance(value, str):
        raise ValueError("expected `all`, ranges such as `1001-1100x2`, or a list of frame numbers")
    if value.strip() == ALL:
        return ALL
    return ",".join(
        f"{a}" if a == b else f"{a}-{b}" if n == 1 else f"{a}-{b}x{n}" for a, b, n in _ranges(value)
    )


def select_frames(selection: str, available: Sequence[int], *, place: Place | None = None) -> tuple[int, ...]:
    """The frames of `available` that `selection` names, in rising order, each once.

    A range may reach beyond what is there; a part that meets no frame at all is an error.
    Raises JobError.
    """
    frames = sorted(set(available))
    if selection == ALL:
        return tuple(frames)
    chosen: set[int] = set()
    there = f"frames {frames[0]} to {frames[-1]} are there" if frames else "the capture has no usable frame"
    for a, b, n in _ranges(selection):
        met = [f for f in frames if a <= f <= b and (f - a) % n == 0]
        if not met:
            text = f"{a}" if a == b else f"{a}-{b}" + (f"x{n}" if n > 1 else "")
            raise JobError(f"there are no frames {text}", place=place, hint=there)
        chosen.update(met)
    return tuple(sorted(chosen))


def beyond(selection: str, available: Sequence[int]) -> str:
    """What to tell of ranges that reach beyond the frames that are there; empty where none does."""
    if selection == ALL or not available:
        return ""
    first, last = min(available), max(available)
    over = [f"{a}-{b}" for a, b, _ in _ranges(selection) if a < b and (a < first or b > last)]
    if not over:
        return ""
    return f"of the frames {', '.join(over)} asked for, {first} to {last} are there"


FrameSelection = Annotated[
    str,
    BeforeValidator(canonical_frames),
    WithJsonSchema(
        {
            "anyOf": [
                {"type": "string", "pattern": r"^\s*(all|-?\d[\dx,\s-]*)\s*$"},
                {"type": "integer"},
                {
                    "type": "array",
                    "items": {"anyOf": [{"type": "integer"}, {"type": "string"}]},
                    "minItems": 1,
                },
            ]
        }
    ),
]
