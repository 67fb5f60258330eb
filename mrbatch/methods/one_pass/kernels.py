"""The kernel of one-pass differential path tracing.

Kan and Kaufmann, *High-Quality Reflections, Refractions, and Caustics in Augmented Reality* (2012) and
*Differential Progressive Path Tracing* (2013): what a real surface shows with virtual objects (L_m) and
without (L_r) is traced from one camera ray, in place of two pictures of the whole scene. Both paths have the
same random numbers at each vertex, so they run over the same vertices, each with its own visibility of the
light, until a ray meets a virtual object: there each goes its own way, L_m from the virtual point among all
objects, L_r from the real point behind it among real ones. A shadow ray is cast among all objects first, and
among real ones only if something is in its way.

Unlike delta path tracing both radiances are computed in full, so the environment is read wherever light
arrives, and not only where virtual objects keep it away.
"""

from __future__ import annotations

import functools
from typing import Any

import warp as wp

from mrbatch.device.rays import FAR, rays
from mrbatch.film.accumulator import FilmData, film_add, film_load, film_pixel, film_store
from mrbatch.film.path_pipeline import CameraPathFlags
from mrbatch.kernels.bsdf import make_bsdf
from mrbatch.kernels.camera import DIM_LENS, make_camera, through_lens
from mrbatch.kernels.environment import make_environment
from mrbatch.kernels.numerics import max_component, min_component, orthonormal_basis, to_local, to_world
from mrbatch.kernels.rng import make_sampler, pixel_key, unit_pair
from mrbatch.kernels.sampling import make_pixel_filter
from mrbatch.scene.counters import CAMERA_RAYS, LOOKUPS, SCATTER_RAYS, SHADOW_RAYS, VERTICES
from mrbatch.scene.frame_params import FrameParams
from mrbatch.scene.light_arrival import SKY, VIRTUAL_LAMP
from mrbatch.scene.light_paths import (
    DIM_PIXEL,
    DIM_ROULETTE,
    DIM_VERTEX,
    Leg,
    PathNumbers,
    make_paths,
)
from mrbatch.scene.ray_start import make_ray_start
from mrbatch.scene.scene_data import HOLDOUT, RECEIVE, VIRTUAL, SceneData, SurfacePoint, surface_point
from mrbatch.scene.see_through import DIM_STOP, STOPS, make_see_through
from mrbatch.scene.shading import PhotoReflectance, make_surface


@functools.cache
def make_kernel(flags: CameraPathFlags) -> Any:
    """The kernel for these flags: adds samples of one half to the film, one thread a pixel."""
    trace, occluded = rays(flags.engine).trace, rays(flags.engine).occluded
    bsdf = make_bsdf(flags.bsdf_kinds, masking=flags.masking)  # type: ignore[arg-type]
    bsdf_sample = bsdf.sample
    camera = make_camera(flags.camera_model, flags.distortion)  # type: ignore[arg-type]
    camera_ray = camera.ray
    environment = make_environment(flags.interpolation, flags.light_sampler)  # type: ignore[arg-type]
    env_radiance, env_pdf = environment.radiance, environment.pdf
    sampler = make_sampler(flags.sampler)  # type: ignore[arg-type]
    sample_1d, sample_2d = sampler.sample_1d, sampler.sample_2d
    sample_vertex, sample_start = sampler.sample_vertex, sampler.sample_start
    pixel_filter = make_pixel_filter(flags.pixel_filter)  # type: ignore[arg-type]
    surfaces = make_surface(flags.shading, camera)
    surface_at, normal_at = surfaces.surface, surfaces.normal
    paths = make_paths(flags)
    path, emission, survival = paths.path, paths.emission, paths.survival
    lights_at, draws, arrival = paths.lights_at, paths.arrivals.draws, paths.arrivals.arrival
    arrival_weight, arrival_radiance = paths.arrivals.weight, paths.arrivals.radiance
    scatter_weight, met_weight = paths.scatter_weight, paths.met_weight
    emitters, lamps = flags.shading.emission, flags.lamps != "none"
    ray_start = make_ray_start(flags.ray_start)
    see_through = make_see_through(flags.shading, trace, ray_start, sample_1d)
    stop_at, transmittance = see_through.stop, see_through.transmittance
    panes = flags.shading.panes

    @wp.func
    def change(
        scene: SceneData,
        photo: PhotoReflectance,
        numbers: PathNumbers,
        start: SurfacePoint,
        direction: wp.vec3,
        key: wp.uint64,
        index: int,
    ) -> Leg:
        """L_m - L_r of the real point `start`, seen along `direction`."""
        leg = Leg()
        mixed = wp.vec3(0.0, 0.0, 0.0)
        real = wp.vec3(0.0, 0.0, 0.0)
        mixed_set = scene.all_set
        throughput = wp.vec3(1.0, 1.0, 1.0)
        point = start
        d = direction
        edges = int(1)
        # Where the two paths part: 1 if L_m alone goes on, 2 if both do.
        legs = int(0)
        mixed_start = start
        if wp.static(panes):
            # Of what glass lets through, on the way to where the paths part.
            mixed_share = wp.vec3(1.0, 1.0, 1.0)
        real_start = start
        # Of what the points there emit: its share found by scattered rays.
        mixed_weight = float(1.0)
        real_weight = float(1.0)
        real_only = bool(False)
        while edges < numbers.max_edges:
            leg.vertices += 1
            dimension = DIM_VERTEX * edges
            if wp.static(flags.unreceptive):
                # Light that reaches such a point has not met virtual objects, nor will it before the sky.
                if (point.flags & RECEIVE) == 0:
                    mixed_set = scene.real_set
            if wp.static(lamps):
                real_only = mixed_set.scene == scene.real_set.scene
            surface = surface_at(scene, photo, point)
            if wp.static(flags.shading.normal_maps):
                point.ns = normal_at(scene, point, -d)
            basis = orthonormal_basis(point.ns)
            wo = to_local(basis, -d)
            lights = lights_at(numbers, edges)
            numbers_here = sample_vertex(key, index, dimension)
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
                    if wp.static(see_through.on):
                        through = transmittance(scene, mixed_set, light.start, light.ray, light.far)
                        leg.shadow_rays += through.rays - 1
                        mixed_open = max_component(through.share) > 0.0
                    else:
                        mixed_open = not occluded(mixed_set, light.start, light.ray, light.far)
                    # What is open among all objects is open among real ones.
                    real_open = mixed_open
                    if wp.static(lamps):
                        # Among real ones there is no virtual lamp.
                        real_open = real_open and light.sender != VIRTUAL_LAMP
                    if not mixed_open and light.sender != VIRTUAL_LAMP:
                        leg.shadow_rays += 1
                        real_open = not occluded(scene.real_set, light.start, light.ray, light.far)
                    if real_open or mixed_open:
                        if light.sender == SKY:
                            leg.lookups += 1
                        w = arrival_weight(surface, wo, light, lights)
                        arriving = (
                            wp.cw_mul(wp.cw_mul(throughput, light.value), arrival_radiance(scene, light)) * w
                        )
                        if real_open:
                            real += arriving
                        if mixed_open:
                            if wp.static(see_through.on):
                                arriving = wp.cw_mul(arriving, through.share)
                            mixed += arriving
            if max_component(drawn.weight) <= 0.0:
                break
            d = to_world(basis, drawn.wi)
            if wp.dot(point.ng, d) <= 0.0:
                break
            throughput = wp.cw_mul(throughput, drawn.weight)
            o = ray_start(scene, point, d)
            leg.scatter_rays += 1
            seen = trace(mixed_set, o, d, FAR)
            if wp.static(see_through.on):
                stop = stop_at(scene, mixed_set, seen, d, key, index, DIM_STOP + STOPS * edges)
                seen = stop.hit
                leg.scatter_rays += stop.rays
                if wp.static(panes):
                    mixed_share = stop.share
            behind = seen
            forks = bool(False)
            if seen.triangle >= 0:
                owner_flags = scene.triangles[seen.triangle].flags
                forks = (owner_flags & VIRTUAL) != 0
            if forks:
                leg.scatter_rays += 1
                behind = trace(scene.real_set, o, d, FAR)
            if behind.triangle < 0:
                w = scatter_weight(drawn.pdf, lights, env_pdf(scene.environment, d))
                if w > 0.0:
                    leg.lookups += 1
                    arriving = wp.cw_mul(throughput, env_radiance(scene.environment, d)) * w
                    real += arriving
                    if not forks:
                        if wp.static(panes):
                            arriving = wp.cw_mul(arriving, mixed_share)
                        mixed += arriving
            if seen.triangle < 0:
                break
            edges += 1
            if wp.static(panes):
                # What comes through glass of a colour goes ways of its own from here.
                forks = forks or min_component(mixed_share) < 1.0
            if forks:
                legs = 1
                mixed_start = surface_point(scene, seen.triangle, seen.u, seen.v, d)
                if wp.static(lamps):
                    mixed_weight = met_weight(scene, point.p, mixed_start, real_only, drawn.pdf, lights)
                if behind.triangle >= 0:
                    legs = 2
                    real_start = surface_point(scene, behind.triangle, behind.u, behind.v, d)
                    if wp.static(lamps):
                        real_weight = met_weight(scene, point.p, real_start, real_only, drawn.pdf, lights)
                break
            # What the point emits reaches both paths, and is no change.
            q = survival(throughput, edges, numbers)
            if q < 1.0:
                if sample_1d(key, index, dimension + DIM_ROULETTE) >= q:
                    break
                throughput = throughput / q
            point = surface_point(scene, seen.triangle, seen.u, seen.v, d)
        for side in range(legs):
            among = scene.all_set
            begin = mixed_start
            if side == 1:
                among = scene.real_set
                begin = real_start
            rest = path(scene, photo, numbers, among, begin, d, edges, key, index)
            leg.shadow_rays += rest.shadow_rays
            leg.scatter_rays += rest.scatter_rays
            leg.lookups += rest.lookups
            leg.vertices += rest.vertices
            if wp.static(emitters):
                rest.radiance += emission(scene, begin) * wp.where(side == 1, real_weight, mixed_weight)
            gathered = wp.cw_mul(throughput, rest.radiance)
            if side == 0:
                if wp.static(panes):
                    gathered = wp.cw_mul(gathered, mixed_share)
                mixed += gathered
            else:
                real += gathered
        leg.radiance = mixed - real
        return leg

    @wp.kernel(enable_backward=False, module="unique")
    def one_pass(
        scene: SceneData,
        frame: FrameParams,
        numbers: PathNumbers,
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
        background = film.background[pixel.index]
        key = pixel_key(frame.seed, frame.frame, frame.view, half, pixel.x, pixel.y)
        total = film_load(film, half, pixel.index)
        camera_rays = int(0)
        shadow_rays = int(0)
        scatter_rays = int(0)
        lookups = int(0)
        vertices = int(0)
        for n in range(samples):
            index = first_sample + n
            shift = pixel_filter(unit_pair(sample_start(key, index, DIM_PIXEL, DIM_VERTEX).pixel))
            primary = camera_ray(
                frame.camera, float(pixel.x) + 0.5 + shift[0], float(pixel.y) + 0.5 + shift[1]
            )
            if wp.static(flags.lens):
                primary = through_lens(frame.camera, primary, sample_2d(key, index, DIM_LENS))
            value = wp.vec3(0.0, 0.0, 0.0)
            delta = wp.vec3(0.0, 0.0, 0.0)
            covered = float(0.0)
            first_set = scene.camera_set
            if wp.static(not flags.virtual_seen):
                first_set = scene.photo_set
            hit = trace(first_set, primary.origin, primary.direction, FAR)
            if wp.static(see_through.on):
                met = stop_at(scene, first_set, hit, primary.direction, key, index, DIM_STOP)
                hit = met.hit
                camera_rays += met.rays
            if primary.ok and hit.triangle >= 0:
                point = surface_point(scene, hit.triangle, hit.u, hit.v, primary.direction)
                here = point.flags
                is_virtual = (here & VIRTUAL) != 0
                counts = is_virtual or wp.static(flags.light_change)
                if wp.static(flags.holdout):
                    counts = counts and (here & HOLDOUT) == 0
                if wp.static(flags.unreceptive):
                    counts = counts and (is_virtual or (here & RECEIVE) != 0)
                leg = Leg()
                if counts and is_virtual:
                    covered = 1.0
                    leg = path(
                        scene, frame.photo, numbers, scene.all_set, point, primary.direction, 1, key, index
                    )
                    if wp.static(emitters):
                        leg.radiance += emission(scene, point)
                    value = leg.radiance
                if wp.static(flags.light_change):
                    if counts and not is_virtual:
                        leg = change(scene, frame.photo, numbers, point, primary.direction, key, index)
                        delta = leg.radiance
                shadow_rays += leg.shadow_rays
                scatter_rays += leg.scatter_rays
                lookups += leg.lookups
                vertices += leg.vertices
            value = wp.cw_mul(value, frame.gain)
            delta = wp.cw_mul(delta, frame.gain)
            if wp.static(panes):
                value = wp.cw_mul(value, met.share)
                delta = wp.cw_mul(delta, met.share)
                if covered == 0.0:
                    delta += wp.cw_mul(background, met.share - wp.vec3(1.0, 1.0, 1.0))
            total = film_add(total, value, covered, delta, background)
        film_store(film, half, pixel.index, total, samples)
        wp.atomic_add(counters, CAMERA_RAYS, wp.int64(samples + camera_rays))
        wp.atomic_add(counters, SHADOW_RAYS, wp.int64(shadow_rays))
        wp.atomic_add(counters, SCATTER_RAYS, wp.int64(scatter_rays))
        wp.atomic_add(counters, LOOKUPS, wp.int64(lookups))
        wp.atomic_add(counters, VERTICES, wp.int64(vertices))

    return one_pass
