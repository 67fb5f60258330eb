"""No hard case loses its test unnoticed: the page of hard cases and the marks of the tests agree."""

from __future__ import annotations

import pytest
from hard_cases import LEFT_OUT, ROWS, cell, exported, marked, rows

COUNTS = {"GEO": 9, "BSDF": 10, "ENV": 9, "MIS": 6, "MC": 8, "RNG": 7, "DPT": 21, "MRK": 8, "IO": 8}
TRAPS = ("1", *(f"1{c}" for c in "abcdefghijk"), "2", *(f"2{c}" for c in "abcdefgh"), "3")
EVERY = [
    *(f"{group}-{n:02}" for group, count in COUNTS.items() for n in range(1, count + 1)),
    *(f"TRAP-{name}" for name in (*TRAPS, *(f"3{c}" for c in "abcdefghij"))),
]


def test_the_page_has_every_row_once():
    assert sorted(rows()) == sorted(EVERY)
    assert all(all(cells) for cells in rows().values()), "an empty cell"


def test_every_mark_names_a_row():
    assert not set(marked()) - set(EVERY)


@pytest.mark.parametrize("row", EVERY)
def test_a_row_has_its_tests_or_a_reason(row):
    told, tests = rows()[row][-1], marked().get(row, [])
    if told.startswith(LEFT_OUT):
        assert not tests, f"{row} is said to be left out, and has tests"
        assert len(told) > len(LEFT_OUT) + 20
    else:
        assert tests, f"no test carries the mark of {row}"
        assert told == cell(tests), "run: python tests/hard_cases.py"


def test_the_product_knows_the_rows_of_the_page():
    assert ROWS.read_text(encoding="utf-8") == exported(), "run: python tests/hard_cases.py"


def test_cases_of_the_product_name_rows_of_the_page():
    from mrbatch.stability.catalogue import covered

    # Twins in float64 are of kernels, not of rows.
    assert not {name for name in covered() if not name.startswith("TWIN-")} - set(EVERY)


def test_a_row_is_a_case_of_the_product_or_says_why_not():
    from mrbatch.stability.catalogue import HELD_BY_TESTS, covered, elsewhere

    out = {name for name, cells in rows().items() if cells[-1].startswith(LEFT_OUT)}
    shown = {name for name in covered() if not name.startswith("TWIN-")}
    assert shown | set(HELD_BY_TESTS) | out == set(EVERY)
    assert not set(HELD_BY_TESTS) & (covered() | out), "a reason that is out of date"
    for row in elsewhere():
        assert row.tests or row.name in out, f"{row.name} is held by nothing"


def test_marks_are_read_as_pytest_reads_them(pytestconfig):
    """The mark is registered, and what is marked is a test function of a module, not of a class."""
    assert any(line.startswith("case(") for line in pytestconfig.getini("markers"))
    assert sum(len(tests) for tests in marked().values()) > 100
