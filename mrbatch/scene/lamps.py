"""Directions to what emits light, for kernels: points drawn on lamps, and the density of a direction to them.

A point y, uniform on a lamp that is chosen by its power (`scene.lamp_table`), has at x the density over solid
angle p_A |x - y|^2 / |cos at y|, p_A being the density over area (Veach 1997, equation 8.10). Weighed against
scattered directions, a lamp's part f cos / (n p + p_scatter) of the estimate stays bounded where x and y
touch and where the lamp is seen edge on. Surfaces emit to both sides.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from mrbatch.device.rays import FAR
from mrbatch.kernels.numerics import offset_origin
from mrbatch.kernels.rng import uint_to_double, uint_to_float
from mrbatch.scene.lamp_table import LampData
from mrbatch.scene.scene_data import VIRTUAL, SceneData, SurfacePoint, surface_point

_NOWHERE = wp.constant(wp.int32(-1))


@wp.struct
class LampPoint:
    """A point on a lamp as seen from another: `triangle`, -1 where there is none, and weights of its second
    and third corner."""

    triangle: wp.int32
    u: float
    v: float


@wp.struct
class LampRay:
    """From a point x to a point of a lamp: `point` there, the unit `direction` and `distance` from x, and the
    `pdf` with which it is drawn, per steradian; 0: no light comes from there. `end`: of a ray that asks what
    is in between, just off the lamp."""

    point: SurfacePoint
    direction: wp.vec3
    distance: float
    pdf: float
    end: wp.vec3


@wp.func
def draw_lamp(lamps: LampData, bits: wp.vec2ui, real_only: bool) -> LampPoint:
    """A point on a lamp, or on a real one; `bits`: two 32-bit fractions."""
    found = LampPoint()
    found.triangle = _NOWHERE
    last = lamps.count
    chosen = uint_to_double(bits[0])
    if real_only:
        last = lamps.real
        chosen *= lamps.real_share
    if last > 0:
        low = int(0)
        high = last - 1
        while low < high:
            middle = (low + high + 1) >> 1
            if lamps.cdf[middle] <= chosen:
                low = middle
            else:
                high = middle - 1
        below = lamps.cdf[low]
        # What the choice leaves of the number is as random as it was.
        rest = float((chosen - below) / (lamps.cdf[low + 1] - below))
        root = wp.sqrt(wp.clamp(rest, 0.0, 1.0))
        found.triangle = lamps.triangles[low]
        found.u = 1.0 - root
        found.v = uint_to_float(bits[1]) * root
    return found


@wp.func
def lamp_pdf(scene: SceneData, x: wp.vec3, met: SurfacePoint, real_only: bool) -> float:
    """Density per steradian at `x` with which the direction to `met` is drawn; 0 where it is on no lamp."""
    density = scene.triangles[met.triangle].lamp
    if density <= 0.0:
        return 0.0
    if real_only:
        density /= float(scene.lamps.real_share)
    way = met.p - x
    facing = wp.abs(wp.dot(met.ng, way))
    if facing == 0.0:
        # Edge on: no point of the lamp is drawn for such a direction, and scattered rays weigh nothing there.
        return FAR
    square = wp.dot(way, way)
    return wp.min(density * square * wp.sqrt(square) / facing, FAR)


@wp.func
def lamp_ray(scene: SceneData, from_point: SurfacePoint, bits: wp.vec2ui, real_only: bool) -> LampRay:
    """A way to a lamp, drawn at `from_point`."""
    found = LampRay()
    drawn = draw_lamp(scene.lamps, bits, real_only)
    if drawn.triangle >= 0 and drawn.triangle != from_point.triangle:
        t = scene.triangles[drawn.triangle]
        way = t.a + t.e1 * drawn.u + t.e2 * drawn.v - from_point.p
        found.distance = wp.length(way)
        if found.distance > 0.0:
            found.direction = way / found.distance
            found.point = surface_point(scene, drawn.triangle, drawn.u, drawn.v, found.direction)
            if wp.dot(found.point.ng, found.direction) < 0.0:
                found.pdf = lamp_pdf(scene, from_point.p, found.point, real_only)
            # The ray's error grows with its length: off the lamp by as much, it ends before the lamp's plane.
            reach = wp.max(float(found.point.reach), found.distance)
            found.end = offset_origin(found.point.p, found.point.ng, -found.direction, reach)
    return found


@wp.func
def is_virtual(point: SurfacePoint) -> bool:
    """Whether the point is on something virtual."""
    return (point.flags & VIRTUAL) != 0


def lamp_strategy(strategy: str, on: bool) -> str:
    """How light of lamps is sampled: `none`, by scattered rays alone; `light`, by directions to lamps alone;
    `mis`, both, weighted."""
    return {"mis": "mis", "environment": "light", "bsdf": "none"}[strategy] if on else "none"


def make_lamp_weights(strategy: str) -> tuple[Any, Any]:
    """Two `wp.func`s for `lamp_strategy`: `over_pdf(count, lamp_pdf, scatter_pdf)`, the weight of one of
    `count` directions to lamps over its density, and `scattered(scatter_pdf, count, lamp_pdf)`, of a
    scattered ray that meets a lamp (balance heuristic; Veach 1997, equation 9.8)."""
    weigh = strategy == "mis"
    draws = strategy != "none"

    @wp.func
    def over_pdf(count: int, lamp: float, scatter: float) -> float:
        if wp.static(weigh):
            return 1.0 / (float(count) * lamp + scatter)
        return 1.0 / (float(count) * lamp)

    @wp.func
    def scattered(scatter: float, count: int, lamp: float) -> float:
        # A lamp that no direction is drawn to is found by scattered rays alone.
        if wp.static(draws):
            if lamp > 0.0:
                if wp.static(weigh):
                    return 1.0 / (1.0 + float(count) * (lamp / scatter))
                return 0.0
        return 1.0

    return over_pdf, scattered
