"""Samples until the error is as asked: what decides, and what it makes of whole jobs."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from small_job import write_job

from mrbatch.batch.error_target import ErrorTarget, Judged, water_level
from mrbatch.batch.job_run import render_job
from mrbatch.errors import EXIT_GATE, JobErrors
from mrbatch.film.exr import read_frame
from mrbatch.film.window import Window
from mrbatch.job import load_job

# --- the level -----------------------------------------------------------------------------------------


def test_level_cuts_what_is_above_and_hands_on_what_is_left_over():
    error, pixels = np.array([1.0, 4.0, 100.0]), np.array([10, 10, 20])
    level = water_level(error, pixels, allowed=11.0)
    assert np.minimum(error, level * pixels).sum() == pytest.approx(11.0)
    # The second tile, too, has more than the level.
    assert level == pytest.approx((11.0 - 1.0) / 30)


def test_level_may_be_below_all():
    error, pixels = np.array([3.0, 4.0]), np.array([1, 3])
    assert water_level(error, pixels, allowed=2.0) == pytest.approx(0.5)


def test_nothing_is_cut_where_all_is_well():
    assert water_level(np.array([1.0, 1.0, 0.0]), np.array([1, 1, 0]), allowed=2.0) == math.inf


# --- steering of a known noise ---------------------------------------------------------------------------

WINDOW = Window(0, 0, 64, 32)
SIGMA = np.repeat([0.02, 0.02, 0.4, 0.02, 0.02, 0.02, 0.02, 0.1], 256).reshape(8, 16, 16)
SIGMA = SIGMA.reshape(2, 4, 16, 16).transpose(0, 2, 1, 3).reshape(32, 64)
"""Standard deviation of a sample; tiles differ."""


class Noise:
    """A renderer of known error: a grey picture of 1 over a black photo; samples have Gaussian noise."""

    def __init__(self, seed: int, *, stays: float = 0.0) -> None:
        self.random = np.random.default_rng(seed)
        self.sums = np.zeros((2, 32, 64, 3))
        self.squares = np.zeros((2, 32, 64, 3))
        self.counts = np.zeros((2, 8), dtype=np.int64)
        self.stays = stays * np.random.default_rng(seed + 1).standard_normal((2, 32, 64, 1))

    def pixels(self, of_tiles: np.ndarray) -> np.ndarray:
        return np.kron(of_tiles.reshape(2, 4), np.ones((16, 16), of_tiles.dtype))

    def add(self, more: np.ndarray) -> None:
        for half in (0, 1):
            n = self.pixels(more[half])[..., None]
            mean = np.sqrt(n) * SIGMA[..., None] * self.random.standard_normal((32, 64, 3)) + n
            spread = (
                SIGMA[..., None] ** 2 * self.random.chisquare(np.maximum(n - 1, 1), (32, 64, 3)) * (n > 1)
            )
            self.sums[half] += mean
            self.squares[half] += spread + np.divide(mean**2, n, out=np.zeros_like(mean), where=n > 0)
        self.counts += more

    def halves(self) -> np.ndarray:
        n = np.stack([self.pixels(self.counts[half]) for half in (0, 1)])[..., None]
        return self.sums / n + self.stays

    def judge(self, name, sources) -> Judged:
        n = np.stack([self.pixels(self.counts[half]) for half in (0, 1)])[..., None]
        halves = self.halves()
        scatter = np.maximum(self.squares / n - (self.sums / n) ** 2, 0.0) / (n - 1)
        every = np.ones((32, 64), dtype=bool)
        return Judged(halves.mean(axis=0), (halves[0], halves[1]), np.zeros((32, 64, 3)), scatter, every)


def steered(noise: Noise, target: float, *, limit: int = 1 << 16) -> ErrorTarget:
    steering = ErrorTarget(target, {"": WINDOW}, noise.judge, batch=4, limit=limit)
    tiles = {"": np.arange(8)}
    estimates = None
    for _ in range(100):
        more = steering.more(estimates, tiles, {"": noise.counts.copy()})
        if not more[""].any():
            return steering
        noise.add(more[""])
        estimates = {"": {}}
    raise AssertionError("it never ends")


@pytest.mark.parametrize("target", [1e-3, 3e-4, 3e-5])
def test_the_true_error_is_below_and_not_far(target):
    errors, counts = [], []
    for seed in range(20):
        noise = Noise(seed)
        steering = steered(noise, target)
        assert steering.outcome == "reached"
        errors.append(float(((noise.halves().mean(axis=0) - 1.0) ** 2 / (1.0 + 1e-2)).mean()))
        counts.append(noise.counts.copy())
    assert np.mean(np.array(errors) <= target) >= 0.9
    assert np.median(errors) > 0.5 * target
    # The noisy tile gets most; none is left without.
    middle = np.median(counts, axis=0)
    assert (middle[:, 2] >= middle.max(axis=1)).all() and (middle >= 4).all()


def test_noise_that_no_sample_takes_away_is_told():
    assert steered(Noise(1, stays=0.05), 1e-4).outcome == "converged-floor"


def test_the_limit_is_told():
    noise = Noise(1)
    steering = steered(noise, 1e-5, limit=64)
    assert steering.outcome == "limit"
    assert noise.counts.max() == 64


def test_what_one_half_gets_is_the_other_ones_word():
    """Noise in one half alone, by chance: the other one is what goes on."""
    noise = Noise(3)
    noise.add(np.full((2, 8), 16))
    steering = ErrorTarget(1e-5, {"": WINDOW}, noise.judge, batch=4, limit=1 << 16)
    noise.squares[0, 16:, :16] *= 4.0
    more = steering.more({"": {}}, {"": np.arange(8)}, {"": noise.counts.copy()})[""]
    assert more[1, 4] > more[0, 4]


# --- whole jobs ------------------------------------------------------------------------------------------


def render(path, *settings, out="out", **options):
    job = load_job(path, [f"output.directory={out}", *settings])
    return render_job(job, report=options.pop("report", False), **options)


@pytest.fixture(scope="module")
def job(tmp_path_factory):
    return write_job(tmp_path_factory.mktemp("target"), (0, 1), dtype=np.float32)


def told(path, frame=0) -> dict:
    return read_frame(path.parent / "out" / f"small.{frame:04d}.exr").metadata["accuracy"]


def test_a_job_reaches_its_target_and_says_so(job):
    outcome = render(
        job, "accuracy.target_error=0.002", "output.directory=reached", out="reached", report=True
    )
    assert outcome.exit_code == 0
    for frame in outcome.report.frames:
        assert frame.outcome == "reached"
        assert frame.error.value <= 0.002
    written = read_frame(job.parent / "reached" / "small.0000.exr")
    accuracy = written.metadata["accuracy"]
    assert accuracy["outcome"] == "reached" and accuracy["target"] == 0.002
    samples = written.views[""].channels.get("samples")
    assert samples is None or samples.max() > samples[samples > 0].min()


def test_the_bits_are_those_of_any_number_of_threads_and_launches(job):
    asked = ("accuracy.target_error=0.005",)
    render(job, *asked, out="one", threads=1, units_per_launch=1)
    render(job, *asked, out="two", threads=2, units_per_launch=5)
    for number in (0, 1):
        name = f"small.{number:04d}.exr"
        assert (job.parent / "one" / name).read_bytes() == (job.parent / "two" / name).read_bytes()


def test_a_target_that_is_missed_is_exit_code_1(job):
    outcome = render(job, "accuracy.target_error=1e-6", "accuracy.max_spp=16", out="missed", report=True)
    assert outcome.exit_code == EXIT_GATE
    assert {frame.outcome for frame in outcome.report.frames} == {"limit"}
    # The frames are there all the same, and kept: but the target stays missed.
    again = render(job, "accuracy.target_error=1e-6", "accuracy.max_spp=16", out="missed")
    assert again.result.kept == (0, 1) and again.exit_code == EXIT_GATE


def test_where_nothing_changes_no_sample_is_spent(tmp_path):
    path = write_job(tmp_path, (0,), virtual=False)
    outcome = render(path, "accuracy.target_error=0.001")
    assert outcome.exit_code == 0
    assert told(path)["outcome"] == "reached"
    entry = outcome.result.entries[0]
    assert entry.details["samples"] == 0 and not any(entry.counters.values())


@pytest.mark.parametrize("value", ["0", "-1", "2", "nan"])
def test_what_is_no_error_is_refused(job, value):
    with pytest.raises(JobErrors):
        load_job(job, [f"accuracy.target_error={value}"])


def test_an_open_shutter_gives_every_moment_the_same(tmp_path):
    moves = json.loads(write_job(tmp_path, (0, 1), dtype=np.float32).read_text())
    path = tmp_path / "job.yaml"
    path.write_text(json.dumps(moves | {"shutter": {"open": 0, "close": 0.5, "samples": 4}}))
    outcome = render(path, "accuracy.target_error=0.01", "method.spp=8")
    assert outcome.exit_code == 0 and told(path)["outcome"] == "reached"
