"""Resolved jobs read back to the same bits; the pixels' part knows what pixels depend on."""

from __future__ import annotations

import io
import json
from pathlib import Path

import pytest
from ruamel.yaml import YAML

from mrbatch.job import parse_job, pixel_relevant, resolved

pytestmark = pytest.mark.usefixtures("toys")


def test_resolved_is_a_job_and_reads_back(sample, tmp_path):
    job = parse_job(
        sample, tmp_path / "desk.yaml", ["virtual.bunny.transform.rotate=[0.1 turn, 33.3 deg, 0]"]
    )
    data = resolved(job)
    assert json.loads(json.dumps(data)) == data
    assert data["capture"]["video"] == "desk.mp4" and str(tmp_path) not in json.dumps(data)
    out = io.StringIO()
    YAML(typ="safe", pure=True).dump(data, out)
    again = parse_job(out.getvalue(), tmp_path / "desk.yaml")
    assert resolved(again) == data
    assert again.virtual == job.virtual and again.real == job.real and again.capture == job.capture


def test_same_job_elsewhere_is_the_same(sample, tmp_path):
    here = pixel_relevant(parse_job(sample, tmp_path / "desk.yaml"))
    assert here == pixel_relevant(parse_job(sample, tmp_path / "moved" / "desk.yaml"))


def test_paths_outside_stay_absolute_but_are_no_part_of_the_pixels(sample, tmp_path):
    """A stored job must find its files; a picture does not depend on where they lie."""
    pixels = []
    for outside in (Path(tmp_path.anchor) / "far" / "b.ply", tmp_path.parent / "near" / "by" / "b.ply"):
        job = parse_job(sample, tmp_path / "desk.yaml", [f"virtual.bunny.mesh={outside.as_posix()}"])
        assert resolved(job)["virtual"][0]["mesh"] == outside.as_posix()
        pixels.append(pixel_relevant(job))
    assert pixels[0] == pixels[1] and pixels[0]["virtual"][0]["mesh"] == "b.ply"


@pytest.mark.parametrize(
    ("override", "changes"),
    [
        ("name=other", False),
        ("output.directory=other", False),
        ("output.pattern='{frame}.exr'", False),
        ("output.preview.video=false", False),
        ("output.owner=me", False),
        ("frames=3", False),
        ("engine=warp", False),
        ("on_error=skip", False),
        ("on_error=hold-last", True),
        ("seed=1", True),
        ("method.spp=65", True),
        ("capture.marker.side=61 mm", True),
        ("virtual.bunny.material.roughness=0.16", True),
        ("virtual.ball.holdout=true", True),
        ("environment.scale=2", True),
        ("effects.glow=auto", True),
        ("output.layers=[virtual]", True),
        ("output.dtype=half", True),
        ("output.crop=[0, 0, 8, 8]", True),
        ("output.scale=1/2", True),
        ("output.overscan=2", True),
        ("participants.0.density=0.2", True),
    ],
)
def test_what_pixels_depend_on(sample, tmp_path, override, changes):
    text = sample.replace("glow: off", "glow: on")
    before = pixel_relevant(parse_job(text, tmp_path / "desk.yaml"))
    after = pixel_relevant(parse_job(text, tmp_path / "desk.yaml", [override]))
    assert (before != after) is changes


def test_order_of_effects_does_not_matter(sample, tmp_path):
    other = sample.replace("{shadow: on, glow: off}", "{glow: off, shadow: on}")
    first, second = (pixel_relevant(parse_job(text, tmp_path / "d.yaml")) for text in (sample, other))
    assert json.dumps(first) == json.dumps(second)
