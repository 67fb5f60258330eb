"""`mrbatch render` as processes: sharing a folder, interrupted, on a full disk; what it tells."""

from __future__ import annotations

import signal

import pytest
from small_job import finish, frames_in, start, strangers_in, wait_for, write_job

FRAMES = tuple(range(6))


@pytest.fixture(scope="module")
def shot(tmp_path_factory):
    """A job, and its frames as one undisturbed process made them, with what that told."""
    job = write_job(tmp_path_factory.mktemp("shot"), FRAMES, spp=48)
    process = start(job, job.parent / "whole")
    events = finish(process)
    assert process.returncode == 0
    return job, frames_in(job.parent / "whole"), events


def test_progress_is_json_and_predicts_before_the_first_frame(shot):
    _, frames, events = shot
    assert len(frames) == len(FRAMES)
    kinds = [event["event"] for event in events]
    assert kinds.index("start") < kinds.index("prediction") < kinds.index("frame-done")
    first = events[kinds.index("prediction")]
    assert first["basis"] == "first samples" and first["seconds_left"] > 0
    assert [e["frame"] for e in events if e["event"] == "frame-done"] == list(FRAMES)
    done = events[-1]
    assert done["event"] == "done" and done["rendered"] == len(FRAMES) and done["exit_code"] == 0
    # What was predicted is compared with what it took; no time is asserted, machines have bad days.
    assert done["predicted"] > 0 and done["seconds"] > 0


def test_two_processes_share_a_folder(shot):
    job, expected, _ = shot
    out = job.parent / "shared"
    two = [start(job, out, "--frames", frames) for frames in ("0-2", "3-5")]
    told = [finish(process) for process in two]
    assert [process.returncode for process in two] == [0, 0]
    assert [sum(e["event"] == "frame-done" for e in events) for events in told] == [3, 3]
    assert frames_in(out) == expected and not strangers_in(out)


def test_two_processes_with_the_same_frames_do_each_once(shot):
    job, expected, _ = shot
    out = job.parent / "twice"
    two = [start(job, out) for _ in range(2)]
    told = [finish(process) for process in two]
    assert [process.returncode for process in two] == [0, 0]
    assert sum(e["event"] == "frame-done" for events in told for e in events) == len(FRAMES)
    assert frames_in(out) == expected and not strangers_in(out)


def test_interrupted_and_resumed(shot):
    job, expected, _ = shot
    out = job.parent / "interrupted"
    process = start(job, out)
    wait_for(process, "frame-done")
    process.send_signal(signal.SIGINT)
    events = finish(process)
    assert process.returncode == 130
    assert events[-1]["event"] == "done" and events[-1]["exit_code"] == 130
    there = frames_in(out)
    assert 1 <= len(there) < len(expected) and not strangers_in(out)
    assert all(expected[name] == found for name, found in there.items())
    again = start(job, out)
    finish(again)
    assert again.returncode == 0 and frames_in(out) == expected


def test_another_jobs_folder_is_refused(shot):
    job, expected, _ = shot
    out = job.parent / "held"
    assert finish(start(job, out, "--frames", 0)) and len(frames_in(out)) == 1
    other = start(job, out, "--frames", 0, "--seed", 5)
    _, told = other.communicate(timeout=120)
    assert other.returncode == 2 and "Traceback" not in told
    assert "holds frames of another job" in told and "--overwrite" in told
    assert frames_in(out) == {"small.0000.exr": expected["small.0000.exr"]}
    taking = start(job, out, "--frames", 0, "--seed", 5, "--overwrite")
    finish(taking)
    assert taking.returncode == 0
    assert frames_in(out)["small.0000.exr"] != expected["small.0000.exr"]


def test_a_full_disk_ends_with_5_and_is_resumed(shot, mounted):
    job, expected, _ = shot
    size = len(expected["small.0000.exr"])
    room = mounted(f"size={4 * size + 120_000}")
    ballast = room / "ballast"
    ballast.write_bytes(bytes(60_000 + size))
    out = room / "out"
    process = start(job, out)
    _, told = process.communicate(timeout=120)
    assert process.returncode == 5, told
    assert "Traceback" not in told and "hint" in told
    there = frames_in(out)
    assert len(there) < len(expected)
    assert all(expected[name] == found for name, found in there.items())
    assert not [name for name in strangers_in(out) if name.startswith(".tmp")]
    ballast.unlink()
    again = start(job, out, "--frames", "0-2")
    finish(again)
    assert again.returncode == 0
    assert frames_in(out).items() <= expected.items() and len(frames_in(out)) >= 3


def test_a_folder_that_may_not_be_written(shot, mounted):
    job, _, _ = shot
    out = mounted("size=100k,ro") / "out"
    process = start(job, out)
    _, told = process.communicate(timeout=120)
    assert process.returncode == 5, told
    assert "Traceback" not in told and "read-only" in told.lower()


def test_a_folder_below_a_file(shot):
    job, _, _ = shot
    process = start(job, job / "out")
    _, told = process.communicate(timeout=120)
    assert process.returncode in (2, 5), told
    assert "Traceback" not in told and "error: " in told
