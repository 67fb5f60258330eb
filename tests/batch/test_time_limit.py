"""Samples for as long as there is time: how it is shared out, and that what came of it can be repeated."""

from __future__ import annotations

import numpy as np
import pytest
from small_job import frames_in, write_job

from mrbatch.batch.job_run import render_job
from mrbatch.batch.time_limit import Allowance, Recorded, Timed, TimeShare
from mrbatch.errors import EXIT_GATE, JobError, JobErrors
from mrbatch.film.exr import read_frame
from mrbatch.job import load_job


class Clock:
    """A machine that takes `each` seconds for a sample of both halves, and says so when it is asked."""

    def __init__(self, each: float) -> None:
        self.now = 100.0
        self.each = each

    def __call__(self) -> float:
        return self.now

    def work(self, samples: float) -> None:
        self.now += samples * self.each


def played(share: TimeShare, clock: Clock) -> int:
    """Renders until the steering asks for no more; samples of each half."""
    done = 0
    while True:
        counts = share.more(None, {"": np.arange(3)}, {})[""]
        assert (counts == counts[0, 0]).all()
        if not counts.any():
            return done
        done += int(counts[0, 0])
        clock.work(counts[0, 0])


@pytest.mark.parametrize("seconds", [0.7, 10.0, 33.3])
def test_a_frame_takes_its_seconds(seconds):
    clock = Clock(each=0.013)
    began = clock.now
    done = played(TimeShare(Timed(seconds, clock), most=1 << 20), clock)
    assert clock.now - began == pytest.approx(seconds, abs=clock.each)
    assert done == pytest.approx(seconds / clock.each, abs=1)


def test_a_frame_without_time_has_one_round_and_ends():
    clock = Clock(each=1.0)
    assert played(TimeShare(Timed(0.0, clock), most=64, unit=4), clock) == 4


def test_samples_asked_for_are_the_most():
    clock = Clock(each=0.001)
    share = TimeShare(Timed(10.0, clock), most=40)
    assert played(share, clock) == 40
    assert share.as_dict() == {"outcome": "fixed", "rounds": 1, "samples": 80}


def test_moments_of_a_shutter_share_evenly():
    clock = Clock(each=0.1)
    assert played(TimeShare(Timed(10.0, clock), most=1 << 20, unit=16), clock) % 16 == 0


@pytest.mark.parametrize("beside", [0.2, 2.5])
def test_all_frames_are_thinned_alike_and_the_limit_is_kept(beside):
    """What a frame takes beside its samples is not known at first."""
    clock = Clock(each=0.01)
    began, left = clock.now, [10]
    allowance = Allowance(began + 60.0, lambda: left[0], megapixels=0.3, closing=False, clock=clock)
    counts = []
    while left[0]:
        clock.now += beside / 2
        counts.append(played(TimeShare(allowance.begin(), most=1 << 20), clock))
        clock.now += beside / 2
        left[0] -= 1
    assert clock.now - began == pytest.approx(60.0, rel=0.03)
    assert min(counts[1:]) > 0.95 * max(counts[1:]) and counts[0] < 2 * counts[1]


def test_a_recorded_frame_ends_where_it_ended():
    clock = Clock(each=0.01)
    share = TimeShare(Timed(1.0, clock), most=1 << 20)
    done = played(share, clock)
    told = share.as_dict()
    again = TimeShare(Recorded(told["rounds"], told["samples"]), most=1 << 20)
    assert played(again, Clock(each=5.0)) == done
    assert again.as_dict() == told


# --- whole jobs ------------------------------------------------------------------------------------------


def render(path, *settings, out, **options):
    job = load_job(path, [f"output.directory={out}", *settings])
    return render_job(job, report=False, **options)


LIMITS = ("accuracy.time_limit=3 s", "method.spp=1000000")


@pytest.fixture(scope="module")
def limited(tmp_path_factory):
    path = write_job(tmp_path_factory.mktemp("limit"), (0, 1), dtype=np.float32)
    outcome = render(path, *LIMITS, out="first")
    assert outcome.exit_code == 0 and outcome.result.rendered == (0, 1)
    return path


def test_a_limit_thins_all_frames(limited):
    for number in (0, 1):
        found = read_frame(limited.parent / "first" / f"small.{number:04d}.exr").metadata["accuracy"]
        assert found["outcome"] == "limit" and 2 <= found["samples"] < 1_000_000


def test_frames_of_a_limit_are_kept(limited):
    assert render(limited, *LIMITS, out="first").result.kept == (0, 1)


def test_a_replay_gives_the_same_bytes(limited):
    render(limited, *LIMITS, out="again", replay=limited.parent / "first", threads=1)
    assert frames_in(limited.parent / "again") == frames_in(limited.parent / "first")


def test_a_replay_of_another_job_is_refused(limited):
    with pytest.raises(JobError, match="nothing can be replayed"):
        render(limited, *LIMITS, "seed=7", out="other", replay=limited.parent / "first")
    with pytest.raises(JobError, match="no `accuracy.time_limit`"):
        render(limited, out="none", replay=limited.parent / "first")


def test_a_target_that_time_did_not_reach_is_missed_and_can_be_replayed(limited):
    asked = ("accuracy.time_limit=2 s", "accuracy.target_error=1e-9", "accuracy.max_spp=1000000")
    assert render(limited, *asked, out="target").exit_code == EXIT_GATE
    render(limited, *asked, out="target again", replay=limited.parent / "target", threads=1)
    assert frames_in(limited.parent / "target again") == frames_in(limited.parent / "target")


def test_quality_is_a_target_by_name(limited):
    assert load_job(limited, ["accuracy.quality=final"]).accuracy.target == 4e-4
    with pytest.raises(JobErrors, match="one of `quality` and `target_error`"):
        load_job(limited, ["accuracy.quality=final", "accuracy.target_error=0.1"])
