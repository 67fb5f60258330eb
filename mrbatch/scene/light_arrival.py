"""Light that may arrive at a vertex of a path, for kernels: one of the directions that it asks for, to the
map or to a lamp, with the ray that tells whether anything is in the way. What is in the way matters to each
kernel in its own manner, so that the ray is theirs to cast, and what arrives is found only where it does.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import warp as wp

from mrbatch.device.rays import FAR
from mrbatch.kernels.bsdf import Surface
from mrbatch.kernels.numerics import max_component, to_local
from mrbatch.kernels.rng import VertexNumbers
from mrbatch.scene.lamps import is_virtual, lamp_ray
from mrbatch.scene.scene_data import SceneData, SurfacePoint
from mrbatch.scene.see_through import opacity_at

DIM_LAMP = wp.constant(wp.int32(4))
"""Dimension, within those of a vertex, of the numbers that draw a point on a lamp."""

SKY = wp.constant(wp.int32(0))
REAL_LAMP = wp.constant(wp.int32(1))
VIRTUAL_LAMP = wp.constant(wp.int32(2))


@wp.struct
class Arrival:
    """`value`: f cos of the surface for light from there, 0 where none can come. The ray from `start` along
    `ray` (any length) up to `far` times its length tells what is in the way. `sender`: SKY, REAL_LAMP or
    VIRTUAL_LAMP. `wi`: the direction in the frame of the surface; `direction`: in the world, unit; `pdf`,
    `share` as in `LightDirection`. Of a lamp: its `radiance`, and its `distance`."""

    value: wp.vec3
    start: wp.vec3
    ray: wp.vec3
    far: float
    sender: wp.int32
    direction: wp.vec3
    wi: wp.vec3
    pdf: float
    share: float
    radiance: wp.vec3
    distance: float


@dataclass(frozen=True)
class ArrivalFuncs:
    """`draws(count) -> int`: how many directions a vertex asks for, `count` to the map and as many to lamps.
    `arrival(scene, surface, basis, wo, point, real_only, drawn, key, index, number, count, dimension) ->
    Arrival`: one of them; `real_only`: only real objects are there. `weight(surface, wo, arrival, count) ->
    float` and `radiance(scene, arrival) -> vec3`: what arrives is value times radiance times weight."""

    draws: Any
    arrival: Any
    weight: Any
    radiance: Any


def make_arrivals(
    *,
    sky: bool,
    lamps: bool,
    light_direction: Any,
    light_weight: Any,
    lamp_over_pdf: Any,
    env_radiance: Any,
    emission_at: Any,
    evaluate: Any,
    scatter_pdf: Any,
    sample_2d_bits: Any,
    ray_start: Any,
    transmission: bool,
    cutouts: bool,
) -> ArrivalFuncs:
    """The functions; `sky` and `lamps`: where directions are drawn to."""
    kinds = int(sky) + int(lamps)

    @wp.func
    def draws(count: int) -> int:
        return count * wp.static(kinds)

    @wp.func
    def faces(point: SurfacePoint, direction: wp.vec3) -> bool:
        side = wp.dot(point.ng, direction)
        if wp.static(transmission):
            side *= wp.dot(point.ns, direction)
        return side > 0.0

    @wp.func
    def arrival(
        scene: SceneData,
        surface: Surface,
        basis: wp.mat33,
        wo: wp.vec3,
        point: SurfacePoint,
        real_only: bool,
        drawn: VertexNumbers,
        key: wp.uint64,
        index: int,
        number: int,
        count: int,
        dimension: int,
    ) -> Arrival:
        found = Arrival()
        if wp.static(sky):
            if number < count:
                light = light_direction(
                    scene.environment,
                    surface,
                    basis,
                    wo,
                    point.ng,
                    drawn,
                    key,
                    index,
                    number,
                    count,
                    dimension,
                )
                if light.pdf > 0.0 and faces(point, light.direction):
                    found.direction = light.direction
                    found.wi = to_local(basis, light.direction)
                    found.value = evaluate(surface, wo, found.wi)
                    found.pdf = light.pdf
                    found.share = light.share
                    if max_component(found.value) > 0.0:
                        found.start = ray_start(scene, point, light.direction)
                        found.ray = light.direction
                        found.far = FAR
        if wp.static(lamps):
            if number >= wp.static(int(sky)) * count:
                place = index * count + number - wp.static(int(sky)) * count
                lamp = lamp_ray(scene, point, sample_2d_bits(key, place, dimension + DIM_LAMP), real_only)
                if lamp.pdf > 0.0 and faces(point, lamp.direction):
                    found.direction = lamp.direction
                    found.wi = to_local(basis, lamp.direction)
                    found.value = evaluate(surface, wo, found.wi)
                    found.pdf = lamp.pdf
                    found.share = 1.0
                    found.distance = lamp.distance
                    found.sender = REAL_LAMP
                    if is_virtual(lamp.point):
                        found.sender = VIRTUAL_LAMP
                    if max_component(found.value) > 0.0:
                        found.start = ray_start(scene, point, lamp.direction)
                        found.ray = lamp.end - found.start
                        found.far = 1.0
                        found.radiance = emission_at(scene, lamp.point)
                        if wp.static(cutouts):
                            # As often as a scattered ray stops there.
                            found.radiance *= opacity_at(scene, lamp.point)
                        if max_component(found.radiance) <= 0.0:
                            found.value = wp.vec3(0.0, 0.0, 0.0)
        return found

    @wp.func
    def weight(surface: Surface, wo: wp.vec3, found: Arrival, count: int) -> float:
        scatter = scatter_pdf(surface, wo, found.wi)
        if wp.static(lamps):
            if found.sender != SKY:
                return lamp_over_pdf(count, found.pdf, scatter)
        return light_weight(count, found.pdf, scatter) / found.pdf * found.share

    @wp.func
    def radiance(scene: SceneData, found: Arrival) -> wp.vec3:
        if wp.static(lamps):
            if found.sender != SKY:
                return found.radiance
        return env_radiance(scene.environment, found.direction)

    return ArrivalFuncs(draws, arrival, weight, radiance)
