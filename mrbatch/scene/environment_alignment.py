"""The rotation of an environment map from directions that are marked in it and known in the world.

Wahba's problem (1965): the rotation R that maximises sum d_world . R d_map, by the singular value
decomposition (Markley 1988). Of two exact directions it is TRIAD's; of more it is the least squares fit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mrbatch.scene.environment_tables import Rows

MIN_ANGLE = np.radians(5.0)
"""Directions nearer than this to one line do not fix the turn about it: it errs twelve times as they do."""


@dataclass(frozen=True)
class EnvironmentAlignment:
    """A map laid over the world. `world_from_map` (3, 3) float64, a rotation; `residuals` (n,) radians, from
    each direction as turned to where it should be; `mirrored`: a mirror image would fit better."""

    world_from_map: np.ndarray
    residuals: np.ndarray
    mirrored: bool


def map_direction(u: float, v: float) -> np.ndarray:
    """(3,) unit direction of a place in the map: u = 1/2 - atan2(y, x) / (2 pi), v = acos(z) / pi."""
    azimuth, polar = 2.0 * np.pi * (0.5 - u), np.pi * v
    return np.array([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)])


def pixel_direction(x: float, y: float, width: int, height: int, rows: Rows = "centres") -> np.ndarray:
    """(3,) unit direction of a pixel place, centres at half integers, of a map of that size."""
    v = y / height if rows == "centres" else (y - 0.5) / (height - 1)
    return map_direction(x / width, min(max(v, 0.0), 1.0))


def angle_to(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Angles in radians between directions (..., 3), exact near 0 and pi too."""
    return np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), np.sum(a * b, axis=-1))


def spread(directions: np.ndarray) -> float:
    """Largest angle in radians between the lines of any two of the directions (n, 3)."""
    angles = angle_to(directions[:, None], directions[None])
    return float(np.minimum(angles, np.pi - angles).max())


def align(map_directions: np.ndarray, world_directions: np.ndarray) -> EnvironmentAlignment:
    """The rotation that takes the one (n, 3) to the other (n, 3), n from 2, all of one weight.

    Raises ValueError where the directions of a side are all (anti)parallel.
    """
    a = map_directions / np.linalg.norm(map_directions, axis=1, keepdims=True)
    b = world_directions / np.linalg.norm(world_directions, axis=1, keepdims=True)
    for side, directions in (("map", a), ("world", b)):
        if (widest := spread(directions)) < MIN_ANGLE:
            raise ValueError(
                f"the directions in the {side} lie within {np.degrees(widest):.2g} degrees of one line, "
                f"which leaves the map free to turn about it: mark another one, at least "
                f"{np.degrees(MIN_ANGLE):.0f} degrees off"
            )
    u, s, vt = np.linalg.svd(b.T @ a)
    sign = np.linalg.det(u) * np.linalg.det(vt)
    rotation = u @ np.diag([1.0, 1.0, np.sign(sign)]) @ vt
    # Directions in one plane, two among them, have no smallest singular value: they have no handedness.
    return EnvironmentAlignment(
        rotation, angle_to(a @ rotation.T, b), bool(sign < 0.0 and s[2] > 1e-3 * s[0])
    )
