"""The list of frames: what is chosen, and what is refused where."""

from __future__ import annotations

import pytest

from mrbatch.batch.frames import describe_frames, parse_frames
from mrbatch.errors import JobError

SHOT = list(range(1001, 1101))


@pytest.mark.parametrize(
    ("text", "chosen"),
    [
        ("1001", [1001]),
        ("1001-1004", [1001, 1002, 1003, 1004]),
        ("1001-1010x4", [1001, 1005, 1009]),
        ("1001-1100x50,1100", [1001, 1051, 1100]),
        ("1003,1001-1003", [1001, 1002, 1003]),
        (" 1002 , 1001 ", [1001, 1002]),
        ("1098-", [1098, 1099, 1100]),
        ("1096-x2", [1096, 1098, 1100]),
    ],
)
def test_chosen_frames(text, chosen):
    assert parse_frames(text).select(SHOT) == chosen


def test_a_range_passes_over_frames_that_are_not_there():
    assert parse_frames("1-5").select([1, 2, 4, 5]) == [1, 2, 4, 5]


def test_a_step_counts_numbers_not_frames():
    assert parse_frames("1-9x2").select([1, 2, 4, 5, 9]) == [1, 5, 9]


@pytest.mark.parametrize(
    ("text", "column", "words"),
    [
        ("", 1, "empty"),
        ("1001,,1002", 6, "empty"),
        ("1001, abc", 7, "`abc`"),
        ("1001-1010x0", 1, "step"),
        ("1010-1001", 1, "ends before"),
        ("1001x2", 1, "no range"),
        ("1.5", 1, "cannot read"),
        ("-5", 1, "cannot read"),
        ("1001-1002-1003", 1, "cannot read"),
        ("1" * 5000, 1, "cannot read"),
        ("١", 1, "cannot read"),
    ],
)
def test_unreadable_lists_say_where(text, column, words):
    with pytest.raises(JobError) as caught:
        parse_frames(text)
    assert caught.value.exit_code == 2
    assert caught.value.place.column == column
    assert words in caught.value.message
    assert caught.value.hint


@pytest.mark.parametrize(
    ("text", "available", "words"),
    [
        ("1200", SHOT, "no frame 1200"),
        ("1001,1090-1101", SHOT, "1101 lies outside"),
        ("1-5", SHOT, "1 lies outside"),
        ("3", [1, 2, 4], "no frame 3"),
        ("2-3", [1, 4], "no frame lies in `2-3`"),
        ("1", [], "no frames"),
    ],
)
def test_unknown_frames_are_refused(text, available, words):
    with pytest.raises(JobError) as caught:
        parse_frames(text).select(available)
    assert words in str(caught.value)
    assert caught.value.hint


def test_a_huge_range_costs_nothing():
    assert parse_frames("0-999999999").select([0, 999999999]) == [0, 999999999]


def test_description_of_frames():
    assert describe_frames([1, 2, 3, 5]) == "frames 1-3, 5"
    assert describe_frames([7]) == "frame 7"
    assert describe_frames([]) == "no frames"
    assert "20 in all" in describe_frames(range(0, 40, 2))
