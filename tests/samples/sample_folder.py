"""Where the sample lies, and how the script that makes it is imported."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from types import ModuleType

ROOT = Path(__file__).resolve().parents[2]
SAMPLE = ROOT / "data_samples" / "marker_video"
CONFIG = ROOT / "configs" / "marker_video.yaml"


def maker() -> ModuleType:
    """`data_samples/make_marker_video.py`, whose neighbours it imports by their plain names."""
    folder = str(ROOT / "data_samples")
    if folder not in sys.path:
        sys.path.append(folder)
    return importlib.import_module("make_marker_video")


def pose_errors() -> tuple[list[float], list[float]]:
    """Degrees, and share of the distance to the marker, of the poses that the footage's marker gives."""
    import numpy as np

    from mrbatch.capture.marker_video.pose_file import load_poses
    from mrbatch.capture.registry import CAPTURES
    from mrbatch.job import load_job

    job = load_job(CONFIG)
    capture = CAPTURES.get(job.capture_kind).open(job.capture, job.folder)
    table = capture.prepare()
    truth = load_poses(SAMPLE / "poses.json")
    degrees, shares = [], []
    for number in capture.frame_numbers():
        (view,) = capture.geometry(number, table).values()
        found, true = view.camera.world_from_camera, truth[number]
        between = found[:3, :3].T @ true[:3, :3]
        # The sine keeps its digits where the angle is small and the trace has lost them.
        axis = [between[2, 1] - between[1, 2], between[0, 2] - between[2, 0], between[1, 0] - between[0, 1]]
        degrees.append(float(np.degrees(np.arcsin(0.5 * np.linalg.norm(axis)))))
        distance = np.linalg.norm(true[:3, 3])
        shares.append(float(np.linalg.norm(found[:3, 3] - true[:3, 3]) / distance))
    return degrees, shares
