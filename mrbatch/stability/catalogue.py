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

PRINTED = "the form that fails there is computed in the test; the product does not carry it"
FOOTAGE = "needs rendered footage of markers, which the tests draw"
FILES = "needs files that are cut, damaged or of other makers, which the tests write"
JOBS = "needs whole jobs with their folders, which the tests render"
LONG = "takes minutes of scenes that the test suite shares"

HELD_BY_TESTS: dict[str, str] = {}
"""Rows without a case of the product: why. `tests/test_hard_cases.py` demands one or the other for each."""


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
        why = (
            row.left_out
            or f"checked by the test suite: {HELD_BY_TESTS.get(row.name, 'it has no case here yet')}"
        )
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
