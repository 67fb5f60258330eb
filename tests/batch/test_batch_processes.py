"""Runs as processes: killed at random moments, interrupted, sharing a folder, on a full disk."""

from __future__ import annotations

import hashlib
import json
import os
import random
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from toy_shot import Toy, expected_payload, request_for, verify

from mrbatch.batch.commit import hash_file
from mrbatch.batch.history import cut_segments
from mrbatch.batch.interrupt import Interrupts
from mrbatch.batch.journal import JournalReader
from mrbatch.batch.run import run

TOY = Path(__file__).resolve().parent / "toy_shot.py"
TIMEOUT = 120.0


def start(directory: Path, first: int, last: int, *options: object) -> subprocess.Popen[str]:
    command = [sys.executable, str(TOY), str(directory), str(first), str(last), *map(str, options)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def finish(process: subprocess.Popen[str]) -> list[dict]:
    """Wait for the end; the events it told."""
    out, _ = process.communicate(timeout=TIMEOUT)
    return [json.loads(line) for line in out.splitlines()]


def wait_for(process: subprocess.Popen[str], kind: str, frame: int | None = None) -> None:
    """Read events until one of `kind` comes."""
    assert process.stdout is not None
    for line in process.stdout:
        event = json.loads(line)
        if event["event"] == kind and frame in (None, event.get("frame")):
            return
    raise AssertionError(f"no {kind}: {process.stderr.read() if process.stderr else ''}")


def file_of(frame: int, state: int = 0) -> bytes:
    payload = expected_payload(1, frame, state)
    return b"TOY1" + hashlib.sha256(payload).digest() + payload


def check_whole(directory: Path) -> int:
    """Every file under a final name is whole, and the journal agrees with it; how many there are."""
    journal = JournalReader(directory)
    count = 0
    for path in directory.glob("shot.*.toy"):
        verify(path)
        count += 1
    for frame, entries in journal.frames.items():
        path = directory / f"shot.{frame:04d}.toy"
        assert {entry.file_hash for entry in entries} == {hash_file(path)}
    return count


def strangers_in(directory: Path) -> list[str]:
    names = [path.name for path in directory.rglob("*") if path.is_file()]
    return [name for name in names if name.startswith(".") or name.endswith((".claim", ".alive"))]


def test_killed_at_twenty_random_moments(tmp_path):
    moments = random.Random(20)
    last, leftovers = 160, 0
    for _ in range(20):
        process = start(tmp_path, 1, last, "--seconds", 0.02)
        wait_for(process, "frame-started")
        time.sleep(moments.uniform(0.0, 0.12))
        process.kill()
        finish_quietly(process)
        leftovers += sum(1 for name in strangers_in(tmp_path) if name.startswith(".tmp-"))
        check_whole(tmp_path)
    # Otherwise the kills missed what they were for.
    assert leftovers > 0
    process = start(tmp_path, 1, last)
    events = finish(process)
    assert process.returncode == 0
    assert events[0]["event"] == "start"
    assert events[0]["kept"] > 0
    assert check_whole(tmp_path) == last
    for frame in range(1, last + 1):
        assert (tmp_path / f"shot.{frame:04d}.toy").read_bytes() == file_of(frame)
    assert strangers_in(tmp_path) == []


def finish_quietly(process: subprocess.Popen[str]) -> None:
    """Wait for a process that was killed; its last line may be cut."""
    process.communicate(timeout=TIMEOUT)


def test_killed_with_history(tmp_path):
    moments = random.Random(5)
    last = 30
    for _ in range(5):
        process = start(tmp_path, 1, last, "--seconds", 0.02, "--history", 7)
        wait_for(process, "frame-started")
        time.sleep(moments.uniform(0.0, 0.12))
        process.kill()
        finish_quietly(process)
        check_whole(tmp_path)
    process = start(tmp_path, 1, last, "--history", 7)
    finish(process)
    assert process.returncode == 0
    for first in range(1, last + 1, 7):
        carried = 7
        for frame in range(first, min(first + 7, last + 1)):
            carried = (carried * 31 + frame) % 1_000_000_007
            assert (tmp_path / f"shot.{frame:04d}.toy").read_bytes() == file_of(frame, carried)


def test_what_a_killed_process_left_is_said(tmp_path):
    process = start(tmp_path, 1, 3, "--seconds", 0.2)
    wait_for(process, "frame-started", 2)
    for _ in range(2000):
        if any(name.startswith(".tmp-") for name in strangers_in(tmp_path)):
            break
        time.sleep(0.001)
    process.kill()
    finish_quietly(process)
    # Not a minute's wait, though the claim is fresh: the process is known to be dead.
    events = finish(start(tmp_path, 1, 3, "--stale-after", 1e6))
    assert events[0]["found"] == "found 1 finished, 1 leftover, 1 dead claim"
    assert [event["frame"] for event in events if event["event"] == "frame-done"] == [2, 3]


def test_two_processes_share_a_folder_and_do_each_frame_once(tmp_path):
    both = [start(tmp_path, 1, 40, "--seconds", 0.02) for _ in range(2)]
    told = [finish(process) for process in both]
    assert [process.returncode for process in both] == [0, 0]
    assert check_whole(tmp_path) == 40
    rendered = [event["frame"] for events in told for event in events if event["event"] == "frame-done"]
    assert sorted(rendered) == list(range(1, 41))
    # Each ends only when all its frames are there, and counts them all.
    for events in told:
        assert events[-1]["rendered"] + events[-1]["kept"] == 40
    assert strangers_in(tmp_path) == []


def test_two_processes_with_ranges_of_their_own(tmp_path):
    both = [start(tmp_path, 1, 10), start(tmp_path, 11, 20)]
    for process in both:
        finish(process)
    assert [process.returncode for process in both] == [0, 0]
    assert check_whole(tmp_path) == 20
    assert len(list((tmp_path / "journal").iterdir())) == 2


def test_two_processes_share_a_shot_with_history(tmp_path):
    both = [start(tmp_path, 1, 20, "--seconds", 0.02, "--history", 5) for _ in range(2)]
    for process in both:
        finish(process)
    assert [process.returncode for process in both] == [0, 0]
    for first in range(1, 21, 5):
        carried = 7
        for frame in range(first, first + 5):
            carried = (carried * 31 + frame) % 1_000_000_007
            assert (tmp_path / f"shot.{frame:04d}.toy").read_bytes() == file_of(frame, carried)


def test_a_process_waits_for_anothers_frame_and_takes_it_over_when_that_dies(tmp_path):
    first = start(tmp_path, 1, 1, "--seconds", 60)
    wait_for(first, "frame-started")
    second = start(tmp_path, 1, 1)
    wait_for(second, "waiting")
    first.kill()
    finish_quietly(first)
    events = finish(second)
    assert second.returncode == 0
    assert [event["event"] for event in events if event["event"].startswith("frame")] == [
        "frame-started",
        "frame-done",
    ]
    assert (tmp_path / "shot.0001.toy").read_bytes() == file_of(1)


def test_another_job_is_refused_while_one_is_running(tmp_path):
    first = start(tmp_path, 1, 2, "--seconds", 0.5)
    wait_for(first, "frame-started")
    second = start(tmp_path, 3, 3, "--seed", 2)
    _, complaint = second.communicate(timeout=TIMEOUT)
    assert second.returncode == 2
    assert "another job" in complaint
    assert "Traceback" not in complaint
    finish(first)
    assert first.returncode == 0
    assert check_whole(tmp_path) == 2


@pytest.mark.skipif(os.name != "posix", reason="signals of this kind are POSIX")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_run_in_order(tmp_path, number):
    # The first frame comes from an earlier run, so that there is something to lose.
    run(request_for(tmp_path, [1]), Toy(), verify)
    process = start(tmp_path, 1, 3, "--seconds", 20)
    wait_for(process, "frame-started", 2)
    time.sleep(0.1)
    process.send_signal(number)
    events = finish(process)
    assert process.returncode == 130
    assert events[-1]["event"] == "done"
    assert events[-1]["exit_code"] == 130
    assert strangers_in(tmp_path) == []
    assert check_whole(tmp_path) == 1


@pytest.mark.skipif(os.name != "posix", reason="signals of this kind are POSIX")
def test_a_second_signal_ends_the_process_at_once():
    stubborn = """
import threading, time
from mrbatch.batch.interrupt import interrupts
with interrupts.caught(threading.Event()):
    word = "ready"
    while True:
        try:
            print(word, flush=True)
            time.sleep(60)
        except KeyboardInterrupt:
            word = "once"
"""
    process = subprocess.Popen([sys.executable, "-c", stubborn], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    process.send_signal(signal.SIGINT)
    assert process.stdout.readline() == "once\n"
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=TIMEOUT)
    assert process.returncode == 130


def test_a_shield_puts_the_signal_off_and_the_handlers_come_back():
    interrupts, stop = Interrupts(), threading.Event()
    before = signal.getsignal(signal.SIGINT)
    steps = []
    with pytest.raises(KeyboardInterrupt), interrupts.caught(stop):
        with interrupts.shielded():
            signal.raise_signal(signal.SIGINT)
            steps.append(stop.is_set())
        steps.append("not reached")
    assert steps == [True]
    assert signal.getsignal(signal.SIGINT) is before


def test_a_disk_that_fills_up_and_is_given_room(mounted):
    disk = mounted("size=1m")
    frames = range(1, 301)
    full = run(request_for(disk, frames), Toy(), verify)
    assert full.exit_code == 5
    assert "disk full" in str(full.error)
    assert 0 < len(full.rendered) < 300
    assert check_whole(disk) >= len(full.rendered)
    assert [name for name in strangers_in(disk) if name.startswith(".tmp-")] == []
    subprocess.run(["mount", "-o", "remount,size=8m", str(disk)], check=True)
    result = run(request_for(disk, frames), Toy(), verify)
    assert result.exit_code == 0
    assert set(full.rendered) <= set(result.kept)
    assert check_whole(disk) == 300


def test_a_disk_that_fills_up_with_history(mounted):
    disk = mounted("size=1m")
    segments = cut_segments(range(1, 301))
    full = run(request_for(disk, range(1, 301), history=True, segments=segments), Toy(history=True), verify)
    assert full.exit_code == 5
    assert [name for name in strangers_in(disk) if name.startswith(".tmp-")] == []
    assert check_whole(disk) >= len(full.rendered)
