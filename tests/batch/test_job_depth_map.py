"""A job whose table is a depth map of one of its frames, against the same job with the table as a plane."""

from __future__ import annotations

import numpy as np
from small_job import FOCAL, HEIGHT, WIDTH, pose, write_job

from mrbatch.batch.job_run import plan_job, render_job
from mrbatch.film.exr import read_frame
from mrbatch.job import load_job

FRAME = 2


def depth() -> np.ndarray:
    """Planar depth (H, W) of z = 0 in the camera of that frame."""
    x, y = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    rays = np.stack([(x - WIDTH / 2) / FOCAL, (y - HEIGHT / 2) / FOCAL, np.ones_like(x)], axis=-1)
    matrix = pose(FRAME)
    return -matrix[2, 3] / (rays @ matrix[2, :3])


def light_change(folder, **parts):
    job = load_job(write_job(folder, (0, 2), spp=64, **parts))
    render_job(job, report=False)
    made = read_frame(next((folder / "out").glob("*0002.exr")))
    return np.stack([made.views[""].channels[f"delta.{c}"] for c in "RGB"], axis=-1), job


def test_a_table_seen_by_a_frame_is_as_good_as_a_plane(tmp_path):
    look = {"name": "table", "reflectance": [0.4, 0.3, 0.2]}
    layers = {"output": {"directory": "out", "layers": ["delta"], "dtype": "float"}}
    plane, _ = light_change(tmp_path / "plane", real=[{**look, "plane": {"size": ["3 m", "3 m"]}}], **layers)
    (tmp_path / "seen").mkdir()
    np.save(tmp_path / "seen" / "depth.npy", (1000.0 * depth()).astype(np.float32))
    given = {"file": "depth.npy", "measures": "z", "unit": "1 mm", "frame": FRAME}
    seen, job = light_change(tmp_path / "seen", real=[{**look, "depth_map": given}], **layers)
    assert plane.min() < -0.02  # a shadow falls on it
    inside = np.s_[2:-2, 2:-2]  # the surface ends at the centres of the outermost pixels
    assert np.abs(seen - plane)[inside].mean() < 0.03 * np.abs(plane)[inside].mean()
    assert any("depth.npy: 100% of 64 x 48 pixels" in note for note in plan_job(job).shot.notes)
