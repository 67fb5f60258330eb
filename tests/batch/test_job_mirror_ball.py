"""A job whose map is turned by a mirror ball in one of its frames."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from small_job import pose, sky, write_job, write_picture

from mrbatch.batch.job_run import plan_job, render_job
from mrbatch.errors import InputError
from mrbatch.job import load_job

WIDTH, HEIGHT, FRAME = 224, 168, 1
FOCAL = 70.0 * WIDTH / 64
TURN = Rotation.from_euler("zyx", [140.0, 15.0, -20.0], degrees=True).as_matrix()
CENTRE, RADIUS = np.array([0.02, 0.01, 0.05]), 0.05
LAMPS = np.array([[0.2, 0.7, 0.6], [-0.8, -0.1, 0.5]])


def light(d):
    value = 0.3 + 0.2 * d[..., 2] + 0.1 * d[..., 0]
    for lamp in LAMPS / np.linalg.norm(LAMPS, axis=1, keepdims=True):
        value = value + 20.0 * (d @ lamp > np.cos(np.radians(8.0)))
    return value


def files(folder, **align):
    """The job, its map, and the picture of the ball, traced in closed form."""
    probe = {"frame": FRAME, "ball": {"centre": [f"{v} m" for v in CENTRE], "radius": "50 mm"}}
    path = write_job(
        folder,
        (0, 1),
        dtype=np.float32,
        width=WIDTH,
        height=HEIGHT,
        environment={"file": "map.exr", "align": {"probe": {**probe, **align}}},
    )
    u, v = np.meshgrid((np.arange(256) + 0.5) / 256, (np.arange(128) + 0.5) / 128)
    azimuth, polar = 2 * np.pi * (0.5 - u), np.pi * v
    d = np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], axis=-1)
    write_picture(folder / "map.exr", np.repeat(light(d)[..., None], 3, axis=-1).astype(np.float32))
    fine = 4  # rays a pixel to either side
    x, y = np.meshgrid((np.arange(fine * WIDTH) + 0.5) / fine, (np.arange(fine * HEIGHT) + 0.5) / fine)
    rays = np.stack([(x - WIDTH / 2) / FOCAL, (y - HEIGHT / 2) / FOCAL, np.ones_like(x)], axis=-1)
    rays = rays @ pose(FRAME)[:3, :3].T
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    o = pose(FRAME)[:3, 3] - CENTRE
    b = rays @ o
    under = b * b - (o @ o - RADIUS**2)
    n = (o + (-b - np.sqrt(np.maximum(under, 0.0)))[..., None] * rays) / RADIUS
    r = rays - 2 * np.sum(rays * n, axis=-1, keepdims=True) * n
    value = np.where(under > 0, 0.5 * light(r @ TURN), 0.2)
    value = value.reshape(HEIGHT, fine, WIDTH, fine).mean(axis=(1, 3))
    write_picture(
        folder / f"photo_{FRAME:04d}.exr", np.repeat(value[..., None], 3, axis=-1).astype(np.float32)
    )
    return path


def test_the_map_is_turned_once_and_for_all_workers(tmp_path, monkeypatch):
    path = files(tmp_path)
    made = plan_job(load_job(path))
    found = made.scene.environment.world_from_map
    assert np.degrees(np.linalg.norm(Rotation.from_matrix(TURN.T @ found).as_rotvec())) < 1.0
    note = next(note for note in made.shot.notes if "mirror ball" in note)
    assert "2 lamps" in note and "frame 1" in note
    render_job(load_job(path), report=False)
    (stored,) = (tmp_path / "out" / "shot").glob("*.json")
    assert json.loads(stored.read_text())["table"]["environment"]["world_from_map"] == found.tolist()
    # A worker that joins takes it from there.
    from mrbatch.batch import prepare

    monkeypatch.setattr(prepare, "find_turn", lambda *given: pytest.fail("looked for again"))
    (tmp_path / "out" / "small.0000.exr").unlink()
    assert render_job(load_job(path), report=False).result.rendered == (0,)


def test_a_ball_that_does_not_show_the_map_is_refused(tmp_path):
    path = files(tmp_path)
    other = np.repeat(sky()[:, ::-1], 16, axis=0).repeat(16, axis=1)
    write_picture(tmp_path / "map.exr", np.ascontiguousarray(other))
    with pytest.raises(InputError, match="rotation|mirror ball"):
        plan_job(load_job(path))


def test_a_frame_that_is_not_there(tmp_path):
    path = files(tmp_path, frame=5)
    with pytest.raises(InputError, match="to be seen in frame 5, which cannot be used"):
        plan_job(load_job(path))
