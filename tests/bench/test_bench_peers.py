"""What another renderer is given of a job, and what is made of its pictures."""

from __future__ import annotations

import json

import numpy as np
import pytest
from click.testing import CliRunner
from small_job import CRATE, write_job

from mrbatch.batch.prepare import prepare
from mrbatch.bench.__main__ import main
from mrbatch.bench.peers.comparison import caught
from mrbatch.bench.peers.export import export
from mrbatch.device.timing import TimingNode
from mrbatch.errors import InputError
from mrbatch.job import load_job


def prepared(path, *settings):
    return prepare(load_job(path, list(settings)), TimingNode("test"))


def test_export_holds_scene_cameras_and_photos(tmp_path):
    ready = prepared(write_job(tmp_path / "job", (0, 1), dtype=np.float32))
    export(ready, (0, 1), tmp_path / "scene")
    told = json.loads((tmp_path / "scene" / "scene.json").read_text())
    assert [o["name"] for o in told["objects"]] == [o.name for o in ready.scene.objects]
    crate = next(n for n, o in enumerate(told["objects"]) if o["virtual"])
    arrays = np.load(tmp_path / "scene" / f"object{crate}.npz")
    size = np.ptp(arrays["vertices"], axis=0)
    np.testing.assert_allclose(size, (0.08, 0.06, 0.1), rtol=1e-6)
    for number, frame in zip((0, 1), told["frames"]):
        given = ready.capture.frame(number, ready.shot.table).views[""]
        np.testing.assert_allclose(frame["world_from_camera"], given.camera.world_from_camera)
        np.testing.assert_array_equal(
            np.load(tmp_path / "scene" / f"photo_{number:04d}.npy"), given.background
        )


def test_what_others_mean_otherwise_is_refused(tmp_path):
    glass = {**CRATE, "material": {"type": "dielectric", "ior": 1.5}}
    ready = prepared(write_job(tmp_path / "job", (0,), dtype=np.float32, virtual=[glass]))
    with pytest.raises(InputError, match="`crate` is dielectric"):
        export(ready, (0,), tmp_path / "scene")


def test_a_catcher_pass_multiplies_the_photo_under_what_is_virtual():
    channels = [f"Layer.Combined.{c}" for c in "RGBA"] + [f"Layer.Shadow Catcher.{c}" for c in "RGB"]
    # A pixel in half shadow, and one that a virtual thing of radiance 0.4 covers to a quarter.
    pixels = np.array([[[0, 0, 0, 0, 0.5, 0.5, 0.5], [0.1, 0.1, 0.1, 0.25, 1, 1, 1]]], np.float32)
    photo = np.full((1, 2, 3), 0.8, np.float32)
    found = caught(pixels, channels, photo, np.full(3, 2.0))
    np.testing.assert_allclose(found[0, :, 0], (0.4, 2 * 0.1 + 0.75 * 0.8), rtol=1e-6)


@pytest.mark.slow
def test_a_peer_that_fails_is_told(tmp_path):
    job = write_job(tmp_path / "job", (0,), dtype=np.float32)
    given = ["peers", str(job), "--peer", "blender", "--python", "/no/such/python"]
    found = CliRunner().invoke(main, [*given, "--set", "output.scale=0.25", "--spp", "2", "2"])
    assert found.exit_code == 1
    assert "no/such/python" in found.output
