"""A camera in a picture's metadata: the matrices that compositors read, and the exact description.

Matrices follow the OpenEXR standard attributes, so they are for row vectors (p' = p M).
`worldToCamera` leads to a left-handed camera space, x right, y up, z along the view; `worldToNDC` to x,
y in 0..1 from the upper left to the lower right corner of the display window, after division by w.
Files keep both in float32, and they know no lens distortion; the exact camera stands in
`mrbatch/camera`. An equirectangular camera has no `worldToNDC`.
"""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from mrbatch.scene.camera import Camera
from mrbatch.scene.lens import Lens

NEAR = 0.01
"""Metres to the near plane of `worldToNDC`, whose z is 1 - NEAR / depth; readers discard z."""


def camera_space_from_camera(camera: Camera) -> np.ndarray:
    """(4, 4), column vectors: from our camera frame to EXR's, x right, y up, z along the view."""
    if camera.model == "equirectangular":  # our frame: x to the picture's centre, y left, z up
        return np.array([[0, -1, 0, 0], [0, 0, 1, 0], [1, 0, 0, 0], [0, 0, 0, 1]], dtype=np.float64)
    return np.diag([1.0, -1.0, 1.0, 1.0])


def world_to_camera(camera: Camera) -> np.ndarray:
    """EXR's `worldToCamera` (4, 4) for row vectors, float64."""
    return (camera_space_from_camera(camera) @ camera.camera_from_world).T


def world_to_ndc(camera: Camera) -> np.ndarray:
    """EXR's `worldToNDC` (4, 4) for row vectors, float64; perspective cameras only."""
    (fx, skew, cx), (_, fy, cy) = camera.matrix[0], camera.matrix[1]
    w, h = camera.width, camera.height
    ndc_from_camera = np.array(
        [[fx / w, skew / w, cx / w, 0], [0, fy / h, cy / h, 0], [0, 0, 1, -NEAR], [0, 0, 1, 0]]
    )
    return (ndc_from_camera @ camera.camera_from_world).T


def screen_window(camera: Camera) -> tuple[float, tuple[float, float]]:
    """EXR's `screenWindowWidth` and `screenWindowCenter`: the picture on the plane z = 1, y up."""
    (fx, _, cx), (_, fy, cy) = camera.matrix[0], camera.matrix[1]
    centre = ((camera.width / 2 - cx) / fx, -(camera.height / 2 - cy) / fy)
    return float(camera.width / fx), (float(centre[0]), float(centre[1]))


def described(camera: Camera) -> dict[str, Any]:
    """The camera as JSON-ready values, exact to the last bit."""
    found = {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in asdict(camera).items()}
    return {k: v for k, v in found.items() if v is not None}


def from_description(values: Any) -> Camera | None:
    """The camera that `described` described; None for anything else."""
    if not isinstance(values, dict):
        return None
    try:
        shapes = {"matrix": (3, 3), "distortion": (8,), "world_from_camera": (4, 4)}
        arrays = {k: np.array(values[k], dtype=np.float64).reshape(shape) for k, shape in shapes.items()}
        lens = Lens(**values["lens"]) if "lens" in values else None
        return Camera(values["width"], values["height"], model=values["model"], lens=lens, **arrays)
    except (KeyError, TypeError, ValueError):
        return None
