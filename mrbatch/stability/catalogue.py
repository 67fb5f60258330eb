"""The rows of the catalogue of hard cases, and why some are held by the test suite alone.

`rows.json` is written by `python tests/hard_cases.py` from docs/hard_cases.md and the marks of the tests.
"""

from __future__ import annotations

import functools
import json
from dataclasses import dataclass
from pathlib import Path

from mrbatch.report.model import HardCase
from mrbatch.stability.registry import entries

PRINTED = "what fails there is a printed form, which the product does not carry"
FOOTAGE = "needs rendered footage of targets, which the tests draw"
FILES = "needs files that are cut, damaged or made by others, which the tests write"
JOBS = "needs whole jobs with their folders"
BRACKET = "needs exposure brackets, which the tests make"
LOOKS = "needs a printed sheet and its photo, which the tests draw"
MAPS = "needs what the job prepares of a map and a room"

HELD_BY_TESTS: dict[str, str] = {
    **dict.fromkeys(("TRAP-1a", "TRAP-1j", "TRAP-2a"), PRINTED),
    **dict.fromkeys(("TRAP-1h", "TRAP-3b", "MC-07"), LOOKS),
    **dict.fromkeys(("TRAP-1i", "DPT-17"), JOBS),
    "TRAP-2h": MAPS,
    **dict.fromkeys(("TRAP-3", "IO-05", "IO-06"), BRACKET),
    "TRAP-3f": "needs frames with their guides, which the tests of the filters draw",
    **dict.fromkeys(("TRAP-3g", "TRAP-3h", *(f"MRK-{n:02}" for n in range(1, 9))), FOOTAGE),
    **dict.fromkeys(("GEO-07", "IO-08"), FILES),
}
"""Rows without a case of the product, and why."""


@dataclass(frozen=True)
class Row:
    """A row of docs/hard_cases.md: its cells, and the tests that carry its mark (`file: test`).

    `left_out`: why nothing holds it, where that is so.
    """

    name: str
    case: str
    answer: str
    near: str
    tests: tuple[str, ...]
    left_out: str


@functools.cache
def rows() -> dict[str, Row]:
    """Every row of the catalogue by its name, in the order of the page."""
    text = (Path(__file__).parent / "rows.json").read_text(encoding="utf-8")
    return {row["name"]: Row(**row | {"tests": tuple(row["tests"])}) for row in json.loads(text)}


def covered() -> frozenset[str]:
    """Rows that a case of the product shows."""
    return frozenset(name for e in entries() for name in (e.case.name, *e.case.rows))


def elsewhere() -> tuple[HardCase, ...]:
    """The rows that no case of the product shows, as skipped cases with the reason and their tests."""
    here = covered()
    found = []
    for row in rows().values():
        if row.name in here:
            continue
        why = row.left_out or f"checked by the test suite: {HELD_BY_TESTS[row.name]}"
        found.append(
            HardCase(
                name=row.name,
                outcome="skipped",
                title=row.case,
                oracle=row.answer,
                tolerance=row.near,
                reason=why,
                tests=row.tests,
            )
        )
    return tuple(found)
