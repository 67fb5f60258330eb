"""`mrbatch render` killed at twenty random moments: what is there is whole, the rest comes out the same."""

from __future__ import annotations

import random
import shutil
import time

import pytest
from small_job import finish, frames_in, start, strangers_in, wait_for, write_job

pytestmark = pytest.mark.slow

FRAMES = tuple(range(8))
KILLS = 20


def test_killed_at_twenty_random_moments(tmp_path, capsys):
    job = write_job(tmp_path, FRAMES, spp=128, width=80, height=60)
    whole, out = tmp_path / "whole", tmp_path / "killed"
    # Kernels are compiled once a machine: a run that does it would make the moments of death too late.
    finish(start(job, tmp_path / "warm"))
    began = time.monotonic()
    undisturbed = start(job, whole)
    wait_for(undisturbed, "frame-started")
    starting = time.monotonic() - began
    finish(undisturbed)
    assert undisturbed.returncode == 0
    lasting = time.monotonic() - began - starting
    expected = frames_in(whole)
    assert len(expected) == len(FRAMES)

    moments = random.Random(20)
    stated = []
    in_work = 0
    for kill in range(KILLS):
        if len(frames_in(out)) >= len(FRAMES) - 2:
            shutil.rmtree(out)
        process = start(job, out)
        # Every fourth dies while it starts and prepares, the others while they render.
        early = kill % 4 == 3
        if early:
            moment = moments.uniform(0.0, starting)
        else:
            wait_for(process, "frame-started")
            moment = moments.uniform(0.0, 0.5 * lasting)
        time.sleep(moment)
        in_work += process.poll() is None
        process.kill()
        process.communicate()
        there = frames_in(out)
        stated.append(f"{'start' if early else 'first frame'} + {moment:.2f} s: {len(there)} frames")
        for name, found in there.items():
            assert found == expected[name], (stated, name)
    with capsys.disabled():
        print("\nkilled at " + "; ".join(stated))
    # A kill that comes when all is done shows nothing.
    assert in_work >= KILLS * 3 // 4

    last = start(job, out)
    events = finish(last)
    assert last.returncode == 0, events
    assert frames_in(out) == expected
    assert not strangers_in(out)
