"""Where rays leave surfaces, for kernels."""

from __future__ import annotations

from typing import Any

import warp as wp

from mrbatch.kernels.numerics import max_component, offset_origin
from mrbatch.scene.scene_data import SceneData, SurfacePoint

_MITSUBA = wp.constant(wp.float32(1500.0 * 2.0**-24))


@wp.func
def exact_start(scene: SceneData, point: SurfacePoint, d: wp.vec3) -> wp.vec3:
    """As near to the surface as the precision of the point allows."""
    return offset_origin(point.p, point.ng, d, float(point.reach))


@wp.func
def mitsuba_start(scene: SceneData, point: SurfacePoint, d: wp.vec3) -> wp.vec3:
    """As Mitsuba 3 starts rays (`SurfaceInteraction.offset_p`): 1500 units of float32 at 1 + |p| off, p in
    the world's coordinates. A tenth of a millimetre in a scene of metres, which takes away the shading of
    finer dents."""
    p = point.p + scene.origin
    step = _MITSUBA * (1.0 + max_component(wp.vec3(wp.abs(p[0]), wp.abs(p[1]), wp.abs(p[2]))))
    if wp.dot(point.ng, d) < 0.0:
        step = -step
    return point.p + step * point.ng


_STARTS = {"exact": exact_start, "mitsuba": mitsuba_start}


def make_ray_start(kind: str = "exact") -> Any:
    """`wp.func` (scene, point, direction) -> start of a ray; `kind`: exact or mitsuba."""
    return _STARTS[kind]
