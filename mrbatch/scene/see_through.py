"""Surfaces that light passes straight on, in part, for kernels: cut-outs by opacity, and thin panes.

What such a surface lets through goes on in its own direction. So a ray towards a light has a transmittance,
the product over all that stand in its way, exact and without noise; and a ray that looks for the next surface
either stops at one or passes on, with the probabilities of opacity. The choice is made once a ray: of the
surfaces along it the first is taken that, with those before, keeps more than a random number u,

    stop at k where  u < 1 - product of p_i over i <= k,   p_i the share that passes,

so that one stratified number serves however many surfaces, and a card of opacity 1/2 stops every second
ray of a pixel. Glass of a colour passes more of one channel than of another: p is the largest share, and
what a ray brings back is weighted by shares / p.

Rays go on from such a surface as they leave one that scatters, so that none is met twice; what lies nearer
behind it than rays start off (two cards in one plane) counts once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import warp as wp

from mrbatch.device.rays import FAR, Hit, RaySet
from mrbatch.kernels.bsdf import THIN_DIELECTRIC
from mrbatch.kernels.numerics import max_component
from mrbatch.kernels.texture import sample_texture
from mrbatch.kernels.thin_dielectric import pane_shares
from mrbatch.scene.scene_data import (
    SEE_THROUGH,
    SceneData,
    SurfacePoint,
    surface_point,
    texture_coordinates,
)
from mrbatch.scene.shading import ShadingFlags

DIM_STOP = wp.constant(wp.int32(1 << 22))
"""Dimensions of the numbers that choose where rays stop begin here: beyond those of a path's vertices."""
STOPS = wp.constant(wp.int32(64))
"""Of them, for each edge of a path."""
MOST_PASSED = 1024
"""Surfaces that a ray may pass; what comes behind is opaque."""


@wp.struct
class Stop:
    """Where a ray stops: the hit, its `t` from the ray's own start; `share`: factor on what it brings back;
    `rays`: further ones that this took."""

    hit: Hit
    share: wp.vec3
    rays: wp.int32


@wp.struct
class Transmitted:
    """`share` of light that comes along a ray, and the rays that this took."""

    share: wp.vec3
    rays: wp.int32


@dataclass(frozen=True)
class SeeThrough:
    """`wp.func`s for rays among surfaces that light may pass.

    `stop(scene, among, first, direction, key, index, dimension) -> Stop`: on from the first hit of a ray
    of one set, of unit direction; `dimension`: of the random number. `transmittance(scene, among, origin,
    direction, tfar) -> Transmitted`: up to `tfar` times the direction's length, which is any. `on`: whether
    any surface is such; else neither has to be asked.
    """

    on: bool
    stop: Any
    transmittance: Any


@wp.func
def opacity_at(scene: SceneData, point: SurfacePoint) -> float:
    """The share of light that a surface keeps from passing straight on, 0..1; of a pane what is no pane."""
    value = scene.objects[point.object].opacity
    found = scene.objects[point.object].opacity_texture
    if found >= 0:
        value = sample_texture(scene.textures, found, texture_coordinates(scene, point))[0]
        cutoff = scene.objects[point.object].opacity_cutoff
        if cutoff > 0.0:
            # After the look-up: the edge is a line across texels, and not their outline.
            value = wp.where(value >= cutoff, 1.0, 0.0)
    return value


def make_see_through(flags: ShadingFlags, trace: Any, ray_start: Any, sample_1d: Any) -> SeeThrough:
    """The functions for what the materials of a shot call for."""

    @wp.func
    def passing(scene: SceneData, point: SurfacePoint, direction: wp.vec3) -> wp.vec3:
        share = wp.vec3(1.0, 1.0, 1.0)
        if wp.static(flags.cutouts):
            share = share * (1.0 - opacity_at(scene, point))
        if wp.static(flags.panes):
            if scene.objects[point.object].kind == THIN_DIELECTRIC:
                cosine = -wp.dot(point.ns, direction)
                pane = pane_shares(
                    cosine, scene.objects[point.object].ior, scene.objects[point.object].reflectance
                )
                share = pane.passed
        return share

    @wp.func
    def stop(
        scene: SceneData,
        among: RaySet,
        first: Hit,
        direction: wp.vec3,
        key: wp.uint64,
        index: int,
        dimension: int,
    ) -> Stop:
        result = Stop()
        result.hit = first
        result.share = wp.vec3(1.0, 1.0, 1.0)
        travelled = float(0.0)
        left = float(1.0)
        choice = float(-1.0)
        for _ in range(wp.static(MOST_PASSED)):
            if result.hit.triangle < 0:
                break
            if (scene.triangles[result.hit.triangle].flags & SEE_THROUGH) == 0:
                break
            point = surface_point(scene, result.hit.triangle, result.hit.u, result.hit.v, direction)
            share = passing(scene, point, direction)
            most = max_component(share)
            if most < 1.0:
                left *= most
                if most <= 0.0:
                    break
                if choice < 0.0:
                    choice = sample_1d(key, index, dimension)
                if choice < 1.0 - left:
                    break
            if wp.static(flags.panes):
                result.share = wp.cw_mul(result.share, share / most)
            travelled += result.hit.t
            result.rays += 1
            result.hit = trace(among, ray_start(scene, point, direction), direction, FAR)
        result.hit.t += travelled
        return result

    @wp.func
    def transmittance(
        scene: SceneData, among: RaySet, origin: wp.vec3, direction: wp.vec3, tfar: float
    ) -> Transmitted:
        result = Transmitted()
        result.share = wp.vec3(1.0, 1.0, 1.0)
        unit = wp.normalize(direction)
        o = origin
        d = direction
        for _ in range(wp.static(MOST_PASSED)):
            result.rays += 1
            hit = trace(among, o, d, tfar)
            if hit.triangle < 0:
                return result
            if (scene.triangles[hit.triangle].flags & SEE_THROUGH) == 0:
                break
            point = surface_point(scene, hit.triangle, hit.u, hit.v, unit)
            result.share = wp.cw_mul(result.share, passing(scene, point, unit))
            if max_component(result.share) <= 0.0:
                break
            o = ray_start(scene, point, unit)
            if tfar < FAR:
                # To the same end, and not beyond it by what a start lies off.
                d = (origin + direction * tfar - o) / tfar
        result.share = wp.vec3(0.0, 0.0, 0.0)
        return result

    return SeeThrough(flags.see_through, stop, transmittance)
