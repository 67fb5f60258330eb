"""Rays cast by an engine, one launch a call: for cases and tests."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp

from mrbatch.device.rays import FAR, Engine, RayMesh, RaySet, build_set, rays


@functools.cache
def _kernel(engine: Engine) -> Any:
    functions = rays(engine)

    @wp.kernel(enable_backward=False, module="unique")
    def cast(
        scene: RaySet,
        o: wp.array(dtype=wp.vec3),
        d: wp.array(dtype=wp.vec3),
        t: wp.array(dtype=float),
        uv: wp.array(dtype=wp.vec2),
        triangle: wp.array(dtype=int),
        blocked: wp.array(dtype=int),
    ):
        i = wp.tid()
        hit = functions.trace(scene, o[i], d[i], FAR)
        t[i] = hit.t
        uv[i] = wp.vec2(hit.u, hit.v)
        triangle[i] = hit.triangle
        blocked[i] = wp.where(functions.occluded(scene, o[i], d[i], FAR), 1, 0)

    return cast


def cast(engine: Engine, meshes: Sequence[RayMesh], o: np.ndarray, d: np.ndarray) -> list[np.ndarray]:
    """t (n,), barycentrics (n, 2), triangle (n,) or -1, blocked (n,) of rays (n, 3) among `RayMesh`es."""
    built = build_set(meshes, engine)
    n = len(o)
    out = [
        wp.zeros(n, dtype=float, device="cpu"),
        wp.zeros(n, dtype=wp.vec2, device="cpu"),
        wp.zeros(n, dtype=int, device="cpu"),
        wp.zeros(n, dtype=int, device="cpu"),
    ]
    given = [wp.array(a.astype(np.float32), dtype=wp.vec3, device="cpu") for a in (o, d)]
    wp.launch(_kernel(engine), n, [built.data, *given, *out], device="cpu")
    return [a.numpy() for a in out]
