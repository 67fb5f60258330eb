"""What methods that trace light paths share: the leg of a path, its weights and its end, for kernels.

A *leg* is the radiance that leaves a surface point, by unidirectional path tracing among the objects of
one ray set: at every vertex the environment and what emits are sampled and the surface scatters, with the
balance heuristic between directions to light and scattered ones (Veach and Guibas, 1995). Its random numbers
are those of its place on the path, so that two legs of the same length from the camera have common ones.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import warp as wp

from mrbatch.device.rays import FAR, Engine, RaySet, rays
from mrbatch.kernels.bsdf import DIELECTRIC, make_bsdf
from mrbatch.kernels.camera import make_camera
from mrbatch.kernels.environment import make_environment
from mrbatch.kernels.numerics import (
    balance_heuristic_counts,
    max_component,
    orthonormal_basis,
    to_local,
    to_world,
)
from mrbatch.kernels.rng import VertexNumbers, make_sampler, unit_pair
from mrbatch.scene.lamps import lamp_pdf, make_lamp_weights
from mrbatch.scene.light_arrival import SKY, ArrivalFuncs, make_arrivals
from mrbatch.scene.light_candidates import make_light_direction
from mrbatch.scene.media import Media, crossed, enters, index_of, medium_of, passed
from mrbatch.scene.onward import make_follow
from mrbatch.scene.ray_start import make_ray_start
from mrbatch.scene.scene_data import RECEIVE, SceneData, SurfacePoint, surface_point
from mrbatch.scene.see_through import DIM_STOP, STOPS, make_see_through
from mrbatch.scene.shading import PhotoReflectance, ShadingFlags, make_surface

DIM_PIXEL = wp.constant(wp.int32(0))
DIM_VERTEX = wp.constant(wp.int32(8))
"""Dimensions of a vertex begin at this times the edges before it: directions to the map and scattered ones at
0 and 1, roulette at 2, a choice among candidates at 3, points on lamps at 4."""
DIM_ROULETTE = wp.constant(wp.int32(2))
ROULETTE_MOST = wp.constant(wp.float32(0.95))
"""A path survives roulette at most this often, so that it ends even among white walls."""
ROULETTE_LEAST = wp.constant(wp.float32(0.05))
UNLIMITED = 1 << 20
"""Edges that no path reaches."""


@dataclass(frozen=True)
class PathFlags:
    """What a shot calls for on its light paths; each that is off leaves no code in a kernel."""

    engine: Engine = "embree"
    bsdf_kinds: frozenset[str] = frozenset({"diffuse"})
    masking: str = "height-correlated"
    camera_model: str = "perspective"
    distortion: bool = False
    interpolation: str = "bilinear"
    sampler: str = "owen"
    light_sampler: str = "median-cut"
    strategy: str = "mis"
    lamps: str = "none"
    """How light of objects that emit is sampled (`scene.lamps.lamp_strategy`)."""
    shading: ShadingFlags = ShadingFlags()
    several_lights: bool = False
    """More than one direction to light is drawn where the camera's ray ends."""
    light_candidates: int = 1
    """Of so many directions from the environment one is chosen."""
    ray_start: str = "exact"
    unreceptive: bool = False
    """Some object takes no light change from virtual objects."""


@wp.struct
class PathNumbers:
    """Numbers of the estimator. `max_edges`: longest path in edges, the camera's included.
    `roulette_from`: edges from which roulette may end a path. `light_samples`: directions drawn from the
    environment, and to lamps, where the camera's ray ends."""

    max_edges: wp.int32
    roulette_from: wp.int32
    light_samples: wp.int32


def path_numbers(max_depth: int | None, roulette_depth: int, light_samples: int) -> Any:
    """`PathNumbers`: a path that is cut at a length is cut there alone, never by roulette."""
    numbers = PathNumbers()
    numbers.max_edges = max_depth or UNLIMITED
    numbers.roulette_from = UNLIMITED if max_depth else roulette_depth
    numbers.light_samples = light_samples
    return numbers


@wp.struct
class Leg:
    """What a leg gathered, and the work it took."""

    radiance: wp.vec3
    shadow_rays: wp.int32
    scatter_rays: wp.int32
    lookups: wp.int32
    vertices: wp.int32


@dataclass(frozen=True)
class PathFuncs:
    """`wp.func`s of light paths.

    `path(scene, photo, numbers, among, start, direction, edges, key, index) -> Leg`: the radiance that
    leaves `start` against `direction`, but for what `start` emits itself, traced among the objects of the ray
    set `among`; `edges`: those of the path from the camera to `start`. `emission(scene, point)`: what a
    surface emits. `lights_at(numbers, edges)`: directions drawn from the environment at a vertex, and as many
    to lamps; the directions themselves: `arrivals` (`scene.light_arrival`). `light_weight(count, light_pdf,
    scatter_pdf)`: weight of one of `count` directions drawn from the map; `scatter_weight(scatter_pdf, count,
    light_pdf)`: of a scattered one that meets the sky; `met_weight(scene, x, met,
    real_only, scatter_pdf, count)`: of one from `x` that meets the surface `met`, for what that emits.
    `survival(throughput, edges, numbers)`: how probably the path goes on.
    """

    path: Any
    emission: Any
    lights_at: Any
    arrivals: ArrivalFuncs
    light_weight: Any
    scatter_weight: Any
    met_weight: Any
    survival: Any


def make_paths(flags: PathFlags) -> PathFuncs:
    """The functions for these flags."""
    trace, occluded = rays(flags.engine).trace, rays(flags.engine).occluded
    bsdf = make_bsdf(flags.bsdf_kinds, masking=flags.masking)  # type: ignore[arg-type]
    bsdf_evaluate, bsdf_pdf, bsdf_sample = bsdf.evaluate, bsdf.pdf, bsdf.sample
    environment = make_environment(flags.interpolation, flags.light_sampler)  # type: ignore[arg-type]
    env_radiance, env_pdf, env_sample = environment.radiance, environment.pdf, environment.sample
    sampler = make_sampler(flags.sampler)  # type: ignore[arg-type]
    sample_1d, sample_2d_bits, sample_vertex = (
        sampler.sample_1d,
        sampler.sample_2d_bits,
        sampler.sample_vertex,
    )
    camera = make_camera(flags.camera_model, flags.distortion)  # type: ignore[arg-type]
    surfaces = make_surface(flags.shading, camera)
    surface_at, normal_at, emission_at = surfaces.surface, surfaces.normal, surfaces.emission
    ray_start = make_ray_start(flags.ray_start)
    see_through = make_see_through(flags.shading, trace, ray_start, sample_1d)
    stop_at, transmittance = see_through.stop, see_through.transmittance
    follow = make_follow(trace, ray_start, see_through)
    sample_light = flags.strategy in ("mis", "environment")
    weigh = flags.strategy == "mis"
    lamps = flags.lamps != "none"
    lamp_over_pdf, lamp_scattered = make_lamp_weights(flags.lamps)

    @wp.func
    def light_weight(count: int, light_pdf: float, scatter_pdf: float) -> float:
        # Weight of one of `count` directions drawn from the environment.
        n = float(count * wp.static(flags.light_candidates))
        if wp.static(weigh):
            return balance_heuristic_counts(n, light_pdf, 1.0, scatter_pdf) / n
        return 1.0 / n

    @wp.func
    def scatter_weight(scatter_pdf: float, count: int, light_pdf: float) -> float:
        if wp.static(weigh):
            n = float(count * wp.static(flags.light_candidates))
            return balance_heuristic_counts(1.0, scatter_pdf, n, light_pdf)
        return wp.where(wp.static(sample_light), 0.0, 1.0)

    @wp.func
    def lights_at(numbers: PathNumbers, edges: int) -> int:
        # Where the camera's ray ends, several: what they find is seen directly.
        if wp.static(flags.several_lights):
            return wp.where(edges == 1, numbers.light_samples, 1)
        return 1

    @wp.func
    def light_bits(
        drawn: VertexNumbers, key: wp.uint64, index: int, number: int, count: int, dimension: int
    ) -> wp.vec2ui:
        if wp.static(flags.several_lights or flags.light_candidates > 1):
            return sample_2d_bits(key, index * count + number, dimension)
        return drawn.light

    light_direction = make_light_direction(
        flags.light_candidates,
        env_sample=env_sample,
        evaluate=bsdf_evaluate,
        scatter_pdf=bsdf_pdf,
        light_bits=light_bits,
        light_weight=light_weight,
        sample_1d=sample_1d,
        transmission=flags.shading.transmission,
    )
    arrivals = make_arrivals(
        sky=sample_light,
        lamps=lamps,
        light_direction=light_direction,
        light_weight=light_weight,
        lamp_over_pdf=lamp_over_pdf,
        env_radiance=env_radiance,
        emission_at=emission_at,
        evaluate=bsdf_evaluate,
        scatter_pdf=bsdf_pdf,
        sample_2d_bits=sample_2d_bits,
        ray_start=ray_start,
        transmission=flags.shading.transmission,
        cutouts=flags.shading.cutouts,
    )
    draws, arrival = arrivals.draws, arrivals.arrival
    arrival_weight, arrival_radiance = arrivals.weight, arrivals.radiance

    @wp.func
    def met_weight(
        scene: SceneData, x: wp.vec3, met: SurfacePoint, real_only: bool, scatter_pdf: float, count: int
    ) -> float:
        if wp.static(lamps):
            return lamp_scattered(scatter_pdf, count, lamp_pdf(scene, x, met, real_only))
        return 1.0

    @wp.func
    def survival(throughput: wp.vec3, edges: int, numbers: PathNumbers) -> float:
        if edges < numbers.roulette_from:
            return 1.0
        return wp.clamp(max_component(throughput), ROULETTE_LEAST, ROULETTE_MOST)

    @wp.func
    def path(
        scene: SceneData,
        photo: PhotoReflectance,
        numbers: PathNumbers,
        among: RaySet,
        start: SurfacePoint,
        direction: wp.vec3,
        edges_so_far: int,
        key: wp.uint64,
        index: int,
    ) -> Leg:
        """Radiance that `start` sends on against `direction`, traced among the objects of one ray set.

        `edges_so_far`: edges of the path from the camera to `start`.
        """
        leg = Leg()
        throughput = wp.vec3(1.0, 1.0, 1.0)
        point = start
        d = direction
        edges = int(edges_so_far)
        scene_set = among
        media = Media()
        # A set without virtual objects: only real lamps are there.
        real_only = bool(False)
        while edges < numbers.max_edges:
            leg.vertices += 1
            dimension = DIM_VERTEX * edges
            if wp.static(flags.unreceptive):
                # Light that reaches such a point has not met virtual objects, nor will it before the sky.
                if (point.flags & RECEIVE) == 0:
                    scene_set = scene.real_set
            if wp.static(lamps):
                real_only = scene_set.scene == scene.real_set.scene
            surface = surface_at(scene, photo, point)
            if wp.static(flags.shading.normal_maps):
                point.ns = normal_at(scene, point, -d)
            basis = orthonormal_basis(point.ns)
            wo = to_local(basis, -d)
            if wp.static(flags.shading.transmission):
                clear = scene.objects[point.object].kind == DIELECTRIC
                beyond = media
                if clear:
                    beyond = crossed(media, point.object, enters(scene, point))
                    surface.eta = index_of(scene, medium_of(scene, beyond)) / index_of(
                        scene, medium_of(scene, media)
                    )
                    if surface.eta == 1.0:
                        # Nothing to bend light: a rough boundary's facets would divide by 0.
                        surface.alpha = 0.0
            lights = lights_at(numbers, edges)
            numbers_here = sample_vertex(key, index, dimension)
            # Before the light's ray, so that a processor works on both directions at once.
            drawn = bsdf_sample(surface, wo, unit_pair(numbers_here.scatter))
            for number in range(draws(lights)):
                light = arrival(
                    scene,
                    surface,
                    basis,
                    wo,
                    point,
                    real_only,
                    numbers_here,
                    key,
                    index,
                    number,
                    lights,
                    dimension,
                )
                if max_component(light.value) > 0.0:
                    leg.shadow_rays += 1
                    value = light.value
                    if wp.static(see_through.on):
                        through = transmittance(scene, scene_set, light.start, light.ray, light.far)
                        leg.shadow_rays += through.rays - 1
                        value = wp.cw_mul(value, through.share)
                        open = max_component(through.share) > 0.0
                    else:
                        open = not occluded(scene_set, light.start, light.ray, light.far)
                    if open:
                        if light.sender == SKY:
                            leg.lookups += 1
                        if wp.static(lamps and flags.shading.transmission):
                            if light.sender != SKY:
                                around = media
                                if light.wi[2] < 0.0:
                                    around = beyond
                                left = passed(scene, medium_of(scene, around), light.distance)
                                value = wp.cw_mul(value, left)
                        w = arrival_weight(surface, wo, light, lights)
                        leg.radiance += (
                            wp.cw_mul(wp.cw_mul(throughput, value), arrival_radiance(scene, light)) * w
                        )
            if max_component(drawn.weight) <= 0.0:
                break
            d = to_world(basis, drawn.wi)
            leaving = wp.dot(point.ng, d)
            if wp.static(flags.shading.transmission):
                leaving *= drawn.wi[2]
            if leaving <= 0.0:
                break
            throughput = wp.cw_mul(throughput, drawn.weight)
            leg.scatter_rays += 1
            o = ray_start(scene, point, d)
            hit = trace(scene_set, o, d, FAR)
            if wp.static(see_through.on):
                stop = stop_at(scene, scene_set, hit, d, key, index, DIM_STOP + STOPS * edges)
                hit = stop.hit
                leg.scatter_rays += stop.rays
                throughput = wp.cw_mul(throughput, stop.share)
            if wp.static(flags.shading.transmission):
                if clear and drawn.wi[2] < 0.0:
                    media = beyond
                onward = follow(scene, scene_set, hit, d, media, key, index, edges)
                hit = onward.hit
                media = onward.media
                leg.scatter_rays += onward.rays
                throughput = wp.cw_mul(throughput, onward.passed)
            if hit.triangle < 0:
                w = scatter_weight(drawn.pdf, lights, env_pdf(scene.environment, d))
                if w > 0.0:
                    leg.lookups += 1
                    leg.radiance += wp.cw_mul(throughput, env_radiance(scene.environment, d)) * w
                break
            edges += 1
            if wp.static(flags.shading.emission):
                met = surface_point(scene, hit.triangle, hit.u, hit.v, d)
                sent = emission_at(scene, met)
                if max_component(sent) > 0.0:
                    w = met_weight(scene, point.p, met, real_only, drawn.pdf, lights)
                    if wp.static(lamps and flags.shading.transmission):
                        if onward.rays > 0:
                            # A ray to the lamp would have ended at the boundaries that this one passed.
                            w = 1.0
                    leg.radiance += wp.cw_mul(throughput, sent) * w
            q = survival(throughput, edges, numbers)
            if q < 1.0:
                if sample_1d(key, index, dimension + DIM_ROULETTE) >= q:
                    break
                throughput = throughput / q
            point = surface_point(scene, hit.triangle, hit.u, hit.v, d)
        return leg

    return PathFuncs(
        path, emission_at, lights_at, arrivals, light_weight, scatter_weight, met_weight, survival
    )
