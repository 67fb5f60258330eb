"""The comparisons of methods and of sampling strategies: what they measure, and how they tell it."""

from __future__ import annotations

import json

import numpy as np
import pytest
from click.testing import CliRunner
from small_job import write_job

from mrbatch.bench.__main__ import main
from mrbatch.bench.bounces import METHODS, bounces
from mrbatch.bench.samplers import KINDS, samplers
from mrbatch.bench.strategies import STRATEGIES, strategies
from mrbatch.bench.tables import as_json
from mrbatch.bench.time_to_error import time_to_error
from mrbatch.bench.variants import Variants, converged
from mrbatch.errors import JobError

SMALL = ["output.scale=0.5", "method.spp=4"]


@pytest.fixture(scope="module")
def job(tmp_path_factory):
    return write_job(tmp_path_factory.mktemp("job"), (0, 1), dtype=np.float32)


@pytest.fixture(scope="module")
def variants(job):
    return Variants(job, SMALL)


def test_capture_is_solved_once(job, monkeypatch):
    from mrbatch.capture.marker_video.capture import MarkerVideoCapture

    calls = []
    solve = MarkerVideoCapture.prepare
    monkeypatch.setattr(
        MarkerVideoCapture, "prepare", lambda self, told: calls.append(1) or solve(self, told)
    )
    several = Variants(job, SMALL)
    for method in METHODS:
        with several.subject(f"method.name={method}") as subject:
            assert subject.run().composite.any()
    assert len(calls) == 1


def test_reference_knows_its_own_error(variants):
    """The noise that two halves foresee is the RMSE against a better picture."""
    coarse, fine = (converged(variants, spp) for spp in (64, 1024))
    assert coarse.spp == 64 and fine.spp == 1024
    assert fine.error < 0.7 * coarse.error
    assert fine.rmse(coarse.picture) == pytest.approx(coarse.error, rel=0.35)
    assert fine.rmse(fine.picture) == 0.0
    # The region holds the crate and its shadow, and not the whole picture.
    assert np.all(fine.changed[fine.covered == 1.0])
    assert 0.05 < fine.changed.mean() < 0.95
    assert np.isnan(fine.rmse(coarse.picture, np.zeros_like(fine.changed)))


def test_time_to_error_is_of_a_picture_that_has_the_error(variants):
    found = time_to_error(variants, 2e-3, repeats=3, reference_spp=8192)
    assert len(found.seconds) == 3 and found.tried[0][0] == 4
    assert found.reference_relmse < 0.25 * found.target
    with variants.subject(f"method.spp={found.spp}") as subject:
        picture = subject.run().composite
    there = found.reference.changed
    truth = found.reference.picture
    floor = 1e-2 * np.abs(truth).mean() ** 2
    relmse = np.mean(((picture - truth) ** 2 / (truth**2 + floor))[there])
    assert relmse == pytest.approx(found.relmse, rel=1e-6)
    assert found.relmse == pytest.approx(found.target, rel=0.5)
    with pytest.raises(ValueError, match="give it more"):
        time_to_error(variants, 1e-9, repeats=3, reference_spp=64)


def test_bounces_compare_delta_path_tracing_with_its_baselines(variants):
    found = bounces(variants, (1, 3), repeats=3, reference_spp=256)
    assert [(row.bounces, row.method) for row in found.rows] == [(b, m) for b in (1, 3) for m in METHODS]
    assert (found.spp, found.frame, found.repeats, found.same.repetitions) == (4, 0, 3, 3)
    for first in (0, 3):
        ours, one, two = found.rows[first : first + 3]
        assert ours.ratio.low == ours.ratio.high == 1.0
        # Common random numbers: the same picture as ours, with more look-ups; two pictures: more noise.
        assert one.rmse == pytest.approx(ours.rmse, rel=1e-3)
        assert two.rmse > ours.rmse
        assert ours.counters["lookups"] < one.counters["lookups"] < two.counters["lookups"]
    # Light of one bounce alone is too little.
    assert found.rows[3].counters["vertices"] > found.rows[0].counters["vertices"]


def test_bounces_are_edges_beyond_the_camera_and_the_light(variants):
    """One bounce: light from the map to the surface to the camera, and no further vertex."""
    with variants.subject("method.name=two-pass", "method.max_depth=2") as subject:
        counters = subject.run().counters
    assert counters["vertices"] <= counters["camera rays"]


@pytest.mark.slow
def test_strategies_are_compared_at_equal_samples(job):
    found = strategies(Variants(job, ["output.scale=0.5", "method.spp=32"]), repeats=3, reference_spp=512)
    assert tuple(row.strategy for row in found.rows) == STRATEGIES
    rows = {row.strategy: row for row in found.rows}
    assert len({row.counters["camera rays"] for row in found.rows}) == 1
    # A small strong light: surfaces alone hardly find it.
    assert rows["bsdf"].rmse > 2 * rows["mis"].rmse
    assert rows["bsdf"].counters["shadow rays"] == 0
    assert all(np.isfinite([row.rmse_real, row.rmse_virtual]).all() for row in found.rows)


@pytest.mark.slow
def test_samplers_are_compared_at_equal_samples(job):
    """By light samples alone, where a sample map's fixed directions show most."""
    settings = ["output.scale=0.5", "method.spp=512", "method.strategy=environment"]
    found = samplers(Variants(job, settings), repeats=3, reference_spp=8192)
    named = [(kind, value) for kind, (_, values) in KINDS.items() for value in values]
    assert [(row.kind, row.sampler) for row in found.rows] == named
    assert len({row.counters["camera rays"] for row in found.rows}) == 1
    rmse = {row.sampler: row.rmse for row in found.rows}
    assert rmse["sample-map"] > 2 * max(rmse["cdf"], rmse["alias"])
    assert rmse["independent"] > 1.3 * rmse["owen"]
    assert rmse["owen"] in (rmse["cdf"], rmse["median-cut"]), "numbers are compared under the job's sampler"
    assert rmse["1"] == rmse["owen"] != rmse["8"] < 2 * rmse["1"]
    ratio = {row.sampler: row.ratio for row in found.rows}
    assert ratio["cdf"].value == ratio["owen"].value == 1.0 != ratio["alias"].value
    alias = found.rows[2]
    assert alias.cost == pytest.approx(alias.ratio.value * (rmse["alias"] / rmse["cdf"]) ** 2)


def test_json_holds_every_number(variants):
    found = strategies(variants, repeats=3, reference_spp=64)
    told = json.loads(json.dumps(as_json(found), allow_nan=False))
    assert told["reference"]["pixels"] > 0 and told["spp"] == 4
    assert [len(row["seconds"]) for row in told["rows"]] == [3, 3, 3]
    assert told["rows"][0]["ratio"]["value"] == 1.0


@pytest.mark.parametrize(
    ("command", "words"),
    [
        (["bounces", "--most", "1"], ("two-pass", "one-pass", "RMSE", "look-ups", "over itself")),
        pytest.param(
            ["samplers"],
            ("alias", "sample-map", "cranley-patterson", "over the first"),
            marks=pytest.mark.slow,
        ),
        (["strategies"], ("environment", "bsdf", "on virtual")),
    ],
)
def test_commands_print_a_table_and_write_json(job, tmp_path, command, words):
    file = tmp_path / "out" / "found.json"
    settings = [word for setting in SMALL for word in ("--set", setting)]
    arguments = [
        *command,
        str(job),
        "--repeats",
        "3",
        "--reference-spp",
        "32",
        "--json",
        str(file),
        *settings,
    ]
    result = CliRunner().invoke(main, arguments)
    assert result.exit_code == 0, result.output
    assert all(word in result.output for word in words)
    assert json.loads(file.read_text())["rows"]


def test_a_job_that_cannot_be_used_is_told(job, tmp_path):
    result = CliRunner().invoke(main, ["bounces", str(tmp_path / "none.yaml")])
    assert result.exit_code == 1 and "none.yaml" in result.output and "Traceback" not in result.output
    with pytest.raises(JobError):
        Variants(job, ["method.sppp=4"])
