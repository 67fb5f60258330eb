"""Does this machine compile kernels and trace rays? Small runs with known answers, for `mrbatch doctor`."""

from __future__ import annotations

import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

from mrbatch.device import embree
from mrbatch.device.rays import FAR, Engine, RayMesh, RaySet, build_set, rays
from mrbatch.device.startup import start
from mrbatch.errors import ResourceError

AGREEMENT = 64 * float(np.finfo(np.float32).eps)
"""Difference of two engines' distances, relative to the scene's size, that rounding explains."""


def compile_and_run() -> float:
    """Compiles a kernel that no cache holds, runs it, and gives the seconds that compiling took.

    Raises ResourceError where its numbers are wrong; whatever Warp raises passes through.
    """
    start()

    @wp.kernel(enable_backward=False, module="unique")
    def squares(out: wp.array(dtype=wp.float32)):
        i = wp.tid()
        out[i] = wp.float32(i * i)

    out = wp.zeros(100, dtype=wp.float32, device="cpu")
    kept = wp.config.kernel_cache_dir
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        wp.config.kernel_cache_dir = folder
        try:
            began = time.perf_counter()
            wp.load_module(squares.module, "cpu", block_dim=1)
            seconds = time.perf_counter() - began
            wp.launch(squares, len(out), [out], device="cpu")
        finally:
            wp.config.kernel_cache_dir = kept
    if not np.array_equal(out.numpy(), np.arange(100, dtype=np.float32) ** 2):
        raise ResourceError("a kernel compiled here gives wrong numbers")
    return seconds


def cache_folder() -> Path:
    """Where compiled kernels are kept; proved writable by writing there.

    Raises ResourceError where it is not.
    """
    start()
    folder = Path(str(wp.config.kernel_cache_dir))
    try:
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(b"mrbatch")
    except OSError as error:
        raise ResourceError(f"{folder} cannot be written: {error.strerror}") from error
    return folder


def embree_version() -> str:
    """Opens the Embree device. Raises ResourceError where it cannot be had."""
    version = embree.library().version
    return f"{version // 10000}.{version // 100 % 100}.{version % 100}"


@dataclass(frozen=True)
class Casts:
    """Rays cast at a scene: distance (n,), infinity where nothing was hit, and triangle (n,), -1 there."""

    distance: np.ndarray
    triangle: np.ndarray


def _cast(engine: Engine, mesh: RayMesh, o: np.ndarray, d: np.ndarray) -> Casts:
    functions = rays(engine)

    @wp.kernel(enable_backward=False, module="unique")
    def cast(
        scene: RaySet,
        o: wp.array(dtype=wp.vec3),
        d: wp.array(dtype=wp.vec3),
        t: wp.array(dtype=wp.float32),
        triangle: wp.array(dtype=wp.int32),
    ):
        i = wp.tid()
        hit = functions.trace(scene, o[i], d[i], FAR)
        t[i] = hit.t
        triangle[i] = hit.triangle

    start()
    built = build_set([mesh], engine)
    out: list[Any] = [wp.zeros(len(o), dtype=kind, device="cpu") for kind in (wp.float32, wp.int32)]
    given: list[Any] = [wp.array(a, dtype=wp.vec3, device="cpu") for a in (o, d)]
    wp.launch(cast, len(o), [built.data, *given, *out], device="cpu")
    t, triangle = (a.numpy() for a in out)
    return Casts(np.where(triangle < 0, np.inf, t), triangle)


def hit_a_triangle(engine: Engine) -> None:
    """One ray that must hit at distance 2 and one that must miss. Raises ResourceError otherwise."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], dtype=np.float32)
    mesh = RayMesh(0, corners, np.array([[0, 1, 2]], dtype=np.int32), 7)
    o = np.array([[0.25, 0.25, 2], [0.75, 0.75, 2]], dtype=np.float32)
    d = np.array([[0, 0, -1], [0, 0, -1]], dtype=np.float32)
    casts = _cast(engine, mesh, o, d)
    if casts.triangle.tolist() != [7, -1] or abs(casts.distance[0] - 2.0) > 2.0 * AGREEMENT:
        raise ResourceError(
            f"the ray engine {engine} should hit a triangle at distance 2 and miss it once; "
            f"it says {casts.distance.tolist()}"
        )


def engines_agree(side: int = 32) -> float:
    """Casts `side`^2 rays at a bumpy sheet with both engines; gives the largest difference of distance,
    relative to the sheet's size.

    The rays meet the sheet steeply and away from its rim, so that distance is a continuous function of
    the ray and rounding cannot change what is hit. Raises ResourceError where they differ by more than
    rounding explains.
    """
    n = 24
    x, y = np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, n))
    z = 0.05 * np.sin(9.0 * x) * np.cos(7.0 * y)
    vertices = np.stack([x, y, z], axis=-1).reshape(-1, 3).astype(np.float32)
    corner = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    faces = np.concatenate(
        [
            np.stack([corner, corner + 1, corner + n], axis=-1),
            np.stack([corner + 1, corner + n + 1, corner + n], axis=-1),
        ]
    ).astype(np.int32)
    mesh = RayMesh(0, vertices, faces, 0)
    u, v = np.meshgrid(np.linspace(0.1, 0.9, side), np.linspace(0.1, 0.9, side))
    target = np.stack([u, v, np.zeros_like(u)], axis=-1).reshape(-1, 3)
    d = target - np.array([0.5, 0.5, 1.5])
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    o = np.broadcast_to([0.5, 0.5, 1.5], d.shape).astype(np.float32)
    first, second = (_cast(engine, mesh, o, d.astype(np.float32)) for engine in ("embree", "warp"))
    if not np.isfinite(first.distance).all() or not np.isfinite(second.distance).all():
        raise ResourceError("a ray engine misses a sheet that lies in the way")
    difference = float(np.abs(first.distance - second.distance).max())
    if difference > AGREEMENT:
        raise ResourceError(f"the ray engines differ by {difference:.1e} of the scene's size")
    return difference
