"""What `mrbatch render` says: progress, the last lines, errors as events."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from small_job import finish, start, wait_for, write_job

from mrbatch import cli


def render(job: Path, *options: object) -> Result:
    return CliRunner().invoke(cli.main, ["render", str(job), "--no-report", *map(str, options)])


@pytest.fixture
def job(tmp_path) -> Path:
    return write_job(tmp_path, (0, 1))


def test_early_failures_are_events_too(job, tmp_path):
    def last_event(result: Result) -> dict:
        lines = [line for line in result.stderr.splitlines() if line.startswith("{")]
        return json.loads(lines[-1])

    result = render(job, "--progress", "json", "--set", "method.ssp=3")
    event = last_event(result)
    assert event["event"] == "error" and event["exit_code"] == result.exit_code == 2
    assert "unknown key `ssp`" in event["message"]
    (tmp_path / "sky.exr").write_bytes(b"rubbish")
    result = render(job, "--progress", "json")
    event = last_event(result)
    assert event["event"] == "error" and event["exit_code"] == result.exit_code == 3


@pytest.mark.parametrize(
    ("raised", "code"), [(KeyboardInterrupt(), 130), (MemoryError(), 5), (ZeroDivisionError("a defect"), 70)]
)
def test_whatever_ends_the_command_is_an_event(job, monkeypatch, raised, code):
    from mrbatch.batch import job_run

    def end(*_: object, **__: object) -> None:
        raise raised

    monkeypatch.setattr(job_run, "prepare", end)
    result = render(job, "--progress", "json")
    assert result.exit_code == code
    events = [json.loads(line) for line in result.stderr.splitlines() if line.startswith("{")]
    assert events[-1]["event"] == "error" and events[-1]["exit_code"] == code and events[-1]["message"]


def test_nothing_to_do_is_said_only_where_all_is_well(job, tmp_path):
    assert render(job, "--progress", "plain").exit_code == 0
    assert "2 kept" in render(job, "--progress", "plain").stderr
    (tmp_path / "photo_0000.png").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(50))
    result = render(job, "--progress", "plain", "--output", tmp_path / "other")
    assert result.exit_code == 3 and "nothing to do" not in result.stderr
    assert "1 failed" in result.stderr and "1 frame was not tried" in result.stderr


def test_a_range_beyond_the_shot_is_rendered_as_far_as_it_goes(job):
    result = render(job, "--progress", "plain", "--frames", "0-99")
    assert result.exit_code == 0
    assert "of the frames 0-99 asked for, 0 to 1 are there" in result.stderr
    assert "2 of 2 frames" in result.stderr


def test_many_failed_frames_are_not_all_shown(tmp_path):
    job = write_job(tmp_path, (0, 1, 30))
    result = render(job, "--progress", "none")
    assert result.exit_code == 4 and result.stderr == ""
    result = render(job, "--progress", "plain")
    assert sum(line.startswith("error: ") for line in result.stderr.splitlines()) == 10
    assert "and 18 more frames that failed" in result.stderr
    assert "small: 31 frames to" in result.stderr
    assert "frame 7 failed: the footage has no such frame" in result.stderr


def test_inputs_are_told_as_they_are_read(job):
    result = render(job, "--progress", "json")
    events = [json.loads(line) for line in result.stderr.splitlines() if line.startswith("{")]
    read = [e for e in events if e["event"] == "prepare" and e["step"] == "reading inputs"]
    assert [e["done"] for e in read] == list(range(read[0]["total"]))
    kinds = [e["event"] for e in events]
    assert kinds.index("prepare") < kinds.index("start") and kinds[-1] == "done"
    assert events[-1]["seconds"] > events[-1]["frame_seconds"]


def test_interrupted_in_words(tmp_path):
    job = write_job(tmp_path, range(6), spp=48)
    process = start(job, tmp_path / "out", "--progress", "json")
    wait_for(process, "frame-done")
    process.send_signal(signal.SIGINT)
    done = finish(process)[-1]
    assert process.returncode == 130
    there = len(list((tmp_path / "out").glob("*.exr")))
    assert done["message"] == f"interrupted: the same command goes on; {there} of 6 frames are there"


@pytest.mark.skipif(os.name != "posix", reason="descriptors are POSIX")
def test_no_line_is_lost_while_standard_error_is_shut():
    """Warp's start shuts descriptor 2 for a moment; progress has a handle of its own."""
    program = """
import os
from mrbatch.batch import events as tell
from mrbatch.batch.progress import progress
with progress("plain") as sink:
    os.close(2)
    sink(tell.Note("still heard"))
"""
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert "still heard" in result.stderr


@pytest.mark.parametrize(
    "line", ["--debug render no.yaml", "render --debug no.yaml", "render no.yaml --debug"]
)
def test_debug_may_stand_anywhere(line):
    result = CliRunner().invoke(cli.main, line.split())
    assert result.exit_code == 2 and "Traceback" in result.stderr


def test_each_command_tells_of_debug():
    assert "--debug" in CliRunner().invoke(cli.main, ["render", "--help"]).output
