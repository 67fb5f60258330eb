"""Data layers of what is virtual: depth, normal, albedo, motion and object coverage at first hits.

A pass of its own over a fixed number of camera rays, run only where a layer asks for it. While the shutter is
open the rays are shared by its moments, and what they find is added up.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import warp as wp

from mrbatch.contracts import Buffer, Counter, Pass
from mrbatch.device.rays import FAR, Engine, rays
from mrbatch.film.accumulator import FilmData, film_pixel
from mrbatch.film.layers import NOTHING
from mrbatch.film.outputs import FrameInput, Outputs, ViewOutput
from mrbatch.film.pixel_pass import pixel_pass
from mrbatch.kernels.camera import DIM_LENS, CameraData, make_camera, through_lens
from mrbatch.kernels.rng import make_sampler, pixel_key
from mrbatch.kernels.sampling import make_pixel_filter
from mrbatch.scene.frame_params import FrameParams
from mrbatch.scene.ray_start import make_ray_start
from mrbatch.scene.scene_data import HOLDOUT, VIRTUAL, DeviceScene, SceneData, surface_point
from mrbatch.scene.see_through import DIM_STOP, make_see_through
from mrbatch.scene.shading import ShadingFlags, make_surface

SAMPLES = wp.constant(wp.int32(32))
RANKS = wp.constant(wp.int32(12))
"""Objects that are told apart in a pixel, the first that its samples meet: twice what Cryptomatte keeps,
so that the six largest are among them wherever no more than twelve meet."""
PARTS = ("depth", "normal", "albedo", "motion")
_NOTHING = wp.constant(wp.float32(NOTHING))

COUNTERS = (Counter("camera rays", "rays", "rays from the camera for data layers"),)


@wp.struct
class FirstHitData:
    """Arrays over the window's pixels; those that are not asked for have length 1. `next_camera` is the
    camera of the next frame, `shifts` take points of each object to where they are then. `ranks` holds
    object numbers plus one, `share` their coverage. While the shutter is open: `samples` a moment, from
    `first`, `home` takes points to where they are at the frame's own time, `frame_camera` is its camera,
    `hits` the samples so far that met something, and `last` tells the last moment."""

    first: wp.int32
    samples: wp.int32
    last: wp.int32
    weight: wp.float32
    hits: wp.array(dtype=wp.int32)
    home: wp.array(dtype=wp.mat44)
    frame_camera: CameraData
    next_camera: CameraData
    shifts: wp.array(dtype=wp.mat44)
    depth: wp.array(dtype=wp.float32)
    normal: wp.array(dtype=wp.vec3)
    albedo: wp.array(dtype=wp.vec3)
    motion: wp.array(dtype=wp.vec2)
    ranks: wp.array2d(dtype=wp.int32)
    share: wp.array2d(dtype=wp.float32)


@dataclass(frozen=True)
class Wanted:
    """Which data layers are computed; the others leave no code."""

    depth: bool
    normal: bool
    albedo: bool
    motion: bool
    names: bool
    """Which objects are seen: for masks by the name of the object or of its material."""
    moving: bool = False
    """Objects move from frame to frame."""
    lens: bool = False
    """The lens has a width."""
    shutter: bool = False
    """Samples are shared by the moments of an exposure."""

    @property
    def any(self) -> bool:
        return self.depth or self.normal or self.albedo or self.motion or self.names


def wanted(outputs: Outputs) -> Wanted:
    named = "object_ids" in outputs.needs or "material_ids" in outputs.needs
    depth, normal, albedo, motion = (part in outputs.needs for part in PARTS)
    return Wanted(depth, normal, albedo, motion, named)


def _name(view: ViewOutput, part: str) -> str:
    return f"first/{view.name}/{part}"


def first_hit_buffers(view: ViewOutput, outputs: Outputs) -> tuple[Buffer, ...]:
    """Buffers of the layers that are asked for."""
    n = view.window.pixels
    wants = wanted(outputs)
    found = []
    for part, width in (("depth", 1), ("normal", 3), ("albedo", 3), ("motion", 2)):
        if getattr(wants, part):
            shape = (n,) if width == 1 else (n, width)
            found.append(Buffer(_name(view, part), shape, "float32", "frame"))
    if wants.names:
        found.append(Buffer(_name(view, "ranks"), (n, int(RANKS)), "int32", "frame"))
        found.append(Buffer(_name(view, "share"), (n, int(RANKS)), "float32", "frame"))
    if outputs.shutter and wants.motion:
        found.append(Buffer(_name(view, "hits"), (n,), "int32", "frame"))
    return tuple(found)


@functools.cache
def _make_kernel(
    wants: Wanted, engine: Engine, model: str, distortion: bool, pixel_filter: str, shading: ShadingFlags
) -> Any:
    trace = rays(engine).trace
    camera = make_camera(model, distortion)  # type: ignore[arg-type]
    camera_ray, camera_project = camera.ray, camera.project
    sampler = make_sampler("owen")
    sample_2d = sampler.sample_2d
    see_through = make_see_through(shading, trace, make_ray_start(), sampler.sample_1d)
    stop_at = see_through.stop
    offset = make_pixel_filter(pixel_filter)  # type: ignore[arg-type]
    surfaces = make_surface(shading, camera)
    surface_at, normal_at = surfaces.surface, surfaces.normal

    @wp.kernel(enable_backward=False, module="unique")
    def first_hit(
        scene: SceneData,
        frame: FrameParams,
        film: FilmData,
        out: FirstHitData,
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
        depth = float(_NOTHING)
        normal = wp.vec3(0.0, 0.0, 0.0)
        albedo = wp.vec3(0.0, 0.0, 0.0)
        motion = wp.vec2(0.0, 0.0)
        hits = int(0)
        further = int(0)
        count = int(SAMPLES)
        weight = 1.0 / float(SAMPLES)
        if wp.static(wants.shutter):
            count = out.samples
            weight = out.weight
            if wp.static(wants.depth):
                if out.first > 0:
                    depth = out.depth[pixel.index]
            if wp.static(wants.normal):
                normal = out.normal[pixel.index]
            if wp.static(wants.albedo):
                albedo = out.albedo[pixel.index]
            if wp.static(wants.motion):
                motion = out.motion[pixel.index]
                hits = out.hits[pixel.index]
        for i in range(count):
            n = i
            if wp.static(wants.shutter):
                n = out.first + i
            shift = offset(sample_2d(key, n, 0))
            x = float(pixel.x) + 0.5 + shift[0]
            y = float(pixel.y) + 0.5 + shift[1]
            primary = camera_ray(frame.camera, x, y)
            if wp.static(wants.lens):
                primary = through_lens(frame.camera, primary, sample_2d(key, n, DIM_LENS))
            if primary.ok:
                hit = trace(scene.camera_set, primary.origin, primary.direction, FAR)
                if wp.static(see_through.on):
                    stop = stop_at(scene, scene.camera_set, hit, primary.direction, key, n, DIM_STOP)
                    hit = stop.hit
                    further += stop.rays
                if hit.triangle >= 0:
                    point = surface_point(scene, hit.triangle, hit.u, hit.v, primary.direction)
                    flags = point.flags
                    if (flags & VIRTUAL) != 0 and (flags & HOLDOUT) == 0:
                        hits += 1
                        if wp.static(wants.depth):
                            depth = wp.min(depth, camera_project(frame.camera, point.p)[2])
                        if wp.static(wants.normal):
                            normal += normal_at(scene, point, -primary.direction) * weight
                        if wp.static(wants.albedo):
                            albedo += surface_at(scene, frame.photo, point).reflectance * weight
                        if wp.static(wants.motion):
                            p = point.p
                            if wp.static(wants.shutter and wants.moving):
                                p = wp.transform_point(out.home[point.object], p)
                            here = wp.vec3(x, y, 1.0)
                            if wp.static(wants.lens or wants.shutter):
                                # A blurred point is not where its sample is.
                                here = camera_project(out.frame_camera, p)
                            if wp.static(wants.moving):
                                p = wp.transform_point(out.shifts[point.object], p)
                            then = camera_project(out.next_camera, p)
                            motion += wp.vec2(then[0] - here[0], then[1] - here[1])
                        if wp.static(wants.names):
                            placed = int(0)
                            for rank in range(int(RANKS)):
                                holder = out.ranks[pixel.index, rank]
                                if placed == 0 and (holder == 0 or holder == point.object + 1):
                                    out.ranks[pixel.index, rank] = point.object + 1
                                    out.share[pixel.index, rank] = out.share[pixel.index, rank] + weight
                                    placed = 1
        if wp.static(wants.depth):
            out.depth[pixel.index] = depth
        if wp.static(wants.normal):
            out.normal[pixel.index] = normal
        if wp.static(wants.albedo):
            out.albedo[pixel.index] = albedo
        if wp.static(wants.motion):
            if wp.static(wants.shutter):
                out.hits[pixel.index] = hits
                if out.last == 0:
                    hits = 1
                out.motion[pixel.index] = motion / float(wp.max(hits, 1))
            elif hits > 0:
                out.motion[pixel.index] = motion / float(hits)
        wp.atomic_add(counters, 0, wp.int64(count + further))

    return first_hit


def first_hit_data(
    view: ViewOutput, outputs: Outputs, frame: FrameInput, next_camera: Any, shifts: np.ndarray
) -> Any:
    """`FirstHitData` over the frame's buffers; `shifts` (objects, 4, 4) as in `ViewInput`."""
    data = FirstHitData()
    buffers = frame.buffers
    data.samples = -(-int(SAMPLES) // frame.moments)
    data.first = frame.moment * data.samples
    data.weight = 1.0 / (data.samples * frame.moments)
    data.last = int(frame.moment == frame.moments - 1)
    data.hits = buffers.get(_name(view, "hits"))
    if data.hits is None:
        data.hits = wp.zeros(1, dtype=wp.int32, device=outputs.device)
    data.shifts = wp.array(shifts.astype(np.float32), dtype=wp.mat44, device=outputs.device)
    data.next_camera = next_camera
    dtypes = {"depth": wp.float32, "normal": wp.vec3, "albedo": wp.vec3, "motion": wp.vec2}
    for part, dtype in dtypes.items():
        held = buffers.get(_name(view, part))
        if held is None:
            setattr(data, part, wp.zeros(1, dtype=dtype, device=outputs.device))
        else:
            setattr(data, part, held if dtype is wp.float32 else held.view(dtype))
    ranks, share = buffers.get(_name(view, "ranks")), buffers.get(_name(view, "share"))
    data.ranks = ranks if ranks is not None else wp.zeros((1, 1), dtype=wp.int32, device=outputs.device)
    data.share = share if share is not None else wp.zeros((1, 1), dtype=wp.float32, device=outputs.device)
    return data


def first_hit_pass(
    scene: DeviceScene,
    view: ViewOutput,
    outputs: Outputs,
    shading: ShadingFlags,
    distortion: bool,
    pixel_filter: str,
) -> Pass | None:
    """The pass for the data layers that are asked for, or None where none is.

    The context's `bound[view]` must start with FrameParams, FilmData and FirstHitData.
    """
    wants = replace(wanted(outputs), moving=scene.scene.moves, lens=outputs.lens, shutter=outputs.shutter)
    if not wants.any:
        return None
    shading = ShadingFlags(
        textures=shading.textures and wants.albedo,
        photo=shading.photo and wants.albedo,
        normal_maps=shading.normal_maps and wants.normal,
        cutouts=shading.cutouts,
        panes=shading.panes,
    )
    kernel = _make_kernel(wants, scene.engine, view.model, distortion, pixel_filter, shading)
    return pixel_pass(
        f"first hits {view.name}".strip(),
        view,
        kernel,
        lambda context: [
            scene.data,
            context.bound[view.name][0],
            context.bound[view.name][1],
            context.bound[view.name][2],
        ],
        writes=tuple(b.name for b in first_hit_buffers(view, outputs)),
        counters=COUNTERS,
        seen=True,
        each_moment=True,
        device=outputs.device,
    )


def first_hit_estimates(
    view: ViewOutput, outputs: Outputs, buffers: Any, ids: Mapping[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Host arrays by the names of `layers.ESTIMATES`.

    `ids`: by `object` and `material`, for each object of the scene, the id (objects,) uint32 of its own
    name and of its material's. Where no pass ran (nothing virtual), the layers are empty.
    """
    h, w = view.window.height, view.window.width
    wants = wanted(outputs)
    found: dict[str, np.ndarray] = {}
    for part, width, empty in (
        ("depth", 1, NOTHING),
        ("normal", 3, 0.0),
        ("albedo", 3, 0.0),
        ("motion", 2, 0.0),
    ):
        if getattr(wants, part):
            held = buffers.get(_name(view, part))
            shape = (h, w) if width == 1 else (h, w, width)
            found[part] = (
                np.full(shape, empty, np.float32) if held is None else held.numpy().reshape(shape).copy()
            )
            if part == "depth" and held is not None:
                # A tile that no pass ran over still holds the zero of its allocation.
                found[part][found[part] == 0.0] = NOTHING
    if wants.names:
        held = buffers.get(_name(view, "ranks"))
        k = int(RANKS)
        ranks = np.zeros((h * w, k), np.int32) if held is None else held.numpy()
        share = np.zeros((h * w, k), np.float32) if held is None else buffers[_name(view, "share")].numpy()
        for kind, named in ids.items():
            if f"{kind}_ids" in outputs.needs:
                chosen = np.concatenate([np.zeros(1, np.uint32), named])[ranks]
                found[f"{kind}_ids"] = chosen.reshape(h, w, k)
                found[f"{kind}_coverage"] = share.reshape(h, w, k).copy()
    return found
