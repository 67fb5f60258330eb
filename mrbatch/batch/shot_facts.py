"""What a person wants to know of a shot at a glance, in words for the report."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from pathlib import PurePosixPath
from typing import Any

from mrbatch.batch.journal import FrameEntry
from mrbatch.batch.shot import Shot
from mrbatch.capture.registry import capture_kind
from mrbatch.contracts import Told
from mrbatch.errors import JobError
from mrbatch.report.model import Fact

ENGINES = {"embree": "Embree", "warp": "Warp"}


def told_by_capture(record: Mapping[str, Any], shot: Shot | None) -> Told:
    """What the capture's own tables tell; nothing where this installation does not know them."""
    if shot is None:
        return Told()
    # A table of another version must not cost the report.
    with contextlib.suppress(JobError, KeyError, TypeError, ValueError, IndexError, ZeroDivisionError):
        return capture_kind(record.get("capture", "")).told(shot.table)
    return Told()


def shot_facts(
    record: Mapping[str, Any], shot: Shot | None, there: Sequence[FrameEntry], told: Told
) -> tuple[Fact, ...]:
    """`record`: what `job.json` holds. `there`: frames that were rendered."""
    facts: list[Fact] = []
    details: Mapping[str, Any] = there[0].details if there else {}
    if size := details.get("display"):
        text = f"{size[0]} x {size[1]} pixels"
        window = details.get("window")
        if window and list(window) != [0, 0, *size]:
            text += f"; rendered {window[2]} x {window[3]} from ({window[0]}, {window[1]})"
        facts.append(Fact(name="picture", text=text))
    if samples := details.get("samples"):
        facts.append(Fact(name="samples a pixel", text=str(samples), meaning="where virtual objects matter"))
    environment = record["settings"].get("environment") or {}
    if isinstance(environment, Mapping) and environment.get("file"):
        facts.append(Fact(name="light", text=PurePosixPath(str(environment["file"])).name))
    facts += [Fact(name=name, text=text, meaning=meaning) for name, text, meaning in told.facts]
    if shot is not None:
        facts.append(Fact(name="colour in files", text=shot.colour_type, meaning=shot.colour_reason))
        facts.append(Fact(name="ray engine", text=ENGINES.get(shot.engine, shot.engine)))
    return tuple(facts)
