"""Whole jobs with a filter: what it changes in the files and what it must not, and what they say of it."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from small_job import write_job

from mrbatch.batch.job_run import render_job
from mrbatch.errors import JobError, ResourceError
from mrbatch.film.exr import read_frame
from mrbatch.job import load_job

LAYERS = "output.layers=[virtual, delta, background, variance, shadow, indirect]"


def render(path: Path, out: str, *overrides: str, **options):
    """The frame's channels, metadata and bytes, and the outcome."""
    job = load_job(path, [f"output.directory={out}", LAYERS, "output.dtype=float", *overrides])
    outcome = render_job(job, report=False, **options)
    assert outcome.exit_code == 0, outcome.result.error
    (frame,) = (path.parent / out).glob("*.0000.exr")
    read = read_frame(frame)
    return read.views[""].channels, read.metadata, frame.read_bytes(), outcome


@pytest.fixture(scope="module")
def shot(tmp_path_factory) -> Path:
    return write_job(tmp_path_factory.mktemp("filter"), (0,), spp=8)


@pytest.fixture(scope="module")
def plain(shot):
    return render(shot, "plain")


def passes(node) -> set[str]:
    return {node["name"]} | {name for child in node["children"] for name in passes(child)}


KINDS = ["bilateral", "variance", "oidn"]


def installed(kind: str) -> str:
    """The override that asks for a kind; skips the test where OIDN is not installed."""
    if kind == "oidn":
        pytest.importorskip("pyoidn")
    return f"output.filter.kind={kind}"


@pytest.mark.parametrize("kind", KINDS)
def test_a_filter_changes_light_alone_and_the_file_says_so(shot, plain, kind):
    before, said_before, _, _ = plain
    after, said, _, _ = render(shot, kind, installed(kind))
    assert "filter" not in said_before and said["filter"]["kind"] == kind
    # Whatever is not light stays, and so does what is said of the samples' noise.
    for name in ("virtual.A", "background.R", "variance.G"):
        assert np.array_equal(before[name], after[name])
    assert said["error_estimate"] == said_before["error_estimate"]
    for name in ("virtual.R", "delta.G", "R"):
        assert not np.array_equal(before[name], after[name])
        assert after[name].mean() == pytest.approx(before[name].mean(), rel=0.02)
    untouched = (before["virtual.A"] == 0) & np.all([before[f"delta.{c}"] == 0 for c in "RGB"], axis=0)
    assert untouched.mean() > 0.1
    for c in "RGB":
        assert np.array_equal(after[c][untouched], after[f"background.{c}"][untouched])
        assert not after[f"virtual.{c}"][after["virtual.A"] == 0].any()
        made = (
            after[f"virtual.{c}"] + (1 - after["virtual.A"]) * after[f"background.{c}"] + after[f"delta.{c}"]
        )
        np.testing.assert_allclose(np.maximum(made, 0), after[c], atol=1e-5)


@pytest.mark.parametrize("kind", KINDS)
def test_neither_threads_nor_launches_change_a_bit(shot, kind):
    asked = installed(kind)
    one = render(shot, f"{kind}_1", asked, threads=1)[2]
    assert one == render(shot, f"{kind}_4", asked, threads=4, units_per_launch=1)[2]


def test_without_a_filter_there_is_no_pass_of_it(shot, plain):
    def ran(outcome):
        return passes(outcome.report.timing.model_dump())

    outcome = plain[3]
    names = ran(outcome)
    assert not any("guide" in name or "filter" in name for name in names)
    assert not any("filter" in note.text for note in outcome.report.notes)
    other = render(shot, "passes", "output.filter.kind=bilateral")[3]
    assert {"filter", "guides"} <= ran(other)
    assert any("went through the filter `bilateral`" in note.text for note in other.report.notes)


def test_a_radius_is_refused_where_there_is_none_to_choose(shot):
    with pytest.raises(JobError, match="`oidn` has no `radius`"):
        load_job(shot, ["output.filter.kind=oidn", "output.filter.radius=3"])
    with pytest.raises(JobError, match="radius"):
        load_job(shot, ["output.filter.kind=bilateral", "output.filter.radius=99"])


def test_a_missing_library_is_one_clear_error(shot, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyoidn", None)
    job = load_job(shot, ["output.directory=missing", "output.filter.kind=oidn"])
    with pytest.raises(ResourceError, match="needs Open Image Denoise") as raised:
        render_job(job, report=False)
    assert raised.value.hint == "pip install 'mrbatch[denoise]'"
    assert not list(shot.parent.glob("missing/*.exr"))


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_the_error_to_a_converged_picture_falls_and_the_mean_stays(tmp_path, kind):
    """32 samples against 2048, on what virtual objects change; the composite's mean is kept to 0.1 %."""
    asked = installed(kind)
    path = write_job(tmp_path, (0,), spp=32, width=128, height=96)
    truth = render(path, "truth", "method.spp=2048")[0]
    raw = render(path, "raw")[0]
    found = render(path, kind, asked)[0]

    def picture(channels):
        return np.stack([channels[c] for c in "RGB"], axis=-1).astype(np.float64)

    changed = (truth["virtual.A"] > 0) | (truth["delta.G"] != 0)
    before, after = (np.sqrt(np.mean((picture(c) - picture(truth))[changed] ** 2)) for c in (raw, found))
    assert after < 0.6 * before
    assert picture(found)[changed].mean() == pytest.approx(picture(raw)[changed].mean(), rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_reflectance_from_the_photo_is_divided_out_and_laid_over_again(tmp_path, kind):
    """The photo is noise, and with it the reflectance that is read from it: the light change relative to the
    photo is smooth all the same, and stays as grainy as the photo in itself."""
    asked = installed(kind)
    table = {"name": "table", "plane": {"size": ["0.3 m", "0.3 m"]}, "reflectance": "photo"}
    path = write_job(tmp_path, (0,), spp=16, real=[table])
    raw, found = render(path, "raw")[0], render(path, kind, asked)[0]
    photo = raw["background.G"]
    whole = (raw["virtual.A"] == 0) & (raw["delta.G"] != 0) & (photo > 0.05) & (photo < 0.4)

    def grain(values):
        """Spread beside the mean of 3 x 3 neighbours, over the pixels that are whole with all of them."""
        windows = [np.roll(values, (j, i), (0, 1)) for j in (-1, 0, 1) for i in (-1, 0, 1)]
        there = np.all([np.roll(near, (j, i), (0, 1)) for j in (-1, 0, 1) for i in (-1, 0, 1)], axis=0)
        return np.std((values - np.mean(windows, axis=0))[there & whole])

    near = (raw["virtual.A"] == 0) & (raw["delta.G"] != 0)
    assert whole.sum() > 100
    relative = [grain(c["delta.G"] / np.maximum(photo, 1e-3)) for c in (raw, found)]
    assert relative[1] < 0.7 * relative[0]
    assert grain(found["delta.G"]) > 0.5 * grain(raw["delta.G"])
