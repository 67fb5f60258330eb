"""Frame selections."""

from __future__ import annotations

import pytest

from mrbatch.errors import JobError
from mrbatch.job.frames import beyond, canonical_frames, select_frames


@pytest.mark.parametrize(
    ("given", "canonical"),
    [("all", "all"), (7, "7"), ("1-10", "1-10"), ("1-10x1", "1-10"), (" 1 - 9 x 2 , 12", "1-9x2,12"),
     ([3, "5-6", 9], "3,5-6,9"), ("-3--1", "-3--1"), ("4-4", "4")],
)  # fmt: skip
def test_canonical(given, canonical):
    assert canonical_frames(given) == canonical
    assert canonical_frames(canonical) == canonical


@pytest.mark.parametrize(
    "given", ["", "x", "1-", "9-1", "1-9x0", [], ["all", 3], True, 1.5, None, "1e5", "9" * 12]
)
def test_refused(given):
    with pytest.raises(ValueError):
        canonical_frames(given)


def test_select():
    there = [1001, 1002, 1004, 1005]
    assert select_frames("all", there) == (1001, 1002, 1004, 1005)
    assert select_frames("1004,1001-1100x2", there) == (1001, 1004, 1005)
    assert select_frames("1-1001", there) == (1001,)
    for nothing in ("1003", "1-9", "1001,2000-3000x7"):
        with pytest.raises(JobError, match="there are no frames"):
            select_frames(nothing, there)
    assert select_frames("0-1000000000", there) == tuple(there)  # costs what is there, not what is asked


def test_parts_beyond_what_is_there():
    there = [0, 1, 2, 15]
    assert beyond("0-99", there) == "of the frames 0-99 asked for, 0 to 15 are there"
    assert beyond("0-15,3", there) == beyond("all", there) == ""
