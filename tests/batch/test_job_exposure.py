"""Lens and shutter of whole jobs: the moments of an exposure, what layers mean, what is refused."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp
from small_job import CRATE, pose, write_job

from mrbatch.batch.exposure import UNMOVED, shutter_times
from mrbatch.batch.job_run import render_job
from mrbatch.batch.prepare import Prepared, prepare
from mrbatch.device.timing import TimingNode
from mrbatch.errors import JobErrors, MrbatchError
from mrbatch.film.exr import read_frame
from mrbatch.job import load_job
from mrbatch.scene.camera_settings import ShutterSettings

HALF = {"open": -0.25, "close": 0.25, "samples": 4}
KEYS = [
    {"frame": 0, "translate": ["-80 mm", "0 m", "50 mm"]},
    {"frame": 3, "translate": ["80 mm", "0 m", "50 mm"]},
]
MOVING = {k: v for k, v in CRATE.items() if k != "transform"} | {"animation": KEYS}
PARTS = ("R", "G", "B", "virtual.R", "virtual.A", "delta.R")


def prepared(folder: Path, frames=(0, 1, 2, 3), **parts) -> Prepared:
    path = write_job(folder, frames, **parts)
    return prepare(load_job(path), TimingNode("job"))


def render(path: Path, *overrides: str, out: str = "out", **options) -> Path:
    layers = "output.layers=[virtual,delta,depth,motion,crypto_object,normal]"
    job = load_job(path, [f"output.directory={out}", layers, *overrides])
    outcome = render_job(job, report=False, **options)
    assert outcome.result.error is None and outcome.exit_code == 0, outcome.result.error
    return path.parent / out


def channels(folder: Path, number: int) -> dict[str, np.ndarray]:
    (path,) = folder.glob(f"*.{number:04d}.exr")
    return dict(next(iter(read_frame(path).views.values())).channels)


def same(a: dict, b: dict, *names: str) -> bool:
    return all(np.array_equal(a[name], b[name]) for name in names)


def between(a: np.ndarray, b: np.ndarray, share: float) -> np.ndarray:
    found = np.eye(4)
    turns = Rotation.from_matrix(np.stack([a[:3, :3], b[:3, :3]]))
    found[:3, :3] = Slerp([0.0, 1.0], turns)(share).as_matrix()
    found[:3, 3] = (1 - share) * a[:3, 3] + share * b[:3, 3]
    return found


def test_moments_are_the_middles_of_equal_parts():
    half = ShutterSettings.model_validate({"open": -0.25, "close": 0.25, "samples": 2})
    assert shutter_times(half, None) == pytest.approx((-0.125, 0.125))
    timed = ShutterSettings.model_validate({"exposure": "20 ms", "samples": 4})
    assert shutter_times(timed, 25) == pytest.approx((-0.1875, -0.0625, 0.0625, 0.1875))
    assert shutter_times(ShutterSettings.model_validate({"exposure": 0}), 25) == ()
    with pytest.raises(MrbatchError, match="no frame rate"):
        shutter_times(timed, None)
    with pytest.raises(MrbatchError, match="lasts 3 frames"):
        shutter_times(ShutterSettings.model_validate({"exposure": "120 ms"}), 25)


def test_cameras_go_from_neighbour_to_neighbour(tmp_path):
    exposure = prepared(tmp_path / "a", shutter=HALF, spp=8).exposure

    def poses(number):
        moments = exposure.frame(number).moments
        return [m.time for m in moments], [m.cameras[""].world_from_camera for m in moments]

    times, found = poses(1)
    assert times == pytest.approx([0.8125, 0.9375, 1.0625, 1.1875])
    expected = [between(pose(1), pose(0), 0.1875), between(pose(1), pose(0), 0.0625)]
    expected += [between(pose(1), pose(2), 0.0625), between(pose(1), pose(2), 0.1875)]
    np.testing.assert_allclose(found, expected, atol=1e-9)
    # The first frame goes backwards as it goes on, the last one on as it came.
    turn = pose(0)[:3, :3].T @ pose(1)[:3, :3]
    back = Rotation.from_rotvec(-0.1875 * Rotation.from_matrix(turn).as_rotvec()).as_matrix()
    first = poses(0)[1][0]
    np.testing.assert_allclose(first[:3, :3], pose(0)[:3, :3] @ back, atol=1e-9)
    np.testing.assert_allclose(first[:3, 3], pose(0)[:3, 3] - 0.1875 * (pose(1) - pose(0))[:3, 3], atol=1e-9)
    np.testing.assert_allclose(
        poses(3)[1][3][:3, 3], pose(3)[:3, 3] + 0.1875 * (pose(3) - pose(2))[:3, 3], atol=1e-9
    )


def test_cuts_and_gaps_end_the_way(tmp_path):
    """Frame 2 is a new scene, and frame 4 is missing: 2 goes with 3 alone, 5 stands still, and says so."""
    made = prepared(tmp_path / "a", (0, 1, 2, 3, 5), shutter=HALF, spp=8)
    table = dict(made.shot.table) | {"cuts": [2]}
    exposure = replace(made, shot=replace(made.shot, table=table)).exposure

    def place(number, moment):
        return exposure.frame(number).moments[moment].cameras[""].world_from_camera[:3, 3]

    step = 0.1875
    np.testing.assert_allclose(place(1, 3), pose(1)[:3, 3] + step * (pose(1) - pose(0))[:3, 3], atol=1e-9)
    np.testing.assert_allclose(place(2, 0), pose(2)[:3, 3] - step * (pose(3) - pose(2))[:3, 3], atol=1e-9)
    np.testing.assert_allclose(place(3, 3), pose(3)[:3, 3] + step * (pose(3) - pose(2))[:3, 3], atol=1e-9)
    assert exposure.frame(5).moments == ()
    assert exposure.flags(5) == (UNMOVED,) and exposure.flags(3) == ()


@pytest.fixture(scope="module")
def blurred(tmp_path_factory) -> Path:
    return write_job(
        tmp_path_factory.mktemp("exposure") / "blurred",
        virtual=[MOVING],
        spp=64,
        shutter={**HALF, "samples": 8},
        lens={"aperture": "30 mm", "focus_object": "table"},
        seed=3,
    )


@pytest.mark.slow
def test_a_frame_depends_on_itself_alone(blurred):
    """Threads, size of launches and of batches, and which frames are rendered, change no bit."""
    whole = render(blurred)
    options = {"threads": 1, "units_per_launch": 1}
    alone = render(blurred, "frames=2", "method.batch=3", out="alone", **options)
    assert same(channels(alone, 2), channels(whole, 2), *PARTS, "depth.Z", "motion.X", "normal.X")


@pytest.mark.slow
def test_layers_are_blurred_alike(blurred, tmp_path):
    """Masks cover what the virtual layer covers; depth is that of the nearest sample; motion that of the
    points that are seen, from the frame's own time to the next frame's."""
    here = channels(render(blurred, out="layers"), 1)
    crypto = here["CryptoObject00.G"] + here["CryptoObject00.A"]
    assert np.abs(crypto - here["virtual.A"]).mean() < 0.02
    sharp_job = json.loads(blurred.read_text()) | {"lens": None, "shutter": None}
    sharp_path = blurred.parent / "sharp.yaml"
    sharp_path.write_text(json.dumps(sharp_job))
    sharp = channels(render(sharp_path, out="sharp"), 1)
    # Wider, and less of it is solid.
    assert (here["virtual.A"] > 0).sum() > (sharp["virtual.A"] > 0).sum()
    assert (here["virtual.A"] > 0.999).sum() < (sharp["virtual.A"] > 0.999).sum()
    both = (here["virtual.A"] > 0.999) & (sharp["virtual.A"] > 0.999)
    assert both.sum() > 20
    for axis in "XY":
        np.testing.assert_allclose(here[f"motion.{axis}"][both], sharp[f"motion.{axis}"][both], atol=1.0)
    assert np.abs(sharp["motion.X"][both]).max() > 5
    assert np.all(here["depth.Z"][both] <= sharp["depth.Z"][both] + 0.03)
    assert here["virtual.A"].sum() == pytest.approx(sharp["virtual.A"].sum(), rel=0.1)


def test_what_stands_still_is_as_without_shutter(tmp_path):
    """The same camera in all frames, and nothing that moves: no moment, no branch, the same bits."""
    paths = [
        write_job(tmp_path / name, (0, 1), **more)
        for name, more in (("shut", {}), ("open", {"shutter": HALF, "lens": None}))
    ]
    for path in paths:
        still = [{"frame": n, "world_from_camera": pose(0).tolist()} for n in (0, 1)]
        (path.parent / "poses.json").write_text(json.dumps(still))
    shut, opened = (render(path, "method.spp=8") for path in paths)
    for number in (0, 1):
        assert same(channels(shut, number), channels(opened, number), *PARTS, "motion.X", "depth.Z")


@pytest.mark.parametrize(
    ("lens", "diameter"),
    [
        ({"aperture": "30 mm", "focus_distance": "0.5 m"}, 0.03),
        ({"f_number": 2, "focal_length": "50 mm", "focus_distance": "0.5 m"}, 0.025),
        # 70 pixels of 64: the picture lies 36 mm * 70 / 64 behind the lens.
        ({"f_number": 2, "sensor_width": "36 mm", "focus_distance": "0.5 m"}, 0.5 / (1 / 0.039375 + 2)),
    ],
)
def test_apertures_of_lenses(tmp_path, lens, diameter):
    camera = prepared(tmp_path / "a", lens=lens).exposure.frame(1).cameras[""]
    assert 2 * camera.lens.radius == pytest.approx(diameter) and camera.lens.focus == 0.5


def test_focus_follows_an_object(tmp_path):
    lens = {"aperture": "30 mm", "focus_object": "crate"}
    exposure = prepared(tmp_path / "a", lens=lens, virtual=[MOVING]).exposure
    for number in (0, 3):
        camera = exposure.frame(number).cameras[""]
        middle = np.array([-0.08 if number == 0 else 0.08, 0, 0.05])
        assert camera.lens.focus == pytest.approx(camera.project(middle[None])[1][0])


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ({"shutter": {**HALF, "rolling": True}}, "rolling shutter is not simulated"),
        ({"shutter": {"open": 0.2, "close": 0.1}}, "before `open`"),
        ({"shutter": {"open": 0.2}}, "are given"),
        ({"shutter": {"exposure": "1 ms", "open": 0}}, "stands alone"),
        ({"shutter": {**HALF, "samples": 3}}, "shared evenly"),
        ({"lens": {"aperture": "1 mm"}}, "focus_distance"),
        ({"lens": {"f_number": 2, "focus_distance": "1 m"}}, "focal_length"),
        ({"lens": {"aperture": "1 mm", "focal_length": "50 mm", "focus_distance": "1 m"}}, "goes with"),
        (
            {"lens": {"f_number": 2, "focal_length": "50 mm", "focus_distance": "4 cm"}},
            "nothing nearer",
        ),
        ({"lens": {"aperture": "1 mm", "focus_object": "crat"}}, "no object is called"),
    ],
)
def test_what_cannot_be_is_said(tmp_path, parts, message):
    with pytest.raises(JobErrors, match=message):
        load_job(write_job(tmp_path / "wrong", (0,), spp=8, **parts))
