"""`mrbatch plan`: a table for people, JSON and a picture of the mask of influence."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result
from small_job import CRATE, HEIGHT, WIDTH, codes, write_job

from mrbatch import cli


def plan(job: Path, *options: object) -> Result:
    return CliRunner().invoke(cli.main, ["plan", str(job), *map(str, options)])


SMALL = CRATE | {"box": {"size": ["4 mm", "4 mm", "4 mm"]}, "cast_shadow": False}


@pytest.fixture
def job(tmp_path) -> Path:
    """A tiny thing, so that most tiles are not traced."""
    return write_job(tmp_path, range(12), virtual=[SMALL], real=[])


def test_few_frames_get_a_row_each_many_a_summary(job):
    few = plan(job, "--frames", "0-2")
    assert few.exit_code == 0, few.output
    assert "tiles to trace" in few.output and few.output.count(" of 12") >= 3
    many = plan(job)
    assert "fewest" in many.output and "median" in many.output and "most" in many.output
    assert "12 frames; --verbose" in many.output and " of 12" not in many.output
    verbose = plan(job, "--verbose")
    assert verbose.output.count(" of 12") >= 12 and "--verbose" not in verbose.output


def test_one_frame_needs_no_summary(job):
    one = plan(job, "--frames", 3).output
    assert "fewest" not in one and one.count(" of 12") >= 1


def test_json_has_the_tiles_and_where_they_lie(job):
    told = json.loads(plan(job, "--frames", "3,5", "--json").stdout)
    assert [frame["frame"] for frame in told["frames"]] == [3, 5]
    assert told["grid"] == {"": {"first": [0, 0], "size": 16, "columns": 4, "rows": 3}}
    for frame in told["frames"]:
        assert len(frame["ids"]) == frame["tiles"] and set(frame["ids"]) <= set(range(12))


def test_the_mask_as_a_picture(job, tmp_path):
    import cv2

    path = tmp_path / "mask.png"
    result = plan(job, "--frames", "3", "--json", "--mask", path)
    assert result.exit_code == 0, result.output
    drawn = cv2.imread(str(path))[..., ::-1]
    assert drawn.shape == (HEIGHT, WIDTH, 3)
    (frame,) = json.loads(result.stdout)["frames"]
    assert 0 < frame["tiles"] < 12
    given = codes(3, np.uint8)
    for tile in range(12):
        row, column = divmod(tile, 4)
        # Without the first row and column, where lines between tiles may lie.
        part = (slice(16 * row + 1, 16 * row + 16), slice(16 * column + 1, 16 * column + 16))
        if tile in frame["ids"]:
            np.testing.assert_array_equal(drawn[part], given[part])
        else:
            assert drawn[part].max() < 0.36 * 255 and drawn[part].std() > 0


def test_the_mask_must_be_a_png(job, tmp_path):
    result = plan(job, "--mask", tmp_path / "mask.tif")
    assert result.exit_code == 2 and ".png" in result.stderr
