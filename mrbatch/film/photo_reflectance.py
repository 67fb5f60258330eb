"""Diffuse reflectance of real surfaces from the photo itself: pi L_b / E_r at every pixel.

With it the light change of a real point is L_b dE / E_r (Sato et al.; TRAP-3b of Xu et al.'s
method): no albedo has to be known, and ink stays ink under a shadow. E_r, the irradiance without
virtual objects, comes from the environment where no real surface is in the way, from the photo where
one is that the camera sees, and by further bounces from one that it does not. Declared lamps add what they
are said to emit: the photo clips them. Of a flat surface the
irradiance of the open map is known in closed form: no ray is traced where nothing rises above it, and where
something does, only what that takes away and sends is sampled. A point that the camera does not see takes
the mean reflectance of its surface.

The whole photo is used, whatever part of it is rendered, so that a crop is the crop of the picture.
"""

from __future__ import annotations

import functools
from dataclasses import replace
from typing import Any

import numpy as np
import warp as wp

from mrbatch.contracts import Buffer, Counter, Domain, Pass, PassContext, Span
from mrbatch.device.rays import FAR, Engine, rays
from mrbatch.film.accumulator import FilmData, film_pixel
from mrbatch.film.outputs import FrameInput, Outputs, ViewOutput
from mrbatch.film.pixel_pass import pixel_pass
from mrbatch.kernels.camera import make_camera
from mrbatch.kernels.environment import make_environment
from mrbatch.kernels.numerics import (
    balance_heuristic,
    max_component,
    offset_origin,
    orthonormal_basis,
    to_world,
)
from mrbatch.kernels.rng import make_sampler, pixel_key, unit_pair
from mrbatch.kernels.sampling import cosine_hemisphere
from mrbatch.scene.frame_params import FrameParams
from mrbatch.scene.lamp_table import is_lamp
from mrbatch.scene.lamps import lamp_pdf, lamp_ray, make_lamp_weights
from mrbatch.scene.mesh import plane_of
from mrbatch.scene.scene import Scene
from mrbatch.scene.scene_data import PHOTO, DeviceScene, SceneData, surface_point
from mrbatch.scene.shading import PhotoReflectance

SAMPLES = wp.constant(wp.int32(256))
"""Pairs of samples for E_r at a pixel. 1 / E_r of a noisy E_r is too bright by its relative variance:
stratified, that is below 1e-3 here."""
FEW = wp.constant(wp.int32(64))
"""The same for a flat surface, where only the part of E_r that other surfaces change is sampled."""
OPEN = wp.constant(wp.int32(1))
SHADED = wp.constant(wp.int32(2))
BOUNCES = wp.constant(wp.int32(8))
"""Longest path over surfaces that the camera does not see."""
DIMENSION = wp.constant(wp.int32(1 << 20))
LAMP_DIMENSION = wp.constant(wp.int32((1 << 20) + 2 * 8))
_INV_PI = wp.constant(wp.float32(0.31830988618379067))
_PI = wp.constant(wp.float32(3.14159265358979323))

RAYS = (Counter("irradiance rays", "rays", "rays that find the irradiance without virtual objects"),)


def _name(view: ViewOutput, part: str) -> str:
    return f"photo/{view.name}/{part}"


def photo_buffers(view: ViewOutput, objects: int) -> tuple[Buffer, ...]:
    n = view.whole.pixels
    return (
        Buffer(_name(view, "reflectance"), (n, 3), "float32", "frame"),
        Buffer(_name(view, "object"), (n,), "int32", "frame"),
        Buffer(_name(view, "mean"), (objects, 3), "float32", "frame"),
    )


def photo_struct(view: ViewOutput, frame: FrameInput, camera: Any, on: bool, device: str) -> Any:
    """`PhotoReflectance` over allocated buffers, or an empty one where the effect is off."""
    photo = PhotoReflectance()
    photo.camera = camera
    if not on:
        photo.reflectance = wp.zeros(1, dtype=wp.vec3, device=device)
        photo.object = wp.zeros(1, dtype=wp.int32, device=device)
        photo.mean = wp.zeros(1, dtype=wp.vec3, device=device)
        return photo
    photo.x, photo.y = view.whole.x, view.whole.y
    photo.width, photo.height = view.whole.width, view.whole.height
    photo.reflectance = frame.buffers[_name(view, "reflectance")].view(wp.vec3)
    photo.object = frame.buffers[_name(view, "object")]
    photo.mean = frame.buffers[_name(view, "mean")].view(wp.vec3)
    return photo


@functools.cache
def _make_kernels(
    engine: Engine, model: str, distortion: bool, interpolation: str, light_sampler: str, lamps: bool
) -> tuple[Any, Any]:
    trace, occluded = rays(engine).trace, rays(engine).occluded
    camera = make_camera(model, distortion)  # type: ignore[arg-type]
    camera_ray, camera_project = camera.ray, camera.project
    environment = make_environment(interpolation, light_sampler)  # type: ignore[arg-type]
    env_radiance, env_pdf, env_sample = environment.radiance, environment.pdf, environment.sample
    sampler = make_sampler("owen")
    sample_vertex, sample_2d_bits = sampler.sample_vertex, sampler.sample_2d_bits
    over_pdf, scattered = make_lamp_weights("mis")

    @wp.kernel(enable_backward=False, module="unique")
    def identify(
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
        """Which real object the pixel's centre shows."""
        thread = wp.tid()
        pixel = film_pixel(film, units[first_unit + (thread >> 8)], thread & 255)
        if pixel.index < 0:
            return
        found = wp.int32(-1)
        primary = camera_ray(frame.camera, float(pixel.x) + 0.5, float(pixel.y) + 0.5)
        if primary.ok:
            hit = trace(scene.photo_set, primary.origin, primary.direction, FAR)
            wp.atomic_add(counters, 0, wp.int64(1))
            if hit.triangle >= 0:
                found = scene.triangles[hit.triangle].object
        frame.photo.object[pixel.index] = found

    @wp.kernel(enable_backward=False, module="unique")
    def reflectance(
        scene: SceneData,
        frame: FrameParams,
        film: FilmData,
        open_sides: wp.array(dtype=wp.int32),
        normals: wp.array(dtype=wp.vec3),
        open_light: wp.array(dtype=wp.vec3),
        units: wp.array(dtype=wp.int32),
        first_unit: int,
        half: int,
        first_sample: int,
        samples: int,
        counters: wp.array(dtype=wp.int64),
    ):
        """pi L_b / E_r at the pixel's centre."""
        thread = wp.tid()
        pixel = film_pixel(film, units[first_unit + (thread >> 8)], thread & 255)
        if pixel.index < 0:
            return
        owner = frame.photo.object[pixel.index]
        if owner < 0 or (scene.objects[owner].flags & PHOTO) == 0:
            return
        primary = camera_ray(frame.camera, float(pixel.x) + 0.5, float(pixel.y) + 0.5)
        hit = trace(scene.photo_set, primary.origin, primary.direction, FAR)
        point = surface_point(scene, hit.triangle, hit.u, hit.v, primary.direction)
        side = 2 * owner
        if wp.dot(point.ng, normals[owner]) < 0.0:
            side += 1
        first_basis = orthonormal_basis(point.ns)
        key = pixel_key(frame.seed, frame.frame, frame.view, 2, pixel.x, pixel.y)
        irradiance = wp.vec3d()
        cast = int(1)
        count = int(SAMPLES)
        # Where the open map's light is known, what is estimated is the change by real surfaces.
        known = open_sides[side] != 0
        if open_sides[side] == SHADED:
            count = int(FEW)
        if open_sides[side] == OPEN:
            count = 0
        for n in range(count):
            value = wp.vec3(0.0, 0.0, 0.0)
            throughput = wp.vec3(1.0, 1.0, 1.0)
            here = point
            basis = first_basis
            for bounce in range(int(BOUNCES)):
                dimension = DIMENSION + 2 * bounce
                numbers_here = sample_vertex(key, n, dimension)
                light = env_sample(scene.environment, numbers_here.light)
                cosine = wp.dot(here.ns, light.direction)
                if light.pdf > 0.0 and cosine > 0.0 and wp.dot(here.ng, light.direction) > 0.0:
                    o = offset_origin(here.p, here.ng, light.direction, here.reach)
                    cast += 1
                    lost = occluded(scene.real_set, o, light.direction, FAR)
                    change = known and bounce == 0
                    if lost == change:
                        w = cosine * balance_heuristic(light.pdf, cosine * _INV_PI) / light.pdf
                        if change:
                            w = -w
                        value += wp.cw_mul(throughput, env_radiance(scene.environment, light.direction)) * w
                if wp.static(lamps):
                    lamp = lamp_ray(scene, here, sample_2d_bits(key, n, LAMP_DIMENSION + bounce), True)
                    cosine = wp.dot(here.ns, lamp.direction)
                    if lamp.pdf > 0.0 and cosine > 0.0 and wp.dot(here.ng, lamp.direction) > 0.0:
                        o = offset_origin(here.p, here.ng, lamp.direction, here.reach)
                        cast += 1
                        if not occluded(scene.real_set, o, lamp.end - o, 1.0):
                            w = cosine * over_pdf(1, lamp.pdf, cosine * _INV_PI)
                            sent = scene.objects[lamp.point.object].emission
                            value += wp.cw_mul(throughput, sent) * w
                local = cosine_hemisphere(unit_pair(numbers_here.scatter))
                d = to_world(basis, local)
                if local[2] <= 0.0 or wp.dot(here.ng, d) <= 0.0:
                    break
                o = offset_origin(here.p, here.ng, d, here.reach)
                cast += 1
                seen = trace(scene.real_set, o, d, FAR)
                change = known and bounce == 0
                if (seen.triangle < 0) != change:
                    w = _PI * balance_heuristic(local[2] * _INV_PI, env_pdf(scene.environment, d))
                    if change:
                        w = -w
                    value += wp.cw_mul(throughput, env_radiance(scene.environment, d)) * w
                if seen.triangle < 0:
                    break
                left = here.p
                here = surface_point(scene, seen.triangle, seen.u, seen.v, d)
                glows = bool(False)
                if wp.static(lamps):
                    sent = scene.objects[here.object].emission
                    glows = max_component(sent) > 0.0
                    if glows:
                        w = _PI * scattered(local[2] * _INV_PI, 1, lamp_pdf(scene, left, here, True))
                        value += wp.cw_mul(throughput, sent) * w
                at = camera_project(frame.camera, here.p)
                i = wp.int32(wp.floor(at[0])) - film.x
                j = wp.int32(wp.floor(at[1])) - film.y
                shown_here = bool(False)
                k = j * film.width + i
                if not glows and at[2] > 0.0 and i >= 0 and j >= 0 and i < film.width and j < film.height:
                    shown_here = frame.photo.object[k] == here.object
                if shown_here:
                    # The same object may hide this part of itself, or show its other side.
                    towards = frame.camera.origin - here.p
                    shown_here = wp.dot(here.ng, towards) > 0.0
                    if shown_here:
                        cast += 1
                        o = offset_origin(here.p, here.ng, towards, here.reach)
                        shown_here = not occluded(scene.photo_set, o, frame.camera.origin - o, 1.0)
                if shown_here:
                    value += wp.cw_mul(throughput, wp.cw_div(film.background[k], frame.gain)) * _PI
                    break
                throughput = wp.cw_mul(throughput, scene.objects[here.object].reflectance)
                basis = orthonormal_basis(here.ns)
            irradiance += wp.vec3d(wp.float64(value[0]), wp.float64(value[1]), wp.float64(value[2]))
        e = wp.vec3(float(irradiance[0]), float(irradiance[1]), float(irradiance[2])) / float(
            wp.max(count, 1)
        )
        if known:
            e += open_light[side]
        shown = wp.cw_div(film.background[pixel.index], frame.gain)
        for c in range(3):
            value_c = float(0.0)
            if e[c] > 0.0:
                value_c = wp.clamp(_PI * shown[c] / e[c], 0.0, 1.0)
            shown[c] = value_c
        frame.photo.reflectance[pixel.index] = shown
        wp.atomic_add(counters, 0, wp.int64(cast))

    return identify, reflectance


def open_sides(scene: Scene) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What the sides of flat real surfaces see, their normals, the irradiance of the open map there.

    (2 n,) int32: OPEN, nothing but the map; SHADED, other real surfaces too; 0, not flat. (n, 3) and
    (2 n, 3) float64, n the number of objects; the side of the normal first.
    """
    count = len(scene.objects)
    normals = np.zeros((count, 3))
    sides, light = np.zeros(2 * count, np.int32), np.zeros((2 * count, 3))
    walls = [o for o in scene.real if o.cast_shadow]
    for number, item in enumerate(scene.objects):
        plane = plane_of(item.mesh) if item.material.from_photo and item.mesh.normals_are_flat() else None
        if plane is None:
            continue
        normal, offset = plane
        normals[number] = normal
        for side, n in enumerate((normal, -normal)):
            reach = max(
                (float((w.mesh.vertices @ n).max()) - (n @ normal) * offset for w in walls if w is not item),
                default=0.0,
            )
            size = max(float(np.abs(w.mesh.vertices).max()) for w in (*walls, item))
            sees_none = reach <= 4 * float(np.spacing(np.float32(size)))
            sides[2 * number + side] = int(OPEN) if sees_none else int(SHADED)
            light[2 * number + side] = scene.environment.irradiance(n[None])[0]
    return sides, normals, light


def photo_passes(
    scene: DeviceScene, view: ViewOutput, outputs: Outputs, distortion: bool
) -> tuple[Pass, ...]:
    """Three passes: which surface each pixel shows, its reflectance, and each surface's mean.

    They run over the whole picture, whatever part of it the shot does: light comes from beyond. The
    context's `bound[view]` must hold FrameParams first and `photo_film` last.
    """
    picture = replace(view, window=view.whole)
    light = scene.scene.environment
    identify, reflectance = _make_kernels(
        scene.engine,
        view.model,
        distortion,
        light.interpolation,
        light.light_sampler,
        any(map(is_lamp, scene.scene.real)),
    )

    sides, normals, lights = open_sides(scene.scene)
    told: tuple[Any, ...] = (
        wp.array(sides, dtype=wp.int32, device=outputs.device),
        wp.array(normals.astype(np.float32), dtype=wp.vec3, device=outputs.device),
        wp.array(lights.astype(np.float32), dtype=wp.vec3, device=outputs.device),
    )

    def inputs(context: PassContext) -> list[Any]:
        bound = context.bound[view.name]
        return [scene.data, bound[0], bound[-1]]

    def mean(context: PassContext, span: Span) -> None:
        values = context.buffers[_name(view, "reflectance")].numpy()
        owners = context.buffers[_name(view, "object")].numpy()
        table = np.zeros((len(scene.scene.objects), 3))
        for number, item in enumerate(scene.scene.objects):
            chosen = owners == number
            table[number] = values[chosen].mean(axis=0, dtype=np.float64) if chosen.any() else 0.5
            if not item.material.from_photo:
                table[number] = item.material.reflectance
        out = context.buffers[_name(view, "mean")]
        wp.copy(out, wp.array(table.astype(np.float32), dtype=wp.float32, device=outputs.device))

    names = [_name(view, part) for part in ("object", "reflectance", "mean")]
    usual: dict[str, Any] = {"counters": RAYS, "everywhere": True, "device": outputs.device}
    return (
        pixel_pass(
            f"photo surfaces {view.name}".strip(), picture, identify, inputs, writes=(names[0],), **usual
        ),
        pixel_pass(
            f"photo reflectance {view.name}".strip(),
            picture,
            reflectance,
            lambda context: [*inputs(context), *told],
            reads=(names[0],),
            writes=(names[1],),
            **usual,
        ),
        Pass(
            f"photo mean {view.name}".strip(),
            Domain("nodes", 1, 1, 1),
            mean,
            reads=(names[0], names[1]),
            writes=(names[2],),
        ),
    )
