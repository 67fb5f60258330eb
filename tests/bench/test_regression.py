"""The gates that hold a job's tiny renderings against its baseline."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from small_job import CRATE, write_job

import mrbatch
from mrbatch.batch.render import ShotRenderer
from mrbatch.bench.baseline import baseline_path, load_baseline
from mrbatch.bench.regression import check_jobs, failures
from mrbatch.bench.regression_gates import welch
from mrbatch.errors import EXIT_GATE, InputError, JobError
from mrbatch.report.model import load_report

ROUGH = {"type": "conductor", "reflectance": [0.9, 0.8, 0.6], "roughness": 0.4}


@pytest.fixture(scope="module")
def job(tmp_path_factory) -> Path:
    path = write_job(
        tmp_path_factory.mktemp("ci"),
        (0,),
        dtype=np.float32,
        width=48,
        height=36,
        virtual=[{**CRATE, "material": ROUGH}],
    )
    report, _ = check_jobs([path], update=True)
    assert report.exit == 0
    return path


def names(report) -> set[str]:
    return {gate.name.partition(": ")[2].split(" (")[0] for gate in report.gates if not gate.passed}


def test_the_same_job_passes_to_the_digit(job):
    report, pictures = check_jobs([job])
    assert report.exit == 0 and failures(report) == []
    work = [gate for gate in report.gates if "work" in gate.name]
    assert work and all(gate.measured.value == 1.0 and "digit" in gate.text for gate in work)
    assert len(pictures) == 1


@pytest.mark.slow
def test_other_seeds_raise_no_alarm(job):
    for seed in (1000, 2000, 3000):
        report, _ = check_jobs([job], seed=seed)
        assert failures(report) == [], seed


def spoiled(monkeypatch, change) -> None:
    """Renders as ever, then `change(channels)` spoils a frame's channels."""
    render = ShotRenderer.render

    def other(self, number, history, *, seed=None):
        rendered = render(self, number, history, seed=seed)
        for image in rendered.image.views.values():
            change(image.channels)
        return rendered

    monkeypatch.setattr(ShotRenderer, "render", other)


def test_three_per_cent_of_bias_in_a_layer_fail(job, monkeypatch):
    def bias(channels):
        for c in "RGB":
            channels[f"virtual.{c}"] = channels[f"virtual.{c}"] * 1.03

    spoiled(monkeypatch, bias)
    report, _ = check_jobs([job], seed=500)
    assert report.exit == EXIT_GATE
    assert any(name.startswith("mean: virtual") for name in names(report))
    assert not any(name.startswith("mean: delta") for name in names(report))


def test_a_single_nan_fails_and_no_baseline_is_written(job, monkeypatch):
    def hole(channels):
        channels["virtual.G"][3, 5] = np.nan

    spoiled(monkeypatch, hole)
    before = baseline_path(job, None).read_bytes()
    for update in (False, True):
        report, _ = check_jobs([job], update=update)
        assert report.exit == EXIT_GATE and "finite" in names(report)
        assert all("virtual.G" in frame.message for frame in report.frames)
    assert baseline_path(job, None).read_bytes() == before


def test_more_work_fails_for_the_same_seeds_and_for_others(job, monkeypatch):
    render = ShotRenderer.render

    def busy(self, number, history, *, seed=None):
        rendered = render(self, number, history, seed=seed)
        rendered.counters["scatter rays"] = round(1.3 * rendered.counters["scatter rays"])
        return rendered

    monkeypatch.setattr(ShotRenderer, "render", busy)
    for seed in (None, 99):
        report, _ = check_jobs([job], seed=seed)
        assert names(report) == {"work: scatter rays"}


def test_a_lost_effect_fails(job):
    path = baseline_path(job, None)
    stored = json.loads(path.read_text())
    stored["effects"]["glossy"] = "absent"
    other = job.parent / "store"
    other.mkdir(exist_ok=True)
    (other / path.name).write_text(json.dumps(stored))
    report, _ = check_jobs([job], store=other)
    assert names(report) == {"effects"}
    assert "glossy was absent, is needed" in failures(report)[0]


@pytest.mark.slow
def test_an_update_tells_what_has_changed(job, monkeypatch, tmp_path):
    check_jobs([job], store=tmp_path, update=True)

    def bias(channels):
        for c in "RGB":
            channels[f"delta.{c}"] = channels[f"delta.{c}"] * 1.5

    spoiled(monkeypatch, bias)
    report, _ = check_jobs([job], store=tmp_path, update=True)
    assert report.exit == 0
    told = [note.text for note in report.notes]
    assert any("changed: the mean of delta" in text for text in told)
    assert any("written anew" in text for text in told)
    # From now on that is what it has to be.
    report, _ = check_jobs([job], store=tmp_path)
    assert report.exit == 0


def test_a_changed_job_is_no_regression(job):
    with pytest.raises(JobError, match="settings or its inputs have changed"):
        check_jobs([job], settings=["method.max_depth=2"])


def test_without_a_baseline_the_way_is_told(job, tmp_path):
    with pytest.raises(JobError, match="no baseline") as caught:
        check_jobs([job], store=tmp_path)
    assert "--update" in caught.value.hint


@pytest.mark.parametrize("text", ["", "{", "[]", '{"version": 2}', '{"version": 1}'])
def test_a_damaged_baseline_is_told(tmp_path, text):
    (tmp_path / "job.ci.json").write_text(text)
    with pytest.raises(InputError, match="baseline"):
        load_baseline(tmp_path / "job.ci.json")


def test_the_command_writes_all_kinds_of_reports(job, tmp_path):
    options = []
    for kind in ("json", "junit", "html", "markdown"):
        options += [f"--{kind}", str(tmp_path / f"report.{kind}")]
    found = CliRunner().invoke(mrbatch_command(), [str(job), *options])
    assert found.exit_code == 0, found.output
    assert "gates passed" in found.output
    report = load_report(tmp_path / "report.json")
    assert report.kind == "ci" and report.passed
    assert "<testsuites" in (tmp_path / "report.junit").read_text()
    assert "data:image" in (tmp_path / "report.html").read_text()


def mrbatch_command():
    from mrbatch.cli.ci import command

    return command


def test_welch_is_right_where_nothing_changed_and_sees_what_did():
    random = np.random.default_rng(5)
    p = welch(random.normal(1.0, 0.1, (16, 20_000)), random.normal(1.0, 0.1, (16, 20_000)))[1]
    assert np.mean(p < 0.01) == pytest.approx(0.01, abs=0.003)
    shifted = welch(random.normal(1.0, 0.1, (16, 1000)), random.normal(1.5, 0.1, (16, 1000)))[1]
    assert (shifted < 1e-4).all()
    assert welch(np.ones((16, 1)), np.ones((16, 1)))[1] == 1.0
    assert welch(np.ones((16, 1)), np.full((16, 1), 1.01))[1] == 0.0


# --- defects planted in a copy of the program ------------------------------------------------------------


def scratch(folder: Path, file: str, old: str, new: str) -> Path:
    """A copy of the program with a defect; gives the folder to import it from."""
    shutil.copytree(
        Path(mrbatch.__file__).parent, folder / "mrbatch", ignore=shutil.ignore_patterns("__pycache__")
    )
    path = folder / "mrbatch" / file
    text = path.read_text()
    assert text.count(old) == 1, (file, old)
    path.write_text(text.replace(old, new))
    return folder


def run_copy(folder: Path, job: Path, *options: str) -> subprocess.CompletedProcess[str]:
    import os

    command = [sys.executable, "-m", "mrbatch", "ci", str(job), "--threads", "1", *options]
    return subprocess.run(
        command, capture_output=True, text=True, cwd=folder, env={**os.environ, "PYTHONPATH": str(folder)}
    )


@pytest.mark.slow
def test_planted_defects_are_found_by_the_command(job, tmp_path):
    clean = run_copy(Path(mrbatch.__file__).parent.parent, job)
    assert clean.returncode == 0, clean.stdout + clean.stderr
    planted = {
        "work": ("effects/influence.py", "MARGIN = 3.0", "MARGIN = 30.0", "work:"),
        "nan": (
            "film/accumulator.py",
            "        mean = sums.sum(axis=0) / divisor\n",
            "        mean = sums.sum(axis=0) / divisor\n        mean[7, 0] = np.nan\n",
            "not finite",
        ),
        "lost effect": ("effects/surface_rules.py", "    if not glossy:", "    if glossy:", "effects"),
    }
    for name, (file, old, new, word) in planted.items():
        found = run_copy(scratch(tmp_path / name.replace(" ", "_"), file, old, new), job)
        assert found.returncode == EXIT_GATE, (name, found.stdout, found.stderr)
        assert word in found.stdout, (name, found.stdout)


@pytest.mark.slow
def test_a_bias_of_three_per_cent_is_found_on_nineteen_of_twenty_seeds(job, tmp_path):
    old = "params.gain = wp.vec3(*(float(g) for g in given.gain))"
    new = old.replace("float(g)", "1.03 * float(g)")
    folder = scratch(tmp_path, "film/binding.py", old, new)
    found = [run_copy(folder, job, "--seed", str(10_000 * (1 + n))).returncode for n in range(20)]
    assert set(found) <= {0, EXIT_GATE}
    assert sum(code == EXIT_GATE for code in found) >= 19


@pytest.mark.slow
def test_ten_clean_reruns_raise_no_alarm(job):
    for n in range(10):
        report, _ = check_jobs([job], seed=20_000 * (1 + n))
        assert failures(report) == [], n
