"""What the camera sees at a pixel, apart for virtual and real surfaces: which object, where, which way it
faces, its reflectance. Filters of the finished frame take it as their guide.

A pass of its own over a fixed number of camera rays; it runs only where a filter asks for it.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from mrbatch.contracts import Buffer, Counter, Pass
from mrbatch.device.rays import FAR, Engine, rays
from mrbatch.film.accumulator import FilmData, film_pixel
from mrbatch.film.outputs import Outputs, ViewOutput
from mrbatch.film.pixel_pass import pixel_pass
from mrbatch.kernels.camera import DIM_LENS, make_camera, through_lens
from mrbatch.kernels.rng import make_sampler, pixel_key
from mrbatch.kernels.sampling import make_pixel_filter
from mrbatch.scene.frame_params import FrameParams
from mrbatch.scene.ray_start import make_ray_start
from mrbatch.scene.scene_data import HOLDOUT, VIRTUAL, DeviceScene, SceneData, surface_point
from mrbatch.scene.see_through import DIM_STOP, make_see_through
from mrbatch.scene.shading import ShadingFlags, make_surface

SAMPLES = wp.constant(wp.int32(32))
VIRTUAL_SIDE, REAL_SIDE = 0, 1
SEVERAL = wp.constant(wp.int32(-1))
"""In place of an object's number: the pixel shows more than one."""
NEED = "guides"
"""The name in `Outputs.needs` that asks for this pass."""

COUNTERS = (Counter("guide samples", "rays", "rays from the camera for the guides of a filter"),)
_VECTORS = ("normal", "position", "reflectance")


@dataclass(frozen=True)
class Guide:
    """Of one side, virtual or real, means over the samples of a pixel that meet it.

    `object` (h, w) int32: number of the object plus one; 0 for none, -1 where there is more than one.
    `normal` (h, w, 3): shading normal, world, towards the camera, not of unit length where it varies.
    `position` (h, w, 3): metres, relative to the scene's origin. `reflectance` (h, w, 3): 0..1.
    """

    object: np.ndarray
    normal: np.ndarray
    position: np.ndarray
    reflectance: np.ndarray


@dataclass(frozen=True)
class Guides:
    """The guides of one view of one frame on its data window."""

    virtual: Guide
    real: Guide


@wp.struct
class GuideData:
    """Side (0 virtual, 1 real) by pixel of the window. `hits`: samples so far that met a side; while the
    shutter is open: `samples` a moment, from `first`, `last` tells the last moment."""

    object: wp.array2d(dtype=wp.int32)
    normal: wp.array2d(dtype=wp.vec3)
    position: wp.array2d(dtype=wp.vec3)
    reflectance: wp.array2d(dtype=wp.vec3)
    hits: wp.array2d(dtype=wp.int32)
    first: wp.int32
    samples: wp.int32
    last: wp.int32


def _name(view: ViewOutput, part: str) -> str:
    return f"guide/{view.name}/{part}"


def guide_buffers(view: ViewOutput, outputs: Outputs) -> tuple[Buffer, ...]:
    """None unless a filter asks for guides."""
    if NEED not in outputs.needs:
        return ()
    n = view.window.pixels
    hits = (Buffer(_name(view, "hits"), (2, n), "int32", "frame"),) if outputs.shutter else ()
    return (
        *hits,
        Buffer(_name(view, "object"), (2, n), "int32", "frame"),
        *(Buffer(_name(view, part), (2, n, 3), "float32", "frame") for part in _VECTORS),
    )


@functools.cache
def _make_kernel(
    engine: Engine,
    model: str,
    distortion: bool,
    pixel_filter: str,
    shading: ShadingFlags,
    lens: bool,
    shutter: bool,
) -> Any:
    trace = rays(engine).trace
    camera = make_camera(model, distortion)  # type: ignore[arg-type]
    camera_ray = camera.ray
    sampler = make_sampler("owen")
    sample_2d = sampler.sample_2d
    see_through = make_see_through(shading, trace, make_ray_start(), sampler.sample_1d)
    stop_at = see_through.stop
    offset = make_pixel_filter(pixel_filter)  # type: ignore[arg-type]
    surfaces = make_surface(shading, camera)
    reflectance_at, normal_at = surfaces.reflectance, surfaces.normal

    @wp.kernel(enable_backward=False, module="unique")
    def guides(
        scene: SceneData,
        frame: FrameParams,
        film: FilmData,
        out: GuideData,
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
        key = pixel_key(frame.seed, frame.frame, frame.view, 0, pixel.x, pixel.y)
        hits = wp.vec2i(0, 0)
        further = int(0)
        owner = wp.vec2i(0, 0)
        count = int(SAMPLES)
        if wp.static(shutter):
            count = out.samples
            for side in range(2):
                hits[side] = out.hits[side, pixel.index]
                owner[side] = out.object[side, pixel.index]
        for i in range(count):
            n = i
            if wp.static(shutter):
                n = out.first + i
            shift = offset(sample_2d(key, n, 0))
            x = float(pixel.x) + 0.5 + shift[0]
            y = float(pixel.y) + 0.5 + shift[1]
            primary = camera_ray(frame.camera, x, y)
            if wp.static(lens):
                primary = through_lens(frame.camera, primary, sample_2d(key, n, DIM_LENS))
            if primary.ok:
                hit = trace(scene.camera_set, primary.origin, primary.direction, FAR)
                if wp.static(see_through.on):
                    stop = stop_at(scene, scene.camera_set, hit, primary.direction, key, n, DIM_STOP)
                    hit = stop.hit
                    further += stop.rays
                if hit.triangle >= 0:
                    point = surface_point(scene, hit.triangle, hit.u, hit.v, primary.direction)
                    side = int(1)
                    if (point.flags & VIRTUAL) != 0:
                        side = 0
                    if (point.flags & HOLDOUT) == 0:
                        hits[side] += 1
                        if owner[side] == 0:
                            owner[side] = point.object + 1
                        elif owner[side] != point.object + 1:
                            owner[side] = SEVERAL
                        normal = normal_at(scene, point, -primary.direction)
                        out.normal[side, pixel.index] = out.normal[side, pixel.index] + normal
                        out.position[side, pixel.index] = out.position[side, pixel.index] + point.p
                        reflectance = reflectance_at(scene, frame.photo, point)
                        out.reflectance[side, pixel.index] = out.reflectance[side, pixel.index] + reflectance
        for side in range(2):
            weight = 1.0 / float(wp.max(hits[side], 1))
            if wp.static(shutter):
                out.hits[side, pixel.index] = hits[side]
                if out.last == 0:
                    weight = 1.0
            out.object[side, pixel.index] = owner[side]
            out.normal[side, pixel.index] = out.normal[side, pixel.index] * weight
            out.position[side, pixel.index] = out.position[side, pixel.index] * weight
            out.reflectance[side, pixel.index] = out.reflectance[side, pixel.index] * weight
        wp.atomic_add(counters, 0, wp.int64(count + further))

    return guides


def guide_pass(
    scene: DeviceScene,
    view: ViewOutput,
    outputs: Outputs,
    shading: ShadingFlags,
    distortion: bool,
    pixel_filter: str,
) -> Pass | None:
    """The pass, or None where no filter asks for it.

    The context's `bound[view]` must start with FrameParams, FilmData and FirstHitData.
    """
    if NEED not in outputs.needs:
        return None
    shading = ShadingFlags(
        textures=shading.textures,
        photo=shading.photo,
        normal_maps=shading.normal_maps,
        cutouts=shading.cutouts,
        panes=shading.panes,
    )
    kernel = _make_kernel(
        scene.engine, view.model, distortion, pixel_filter, shading, outputs.lens, outputs.shutter
    )

    def inputs(context: Any) -> list[Any]:
        data = GuideData()
        data.object = context.buffers[_name(view, "object")]
        for part in _VECTORS:
            setattr(data, part, context.buffers[_name(view, part)].view(wp.vec3))
        hits = context.bound[view.name][2]
        data.first, data.samples, data.last = hits.first, hits.samples, hits.last
        if outputs.shutter:
            data.hits = context.buffers[_name(view, "hits")]
        return [scene.data, *context.bound[view.name][:2], data]

    return pixel_pass(
        f"guides {view.name}".strip(),
        view,
        kernel,
        inputs,
        writes=tuple(b.name for b in guide_buffers(view, outputs)),
        counters=COUNTERS,
        each_moment=True,
        device=outputs.device,
    )


def guides_of(view: ViewOutput, buffers: Any) -> Guides | None:
    """The guides that the pass left in the buffers; None where it did not run (nothing virtual)."""
    if _name(view, "object") not in buffers:
        return None
    h, w = view.window.height, view.window.width
    owners = buffers[_name(view, "object")].numpy().reshape(2, h, w)
    vectors = {part: buffers[_name(view, part)].numpy().reshape(2, h, w, 3) for part in _VECTORS}
    sides = [
        Guide(owners[side].copy(), **{part: values[side].copy() for part, values in vectors.items()})
        for side in (VIRTUAL_SIDE, REAL_SIDE)
    ]
    return Guides(*sides)
