"""Wrong input on the command line: a code, a sentence that says what and where, a hint, no traceback."""

from __future__ import annotations

import errno
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result
from small_job import CRATE, HEIGHT, WIDTH, sky, write_job, write_picture

from mrbatch import cli

TARGET = {"marker": {"dictionary": "DICT_4X4_50", "id": 7, "side": "60 mm"}}


def render(job: Path, *options: object) -> Result:
    arguments = ["render", str(job), "--progress", "none", "--no-report", *map(str, options)]
    return CliRunner().invoke(cli.main, arguments)


def change(job: Path, **parts: Any) -> None:
    """Replaces top-level keys of the job; those of `capture` one by one (None takes a key away)."""
    content = json.loads(job.read_text(encoding="utf-8"))
    for key, value in parts.items():
        if key == "capture":
            merged = content["capture"] | value
            content["capture"] = {k: v for k, v in merged.items() if v is not None}
        else:
            content[key] = value
    job.write_text(json.dumps(content, indent=1), encoding="utf-8")


def told(result: Result, code: int) -> str:
    """What was said, which must be short and for people. Asserts the exit code."""
    text = result.stderr
    assert result.exit_code == code, (result.exit_code, text)
    assert "Traceback" not in text and "internal error" not in text
    errors = [line for line in text.splitlines() if line.startswith("error: ")]
    assert len(errors) == 1, text
    assert len(text) < 1200, text
    return text


@pytest.fixture
def job(tmp_path) -> Path:
    return write_job(tmp_path, (0, 1))


# --- the capture ------------------------------------------------------------------------------------


def test_missing_video(job):
    change(job, capture={"frames": "holiday.mp4"})
    text = told(render(job), 2)
    assert "there is no file" in text and "holiday.mp4" in text and f"{job}:" in text


def test_a_video_that_is_none(job, tmp_path):
    (tmp_path / "holiday.mp4").write_bytes(b"no video at all" * 100)
    change(job, capture={"frames": "holiday.mp4"})
    text = told(render(job), 3)
    assert "holiday.mp4: this is not a video but text" in text and f"named at {job}:" in text


@pytest.mark.parametrize("broken", [0, 1, 2])
def test_one_unreadable_frame_among_good_ones(tmp_path, broken):
    """Skipped, the others are there, code 4; by default the run stops at it, and what was finished stays:
    code 4 too, or 3 where that is nothing."""
    job = write_job(tmp_path, (0, 1, 2))
    picture = tmp_path / f"photo_{broken:04d}.png"
    picture.write_bytes(picture.read_bytes()[:200])
    result = render(job, "--set", "on_error=skip", "--output", tmp_path / "skipped")
    assert result.exit_code == 4, result.stderr
    assert "Traceback" not in result.stderr
    there = sorted(p.name for p in (tmp_path / "skipped").glob("*.exr"))
    assert there == [f"small.{n:04d}.exr" for n in range(3) if n != broken]
    result = render(job, "--output", tmp_path / "stopped")
    assert result.exit_code == (4 if broken else 3), result.stderr
    assert len(list((tmp_path / "stopped").glob("*.exr"))) == broken


@pytest.mark.parametrize("lacking", ["gain", "matte"])
def test_a_frame_that_lacks_its_gain_or_matte_costs_itself(tmp_path, lacking):
    job = write_job(tmp_path, (0, 1, 2))
    (tmp_path / "gains.json").write_text(json.dumps({"0": 0.5, "2": 0.5}))
    for number in (0, 2):
        write_picture(tmp_path / f"matte_{number:04d}.png", np.zeros((HEIGHT, WIDTH, 3), np.uint8))
    change(job, capture={"gain": "gains.json"} if lacking == "gain" else {"mattes": "matte_####.png"})
    result = render(job, "--set", "on_error=skip", "--output", tmp_path / "skipped")
    assert result.exit_code == 4, result.stderr
    assert sorted(p.name for p in (tmp_path / "skipped").glob("*.exr")) == [
        "small.0000.exr",
        "small.0002.exr",
    ]
    result = render(job, "--set", "on_error=hold-last", "--output", tmp_path / "held")
    assert result.exit_code == 4 and len(list((tmp_path / "held").glob("*.exr"))) == 3


def test_the_broken_frame_is_named(tmp_path):
    job = write_job(tmp_path, (0, 1, 2))
    (tmp_path / "photo_0001.png").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(50))
    arguments = ["render", str(job), "--progress", "plain", "--no-report", "--set", "on_error=skip"]
    result = CliRunner().invoke(cli.main, arguments)
    assert result.exit_code == 4
    assert "photo_0001.png" in result.stderr and "frame 1" in result.stderr


def test_no_readable_frame_at_all(job, tmp_path):
    for picture in tmp_path.glob("photo_*.png"):
        picture.write_bytes(b"rubbish")
    told(render(job, "--set", "on_error=skip"), 3)


def test_marker_never_seen(job):
    change(job, capture={"poses": None, "target": TARGET})
    text = told(render(job), 3)
    assert "marker 7 of DICT_4X4_50 is seen in none of the 2 frames" in text and "hint: " in text


def test_wrong_dictionary_is_told_the_right_one(job, tmp_path):
    import cv2

    entry = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_6X6_250)
    for number in (0, 1):
        page = np.full((240, 320, 3), 220, np.uint8)
        page[60:180, 100 + number : 220 + number] = cv2.aruco.generateImageMarker(entry, 7, 120)[..., None]
        write_picture(tmp_path / f"photo_{number:04d}.png", page)
    camera = {
        "matrix": [[300, 0, 160], [0, 300, 120], [0, 0, 1]],
        "width": 320,
        "height": 240,
    }
    change(job, capture={"poses": None, "target": TARGET, "camera": camera})
    text = told(render(job), 3)
    hint = text.partition("hint: ")[2]
    assert "DICT_6X6" in hint and "7" in hint


def test_singular_intrinsics(job):
    camera = {"matrix": [[0, 0, 32], [0, 70, 24], [0, 0, 1]], "width": WIDTH, "height": HEIGHT}
    change(job, capture={"camera": camera})
    text = told(render(job), 2)
    assert "singular" in text and "camera" in text and f"{job}:" in text


def test_singular_intrinsics_in_a_file(job, tmp_path):
    (tmp_path / "camera.json").write_text(
        json.dumps({"camera_matrix": [[0, 0, 32], [0, 0, 24], [0, 0, 1]], "width": WIDTH, "height": HEIGHT})
    )
    change(job, capture={"camera": "camera.json"})
    assert "camera.json" in told(render(job), 3)


def test_pictures_of_another_size_than_the_calibration(job):
    camera = {"matrix": [[70, 0, 50], [0, 70, 24], [0, 0, 1]], "width": 100, "height": HEIGHT}
    change(job, capture={"camera": camera})
    text = told(render(job), 3)
    assert "100" in text and str(WIDTH) in text


def test_poses_that_do_not_fit(job, tmp_path):
    (tmp_path / "poses.json").write_text(json.dumps([{"frame": 7, "world_from_camera": np.eye(4).tolist()}]))
    text = told(render(job), 3)
    assert "poses.json" in text and "hint: " in text
    (tmp_path / "poses.json").write_text(
        json.dumps([{"frame": n, "world_from_camera": (2 * np.eye(4)).tolist()} for n in (0, 1)])
    )
    assert "poses.json" in told(render(job), 3)


# --- the scene --------------------------------------------------------------------------------------


@pytest.mark.parametrize(("value", "word"), [(np.nan, "NaN"), (np.inf, "infinite"), (-1.0, "negative")])
def test_environment_with_values_that_are_none(job, tmp_path, value, word):
    values = sky()
    values[2, 3, 1] = value
    write_picture(tmp_path / "sky.exr", values)
    text = told(render(job), 3)
    assert word in text and "sky.exr" in text and "(3, 2)" in text and "hint: " in text


def test_an_environment_of_codes(job, tmp_path):
    write_picture(tmp_path / "sky.png", np.zeros((8, 16, 3), np.uint8))
    change(job, environment={"file": "sky.png"})
    text = told(render(job), 3)
    assert "sky.png" in text and "hint: " in text


EMPTY_PLY = (
    "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    "element face 0\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n"
)


@pytest.mark.parametrize("content", [EMPTY_PLY, "", "rubbish\n", EMPTY_PLY[:100]])
def test_mesh_without_faces(job, tmp_path, content):
    (tmp_path / "thing.ply").write_text(content)
    change(job, virtual=[{"name": "thing", "mesh": "thing.ply"}])
    text = told(render(job), 3)
    assert "thing.ply" in text and f"named at {job}:" in text


def test_missing_mesh_names_its_neighbour(job, tmp_path):
    (tmp_path / "bunny.ply").write_text(EMPTY_PLY)
    change(job, virtual=[{"name": "thing", "mesh": "buny.ply"}])
    text = told(render(job), 2)
    assert "buny.ply" in text and "bunny.ply" in text.partition("hint: ")[2]


# --- the job ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("parts", "words"),
    [
        ({"methd": {}}, ["unknown key `methd`", "did you mean `method`?"]),
        ({"method": {"name": "delta-path-tracing", "ssp": 4}}, ["unknown key `ssp`", "`spp`"]),
        ({"method": {"name": "delta-path-tracng"}}, ["delta-path-tracng", "delta-path-tracing"]),
        ({"method": {"name": "delta-path-tracing", "spp": 0}}, ["method.spp", "2"]),
        ({"method": {"name": "delta-path-tracing", "spp": 3}}, ["method.spp"]),
        ({"virtual": [CRATE | {"box": {"size": [80, "60 mm", "100 mm"]}}]}, ["unit missing", "mm"]),
        ({"virtual": [CRATE | {"material": {"type": "diffuse", "reflectance": 1.5}}]}, ["reflectance", "1"]),
        ({"output": {"layers": ["composit"]}}, ["composit", "composite"]),
        ({"frames": "3-1"}, ["backwards"]),
        ({"effects": {"shadows": "on"}}, ["unknown effect `shadows`"]),
    ],
)
def test_wrong_jobs(job, parts, words):
    change(job, **parts)
    text = told(render(job), 2)
    assert f"{job}:" in text
    for word in words:
        assert word in text, text


@pytest.mark.parametrize("command", ["validate", "render", "plan"])
def test_missing_files_beside_a_wrong_key(job, command):
    """Short forms of parts name files too; one reading shows everything."""
    change(
        job,
        capture={
            "camera": "lens.yaml",
            "gain": "gains.csv",
            "mattes": "hand_####.png",
            "poses": "track.json",
        },
        environment={"file": "dome.exr", "rows": "up"},
        methd={},
    )
    result = CliRunner().invoke(cli.main, [command, str(job)])
    assert result.exit_code == 2
    for name in ("lens.yaml", "gains.csv", "hand_####.png", "track.js", "dome.exr"):
        assert f"there is no file {job.parent / name}" in result.stderr, name
    assert "unknown key `methd`" in result.stderr and "environment.rows" in result.stderr
    assert result.stderr.count("there is no file") == 5


def test_frames_that_are_not_there(job):
    text = told(render(job, "--frames", "7"), 2)
    assert "--frames 7: there are no frames 7" in text and "0 to 1" in text


def test_options_are_called_as_they_were_typed(job):
    assert "--layers virtul: " in told(render(job, "--layers", "virtul"), 2)
    assert "--frames 3-1: " in told(render(job, "--frames", "3-1"), 2)
    assert "--scale big: " in told(render(job, "--scale", "big"), 2)


def test_what_can_be_refused_is_refused_before_anything_slow(job, tmp_path, monkeypatch):
    from mrbatch.batch import prepare

    assert render(job).exit_code == 0

    def slow(*_: object, **__: object) -> None:
        pytest.fail("something slow was begun")

    monkeypatch.setattr(prepare, "build_scene", slow)
    monkeypatch.setattr(prepare, "_plan", slow)
    picture = tmp_path / "photo_0001.png"
    picture.write_bytes((tmp_path / "photo_0000.png").read_bytes())
    text = told(render(job), 2)
    assert "photo_0001.png: its content has changed" in text
    monkeypatch.setattr(prepare, "hash_file", slow)
    text = told(render(job, "--seed", 7, "--set", "method.spp=8"), 2)
    assert "seed: 0 -> 7" in text and "method.spp: 4 -> 8" in text and "sha256" not in text
    assert "--overwrite" in text
    assert "there are no frames 99" in told(render(job, "--frames", 99), 2)
    assert "sky.exr" in told(render(job, "--output", tmp_path / "sky.exr" / "out"), 5)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "small.0001.exr").write_bytes(b"somebody's own")
    assert "there already" in told(render(job, "--output", tmp_path / "mine"), 2)


def test_a_crop_that_leaves_the_picture(job):
    text = told(render(job, "--crop", "60,40,10,10"), 2)
    assert "crop" in text and f"{WIDTH} x {HEIGHT}" in text


def test_a_job_that_is_not_there(tmp_path):
    assert "nothing.yaml" in told(render(tmp_path / "nothing.yaml"), 2)


def test_a_job_that_is_no_yaml(tmp_path):
    (tmp_path / "job.yaml").write_bytes(b"\x00\xff{[")
    assert "job.yaml" in told(render(tmp_path / "job.yaml"), 2)


# --- the output -------------------------------------------------------------------------------------


def test_output_below_a_file(job, tmp_path):
    (tmp_path / "file").write_text("here")
    text = told(render(job, "--output", tmp_path / "file" / "out"), 5)
    assert "file" in text and "hint: " in text


def test_output_that_is_a_file(job, tmp_path):
    (tmp_path / "file").write_text("here")
    assert "is a file, not a folder" in told(render(job, "--output", tmp_path / "file"), 2)


@pytest.mark.parametrize(
    ("number", "word"),
    [(errno.ENOSPC, "full"), (errno.EROFS, "writ"), (errno.EACCES, "writ"), (errno.EDQUOT, "full")],
)
def test_a_disk_that_refuses(job, monkeypatch, number, word):
    """The system's own word, whatever file system stands behind it."""
    import mrbatch.batch.commit as commit

    def refuse(path: Path) -> None:
        raise OSError(number, "refused by the test", str(path))

    monkeypatch.setattr(commit, "flush_file", refuse)
    text = told(render(job), 5)
    assert word in text.lower() and "hint: " in text


def test_debug_shows_where(job):
    change(job, virtual=[{"name": "thing", "mesh": "no.ply"}])
    result = render(job, "--debug")
    assert result.exit_code == 2 and "Traceback" in result.stderr
