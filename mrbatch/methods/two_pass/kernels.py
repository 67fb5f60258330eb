"""The kernel of two-pass differential path tracing.

Fournier et al., *Common Illumination between Real and Computer Generated Scenes* (1992), took the ratio of
two pictures of the modelled scene, with and without the virtual objects; Debevec, *Rendering Synthetic
Objects into Real Scenes* (1998), section 6, their difference, which is what is done here:

    C = M L_m + (1 - M) (L_b + L_m - L_r).

The two pictures are independent, each with random numbers of its own, from the offset in the pixel on: that
is what rendering a scene twice gives. A sample of the second picture counts where it shows a real surface
that no virtual object covers, so that M is taken alike on both sides of the difference and edges stay right.
"""

from __future__ import annotations

import functools
from typing import Any

import warp as wp

from mrbatch.device.rays import FAR, rays
from mrbatch.film.accumulator import FilmData, film_add, film_load, film_pixel, film_store
from mrbatch.film.path_pipeline import CameraPathFlags
from mrbatch.kernels.camera import DIM_LENS, make_camera, through_lens
from mrbatch.kernels.rng import make_sampler, pixel_key, unit_pair
from mrbatch.kernels.sampling import make_pixel_filter
from mrbatch.scene.counters import CAMERA_RAYS, LOOKUPS, SCATTER_RAYS, SHADOW_RAYS, VERTICES
from mrbatch.scene.frame_params import FrameParams
from mrbatch.scene.light_paths import DIM_PIXEL, DIM_VERTEX, PathNumbers, make_paths
from mrbatch.scene.ray_start import make_ray_start
from mrbatch.scene.scene_data import HOLDOUT, RECEIVE, VIRTUAL, SceneData, surface_point
from mrbatch.scene.see_through import DIM_STOP, make_see_through

WITHOUT = wp.constant(wp.int32(4))
"""Added to the half in the key of the second picture: 2 is the key of the photo's reflectance."""


@functools.cache
def make_kernel(flags: CameraPathFlags) -> Any:
    """The kernel for these flags: adds samples of one half to the film, one thread a pixel."""
    trace = rays(flags.engine).trace
    camera_ray = make_camera(flags.camera_model, flags.distortion).ray  # type: ignore[arg-type]
    sampler = make_sampler(flags.sampler)  # type: ignore[arg-type]
    sample_start, sample_2d = sampler.sample_start, sampler.sample_2d
    pixel_filter = make_pixel_filter(flags.pixel_filter)  # type: ignore[arg-type]
    paths = make_paths(flags)
    path, emission = paths.path, paths.emission
    see_through = make_see_through(flags.shading, trace, make_ray_start(flags.ray_start), sampler.sample_1d)
    stop_at = see_through.stop
    panes = flags.shading.panes
    pictures = 2 if flags.light_change else 1

    @wp.kernel(enable_backward=False, module="unique")
    def two_pass(
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
        total = film_load(film, half, pixel.index)
        camera_rays = int(0)
        shadow_rays = int(0)
        scatter_rays = int(0)
        lookups = int(0)
        vertices = int(0)
        for n in range(samples):
            index = first_sample + n
            value = wp.vec3(0.0, 0.0, 0.0)
            delta = wp.vec3(0.0, 0.0, 0.0)
            covered = float(0.0)
            if wp.static(panes):
                tint = wp.vec3(1.0, 1.0, 1.0)
            for picture in range(wp.static(pictures)):
                key = pixel_key(
                    frame.seed, frame.frame, frame.view, half + picture * WITHOUT, pixel.x, pixel.y
                )
                shift = pixel_filter(unit_pair(sample_start(key, index, DIM_PIXEL, DIM_VERTEX).pixel))
                primary = camera_ray(
                    frame.camera, float(pixel.x) + 0.5 + shift[0], float(pixel.y) + 0.5 + shift[1]
                )
                if wp.static(flags.lens):
                    primary = through_lens(frame.camera, primary, sample_2d(key, index, DIM_LENS))
                first_set = scene.camera_set
                if wp.static(not flags.virtual_seen):
                    first_set = scene.photo_set
                hit = trace(first_set, primary.origin, primary.direction, FAR)
                if wp.static(see_through.on):
                    met = stop_at(scene, first_set, hit, primary.direction, key, index, DIM_STOP)
                    hit = met.hit
                    camera_rays += met.rays
                    if wp.static(panes):
                        if picture == 0:
                            tint = met.share
                if primary.ok and hit.triangle >= 0:
                    point = surface_point(scene, hit.triangle, hit.u, hit.v, primary.direction)
                    here = point.flags
                    is_virtual = (here & VIRTUAL) != 0
                    counts = wp.where(is_virtual, picture == 0, wp.static(flags.light_change))
                    if wp.static(flags.holdout):
                        counts = counts and (here & HOLDOUT) == 0
                    if wp.static(flags.unreceptive):
                        counts = counts and (is_virtual or (here & RECEIVE) != 0)
                    if counts:
                        among = scene.all_set
                        if picture == 1:
                            among = scene.real_set
                        leg = path(
                            scene, frame.photo, numbers, among, point, primary.direction, 1, key, index
                        )
                        if wp.static(flags.shading.emission):
                            leg.radiance += emission(scene, point)
                        shadow_rays += leg.shadow_rays
                        scatter_rays += leg.scatter_rays
                        lookups += leg.lookups
                        vertices += leg.vertices
                        shown = leg.radiance
                        if wp.static(panes):
                            shown = wp.cw_mul(shown, met.share)
                        if is_virtual:
                            covered = 1.0
                            value = shown
                        elif picture == 0:
                            delta += shown
                        else:
                            delta -= shown
            delta = wp.cw_mul(delta, frame.gain)
            if wp.static(panes):
                if covered == 0.0:
                    delta += wp.cw_mul(background, tint - wp.vec3(1.0, 1.0, 1.0))
            total = film_add(total, wp.cw_mul(value, frame.gain), covered, delta, background)
        film_store(film, half, pixel.index, total, samples)
        wp.atomic_add(counters, CAMERA_RAYS, wp.int64(samples * wp.static(pictures) + camera_rays))
        wp.atomic_add(counters, SHADOW_RAYS, wp.int64(shadow_rays))
        wp.atomic_add(counters, SCATTER_RAYS, wp.int64(scatter_rays))
        wp.atomic_add(counters, LOOKUPS, wp.int64(lookups))
        wp.atomic_add(counters, VERTICES, wp.int64(vertices))

    return two_pass
