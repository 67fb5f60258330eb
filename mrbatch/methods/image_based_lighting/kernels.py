"""The kernel of image-based lighting: one scattering of light from map and lamps on virtual objects.

Debevec, *Rendering Synthetic Objects into Real Scenes* (1998), without its differential part: the
baseline against which every method that changes the real scene is compared. Without `occlusion` lamps alone
stand in the way of lamps.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import warp as wp

from mrbatch.device.rays import FAR, Engine, RaySet, rays
from mrbatch.film.accumulator import FilmData, film_add, film_load, film_pixel, film_store
from mrbatch.kernels.bsdf import make_bsdf
from mrbatch.kernels.camera import DIM_LENS, make_camera, through_lens
from mrbatch.kernels.environment import make_environment
from mrbatch.kernels.numerics import (
    balance_heuristic,
    max_component,
    orthonormal_basis,
    to_local,
    to_world,
)
from mrbatch.kernels.rng import make_sampler, pixel_key, unit_pair
from mrbatch.kernels.sampling import make_pixel_filter
from mrbatch.scene.frame_params import FrameParams
from mrbatch.scene.lamps import lamp_pdf, lamp_ray, make_lamp_weights
from mrbatch.scene.light_arrival import DIM_LAMP
from mrbatch.scene.media import enters
from mrbatch.scene.ray_start import make_ray_start
from mrbatch.scene.scene_data import HOLDOUT, VIRTUAL, SceneData, surface_point
from mrbatch.scene.see_through import DIM_STOP, STOPS, make_see_through
from mrbatch.scene.shading import ShadingFlags, make_surface

DIM_PIXEL = wp.constant(wp.int32(0))
DIM_VERTEX = wp.constant(wp.int32(8))


@dataclass(frozen=True)
class Flags:
    """What a shot calls for; each that is off leaves no code in the kernel."""

    engine: Engine = "embree"
    bsdf_kinds: frozenset[str] = frozenset({"diffuse"})
    masking: str = "height-correlated"
    ray_start: str = "exact"
    camera_model: str = "perspective"
    distortion: bool = False
    interpolation: str = "bilinear"
    sampler: str = "owen"
    light_sampler: str = "median-cut"
    pixel_filter: str = "box"
    strategy: str = "mis"
    lamps: str = "none"
    shading: ShadingFlags = ShadingFlags()
    occlusion: bool = False
    lens: bool = False


@functools.cache
def make_kernel(flags: Flags) -> Any:
    """The kernel for these flags: adds samples of one half to the film, one thread a pixel."""
    trace, occluded = rays(flags.engine).trace, rays(flags.engine).occluded
    bsdf = make_bsdf(flags.bsdf_kinds, masking=flags.masking)  # type: ignore[arg-type]
    bsdf_evaluate, bsdf_pdf, bsdf_sample = bsdf.evaluate, bsdf.pdf, bsdf.sample
    camera = make_camera(flags.camera_model, flags.distortion)  # type: ignore[arg-type]
    camera_ray = camera.ray
    environment = make_environment(flags.interpolation, flags.light_sampler)  # type: ignore[arg-type]
    env_radiance, env_pdf, env_sample = environment.radiance, environment.pdf, environment.sample
    sampler = make_sampler(flags.sampler)  # type: ignore[arg-type]
    sample_start, sample_2d = sampler.sample_start, sampler.sample_2d
    sample_2d_bits = sampler.sample_2d_bits
    ray_start = make_ray_start(flags.ray_start)
    see_through = make_see_through(flags.shading, trace, ray_start, sampler.sample_1d)
    stop_at, transmittance = see_through.stop, see_through.transmittance
    pixel_filter = make_pixel_filter(flags.pixel_filter)  # type: ignore[arg-type]
    surfaces = make_surface(flags.shading, camera)
    surface_at, normal_at, emission_at = surfaces.surface, surfaces.normal, surfaces.emission
    sample_light = flags.strategy in ("mis", "environment")
    sample_scatter = flags.strategy in ("mis", "bsdf")
    weigh = flags.strategy == "mis"
    emitters, lamps = flags.shading.emission, flags.lamps != "none"
    lamp_over_pdf, lamp_scattered = make_lamp_weights(flags.lamps)

    @wp.func
    def lit_by(scene: SceneData) -> RaySet:
        if wp.static(flags.occlusion):
            return scene.all_set
        return scene.lamp_set

    @wp.kernel(enable_backward=False, module="unique")
    def image_based_lighting(
        scene: SceneData,
        frame: FrameParams,
        film: FilmData,
        units: wp.array(dtype=wp.int32),
        first_unit: int,
        half: int,
        first_sample: int,
        samples: int,
        counters: wp.array(dtype=wp.int64),
    ):
        thread = wp.tid()
        pixel = film_pixel(film, units[first_unit + (thread >> 8)], thread & 255)
        if pixel.index < 0:
            return
        key = pixel_key(frame.seed, frame.frame, frame.view, half, pixel.x, pixel.y)
        total = film_load(film, half, pixel.index)
        camera_rays = int(0)
        shadow_rays = int(0)
        lookups = int(0)
        vertices = int(0)
        for n in range(samples):
            index = first_sample + n
            start = sample_start(key, index, DIM_PIXEL, DIM_VERTEX)
            shift = pixel_filter(unit_pair(start.pixel))
            primary = camera_ray(
                frame.camera, float(pixel.x) + 0.5 + shift[0], float(pixel.y) + 0.5 + shift[1]
            )
            if wp.static(flags.lens):
                primary = through_lens(frame.camera, primary, sample_2d(key, index, DIM_LENS))
            value = wp.vec3(0.0, 0.0, 0.0)
            covered = float(0.0)
            hit = trace(scene.camera_set, primary.origin, primary.direction, FAR)
            change = wp.vec3(0.0, 0.0, 0.0)
            if wp.static(see_through.on):
                met = stop_at(scene, scene.camera_set, hit, primary.direction, key, index, DIM_STOP)
                hit = met.hit
                camera_rays += met.rays
            if primary.ok and hit.triangle >= 0:
                point = surface_point(scene, hit.triangle, hit.u, hit.v, primary.direction)
                here = point.flags
                if (here & VIRTUAL) != 0 and (here & HOLDOUT) == 0:
                    covered = 1.0
                    vertices += 1
                    if wp.static(flags.shading.emission):
                        value = emission_at(scene, point)
                    surface = surface_at(scene, frame.photo, point)
                    if wp.static(flags.shading.normal_maps):
                        point.ns = normal_at(scene, point, -primary.direction)
                    basis = orthonormal_basis(point.ns)
                    wo = to_local(basis, -primary.direction)
                    if wp.static(flags.shading.transmission):
                        surface.eta = scene.objects[point.object].ior
                        if not enters(scene, point):
                            surface.eta = 1.0 / surface.eta
                    if wp.static(sample_light):
                        light = env_sample(scene.environment, start.vertex.light)
                        if light.pdf > 0.0 and wp.dot(point.ng, light.direction) > 0.0:
                            wi = to_local(basis, light.direction)
                            f = bsdf_evaluate(surface, wo, wi)
                            open = max_component(f) > 0.0
                            if wp.static(flags.occlusion):
                                if open:
                                    shadow_rays += 1
                                    o = ray_start(scene, point, light.direction)
                                    if wp.static(see_through.on):
                                        through = transmittance(scene, scene.all_set, o, light.direction, FAR)
                                        shadow_rays += through.rays - 1
                                        f = wp.cw_mul(f, through.share)
                                        open = max_component(through.share) > 0.0
                                    else:
                                        open = not occluded(scene.all_set, o, light.direction, FAR)
                            if open:
                                lookups += 1
                                w = 1.0 / light.pdf
                                if wp.static(weigh):
                                    w *= balance_heuristic(light.pdf, bsdf_pdf(surface, wo, wi))
                                value += wp.cw_mul(f, env_radiance(scene.environment, light.direction)) * w
                    if wp.static(lamps):
                        bits = sample_2d_bits(key, index, DIM_VERTEX + DIM_LAMP)
                        lamp = lamp_ray(scene, point, bits, False)
                        if lamp.pdf > 0.0 and wp.dot(point.ng, lamp.direction) > 0.0:
                            wi = to_local(basis, lamp.direction)
                            f = wp.cw_mul(bsdf_evaluate(surface, wo, wi), emission_at(scene, lamp.point))
                            if max_component(f) > 0.0:
                                shadow_rays += 1
                                o = ray_start(scene, point, lamp.direction)
                                if wp.static(see_through.on):
                                    between = transmittance(scene, lit_by(scene), o, lamp.end - o, 1.0)
                                    shadow_rays += between.rays - 1
                                    f = wp.cw_mul(f, between.share)
                                    clear = max_component(between.share) > 0.0
                                else:
                                    clear = not occluded(lit_by(scene), o, lamp.end - o, 1.0)
                                if clear:
                                    value += f * lamp_over_pdf(1, lamp.pdf, bsdf_pdf(surface, wo, wi))
                    if wp.static(sample_scatter or emitters):
                        drawn = bsdf_sample(surface, wo, unit_pair(start.vertex.scatter))
                        d = to_world(basis, drawn.wi)
                        lit = max_component(drawn.weight) > 0.0 and wp.dot(point.ng, d) * drawn.wi[2] > 0.0
                        if wp.static(flags.shading.transmission):
                            if drawn.wi[2] < 0.0:
                                # The map as it is seen through one boundary: what light leaves by is unknown.
                                drawn.weight = drawn.weight * surface.eta * surface.eta
                        if wp.static(emitters):
                            if lit and drawn.wi[2] > 0.0:
                                shadow_rays += 1
                                seen = trace(lit_by(scene), ray_start(scene, point, d), d, FAR)
                                sent_on = drawn.weight
                                if wp.static(see_through.on):
                                    place = DIM_STOP + STOPS
                                    end = stop_at(scene, lit_by(scene), seen, d, key, index, place)
                                    seen = end.hit
                                    shadow_rays += end.rays
                                    sent_on = wp.cw_mul(sent_on, end.share)
                                    if wp.static(flags.occlusion):
                                        drawn.weight = sent_on
                                if seen.triangle >= 0:
                                    met = surface_point(scene, seen.triangle, seen.u, seen.v, d)
                                    sent = emission_at(scene, met)
                                    if max_component(sent) > 0.0:
                                        w = lamp_scattered(drawn.pdf, 1, lamp_pdf(scene, point.p, met, False))
                                        value += wp.cw_mul(sent_on, sent) * w
                                    if wp.static(flags.occlusion):
                                        lit = False
                        elif wp.static(flags.occlusion):
                            if lit and drawn.wi[2] > 0.0:
                                shadow_rays += 1
                                o = ray_start(scene, point, d)
                                if wp.static(see_through.on):
                                    past = transmittance(scene, scene.all_set, o, d, FAR)
                                    shadow_rays += past.rays - 1
                                    drawn.weight = wp.cw_mul(drawn.weight, past.share)
                                    lit = max_component(past.share) > 0.0
                                else:
                                    lit = not occluded(scene.all_set, o, d, FAR)
                        if wp.static(sample_scatter):
                            if lit:
                                lookups += 1
                                w = 1.0
                                if wp.static(weigh):
                                    w = balance_heuristic(drawn.pdf, env_pdf(scene.environment, d))
                                value += wp.cw_mul(drawn.weight, env_radiance(scene.environment, d)) * w
            if wp.static(flags.shading.panes):
                value = wp.cw_mul(value, met.share)
                if covered == 0.0:
                    change = wp.cw_mul(film.background[pixel.index], met.share - wp.vec3(1.0, 1.0, 1.0))
            total = film_add(
                total, wp.cw_mul(value, frame.gain), covered, change, film.background[pixel.index]
            )
        film_store(film, half, pixel.index, total, samples)
        wp.atomic_add(counters, 0, wp.int64(samples + camera_rays))
        wp.atomic_add(counters, 1, wp.int64(shadow_rays))
        wp.atomic_add(counters, 2, wp.int64(0))
        wp.atomic_add(counters, 3, wp.int64(lookups))
        wp.atomic_add(counters, 4, wp.int64(vertices))

    return image_based_lighting
