"""The kernel of delta path tracing.

After Xu et al., *Delta Path Tracing for Real-Time Global Illumination in Mixed Reality*, corrected.
The paper's Algorithm 1 subtracts, at the first real hit, all light that any surface blocks, adds
what later bounces gather, and is right for one empty plane only. Here the light change of a real
point is taken for what it is,

    Delta(x) = integral f cos (L_m - L_r),

with L_m the radiance with, L_r without virtual objects, and the nearest hit in real and virtual
geometry is compared with the nearest hit in real geometry:

- sky in both: nothing changes, the path ends and nothing is gathered;
- the same real point y: the change goes on there, Delta(y);
- a virtual point y_V in front: the path forks; + L_m(y_V), traced among all objects, and - L_r of
  what lay behind (a real point, traced among real objects alone, or the sky), both legs with common
  random numbers;
- the same real point or the sky, through glass of a colour: s L_m - L_r, s the share that passes.

Of virtual surfaces that are there in part, the nearest is what a ray stops at (`scene.see_through`).

Light from the sky that virtual objects block on the way, -f cos L_s V_R (1 - V_V), comes by sampling
the environment and by the same scattered ray, with the balance heuristic. So does that of real lamps, and
the light that virtual lamps add, + f cos L_e V_R V_V: points are drawn on both. Every leg is cut by
roulette, or at equal path length on both sides, so a cap does not darken.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import warp as wp

from mrbatch.device.rays import FAR, RaySet, rays
from mrbatch.film.accumulator import FilmData, film_add, film_load, film_pixel, film_store
from mrbatch.film.path_pipeline import CameraPathFlags
from mrbatch.kernels.bsdf import Surface, make_bsdf
from mrbatch.kernels.camera import DIM_LENS, make_camera, through_lens
from mrbatch.kernels.environment import make_environment
from mrbatch.kernels.numerics import (
    max_component,
    min_component,
    orthonormal_basis,
    to_local,
    to_world,
)
from mrbatch.kernels.rng import make_sampler, pixel_key, unit_pair
from mrbatch.kernels.sampling import make_pixel_filter
from mrbatch.scene.counters import CAMERA_RAYS, LOOKUPS, SCATTER_RAYS, SHADOW_RAYS, VERTICES
from mrbatch.scene.frame_params import FrameParams
from mrbatch.scene.light_arrival import SKY, VIRTUAL_LAMP, Arrival
from mrbatch.scene.light_paths import (
    DIM_PIXEL,
    DIM_ROULETTE,
    DIM_VERTEX,
    PathNumbers,
    make_paths,
)
from mrbatch.scene.ray_start import make_ray_start
from mrbatch.scene.scene_data import HOLDOUT, RECEIVE, VIRTUAL, SceneData, SurfacePoint, surface_point
from mrbatch.scene.see_through import DIM_STOP, STOPS, make_see_through
from mrbatch.scene.shading import PhotoReflectance, make_surface


@dataclass(frozen=True)
class Flags(CameraPathFlags):
    """What a shot calls for; each that is off leaves no code in the kernel."""

    real_on_real: bool = True
    """A real point can see another real point."""
    virtual_paths: bool = True
    """Light goes on after the first scattering: bleeding, inter-reflection, reflections of surfaces."""
    glossy_real: bool = False
    """A real surface is not diffuse."""
    split: bool = False
    """The film keeps blocked and indirect light of D apart."""


@dataclass(frozen=True)
class DeltaKernel:
    kernel: Any
    flags: Flags


@functools.cache
def make_kernel(flags: Flags) -> DeltaKernel:
    """The kernel for these flags: adds samples of one half to the film, one thread a pixel."""
    trace, occluded = rays(flags.engine).trace, rays(flags.engine).occluded
    bsdf = make_bsdf(flags.bsdf_kinds, masking=flags.masking)  # type: ignore[arg-type]
    bsdf_sample = bsdf.sample
    camera = make_camera(flags.camera_model, flags.distortion)  # type: ignore[arg-type]
    camera_ray = camera.ray
    environment = make_environment(flags.interpolation, flags.light_sampler)  # type: ignore[arg-type]
    env_radiance, env_pdf = environment.radiance, environment.pdf
    prefetch = environment.prefetch
    sampler = make_sampler(flags.sampler)  # type: ignore[arg-type]
    sample_1d, sample_2d = sampler.sample_1d, sampler.sample_2d
    sample_vertex, sample_start = sampler.sample_vertex, sampler.sample_start
    pixel_filter = make_pixel_filter(flags.pixel_filter)  # type: ignore[arg-type]
    funcs = make_surface(flags.shading, camera)
    bare_at, reflectance_at, surface_at = funcs.bare, funcs.reflectance, funcs.surface
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

    # Of a diffuse surface reflectance is a factor, and is read only where it counts.
    @wp.func
    def real_surface(scene: SceneData, photo: PhotoReflectance, point: SurfacePoint) -> Surface:
        if wp.static(flags.glossy_real):
            return surface_at(scene, photo, point)
        return bare_at(scene, photo, point)

    @wp.func
    def tinted(scene: SceneData, photo: PhotoReflectance, point: SurfacePoint, value: wp.vec3) -> wp.vec3:
        if wp.static(flags.glossy_real):
            return value
        return wp.cw_mul(value, reflectance_at(scene, photo, point))

    @wp.func
    def reach_of(scene: SceneData) -> RaySet:
        # Where real points see nothing real, only virtual objects can be met.
        if wp.static(flags.real_on_real):
            return scene.all_set
        return scene.virtual_set

    @wp.func
    def takes_away(light: Arrival) -> bool:
        # Where real points see nothing real, they see no real lamp either.
        if wp.static(lamps and flags.real_on_real):
            return light.sender != VIRTUAL_LAMP
        return light.sender == SKY

    @wp.kernel(enable_backward=False, module="unique")
    def delta_path_tracing(
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
            start = sample_start(key, index, DIM_PIXEL, DIM_VERTEX)
            prefetch(scene.environment, start.vertex.light)
            shift = pixel_filter(unit_pair(start.pixel))
            primary = camera_ray(
                frame.camera, float(pixel.x) + 0.5 + shift[0], float(pixel.y) + 0.5 + shift[1]
            )
            if wp.static(flags.lens):
                primary = through_lens(frame.camera, primary, sample_2d(key, index, DIM_LENS))
            value = wp.vec3(0.0, 0.0, 0.0)
            blocked = wp.vec3(0.0, 0.0, 0.0)
            indirect = wp.vec3(0.0, 0.0, 0.0)
            covered = float(0.0)
            changes = bool(False)
            first_set = scene.camera_set
            if wp.static(not flags.virtual_seen):
                first_set = scene.photo_set
            hit = trace(first_set, primary.origin, primary.direction, FAR)
            if wp.static(see_through.on):
                first = stop_at(scene, first_set, hit, primary.direction, key, index, DIM_STOP)
                hit = first.hit
                camera_rays += first.rays
                # What comes through glass on the way to where the path forks.
                plus_share = wp.vec3(1.0, 1.0, 1.0)
            if primary.ok and hit.triangle >= 0:
                point = surface_point(scene, hit.triangle, hit.u, hit.v, primary.direction)
                flags_here = point.flags
                is_virtual = (flags_here & VIRTUAL) != 0
                skip = bool(False)
                if wp.static(flags.holdout):
                    skip = (flags_here & HOLDOUT) != 0
                if wp.static(flags.unreceptive):
                    skip = skip or ((not is_virtual) and (flags_here & RECEIVE) == 0)
                first_leg = int(0)
                legs = int(0)
                # The two legs of the fork: `plus` among all objects, `minus` among real ones.
                plus = point
                plus_direction = primary.direction
                minus = point
                fork_throughput = wp.vec3(1.0, 1.0, 1.0)
                # Of what the points where the legs begin emit: its share found by scattered rays.
                plus_weight = float(1.0)
                minus_weight = float(1.0)
                edges = int(1)
                if is_virtual and not skip:
                    covered = 1.0
                    changes = bool(True)
                    legs = 1
                if wp.static(flags.light_change):
                    if not is_virtual and not skip:
                        d = primary.direction
                        throughput = wp.vec3(1.0, 1.0, 1.0)
                        numbers_here = start.vertex
                        while edges < numbers.max_edges:
                            vertices += 1
                            dimension = DIM_VERTEX * edges
                            surface = real_surface(scene, frame.photo, point)
                            basis = orthonormal_basis(point.ns)
                            wo = to_local(basis, -d)
                            lights = lights_at(numbers, edges)
                            # Before the light's ray, so that a processor works on both directions at once.
                            drawn = bsdf_sample(surface, wo, unit_pair(numbers_here.scatter))
                            for number in range(draws(lights)):
                                light = arrival(
                                    scene,
                                    surface,
                                    basis,
                                    wo,
                                    point,
                                    False,
                                    numbers_here,
                                    key,
                                    index,
                                    number,
                                    lights,
                                    dimension,
                                )
                                if max_component(light.value) > 0.0:
                                    # Light of the sky and of real lamps is lost where virtual objects, and
                                    # no real ones, are in its way; a virtual lamp's comes where nothing is.
                                    f = light.value
                                    adds = bool(False)
                                    lost = bool(False)
                                    if wp.static(lamps):
                                        if light.sender == VIRTUAL_LAMP:
                                            if wp.static(flags.virtual_paths):
                                                shadow_rays += 1
                                                if wp.static(see_through.on):
                                                    past = transmittance(
                                                        scene,
                                                        reach_of(scene),
                                                        light.start,
                                                        light.ray,
                                                        light.far,
                                                    )
                                                    shadow_rays += past.rays - 1
                                                    f = wp.cw_mul(f, past.share)
                                                    adds = max_component(past.share) > 0.0
                                                else:
                                                    adds = not occluded(
                                                        reach_of(scene), light.start, light.ray, light.far
                                                    )
                                    if takes_away(light):
                                        shadow_rays += 1
                                        if wp.static(see_through.on):
                                            through = transmittance(
                                                scene, scene.virtual_set, light.start, light.ray, light.far
                                            )
                                            shadow_rays += through.rays - 1
                                            kept = wp.vec3(1.0, 1.0, 1.0) - through.share
                                            f = wp.cw_mul(f, kept)
                                            lost = max_component(kept) > 0.0
                                        else:
                                            lost = occluded(
                                                scene.virtual_set, light.start, light.ray, light.far
                                            )
                                        if wp.static(flags.real_on_real):
                                            if lost:
                                                shadow_rays += 1
                                                lost = not occluded(
                                                    scene.real_set, light.start, light.ray, light.far
                                                )
                                    if lost or adds:
                                        changes = bool(True)
                                        w = arrival_weight(surface, wo, light, lights)
                                        f = tinted(scene, frame.photo, point, f)
                                        light_change = (
                                            wp.cw_mul(
                                                wp.cw_mul(throughput, f), arrival_radiance(scene, light)
                                            )
                                            * w
                                        )
                                        if lost:
                                            if light.sender == SKY:
                                                lookups += 1
                                            blocked -= light_change
                                        else:
                                            indirect += light_change
                            if max_component(drawn.weight) <= 0.0:
                                break
                            d = to_world(basis, drawn.wi)
                            if wp.dot(point.ng, d) <= 0.0:
                                break
                            o = ray_start(scene, point, d)
                            scatter_rays += 1
                            behind_triangle = wp.int32(-1)
                            behind_u = float(0.0)
                            behind_v = float(0.0)
                            forks = bool(False)
                            seen = trace(reach_of(scene), o, d, FAR)
                            if wp.static(see_through.on):
                                place = DIM_STOP + STOPS * edges
                                stop = stop_at(scene, reach_of(scene), seen, d, key, index, place)
                                seen = stop.hit
                                scatter_rays += stop.rays
                                plus_share = stop.share
                            if wp.static(flags.real_on_real):
                                # Most rays meet something real, or nothing, first: one query tells.
                                behind_triangle = seen.triangle
                                behind_u = seen.u
                                behind_v = seen.v
                                if seen.triangle >= 0:
                                    owner_flags = scene.triangles[seen.triangle].flags
                                    forks = (owner_flags & VIRTUAL) != 0
                                if forks:
                                    scatter_rays += 1
                                    behind = trace(scene.real_set, o, d, FAR)
                                    behind_triangle = behind.triangle
                                    behind_u = behind.u
                                    behind_v = behind.v
                            else:
                                forks = seen.triangle >= 0
                            if wp.static(panes):
                                # What comes through glass of a colour is changed, whatever sent it.
                                forks = forks or min_component(plus_share) < 1.0
                            if seen.triangle < 0 and not forks:
                                break
                            throughput = wp.cw_mul(throughput, drawn.weight)
                            throughput = tinted(scene, frame.photo, point, throughput)
                            if max_component(throughput) <= 0.0:
                                break
                            if forks:
                                edges += 1
                                changes = bool(True)
                                fork_throughput = throughput
                                if behind_triangle < 0:
                                    w = scatter_weight(drawn.pdf, lights, env_pdf(scene.environment, d))
                                    if w > 0.0:
                                        lookups += 1
                                        lost_light = env_radiance(scene.environment, d)
                                        if wp.static(panes):
                                            if seen.triangle < 0:
                                                lost_light = lost_light - wp.cw_mul(lost_light, plus_share)
                                        blocked -= wp.cw_mul(throughput, lost_light) * w
                                if wp.static(flags.virtual_paths):
                                    if seen.triangle >= 0:
                                        plus = surface_point(scene, seen.triangle, seen.u, seen.v, d)
                                        plus_direction = d
                                        legs = 1
                                        if wp.static(lamps):
                                            plus_weight = met_weight(
                                                scene, point.p, plus, False, drawn.pdf, lights
                                            )
                                if wp.static(flags.real_on_real):
                                    if behind_triangle >= 0:
                                        minus = surface_point(scene, behind_triangle, behind_u, behind_v, d)
                                        plus_direction = d
                                        legs = 2
                                        # Nothing comes from a virtual point that returns no light.
                                        first_leg = wp.where(wp.static(flags.virtual_paths), 0, 1)
                                        if wp.static(lamps):
                                            minus_weight = met_weight(
                                                scene, point.p, minus, False, drawn.pdf, lights
                                            )
                                break
                            if wp.static(flags.real_on_real):
                                point = surface_point(scene, behind_triangle, behind_u, behind_v, d)
                                if wp.static(flags.unreceptive):
                                    if (point.flags & RECEIVE) == 0:
                                        break
                                edges += 1
                                numbers_here = sample_vertex(key, index, DIM_VERTEX * edges)
                                q = survival(throughput, edges, numbers)
                                if q < 1.0:
                                    if sample_1d(key, index, dimension + DIM_ROULETTE) >= q:
                                        break
                                    throughput = throughput / q
                for side in range(first_leg, legs):
                    among = scene.all_set
                    origin = plus
                    if wp.static(flags.real_on_real):
                        if side == 1:
                            among = scene.real_set
                            origin = minus
                    leg = path(scene, frame.photo, numbers, among, origin, plus_direction, edges, key, index)
                    shadow_rays += leg.shadow_rays
                    scatter_rays += leg.scatter_rays
                    lookups += leg.lookups
                    vertices += leg.vertices
                    if wp.static(emitters):
                        emitted_weight = wp.where(side == 1, minus_weight, plus_weight)
                        leg.radiance += emission(scene, origin) * emitted_weight
                    gathered = wp.cw_mul(fork_throughput, leg.radiance)
                    if wp.static(panes):
                        if side == 0:
                            gathered = wp.cw_mul(gathered, plus_share)
                    if covered > 0.0:
                        value = gathered
                    elif side == 0:
                        indirect += gathered
                    else:
                        indirect -= gathered
            if wp.static(panes):
                changes = changes or min_component(first.share) < 1.0
            # Most samples change nothing, and adding zero is work too.
            if changes:
                value = wp.cw_mul(value, frame.gain)
                blocked = wp.cw_mul(blocked, frame.gain)
                indirect = wp.cw_mul(indirect, frame.gain)
                if wp.static(panes):
                    value = wp.cw_mul(value, first.share)
                    indirect = wp.cw_mul(indirect, first.share)
                    blocked = wp.cw_mul(blocked, first.share)
                    if covered == 0.0:
                        blocked -= wp.cw_mul(background, wp.vec3(1.0, 1.0, 1.0) - first.share)
                delta = blocked + indirect
                total = film_add(total, value, covered, delta, background)
                if wp.static(flags.split):
                    for c in range(3):
                        film.sums[half, pixel.index, 7 + c] += wp.float64(blocked[c])
                        film.sums[half, pixel.index, 10 + c] += wp.float64(indirect[c])
        film_store(film, half, pixel.index, total, samples)
        wp.atomic_add(counters, CAMERA_RAYS, wp.int64(samples + camera_rays))
        wp.atomic_add(counters, SHADOW_RAYS, wp.int64(shadow_rays))
        wp.atomic_add(counters, SCATTER_RAYS, wp.int64(scatter_rays))
        wp.atomic_add(counters, LOOKUPS, wp.int64(lookups))
        wp.atomic_add(counters, VERTICES, wp.int64(vertices))

    return DeltaKernel(delta_path_tracing, flags)
