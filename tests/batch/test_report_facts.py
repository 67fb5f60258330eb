"""What a rendered job's report says of the shot and of the noise in each frame."""

from __future__ import annotations

import numpy as np
import pytest
from small_job import HEIGHT, WIDTH, write_job

from mrbatch.batch.job_run import PAGE, render_job
from mrbatch.film.exr import read_frame
from mrbatch.job import load_job
from mrbatch.metrics.noise import NoiseMap, unpack_codes
from mrbatch.report.model import load_report


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = write_job(tmp_path_factory.mktemp("job"), (0, 1, 2))
    layers = 'output.layers=["virtual","background","delta"]'
    render_job(load_job(path, [layers, "method.spp=8", "output.preview.video=true"]))
    return path.parent / "out"


def test_facts_of_the_shot(folder):
    facts = {fact.name: fact.text for fact in load_report(folder).facts}
    assert facts["picture"] == f"{WIDTH} x {HEIGHT} pixels"
    assert facts["samples a pixel"] == "8"
    assert facts["camera track"] == "3 of 3 frames have a camera, from the poses given"
    assert facts["light"] == "sky.exr" and facts["footage"].startswith(f"{WIDTH} x {HEIGHT}, 8-bit srgb")
    assert {"lens", "gain", "colour in files", "ray engine"} <= set(facts)


def test_the_noise_is_how_far_runs_with_other_random_numbers_differ(folder, tmp_path):
    """Half the mean squared difference of two runs is the variance of one, whatever the sampler."""
    path = write_job(tmp_path, (0, 1, 2))
    layers = 'output.layers=["virtual","background","delta"]'
    render_job(load_job(path, [layers, "method.spp=8", "seed=77"]), report=False)
    for frame in load_report(folder).frames:
        name = frame.files[0].path
        views = [next(iter(read_frame(f / name).views.values())) for f in (folder, tmp_path / "out")]
        channels = [{n: np.asarray(c, np.float64) for n, c in view.channels.items()} for view in views]
        a, b = (np.stack([c[n] for n in "RGB"], axis=-1) for c in channels)
        changed = np.zeros((HEIGHT, WIDTH), bool)
        for c in channels:
            changed |= (c["virtual.A"] > 0) | (np.stack([c[f"delta.{n}"] for n in "RGB"]) != 0).any(axis=0)
        square = ((a + b) / 2)[changed] ** 2
        variance = ((a - b)[changed] ** 2 / 2 / (square + 0.01 * square.mean())).mean()
        assert frame.error.low < variance < frame.error.high
        assert frame.error.low < frame.error.value < frame.error.high and frame.error.repetitions == 8
        assert frame.samples == 8


def test_every_frame_has_its_map_of_noise(folder):
    report = load_report(folder)
    maps = {p.frame: p.noise for p in report.pictures if p.role == "error"}
    assert set(maps) == {0, 1, 2}
    for blocks in maps.values():
        codes = unpack_codes(blocks.columns, blocks.rows, blocks.codes)
        assert codes.shape == (-(-HEIGHT // blocks.block), -(-WIDTH // blocks.block))
        amplitudes = NoiseMap.amplitudes(codes)
        assert np.isfinite(amplitudes).any() and np.isnan(amplitudes).any()


def test_the_page_shows_and_links_them(folder):
    page = (folder / PAGE).read_text(encoding="utf-8")
    assert page.count("<img") >= 3 * 4  # composite, photo, light change, noise
    for name in ("./preview.mp4", "./small.0000.exr", "./small.0002.exr"):
        assert f'href="{name}"' in page
    assert "Noise against seconds a frame" in page and '<div class="ramp magma">' in page
    assert '<div class="ramp signed">' in page
