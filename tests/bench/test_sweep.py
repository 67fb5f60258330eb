"""The sweep: errors and seconds by setting, what is claimed of them, and how it is told."""

from __future__ import annotations

import csv
import json

import numpy as np
import pytest
from click.testing import CliRunner
from small_job import write_job, write_picture

import mrbatch
from mrbatch.bench.sweep import SweepRequest, sweep
from mrbatch.bench.sweep_targets import times_the_samples
from mrbatch.bench.truth import noise_and_bias, rendered_truth, stored_truth
from mrbatch.bench.variants import Variants
from mrbatch.cli import main
from mrbatch.errors import InputError, JobError
from mrbatch.metrics.frontier import front, knee
from mrbatch.report.model import load_report
from mrbatch.report.sweep_table import price_list

SMALL = ("output.scale=0.5",)


@pytest.fixture(scope="module")
def job(tmp_path_factory):
    return write_job(tmp_path_factory.mktemp("job"), (0, 1), dtype=np.float32, spp=8)


@pytest.fixture(scope="module")
def found(job):
    """Few turns: what is told, not how it is claimed."""
    axes = ("method.spp=16,64", "method.max_depth=1", "output.scale=1.0")
    request = SweepRequest(settings=SMALL, axes=axes, repeats=4, pictures=True, reference_spp=1024)
    return sweep(job, request)


def test_noise_and_bias_are_told_apart():
    """Known parts: a bias of 0.3, noise of variance 0.5, a truth that is off by 0.1 of its own."""
    rng = np.random.default_rng(4)
    n, size = 24, 4000
    shared = 0.3 + np.sqrt(0.1) * rng.standard_normal(size)
    renderings = [(shared + np.sqrt(0.5) * rng.standard_normal(size)) / np.sqrt(size) for _ in range(n)]
    parts = noise_and_bias(renderings, 0.1)
    assert parts.noise.value == pytest.approx(0.5, rel=0.02)
    assert parts.bias.value == pytest.approx(0.09, abs=0.02)
    assert parts.total.value == pytest.approx(0.69, abs=0.02)
    assert parts.noise.low < 0.5 < parts.noise.high
    # The mean error alone would call the noise of few renderings bias.
    assert noise_and_bias(renderings, None).bias.value == pytest.approx(0.19, abs=0.02)
    with pytest.raises(ValueError, match="three"):
        noise_and_bias(renderings[:2], 0.1)


def test_front_and_knee():
    points = {"fast": (1.0, 8.0), "knee": (2.0, 1.0), "exact": (16.0, 0.5), "beaten": (3.0, 2.0)}
    assert front(points) == ("fast", "knee", "exact")
    assert knee(points) == "knee"
    assert knee({"a": (1.0, 4.0), "b": (2.0, 2.0), "c": (4.0, 1.0)}) == "", "a straight line has none"
    assert front({"a": (1.0, 1.0), "b": (1.0, 1.0)}) == ("a",)


def test_samples_for_a_target_leave_the_bias_alone():
    assert times_the_samples(1.0, 0.0, 0.25, 1.0) == 4.0
    assert times_the_samples(1.0, 0.2, 0.25, 1.0) == pytest.approx(20.0)
    assert times_the_samples(1.0, 0.3, 0.25, 1.0) == np.inf
    assert times_the_samples(1.0, -0.1, 0.25, 2.0) == 2.0, "a bias below 0 is noise of its estimate"


def test_the_truth_knows_its_own_error(job):
    variants = Variants(job, SMALL)
    coarse, fine = (rendered_truth(variants, spp, threads=1) for spp in (64, 2048))
    assert coarse.own > 4 * fine.own
    against = fine.errors(coarse.picture).region.relmse
    assert against == pytest.approx(coarse.own, rel=0.5)
    difference = fine.difference(coarse.picture)
    assert float(np.sum(difference.astype(np.float64) ** 2)) == pytest.approx(against, rel=1e-5)


def test_a_stored_truth_is_brought_to_the_output(job, tmp_path):
    whole = rendered_truth(Variants(job), 128, threads=1)
    write_picture(tmp_path / "truth.exr", whole.picture.astype(np.float32))
    write_picture(tmp_path / "deviation.exr", np.full(whole.picture.shape, 1e-3, np.float32))
    small = Variants(job, SMALL)
    truth = stored_truth(small, tmp_path / "truth.exr", tmp_path / "deviation.exr")
    assert truth.independent and truth.changed.shape == (24, 32) and 0 < truth.own < 1e-4
    own = rendered_truth(small, 128, threads=1)
    assert own.errors(truth.picture).region.relmse < 0.03
    unknown = stored_truth(small, tmp_path / "truth.exr")
    assert unknown.own is None
    write_picture(tmp_path / "odd.exr", np.ones((10, 30, 3), np.float32))
    with pytest.raises(InputError, match="the frame 32x24"):
        stored_truth(small, tmp_path / "odd.exr")


def test_points_have_the_laws_of_their_axes(found):
    told = found[0].sweep
    points = {p.name: p for p in told.points}
    own = told.own
    assert own.time.value == own.error.value == 1.0 and own.samples == 8
    assert own.noise.value > points["spp 16"].noise.value > 4 * points["spp 64"].noise.value
    rays = {n: sum(c for k, c in p.counters.items() if k.endswith("rays")) for n, p in points.items()}
    assert rays["spp 64"] == pytest.approx(8 * rays[own.name], rel=0.02)
    assert all(p.repeats_bits for p in told.points)
    assert [s.against for s in told.slopes] == ["samples", "work (rays)", "seconds"]
    assert -2.5 < told.slopes[0].slope.value < -0.8
    assert points["spp 64"].front and told.knee in ("", *points)
    axes = {a.name: a for a in told.axes}
    assert "1" in axes["depth"].left_out and all(a.repeats == 4 for a in told.axes)
    assert axes["spp"].again.low <= axes["spp"].again.value <= axes["spp"].again.high


def test_four_turns_are_too_few_to_claim_anything(found):
    told = found[0].sweep
    assert {c.outcome for c in told.claims} == {"undecided"}
    pairs = {(c.axis, c.kind) for c in told.claims}
    assert ("spp", "time") in pairs and ("spp", "error") in pairs
    assert sum(c.axis == "spp" and c.kind == "time" for c in told.claims) == 3, "all pairs of an axis"


def test_every_part_of_the_frame_has_all_scores(found):
    for point in found[0].sweep.points:
        kinds = {(s.metric, s.scope) for s in point.scores}
        wanted = {"relmse", "relmse_trimmed", "rmse", "psnr", "ssim", "flip_hdr"}
        assert {(m, s) for m in wanted for s in ("frame", "region", "tile")} <= kinds
        by = {(s.metric, s.scope): s.value for s in point.scores}
        assert by["relmse", "region"].value == pytest.approx(point.relmse.value)
        assert by["relmse", "tile"].value >= by["relmse", "region"].value


def test_targets_and_crops(found):
    report, images = found
    told = report.sweep
    assert told.target == told.own.relmse.value
    by = {t.point: t for t in told.targets}
    assert by[told.own.name].samples == pytest.approx(8, abs=2)
    assert "spp 64" not in by, "other samples are what a target is reached with"
    assert set(images) >= {"truth", *(p.name for p in told.points)}
    assert len({images[p.name].shape for p in told.points}) == 1, "all on the truth's pixels"


@pytest.mark.slow
def test_a_grid_is_all_combinations_and_missing_light_is_bias(job):
    request = SweepRequest(
        settings=SMALL,
        axes=("method.max_depth=2",),
        grid=("method.strategy=bsdf", "method.spp=16"),
        repeats=9,
    )
    told = sweep(job, request)[0].sweep
    # One bounce alone: what is missing does not go with samples.
    one = told.point("depth 2")
    assert one.bias.low > 0 and one.bias.value > 2 * told.own.bias.value
    # Each of a grid is compared with the job's own.
    assert sum(c.axis == "grid" and c.kind == "time" for c in told.claims) == 3
    grid = told.grid
    assert (grid.rows, grid.columns) == (("mis", "bsdf"), ("8", "16"))
    assert grid.points[0][0] == told.own.name and all(name for row in grid.points for name in row)
    both = told.point(grid.points[1][1])
    assert both.values == {"strategy": "bsdf", "spp": "16"} and both.samples == 16


@pytest.mark.slow
def test_two_sweeps_agree_and_rank_what_is_far_apart(job):
    """With as many turns as the family asks for: four samples for one are ranked, and never the other way."""
    request = SweepRequest(
        settings=("output.scale=0.5", "method.spp=32"), axes=("method.spp=8,128",), reference_spp=8192
    )
    claims = []
    for _ in range(2):
        told = sweep(job, request)[0].sweep
        claims.append({(c.kind, c.first, c.second): c for c in told.claims})
    for key, one in claims[0].items():
        assert {one.outcome, claims[1][key].outcome} != {"less", "more"}
    errors = [c.outcome for found in claims for (kind, *_), c in found.items() if kind == "error"]
    assert errors.count("undecided") == 0
    assert claims[0]["error", "spp 8", "spp 128"].outcome == "more"
    assert claims[0]["time", "spp 8", "spp 128"].outcome == "less"


def test_without_a_known_error_of_the_truth_nothing_is_claimed_on_errors(job, tmp_path):
    write_picture(
        tmp_path / "truth.exr", rendered_truth(Variants(job), 64, threads=1).picture.astype(np.float32)
    )
    request = SweepRequest(settings=SMALL, axes=("method.spp=16",), truth=tmp_path / "truth.exr", repeats=3)
    told = sweep(job, request)[0].sweep
    assert told.truth.own is None and {c.kind for c in told.claims} == {"time"}


@pytest.mark.slow
def test_estimators_are_rendered_to_a_target(job):
    request = SweepRequest(settings=SMALL, axes=("method.name=two-pass",), repeats=3, target=0.01)
    told = sweep(job, request)[0].sweep
    by = {t.point: t for t in told.targets}
    assert not any(t.foreseen for t in by.values())
    ours, two = by[told.own.name], by["estimator two-pass"]
    assert two.samples > ours.samples and two.seconds.repetitions == 5
    assert 0.3 < ours.relmse / 0.01 < 2.0


def test_command_writes_what_the_sweep_found(job, tmp_path):
    files = {kind: tmp_path / f"found.{kind}" for kind in ("json", "csv", "junit")}
    arguments = [
        "sweep",
        str(job),
        "--set",
        SMALL[0],
        "--axis",
        "method.spp=4,16",
        "--repeats",
        "3",
        "--reference-spp",
        "64",
    ]
    for kind, path in files.items():
        arguments += [f"--{kind}", str(path)]
    result = CliRunner().invoke(main, arguments)
    assert result.exit_code in (0, 1), result.output
    assert all(word in result.output for word in ("method.spp", "Noise of this machine", "x 1", "ranked"))
    report = load_report(files["json"])
    assert report.kind == "sweep" and len(price_list(report.sweep)[0].rows) == 2
    rows = list(csv.DictReader(files["csv"].open()))
    assert [r["value"] for r in rows] == ["", "4", "16"] and float(rows[1]["relmse"]) > 0
    assert "same bits" in files["junit"].read_text()
    assert json.loads(files["json"].read_text())["sweep"]["points"][1]["time"]["unit"] == "x"


def test_wrong_requests_are_told(job):
    with pytest.raises(JobError, match="two axes"):
        sweep(job, SweepRequest(grid=("spp",)))
    with pytest.raises(JobError, match="nothing to measure"):
        sweep(job, SweepRequest(settings=SMALL, axes=("method.spp=8",), reference_spp=16))
    assert mrbatch.sweep is sweep
