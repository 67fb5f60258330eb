"""Random jobs: repeated by their seed, watched from outside, shrunk by hypothesis where one is unsound."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mrbatch.cli import main
from mrbatch.contracts import Measurement
from mrbatch.stability import fuzz, small_job
from mrbatch.stability.run import unsound
from mrbatch.stability.small_job import LIGHTS, SHAPES, SIZES, SmallJob, Thing, random_job


def test_a_seed_is_a_job_and_jobs_span_what_they_should():
    assert random_job(5) == random_job(5) != random_job(6)
    jobs = [random_job(seed) for seed in range(2000)]
    scales, offsets = np.array([j.scale for j in jobs]), np.array([j.offset for j in jobs])
    assert scales.min() < 2e-4 and scales.max() > 5e3
    assert offsets.min() == 0 and offsets.max() > 5e5
    assert {j.size for j in jobs} == set(SIZES) and (1, 1) in SIZES
    assert {j.light for j in jobs} == set(LIGHTS)
    assert {t.shape for j in jobs for t in j.things} == set(SHAPES)
    assert {j.family for j in jobs} == set(range(len(small_job.FAMILIES)))


def test_a_crash_and_a_hang_cost_one_job(monkeypatch):
    monkeypatch.setenv(
        "PYTHONPATH", os.pathsep.join([str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")])
    )
    found = dict(fuzz.jobs(2, 6, patience=4.0, task="broken_work"))
    assert list(found) == [2, 3, 4, 5, 6, 7]
    assert found[3] == "ended the process, exit code 11" and found[5] == "took more than 4 s"
    assert found[6] == "no number" and not (found[2] or found[4] or found[7])


def test_what_is_unsound_is_told_with_its_seed(monkeypatch):
    monkeypatch.setattr(
        fuzz, "jobs", lambda first, count: ((first + k, "" if k else "bad") for k in range(count))
    )
    report = fuzz.fuzz(3, seed=40)
    assert [c.name for c in report.cases] == ["FUZZ", "FUZZ-40"] and report.exit == 1
    assert report.cases[1].setup == "mrbatch stability --fuzz 1 --seed 40"
    found = CliRunner().invoke(main, ["stability", "--fuzz", "3", "--seed", "40"])
    assert found.exit_code == 1 and "seed 40: bad" in found.output and "1 of 3 jobs" in found.output
    assert CliRunner().invoke(main, ["stability", "--fuzz", "3", "--case", "DPT-01"]).exit_code == 2


def test_a_crash_inside_a_job_and_a_pixel_that_is_no_number_are_seen(monkeypatch):
    def broken(job):
        raise ZeroDivisionError("no")

    monkeypatch.setattr(fuzz, "measure", broken)
    assert fuzz.check(0) == "raised ZeroDivisionError: no"
    bad = Measurement(True, "", "", "", radiance=(np.array([np.nan]),))
    monkeypatch.setattr(fuzz, "measure", lambda job: bad)
    assert "no finite numbers" in fuzz.check(0)


unit = st.floats(0, 1, width=32)
colour = st.tuples(unit, unit, unit)
things = st.builds(
    Thing,
    shape=st.sampled_from(SHAPES),
    place=st.tuples(st.floats(-1.5, 1.5), st.floats(-1.5, 1.5), st.floats(0, 1.5)),
    size=st.floats(1e-3, 3.0),
    reflectance=colour,
    alpha=unit,
    metalness=unit,
    emission=st.floats(1e-6, 1e4),
)
small_jobs = st.builds(
    SmallJob,
    # Matt things alone, by delta path tracing: one set of kernels.
    family=st.just(0),
    seed=st.integers(0, 2**31 - 1),
    scale=st.floats(1e-4, 1e4),
    offset=st.floats(0, 1e6),
    size=st.sampled_from(SIZES),
    azimuth=st.floats(0, 6.3),
    elevation=st.floats(-0.2, 1.57),
    distance=st.floats(0.1, 10),
    focal=st.floats(0.3, 100),
    light=st.sampled_from(LIGHTS),
    strength=st.floats(1e-4, 1e6),
    floor=colour,
    things=st.lists(things, min_size=1, max_size=3).map(tuple),
    spp=st.sampled_from([2, 4]),
    max_depth=st.one_of(st.none(), st.integers(2, 20)),
    gain=st.floats(1e-3, 1e3),
    photo=st.floats(0, 1e3),
)


def sound(job: SmallJob) -> None:
    found = small_job.measure(job)
    assert found.passed and not unsound(found), (unsound(found), job)


@pytest.mark.slow
@settings(max_examples=150, deadline=None, suppress_health_check=list(HealthCheck))
@given(job=small_jobs)
def test_no_small_job_is_unsound(job):
    sound(job)


@pytest.mark.slow
@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(job=small_jobs, family=st.sampled_from([1, 2]))
def test_nor_is_one_of_metal_lamps_or_glass(job, family):
    second = replace(job.things[0], place=(0.5, 0.2, 0.4))
    sound(replace(job, family=family, things=(*job.things[:1], second)))


def test_a_few_random_jobs_are_sound():
    for seed in range(6):
        sound(replace(random_job(seed), family=0))
