"""What another renderer is given of a job, and what is made of its pictures."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest
from click.testing import CliRunner
from small_job import CRATE, write_job

from mrbatch.batch.prepare import prepare
from mrbatch.bench.__main__ import main
from mrbatch.bench.peers import mitsuba_difference
from mrbatch.bench.peers.comparison import caught
from mrbatch.bench.peers.export import export
from mrbatch.bench.peers.mitsuba_difference import light_of_map, matt, rgb, sensor, texture
from mrbatch.device.timing import TimingNode
from mrbatch.errors import InputError, MrbatchError
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


def test_a_missing_pass_is_told():
    channels = [f"Layer.Combined.{c}" for c in "RGBA"]
    with pytest.raises(MrbatchError, match="no pass `Shadow Catcher`"):
        caught(np.zeros((1, 1, 4), np.float32), channels, np.zeros((1, 1, 3), np.float32), np.ones(3))


@pytest.mark.slow
def test_a_peer_that_fails_is_told(tmp_path):
    job = write_job(tmp_path / "job", (0,), dtype=np.float32)
    given = ["peers", str(job), "--peer", "blender", "--python", "/no/such/python"]
    found = CliRunner().invoke(main, [*given, "--set", "output.scale=0.25", "--spp", "2", "2"])
    assert found.exit_code == 1
    assert "no/such/python" in found.output


@pytest.mark.slow
def test_mitsuba_shows_no_photo_where_something_virtual_is(mi, tmp_path):
    """The photo is noise, so where any of it is left the picture is rough."""
    ready = prepared(write_job(tmp_path / "job", (0,), dtype=np.float32))
    ((photo, _),) = export(ready, (0,), tmp_path / "scene")
    command = [sys.executable, mitsuba_difference.__file__, str(tmp_path / "scene"), str(tmp_path / "out")]
    subprocess.run([*command, "--spp", "256", "--variant", "scalar_rgb"], check=True)
    picture = np.array(mi.Bitmap(str(tmp_path / "out" / "0000.exr")))
    camera = ready.capture.frame(0, ready.shot.table).views[""].camera
    seen = camera.matrix @ (camera.camera_from_world[:3] @ (0.0, 0.0, 0.05, 1.0))
    x, y = (seen[:2] / seen[2]).astype(int)
    patch = np.s_[y - 1 : y + 2, x - 1 : x + 2]
    assert np.all(picture[patch].std(axis=(0, 1)) < 0.2 * photo[patch].std(axis=(0, 1)))


SIZE = (64, 48)
MATRIX = np.array([[80.0, 0.0, 26.5], [0.0, 80.0, 30.25], [0.0, 0.0, 1.0]])


def seen_by_mitsuba(mi, world_from_camera: np.ndarray, **parts) -> np.ndarray:
    """(h, w, 3) of a scene of its own parts."""
    scene = {"type": "scene", "integrator": {"type": "path"}, **parts}
    scene["sensor"] = sensor(SIZE, MATRIX, world_from_camera, mi)
    return np.array(mi.render(mi.load_dict(scene), spp=64, seed=0))


def middle(picture: np.ndarray) -> np.ndarray:
    """x, y of the centre of the light in a picture, pixel centres at half integers."""
    y, x = np.indices(picture.shape[:2]) + 0.5
    weight = picture.sum(axis=2)
    return np.array([(weight * x).sum(), (weight * y).sum()]) / weight.sum()


@pytest.mark.slow
def test_mitsuba_sees_a_point_where_the_camera_matrix_says(mi):
    place = np.array([0.1, -0.15, 1.0])
    lamp = {"type": "sphere", "center": list(place), "radius": 0.02}
    lamp["emitter"] = {"type": "area", "radiance": {"type": "rgb", "value": [1, 1, 1]}}
    found = middle(seen_by_mitsuba(mi, np.eye(4), lamp=lamp))
    np.testing.assert_allclose(found, (MATRIX @ place)[:2], atol=0.05)


@pytest.mark.slow
def test_mitsuba_sees_a_light_of_the_map_where_the_world_has_it(mi):
    """A camera that looks along y, z up; a texel by the house's rule, the map turned by 0.3 about z."""
    radiance = np.zeros((65, 128, 3), np.float32)
    row, column = 30, 39
    radiance[row, column] = 1.0
    polar, azimuth = np.pi * row / 64, np.pi * (1 - 2 * (column + 0.5) / 128) + 0.3
    turned = np.array([[np.cos(0.3), -np.sin(0.3), 0], [np.sin(0.3), np.cos(0.3), 0], [0, 0, 1]])
    toward = (np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar))
    pose = np.eye(4)
    pose[:3, :3] = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]).T
    seen = MATRIX @ (pose[:3, :3].T @ toward)
    found = middle(seen_by_mitsuba(mi, pose, light=light_of_map(radiance, turned, mi)))
    np.testing.assert_allclose(found, seen[:2] / seen[2], atol=0.1)


@pytest.mark.slow
def test_mitsuba_lays_a_texture_the_right_way_up(mi):
    """Seen from above with y up in the picture, a textured square looks like its picture."""
    pixels = np.zeros((8, 8, 3), np.float32)
    pixels[1, 5] = 1.0
    square = {"type": "rectangle", "bsdf": matt(texture(pixels, mi))}
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[2, 3] = 4.0
    light = light_of_map(np.ones((4, 8, 3), np.float32), np.eye(3), mi)
    black = {**square, "bsdf": matt(rgb((0, 0, 0)))}
    # What is left is the texel: the map around the square is the same in both.
    lit = [seen_by_mitsuba(mi, pose, square=one, light=light) for one in (square, black)]
    # The middle of texel (5, 1) on a square from -1 to 1, 4 m away.
    at = MATRIX @ (2 * 5.5 / 8 - 1, 2 * 1.5 / 8 - 1, 4.0)
    np.testing.assert_allclose(middle(lit[0] - lit[1]), at[:2] / at[2], atol=0.1)
