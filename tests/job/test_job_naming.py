"""An error of an input file also says where the job names the file."""

from __future__ import annotations

import pickle

import pytest

from mrbatch.errors import InputError, Place
from mrbatch.job import load_job
from mrbatch.job.naming import place_of_file, tells_where_named

TEXT = """\
capture:
  kind: marker-video
  frames: footage.mp4
  camera: calibration.yaml
  target: {marker: {dictionary: DICT_4X4_50, id: 7, side: 60 mm}}
  gain: 1.0
environment: {file: light/sky.exr}
virtual:
  - {name: ball, sphere: {radius: 3 cm}}
  - {name: bunny, mesh: bunny.ply}
method: {name: delta-path-tracing}
"""


@pytest.fixture
def job(tmp_path):
    (tmp_path / "desk.yaml").write_text(TEXT, encoding="utf-8")
    return load_job(tmp_path / "desk.yaml")


@pytest.mark.parametrize(
    ("file", "line", "column"),
    [
        ("footage.mp4", 3, 11),
        ("calibration.yaml", 4, 11),
        ("light/sky.exr", 7, 21),
        ("bunny.ply", 10, 25),
    ],
)
def test_places_of_files(job, tmp_path, file, line, column):
    place = place_of_file(job, str(tmp_path / file))
    assert place is not None and (place.line, place.column) == (line, column)


def test_files_that_the_job_does_not_name(job, tmp_path):
    assert place_of_file(job, str(tmp_path / "other.ply")) is None
    assert place_of_file(job, str(tmp_path / "out")) is None  # written, not read


def test_links_lead_to_the_same_place(job, tmp_path):
    (tmp_path / "real.ply").touch()
    (tmp_path / "bunny.ply").symlink_to(tmp_path / "real.ply")
    place = place_of_file(job, str(tmp_path / "real.ply"))
    assert place is not None and place.line == 10


def test_errors_say_it_after_their_own_place(job, tmp_path):
    @tells_where_named
    def read(job, name):
        raise InputError("is broken", place=Place(file=str(tmp_path / name)), hint="repair it")

    with pytest.raises(InputError) as caught:
        read(job, "bunny.ply")
    lines = str(caught.value).splitlines()
    assert lines == [
        f"{tmp_path / 'bunny.ply'}: is broken",
        f"  named at {tmp_path / 'desk.yaml'}:10:25",
        "  hint: repair it",
    ]
    assert str(pickle.loads(pickle.dumps(caught.value))) == str(caught.value)
    with pytest.raises(InputError) as caught:
        read(job, "other.ply")
    assert "named at" not in str(caught.value)
