"""Where a ray among clear media ends, for kernels: it goes on through boundaries that are not there."""

from __future__ import annotations

from typing import Any

import warp as wp

from mrbatch.device.rays import FAR, Hit, RaySet
from mrbatch.kernels.bsdf import DIELECTRIC
from mrbatch.scene.media import Media, crossed, enters, medium_of, passed
from mrbatch.scene.scene_data import SceneData, surface_point
from mrbatch.scene.see_through import DIM_STOP, STOPS, SeeThrough

MOST_UNSEEN = 32
"""Boundaries inside denser media that one ray may pass."""


@wp.struct
class Onward:
    """Where a ray ends: the hit, the media it is in there, the share of light that comes through them, and
    further rays that this took."""

    hit: Hit
    media: Media
    passed: wp.vec3
    rays: wp.int32


def make_follow(trace: Any, ray_start: Any, see_through: SeeThrough) -> Any:
    """`wp.func` (scene, among, first, direction, media, key, index, edges) -> Onward."""
    stop_at = see_through.stop

    @wp.func
    def follow(
        scene: SceneData,
        among: RaySet,
        first: Hit,
        direction: wp.vec3,
        media: Media,
        key: wp.uint64,
        index: int,
        edges: int,
    ) -> Onward:
        """On from a ray's first hit, through boundaries at which the medium stays the same."""
        onward = Onward()
        onward.hit = first
        onward.media = media
        onward.passed = wp.vec3(1.0, 1.0, 1.0)
        medium = medium_of(scene, media)
        for number_of in range(wp.static(MOST_UNSEEN)):
            if onward.hit.triangle < 0:
                break
            onward.passed = wp.cw_mul(onward.passed, passed(scene, medium, onward.hit.t))
            number = scene.triangles[onward.hit.triangle].object
            if scene.objects[number].kind != DIELECTRIC:
                break
            point = surface_point(scene, onward.hit.triangle, onward.hit.u, onward.hit.v, direction)
            beyond = crossed(onward.media, number, enters(scene, point))
            if medium_of(scene, beyond) != medium:
                break
            onward.media = beyond
            onward.rays += 1
            onward.hit = trace(among, ray_start(scene, point, direction), direction, FAR)
            if wp.static(see_through.on):
                dimension = DIM_STOP + STOPS * edges + 1 + number_of
                stop = stop_at(scene, among, onward.hit, direction, key, index, dimension)
                onward.hit = stop.hit
                onward.rays += stop.rays
                onward.passed = wp.cw_mul(onward.passed, stop.share)
        return onward

    return follow
