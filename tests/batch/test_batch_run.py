"""The run in one process: what is kept, what is refused, what failures cost."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import threading
from pathlib import Path

import psutil
import pytest
from toy_shot import Toy, expected_payload, request_for, verify

from mrbatch.batch import events as tell
from mrbatch.batch.commit import temporary_name
from mrbatch.batch.history import cut_segments
from mrbatch.batch.journal import JournalReader
from mrbatch.batch.presence import Owner, Presence
from mrbatch.batch.run import run
from mrbatch.errors import InputError, JobError, ResourceError


def frames_in(directory: Path) -> dict[int, bytes]:
    return {int(path.stem.split(".")[1]): path.read_bytes() for path in directory.glob("*.toy")}


def strangers_in(directory: Path) -> list[str]:
    """Files that should not be there after a run."""
    names = [path.name for path in directory.rglob("*") if path.is_file()]
    return [name for name in names if name.startswith(".") or name.endswith((".claim", ".alive"))]


def file_of(frame: int, seed: int = 1) -> bytes:
    payload = expected_payload(seed, frame)
    return b"TOY1" + hashlib.sha256(payload).digest() + payload


def test_a_fresh_folder_gets_all_frames(tmp_path):
    told = []
    result = run(request_for(tmp_path / "out", [1, 2, 3]), Toy(), verify, events=told.append)
    assert result.exit_code == 0
    assert (result.rendered, result.kept, result.failed, result.undone) == ((1, 2, 3), (), (), ())
    assert result.findings.summary() == ""
    assert frames_in(tmp_path / "out") == {frame: file_of(frame) for frame in (1, 2, 3)}
    assert strangers_in(tmp_path / "out") == []
    kinds = [event.kind for event in told if event.kind != "prediction"]
    assert kinds == ["start", *["frame-started", "frame-done"] * 3, "done"]
    entry = result.entries[2]
    assert entry.content_hash == hashlib.sha256(expected_payload(1, 2)).hexdigest()
    assert entry.counters == {"rays": 4096}
    assert entry.details == {"toy": True}


def test_a_second_run_keeps_everything_and_touches_nothing(tmp_path):
    run(request_for(tmp_path, [1, 2]), Toy(), verify)
    before = {path: path.stat().st_mtime_ns for path in tmp_path.glob("*.toy")}
    toy = Toy()
    result = run(request_for(tmp_path, [1, 2, 3]), toy, verify)
    assert toy.calls == [3]
    assert (result.rendered, result.kept) == ((3,), (1, 2))
    assert result.findings.summary() == "found 2 finished"
    assert sorted(result.entries) == [1, 2, 3]
    assert all(path.stat().st_mtime_ns == stamp for path, stamp in before.items())


@pytest.mark.parametrize("damage", ["flip", "cut", "empty"])
def test_a_corrupt_file_is_found_said_and_rendered_again(tmp_path, damage):
    run(request_for(tmp_path, [1, 2, 3]), Toy(), verify)
    path = tmp_path / "shot.0002.toy"
    data = bytearray(path.read_bytes())
    data[1000] ^= 1
    path.write_bytes({"flip": bytes(data), "cut": bytes(data[:-1]), "empty": b""}[damage])
    toy, told = Toy(), []
    result = run(request_for(tmp_path, [1, 2, 3]), toy, verify, events=told.append)
    assert toy.calls == [2]
    assert result.findings.corrupt == (2,)
    assert result.findings.summary() == "found 2 finished, 1 corrupt"
    assert any(isinstance(event, tell.Note) and "corrupt" in event.message for event in told)
    assert path.read_bytes() == file_of(2)


def test_a_missing_and_an_unrecorded_file_are_rendered_again(tmp_path):
    run(request_for(tmp_path, [1, 2, 3]), Toy(), verify)
    (tmp_path / "shot.0001.toy").unlink()
    # Killed between the rename and its line in the journal.
    (tmp_path / "shot.0004.toy").write_bytes(file_of(4))
    toy = Toy()
    result = run(request_for(tmp_path, [1, 2, 3, 4]), toy, verify)
    assert toy.calls == [1, 4]
    assert (result.findings.missing, result.findings.unrecorded) == ((1,), (4,))


def test_a_torn_journal_costs_its_last_frame_only(tmp_path):
    run(request_for(tmp_path, [1, 2, 3]), Toy(), verify)
    (journal,) = (tmp_path / "journal").iterdir()
    journal.write_bytes(journal.read_bytes()[:-20])
    toy = Toy()
    result = run(request_for(tmp_path, [1, 2, 3]), toy, verify)
    assert toy.calls == [3]
    assert result.findings.torn == 1
    assert "1 torn journal line" in result.findings.summary()


def test_leftovers_of_dead_processes_go_those_of_living_ones_stay(tmp_path):
    folder = tmp_path / "out"
    folder.mkdir()
    with Presence(folder, Owner.here(), "another") as living:
        theirs = folder / f".tmp-{living.owner.name}~1.toy"
        theirs.write_bytes(b"half")
        dead = folder / ".tmp-host-999999-dead~1.toy"
        dead.write_bytes(b"half")
        os.utime(dead, (1.0, 1.0))
        result = run(request_for(folder, [1]), Toy(), verify)
        assert theirs.exists()
    assert not dead.exists()
    assert result.findings.leftovers == 1


# --- whose folder it is -------------------------------------------------------------------------


def test_another_jobs_folder_is_refused_and_left_as_it_was(tmp_path):
    run(request_for(tmp_path, [1, 2], seed=1), Toy(1), verify)
    before = frames_in(tmp_path)
    toy = Toy(2)
    with pytest.raises(JobError, match="another job") as caught:
        run(request_for(tmp_path, [3], seed=2), toy, verify)
    assert caught.value.exit_code == 2
    assert "--overwrite" in caught.value.hint
    assert toy.calls == []
    assert frames_in(tmp_path) == before


def test_overwrite_takes_the_folder_and_says_what_stays(tmp_path):
    run(request_for(tmp_path, [1, 2, 3], seed=1), Toy(1), verify)
    result = run(request_for(tmp_path, [1, 2], seed=2, overwrite=True), Toy(2), verify)
    assert result.rendered == (1, 2)
    assert result.findings.foreign == (3,)
    assert frames_in(tmp_path) == {1: file_of(1, 2), 2: file_of(2, 2), 3: file_of(3, 1)}
    # The folder is the new job's from now on, without being told again.
    result = run(request_for(tmp_path, [1, 2, 3], seed=2), Toy(2), verify)
    assert (result.kept, result.rendered) == ((1, 2), (3,))


def test_overwrite_keeps_finished_frames_of_the_same_job(tmp_path):
    run(request_for(tmp_path, [1, 2]), Toy(), verify)
    assert run(request_for(tmp_path, [1, 2], overwrite=True), Toy(), verify).kept == (1, 2)


def test_a_lost_job_file_does_not_open_the_folder_to_others(tmp_path):
    run(request_for(tmp_path, [1], seed=1), Toy(1), verify)
    (tmp_path / "job.json").unlink()
    with pytest.raises(JobError):
        run(request_for(tmp_path, [1], seed=2), Toy(2), verify)
    assert run(request_for(tmp_path, [1], seed=1), Toy(1), verify).kept == (1,)


@pytest.mark.parametrize("torn", [b"", b'{"job_ha', b"[]", b"\xff"])
def test_a_torn_job_file_is_made_anew(tmp_path, torn):
    run(request_for(tmp_path, [1]), Toy(), verify)
    (tmp_path / "job.json").write_bytes(torn)
    request = request_for(tmp_path, [1])
    assert run(request, Toy(), verify).kept == (1,)
    assert json.loads((tmp_path / "job.json").read_text())["job_hash"] == request.job_hash


def test_files_of_unknown_origin_are_not_replaced_unasked(tmp_path):
    (tmp_path / "shot.0001.toy").write_bytes(b"somebody's own")
    with pytest.raises(JobError, match="there already"):
        run(request_for(tmp_path, [1]), Toy(), verify)
    assert [path.name for path in tmp_path.iterdir()] == ["shot.0001.toy"]
    assert run(request_for(tmp_path, [1], overwrite=True), Toy(), verify).exit_code == 0


def test_a_folder_in_which_another_job_is_at_work_is_refused_even_with_overwrite(tmp_path):
    run(request_for(tmp_path, [1], seed=1), Toy(1), verify)
    with Presence(tmp_path, Owner.here(), "the other job"), pytest.raises(JobError, match="in use"):
        run(request_for(tmp_path, [1], seed=2, overwrite=True), Toy(2), verify)


def test_a_folder_that_another_job_takes_meanwhile_ends_the_run(tmp_path):
    def render(frame, state):
        if frame == 2:
            (tmp_path / "job.json").write_text('{"job_hash": "other"}')
        return Toy()(frame, state)

    result = run(request_for(tmp_path, [1, 2, 3]), render, verify)
    assert (result.rendered, result.undone, result.exit_code) == ((1,), (2, 3), 2)
    assert strangers_in(tmp_path) == []


@pytest.mark.parametrize(
    "pattern",
    [
        "{job}.toy",
        "../{frame}.toy",
        "/tmp/{frame}.toy",
        "{frame}",
        "{frame.__class__}.toy",
        "{0}{frame}.toy",
        "{frame:{job}}.toy",
        "{frame:zz}.toy",
        "{frame",
        "{seed}{frame}.toy",
    ],
)
def test_patterns_that_cannot_name_frames_are_refused(tmp_path, pattern):
    with pytest.raises(JobError, match="pattern"):
        run(request_for(tmp_path, [1], pattern=pattern), Toy(), verify)


def test_a_pattern_may_name_folders(tmp_path):
    result = run(request_for(tmp_path, [1], pattern="exr/{frame:06d}/{job}.toy"), Toy(), verify)
    assert (tmp_path / "exr" / "000001" / "shot.toy").read_bytes() == file_of(1)
    assert result.entries[1].file == "exr/000001/shot.toy"


# --- frames that fail ---------------------------------------------------------------------------


def test_stop_ends_at_the_first_broken_frame(tmp_path):
    result = run(request_for(tmp_path, [1, 2, 3, 4], on_error="stop"), Toy(broken=[2, 4]), verify)
    assert (result.rendered, result.undone, result.exit_code) == ((1,), (3, 4), 4)
    assert [(failed.frame, failed.held_from) for failed in result.failed] == [(2, None)]
    assert "frame 2" in str(result.failed[0].error)
    assert JournalReader(tmp_path).failures[2][0].error == str(result.failed[0].error)


def test_skip_costs_the_broken_frames_only(tmp_path):
    result = run(request_for(tmp_path, [1, 2, 3, 4], on_error="skip"), Toy(broken=[2, 4]), verify)
    assert (result.rendered, result.exit_code) == ((1, 3), 4)
    assert [failed.frame for failed in result.failed] == [2, 4]
    assert sorted(frames_in(tmp_path)) == [1, 3]
    assert strangers_in(tmp_path) == []


def test_no_usable_frame_at_all(tmp_path):
    assert run(request_for(tmp_path, [1, 2], on_error="skip"), Toy(broken=[1, 2]), verify).exit_code == 3
    assert run(request_for(tmp_path, [1], on_error="stop"), Toy(broken=[1]), verify).exit_code == 3


def test_hold_last_copies_the_nearest_earlier_frame_and_tries_again_next_time(tmp_path):
    request = request_for(tmp_path, [1, 2, 3, 4, 5], on_error="hold-last")
    result = run(request, Toy(broken=[1, 3, 4]), verify)
    assert (result.rendered, result.exit_code) == ((2, 5), 4)
    held = {failed.frame: failed.held_from for failed in result.failed}
    assert held == {1: None, 3: 2, 4: 2}
    files = frames_in(tmp_path)
    assert sorted(files) == [2, 3, 4, 5]
    assert files[3] == files[4] == files[2] == file_of(2)
    assert result.entries[3].held_from == 2
    assert "cut short" in result.entries[3].error
    # The input is whole now: stand-ins make way.
    result = run(request, Toy(), verify)
    assert result.findings.stand_ins == (3, 4)
    assert (result.rendered, result.kept, result.exit_code) == ((1, 3, 4), (2, 5), 0)
    assert frames_in(tmp_path) == {frame: file_of(frame) for frame in range(1, 6)}


def test_a_frame_whose_file_does_not_verify_never_gets_its_name(tmp_path):
    def refuse(path):
        raise InputError("a pixel is not finite")

    result = run(request_for(tmp_path, [1], on_error="skip"), Toy(), refuse)
    assert result.exit_code == 3
    assert frames_in(tmp_path) == {}
    assert strangers_in(tmp_path) == []


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (OSError(errno.ENOSPC, "No space left on device"), "disk full"),
        (OSError(errno.EROFS, "Read-only file system"), "unwritable"),
        (MemoryError(), "out of memory"),
        (ResourceError("no engine"), "no engine"),
    ],
)
@pytest.mark.parametrize("where", ["render", "write"])
def test_out_of_resources_stops_with_5_and_keeps_what_is_finished(tmp_path, error, words, where):
    def render(frame, state):
        if frame == 3 and where == "render":
            raise error
        result = Toy()(frame, state)
        if frame == 3:

            def write(path):
                path.write_bytes(b"half")
                raise error

            result.write = write
        return result

    result = run(request_for(tmp_path, [1, 2, 3, 4], on_error="skip"), render, verify)
    assert (result.rendered, result.undone, result.exit_code) == ((1, 2), (3, 4), 5)
    assert words in str(result.error)
    assert strangers_in(tmp_path) == []
    assert run(request_for(tmp_path, [1, 2, 3, 4]), Toy(), verify).kept == (1, 2)


def test_an_output_that_cannot_be_a_folder(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ResourceError) as caught:
        run(request_for(tmp_path / "file" / "out", [1]), Toy(), verify)
    assert caught.value.exit_code == 5


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="rights do not bind this user")
def test_an_unwritable_folder(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(ResourceError, match="unwritable"):
        run(request_for(tmp_path, [1]), Toy(), verify)


def test_a_defect_of_the_program_is_not_hidden_but_leaves_the_folder_clean(tmp_path):
    def render(frame, state):
        if frame == 2:
            raise ZeroDivisionError
        return Toy()(frame, state)

    with pytest.raises(ZeroDivisionError):
        run(request_for(tmp_path, [1, 2, 3]), render, verify)
    assert strangers_in(tmp_path) == []
    assert run(request_for(tmp_path, [1, 2, 3]), Toy(), verify).kept == (1,)


def test_the_stop_event_ends_the_run_between_frames(tmp_path):
    stop = threading.Event()

    def render(frame, state):
        if frame == 2:
            stop.set()
        return Toy()(frame, state)

    result = run(request_for(tmp_path, [1, 2, 3]), render, verify, stop=stop)
    assert (result.rendered, result.undone, result.exit_code) == ((1, 2), (3,), 130)


def test_ctrl_c_in_a_frame_gives_that_frame_up(tmp_path):
    def render(frame, state):
        result = Toy()(frame, state)
        if frame == 2:

            def write(path):
                path.write_bytes(b"half")
                raise KeyboardInterrupt

            result.write = write
        return result

    result = run(request_for(tmp_path, [1, 2, 3]), render, verify)
    assert (result.rendered, result.undone, result.exit_code) == ((1,), (2, 3), 130)
    assert strangers_in(tmp_path) == []


def test_a_signal_between_two_lines_leaves_no_temporary_file(tmp_path):
    def render(frame, state):
        (sign,) = (tmp_path / "claims").glob("*.alive")
        temporary_name(tmp_path / "shot.0001.toy", sign.stem).write_bytes(b"half")
        raise KeyboardInterrupt

    assert run(request_for(tmp_path, [1]), render, verify).exit_code == 130
    assert strangers_in(tmp_path) == []


def test_a_listener_that_breaks_costs_no_frame(tmp_path):
    def broken(event):
        raise BrokenPipeError

    assert run(request_for(tmp_path, [1, 2]), Toy(), verify, events=broken).exit_code == 0


# --- history ------------------------------------------------------------------------------------

SHOT = range(1, 13)


def history_request(directory, frames, **options):
    segments = cut_segments(SHOT, cuts=[6], length=4, warm_up=2)
    return request_for(directory, frames, history=True, segments=segments, **options)


def recurrence(broken=()) -> dict[int, int]:
    """What each frame carries, by a plain loop over the segments written out by hand."""
    carried = {}
    for warm_up, frames in [((), (1, 2, 3, 4)), ((3, 4), (5,)), ((), (6, 7, 8, 9)), ((8, 9), (10, 11, 12))]:
        value = 7
        for frame in (*warm_up, *frames):
            if frame in broken:
                continue
            value = (value * 31 + frame) % 1_000_000_007
            if frame in frames:
                carried[frame] = value
    return carried


def expected_history_files(broken=()) -> dict[int, bytes]:
    files = {}
    for frame, value in recurrence(broken).items():
        payload = expected_payload(1, frame, value)
        files[frame] = b"TOY1" + hashlib.sha256(payload).digest() + payload
    return files


def test_the_whole_shot_with_history(tmp_path):
    toy = Toy(history=True)
    result = run(history_request(tmp_path, SHOT), toy, verify)
    assert result.exit_code == 0
    assert frames_in(tmp_path) == expected_history_files()
    # Twelve frames, and two warm-ups of two.
    assert len(toy.calls) == 16


@pytest.mark.parametrize("frame", SHOT)
def test_a_lone_frame_gets_the_same_bits(tmp_path, frame):
    run(history_request(tmp_path, [frame]), Toy(history=True), verify)
    assert frames_in(tmp_path) == {frame: expected_history_files()[frame]}


def test_a_resume_starts_at_the_committed_state(tmp_path):
    run(history_request(tmp_path, [6, 7]), Toy(history=True), verify)
    toy = Toy(history=True)
    run(history_request(tmp_path, [9]), toy, verify)
    assert toy.calls == [8, 9]
    assert frames_in(tmp_path)[9] == expected_history_files()[9]


@pytest.mark.parametrize("damage", ["flip", "gone", "pickle"])
def test_a_damaged_state_is_not_used(tmp_path, damage):
    run(history_request(tmp_path, [6, 7, 8]), Toy(history=True), verify)
    path = tmp_path / "history" / "8.npz"
    data = bytearray(path.read_bytes())
    data[-70] ^= 255
    if damage == "gone":
        path.unlink()
    else:
        path.write_bytes(bytes(data) if damage == "flip" else b"\x80\x04K\x01.")
    toy = Toy(history=True)
    result = run(history_request(tmp_path, [8, 9]), toy, verify)
    assert toy.calls == [8, 9]
    assert (result.kept, result.rendered) == ((8,), (9,))
    assert frames_in(tmp_path)[9] == expected_history_files()[9]


def test_a_broken_frame_in_the_chain_hands_on_its_state_in_every_run_alike(tmp_path):
    expected = expected_history_files(broken=[7])
    whole = run(
        history_request(tmp_path / "whole", SHOT, on_error="skip"), Toy(history=True, broken=[7]), verify
    )
    assert [failed.frame for failed in whole.failed] == [7]
    assert frames_in(tmp_path / "whole") == expected
    run(history_request(tmp_path / "lone", [9]), Toy(history=True, broken=[7]), verify)
    assert frames_in(tmp_path / "lone")[9] == expected[9]


def test_state_files_depend_on_nothing_but_the_state(tmp_path):
    run(history_request(tmp_path / "a", [6, 7]), Toy(history=True), verify)
    run(history_request(tmp_path / "b", [7]), Toy(history=True), verify)
    states = [(tmp_path / name / "history" / "7.npz").read_bytes() for name in "ab"]
    assert states[0] == states[1]


def test_segments_are_cut_where_they_should_be():
    segments = cut_segments(SHOT, cuts=[6], length=4, warm_up=2)
    assert [(segment.warm_up, segment.frames) for segment in segments] == [
        ((), (1, 2, 3, 4)),
        ((3, 4), (5,)),
        ((), (6, 7, 8, 9)),
        ((8, 9), (10, 11, 12)),
    ]
    assert [segment.frames for segment in cut_segments([3, 1, 2])] == [(1, 2, 3)]


def test_history_without_segments_is_a_defect(tmp_path):
    with pytest.raises(ValueError, match="segments"):
        run(request_for(tmp_path, [1], history=True), Toy(history=True), verify)


# --- long runs ----------------------------------------------------------------------------------


def test_a_thousand_frames_leave_no_handles_or_threads_behind(tmp_path, monkeypatch):
    # Flushing to the disk is not what is tested here.
    monkeypatch.setattr(os, "fsync", lambda handle: None)
    process = psutil.Process()

    def open_handles() -> int:
        return process.num_fds() if hasattr(process, "num_fds") else process.num_handles()

    seen = []

    def render(frame, state):
        if frame in (10, 1000):
            seen.append((open_handles(), threading.active_count()))
        return Toy()(frame, state)

    before = (open_handles(), threading.active_count())
    result = run(request_for(tmp_path, range(1, 1001)), render, verify)
    assert len(result.rendered) == 1000
    assert seen[0] == seen[1]
    assert (open_handles(), threading.active_count()) == before
