"""Claims: one frame, one living owner; the dead are found by pid or by the file system's time."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
import time
from dataclasses import asdict, replace

import pytest

from mrbatch.batch.claim import Claims, read_claim
from mrbatch.batch.presence import FileSystemClock, Owner, Presence


@pytest.fixture
def present(tmp_path):
    entered = []

    def make(**options):
        presence = Presence(tmp_path, Owner.here(), "job", **options)
        presence.__enter__()
        entered.append(presence)
        return presence

    yield make
    for presence in entered:
        presence.__exit__(None, None, None)


def leave_claim(folder, owner: Owner, frame: int, *, age: float = 0.0, sign: bool = True):
    """A claim as another process would have left it `age` seconds ago."""
    folder.mkdir(exist_ok=True)
    paths = [folder / f"{frame}.claim"]
    paths[0].write_text(owner.name)
    if sign:
        paths.append(folder / f"{owner.name}.alive")
        paths[1].write_text(json.dumps({"owner": asdict(owner), "job_hash": "job"}))
    for path in paths:
        stamp = path.stat().st_mtime - age
        os.utime(path, (stamp, stamp))


def dead_process() -> int:
    """A pid that no process has any more."""
    process = subprocess.Popen([sys.executable, "-c", "pass"])
    process.wait()
    return process.pid


def other(**changes) -> Owner:
    return replace(Owner.here(), **changes)


def test_a_claim_is_exclusive_until_released(present):
    first, second = Claims(present()), Claims(present())
    assert first.acquire(7)
    assert not second.acquire(7)
    assert second.holder(7) == first.presence.owner.name
    first.release(7)
    assert second.holder(7) is None
    assert second.acquire(7)
    assert second.taken_over == 0


def test_many_threads_one_winner(present):
    claimers = [Claims(present()) for _ in range(8)]
    won = []
    barrier = threading.Barrier(8)

    def compete(claims):
        barrier.wait()
        won.append([frame for frame in range(50) if claims.acquire(frame)])

    threads = [threading.Thread(target=compete, args=(claims,)) for claims in claimers]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(frame for frames in won for frame in frames) == list(range(50))


def test_a_dead_process_of_this_machine_loses_its_claim_at_once(tmp_path, present):
    dead = other(name="host-dead", pid=dead_process())
    leave_claim(tmp_path / "claims", dead, 3)
    claims = Claims(present(stale_after=1e9))
    assert claims.acquire(3)
    assert claims.taken_over == 1
    assert read_claim(claims.path(3)) == claims.presence.owner.name


def test_a_living_process_of_this_machine_keeps_its_claim_however_old(tmp_path, present):
    leave_claim(tmp_path / "claims", other(name="host-living"), 3, age=1e6)
    claims = Claims(present(stale_after=1.0))
    assert not claims.acquire(3)


@pytest.mark.parametrize("sign", [True, False])
@pytest.mark.parametrize(("age", "taken"), [(0.0, False), (50.0, False), (70.0, True)])
def test_another_machine_is_judged_by_the_age_of_its_sign(tmp_path, present, age, taken, sign):
    # The pid is dead here, which says nothing of the other machine.
    far = other(name="far-1-aa", machine="elsewhere", pid=dead_process())
    leave_claim(tmp_path / "claims", far, 3, age=age, sign=sign)
    claims = Claims(present(stale_after=60.0))
    assert claims.acquire(3) is taken


def test_ages_are_told_by_the_file_system_not_by_the_clock(tmp_path, present, monkeypatch):
    far = other(name="far-1-aa", machine="elsewhere")
    leave_claim(tmp_path / "claims", far, 3)
    claims = Claims(present(stale_after=60.0))
    monkeypatch.setattr(time, "time", lambda: 4e9)
    assert not claims.acquire(3)


def test_the_probe_tells_the_time_that_files_get_and_leaves_nothing(tmp_path):
    clock = FileSystemClock(tmp_path, Owner.here())
    before = tmp_path / "before"
    before.touch()
    now = clock.now()
    after = tmp_path / "after"
    after.touch()
    assert before.stat().st_mtime <= now <= after.stat().st_mtime
    assert sorted(os.listdir(tmp_path)) == ["after", "before"]


def test_the_heartbeat_keeps_a_claim_alive(present, monkeypatch):
    living = present(stale_after=0.4)
    first = Claims(living)
    assert first.acquire(1)
    watcher = present(stale_after=0.4)
    # Seen as from another machine, where only the heartbeat tells.
    watcher.owner = replace(watcher.owner, machine="elsewhere")
    for _ in range(8):
        time.sleep(0.1)
        assert watcher.is_alive(living.owner.name)
    living._ended.set()
    living._thread.join()
    for _ in range(100):
        if not watcher.is_alive(living.owner.name):
            break
        time.sleep(0.1)
    assert not watcher.is_alive(living.owner.name)


def test_a_sign_that_others_removed_comes_back(present):
    presence = present(stale_after=0.4)
    presence.path.unlink()
    for _ in range(100):
        if presence.path.exists() and presence.path.stat().st_size:  # made first, then written
            break
        time.sleep(0.05)
    assert json.loads(presence.path.read_text())["owner"]["pid"] == os.getpid()


def test_release_leaves_a_claim_that_was_taken_over(present):
    first, second = Claims(present()), Claims(present())
    assert first.acquire(1)
    first.path(1).write_text(second.presence.owner.name)
    first.release_all()
    assert first.path(1).exists()


def test_sweep_removes_the_dead_and_leaves_the_living(tmp_path, present):
    folder = tmp_path / "claims"
    dead = other(name="host-dead", pid=dead_process())
    leave_claim(folder, dead, 1)
    leave_claim(folder, dead, 2)
    leave_claim(folder, other(name="host-living"), 3)
    claims = Claims(present())
    claims.sweep()
    assert claims.taken_over == 2
    names = {path.name for path in folder.iterdir()}
    assert names == {"3.claim", "host-living.alive", f"{claims.presence.owner.name}.alive"}


def test_a_claim_cut_off_before_its_name_was_written_ages_like_any_other(tmp_path, present):
    folder = tmp_path / "claims"
    folder.mkdir()
    path = folder / "5.claim"
    path.touch()
    claims = Claims(present(stale_after=60.0))
    assert not claims.acquire(5)
    stamp = path.stat().st_mtime - 61.0
    os.utime(path, (stamp, stamp))
    assert claims.acquire(5)


def test_another_start_time_is_another_process(tmp_path, present):
    """A pid that was given again: its old owner is judged by the heartbeat."""
    reused = other(name="host-reused", started=Owner.here().started - 1e5)
    leave_claim(tmp_path / "claims", reused, 3, age=70.0)
    assert Claims(present(stale_after=60.0)).acquire(3)


def test_a_slow_taker_gives_the_claim_of_a_faster_one_back(tmp_path, present, monkeypatch):
    dead = other(name="host-dead", pid=dead_process())
    leave_claim(tmp_path / "claims", dead, 3)
    slow, fast = Claims(present()), Claims(present())
    judge = slow.presence.is_alive

    def overtaken(name, claimed=None):
        verdict = judge(name, claimed)
        if name == dead.name:
            # Between this judgement and what follows from it, the other one is through.
            assert fast.acquire(3)
        return verdict

    monkeypatch.setattr(slow.presence, "is_alive", overtaken)
    assert not slow.acquire(3)
    assert read_claim(fast.path(3)) == fast.presence.owner.name
    assert list((tmp_path / "claims").glob(".stale-*")) == []
