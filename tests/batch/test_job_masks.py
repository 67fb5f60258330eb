"""Whole jobs: masks by name, and what passes in front of virtual objects, in every layer of the files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from small_job import CRATE, HEIGHT, WIDTH, write_job, write_picture

from mrbatch.batch.job_run import render_job
from mrbatch.film.cryptomatte import MATERIAL, OBJECT, coverage_of
from mrbatch.film.exr import read_frame
from mrbatch.job import load_job

LAYERS = "[virtual, delta, variance, depth, normal, albedo, motion, crypto_object, crypto_material]"
LEFT, SOFT = np.s_[:, : WIDTH // 2 - 8], np.s_[:, WIDTH // 2 - 8 : WIDTH // 2 + 8]
"""Columns that the hand covers wholly, and by a quarter."""


def render(path: Path, *overrides: str) -> dict[str, np.ndarray]:
    job = load_job(path, [f"output.layers={LAYERS}", "output.dtype=float", *overrides])
    outcome = render_job(job, report=False)
    assert outcome.exit_code == 0, outcome.result.error
    (frame,) = path.parent.glob("out*/*.0000.exr") if not overrides else path.parent.glob("matte/*.0000.exr")
    (view,) = read_frame(frame).views.values()
    return {**view.channels, **{k: v for k, v in view.attributes.items()}}


@pytest.fixture(scope="module")
def crates(tmp_path_factory):
    """Two crates of one material, a third of its own: without and with a hand in front."""
    wood = {**CRATE["material"], "name": "wood"}
    objects = [
        {**CRATE, "name": name, "material": look, "transform": {"translate": [f"{x} mm", 0, "50 mm"]}}
        for name, look, x in (("left", wood, -90), ("right", wood, 90), ("middle", CRATE["material"], 0))
    ]
    path = write_job(tmp_path_factory.mktemp("crates"), (0, 1), virtual=objects)
    hand = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    hand[LEFT], hand[SOFT] = 255, 64
    for number in (0, 1):
        write_picture(path.parent / f"hand_{number:04d}.png", hand)
    return render(path), render(path, "output.directory=matte", "capture.mattes=hand_####.png")


def test_masks_by_object_and_by_material(crates):
    plain, _ = crates
    by_object = {name: coverage_of(name, plain, OBJECT) for name in ("left", "middle", "right")}
    assert all(mask.max() == 1.0 for mask in by_object.values())
    np.testing.assert_allclose(
        coverage_of("wood", plain, MATERIAL), by_object["left"] + by_object["right"], atol=1e-6
    )
    # A material without a name goes by the object's.
    assert np.array_equal(coverage_of("middle", plain, MATERIAL), by_object["middle"])
    assert not coverage_of("left", plain, MATERIAL).any()
    manifests = {k: v for k, v in plain.items() if str(k).endswith("/manifest")}
    assert len(manifests) == 2 and any(
        '"wood"' in str(v) and '"left"' not in str(v) for v in manifests.values()
    )


def test_a_hand_in_front_cuts_every_layer(crates):
    plain, cut = crates
    crate = plain["virtual.A"] > 0
    assert crate[LEFT].any() and crate[SOFT].any()
    share = np.zeros((HEIGHT, WIDTH), np.float32)
    share[LEFT], share[SOFT] = 1.0, np.float32(64 / 255)
    rest = 1 - share
    weighted = ["virtual.R", "virtual.A", "delta.G", "normal.Z", "albedo.R"]
    for name in weighted:
        np.testing.assert_allclose(cut[name], plain[name] * rest, rtol=1e-5, atol=1e-7, err_msg=name)
    np.testing.assert_allclose(cut["variance.R"], plain["variance.R"] * rest**2, rtol=1e-5, atol=1e-9)
    for name, layer in (("left", OBJECT), ("middle", OBJECT), ("wood", MATERIAL)):
        np.testing.assert_allclose(
            coverage_of(name, cut, layer), coverage_of(name, plain, layer) * rest, rtol=1e-5, atol=1e-7
        )
    assert np.all(cut["depth.Z"][LEFT] == np.float32(1e10)) and not cut["motion.X"][LEFT].any()
    beside = share < 1
    assert np.array_equal(cut["depth.Z"][beside], plain["depth.Z"][beside])
    assert np.abs(plain["motion.X"][LEFT]).max() > 0.1


@pytest.mark.case("DPT-14", "TRAP-1i")
def test_what_the_hand_covers_is_the_photo(crates):
    plain, cut = crates
    without = plain["virtual.A"] == 0
    untouched = without & (plain["delta.R"] == 0) & (plain["delta.G"] == 0) & (plain["delta.B"] == 0)
    assert not untouched[LEFT].all()
    for name in "RGB":
        # Where nothing is changed both are the photo: the hand's pixels continue it.
        assert np.array_equal(cut[name][untouched], plain[name][untouched])
        assert not cut[f"virtual.{name}"][LEFT].any() and not cut[f"delta.{name}"][LEFT].any()
