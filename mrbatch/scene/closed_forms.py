"""Small scenes whose light is known in closed form, and the forms: for hard cases, tests and benches.

Sky: radiance 1 from everywhere, so an open diffuse surface of reflectance rho sends rho, and a body that
covers the share F of its cosine-weighted hemisphere takes rho F.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from mrbatch.scene.camera import Camera
from mrbatch.scene.environment import Environment
from mrbatch.scene.mesh import Mesh, icosphere, plane
from mrbatch.scene.scene import Material, Scene, SceneObject, centre


def sky(radiance: float | Sequence[float] = 1.0) -> Environment:
    """The same radiance from everywhere."""
    return Environment(np.broadcast_to(np.asarray(radiance, np.float32), (4, 8, 3)).copy())


def lamp_sky(strength: float = 40.0) -> Environment:
    """A dim sky with a lamp of some degrees high on the +x side, which surfaces sample badly."""
    radiance = np.full((32, 64, 3), 0.2, np.float32)
    radiance[6:8, 30:33] = strength
    return Environment(radiance)


def placed(mesh: Mesh, *, at: Sequence[float] = (0, 0, 0), normal: Sequence[float] = (0, 0, 1)) -> Mesh:
    """The mesh with its z axis turned to `normal` (an axis) and its origin moved to `at`, in metres."""
    n = np.asarray(normal, dtype=np.float64)
    matrix = np.eye(4)
    if abs(n[2]) < 0.5:
        matrix[:3, 0], matrix[:3, 1] = np.cross([0, 0, 1.0], n), [0, 0, 1.0]
        matrix[:3, 2] = n
    elif n[2] < 0:
        matrix[:3, :3] = np.diag([1.0, -1.0, -1.0])
    matrix[:3, 3] = at
    return mesh.transformed(matrix)


def real(name: str, mesh: Mesh, reflectance: float | Sequence[float] = 0.5, **switches: Any) -> SceneObject:
    return SceneObject(name, mesh, Material(reflectance=_rgb(reflectance)), False, **switches)


def virtual(
    name: str, mesh: Mesh, reflectance: float | Sequence[float] = 0.5, **switches: Any
) -> SceneObject:
    return SceneObject(name, mesh, Material(reflectance=_rgb(reflectance)), True, **switches)


def _rgb(value: float | Sequence[float]) -> tuple[float, float, float]:
    r, g, b = np.broadcast_to(np.asarray(value, dtype=np.float64), (3,))
    return float(r), float(g), float(b)


def ball(radius: float = 1.0, *, at: Sequence[float] = (0, 0, 1), subdivisions: int = 6) -> Mesh:
    """A faceted ball; at the default its silhouette is smaller than the sphere's by 4e-5."""
    return replace(icosphere(radius, subdivisions=subdivisions, centre=at), normals=None)


def floor(size: float = 2.0**12) -> Mesh:
    return plane(size, size)


def look_at(
    eye: Sequence[float] | np.ndarray,
    target: Sequence[float] | np.ndarray,
    *,
    width: int,
    height: int,
    focal: float,
) -> Camera:
    """A pinhole at `eye` whose middle pixel looks at `target`; x of the picture is horizontal."""
    e, t = np.asarray(eye, dtype=np.float64), np.asarray(target, dtype=np.float64)
    forward = (t - e) / np.linalg.norm(t - e)
    up = np.array([0.0, 0.0, 1.0]) if abs(forward[2]) < 0.999 else np.array([0.0, 1.0, 0.0])
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2], pose[:3, 3] = right, np.cross(forward, right), forward, e
    matrix = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]])
    return Camera(width, height, matrix, np.zeros(8), pose)


def scene_of(
    objects: Sequence[SceneObject], environment: Environment | None = None, origin: np.ndarray | None = None
) -> Scene:
    return Scene(tuple(objects), environment or sky(), centre(objects) if origin is None else origin)


def everything_virtual(objects: Sequence[SceneObject], *, with_virtual: bool = True) -> list[SceneObject]:
    """The objects as virtual ones, with or without those that were: P is then a plain path tracer's."""
    return [replace(o, virtual=True) for o in objects if with_virtual or not o.virtual]


def ball_share(radius: float, height: float, s: float | np.ndarray) -> np.ndarray:
    """Form factor of a ball above the horizon: r^2 h / (s^2 + h^2)^1.5 at s from its foot."""
    return radius**2 * height / (np.asarray(s) ** 2 + height**2) ** 1.5


def sunk_ball_share(q: float | np.ndarray) -> np.ndarray:
    """Form factor of a ball half under the plane, q radii off: (atan(1/g) - g/q^2) / pi, g^2 = q^2 - 1."""
    h = np.asarray(q, dtype=np.float64)
    g = np.sqrt(h * h - 1)
    return (np.arctan(1 / g) - g / h**2) / np.pi


def upright_share(a: float, b: float, c: float) -> float:
    """Form factor of a rectangle a high and b wide that stands on the plane, c off one of its lower corners:
    (atan(1/y) - y/q atan(1/q)) / 2 pi with y = c / b, q = hypot(a, c) / b."""
    y, q = c / b, np.hypot(a, c) / b
    return float((np.arctan(1 / y) - y / q * np.arctan(1 / q)) / (2 * np.pi))


def corner(reflectance: float = 0.5, *, size: float = 2.0**12) -> list[SceneObject]:
    """A floor (z = 0) and a wall (x = 0), both large; the open corner is where x and z are positive."""
    half = size / 2
    return [
        real("floor", placed(plane(size, size), at=(half, 0, 0)), reflectance),
        real("wall", placed(plane(size, size), at=(0, 0, half), normal=(1, 0, 0)), reflectance),
    ]


def scaled(scene: Scene, factor: float) -> Scene:
    """The scene times `factor`, its origin too."""
    matrix = np.diag([factor, factor, factor, 1.0])
    objects = tuple(replace(o, mesh=o.mesh.transformed(matrix)) for o in scene.objects)
    return Scene(objects, scene.environment, scene.origin * factor)
