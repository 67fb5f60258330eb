"""What a surface point is made of, for kernels: textures, the photo as reflectance, local frames."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import warp as wp

from mrbatch.kernels.bsdf import Surface
from mrbatch.kernels.camera import CameraData, CameraFuncs
from mrbatch.kernels.texture import sample_texture
from mrbatch.scene.scene_data import PHOTO, SceneData, SurfacePoint, texture_coordinates


@wp.struct
class PhotoReflectance:
    """Diffuse reflectance of real surfaces as the photo shows it, one view of one frame.

    `reflectance` (height * width): pi L_b / E_r at the pixel; `object` (height * width): which object
    was seen there, -1 none; `mean` (objects): for points that the camera does not see.
    """

    camera: CameraData
    width: wp.int32
    height: wp.int32
    x: wp.int32
    y: wp.int32
    reflectance: wp.array(dtype=wp.vec3)
    object: wp.array(dtype=wp.int32)
    mean: wp.array(dtype=wp.vec3)


@dataclass(frozen=True)
class ShadingFlags:
    """What the materials of a shot call for; what is off leaves no code."""

    textures: bool = False
    photo: bool = False
    principled: bool = False
    normal_maps: bool = False
    emission: bool = False
    transmission: bool = False
    cutouts: bool = False
    """Some surface is there in part."""
    panes: bool = False
    """Thin glass."""

    @property
    def see_through(self) -> bool:
        """Light passes some surface straight on."""
        return self.cutouts or self.panes


@dataclass(frozen=True)
class SurfaceFuncs:
    """`wp.func`s: three of (scene, photo, point), `normal` of (scene, point, towards the viewer), and
    `emission` of (scene, point).

    `surface` -> Surface: all scattering properties. `bare` -> Surface: the same with reflectance 1, and
    `reflectance` -> vec3, for a caller who finds out first whether it is needed: textures are large, and
    a look-up costs as much as a short ray. `normal` -> vec3: the shading normal, which a map may bend.
    `emission` -> vec3: the radiance that the surface sends of itself.
    """

    surface: Any
    bare: Any
    reflectance: Any
    normal: Any
    emission: Any


@wp.func
def bent_normal(scene: SceneData, point: SurfacePoint, viewer: wp.vec3, local: wp.vec3) -> wp.vec3:
    """The shading normal whose parts along u, v and the surface's own normal are `local` (any length).

    The frame is the triangle's: u and v as they grow over it, u made square with the shading normal. A
    normal that would turn away from the viewer is bent only as far as it can be seen.
    """
    c = scene.corners[point.triangle]
    e1 = scene.triangles[point.triangle].e1
    e2 = scene.triangles[point.triangle].e2
    t1 = scene.uvs[c[1]] - scene.uvs[c[0]]
    t2 = scene.uvs[c[2]] - scene.uvs[c[0]]
    area = t1[0] * t2[1] - t2[0] * t1[1]
    # The map stands on the outside; seen from inside, all of it is turned over.
    outward = wp.where(wp.dot(point.ng, scene.triangles[point.triangle].ng) < 0.0, -1.0, 1.0)
    n = point.ns * outward
    along = (e1 * t2[1] - e2 * t1[1]) * wp.sign(area)
    along = along - n * wp.dot(n, along)
    length = wp.length(along)
    if area == 0.0 or length == 0.0:
        return point.ns
    along = along / length
    across = wp.cross(n, along)
    up = (e2 * t1[0] - e1 * t2[0]) * wp.sign(area)
    if wp.dot(across, up) < 0.0:
        across = -across
    bent = wp.normalize(along * local[0] + across * local[1] + n * local[2]) * outward
    before = wp.dot(point.ns, viewer)
    after = wp.dot(bent, viewer)
    if before <= 0.0:
        return point.ns
    if after <= 0.0:
        bent = wp.normalize(point.ns + (bent - point.ns) * (0.9 * before / (before - after)))
    return bent


def make_surface(flags: ShadingFlags, camera: CameraFuncs) -> SurfaceFuncs:
    """The functions that tell what is at a surface point."""

    @wp.func
    def from_photo(photo: PhotoReflectance, point: SurfacePoint) -> wp.vec3:
        seen = camera.project(photo.camera, point.p)
        i = wp.int32(wp.floor(seen[0])) - photo.x
        j = wp.int32(wp.floor(seen[1])) - photo.y
        value = photo.mean[point.object]
        if seen[2] > 0.0 and i >= 0 and j >= 0 and i < photo.width and j < photo.height:
            k = j * photo.width + i
            if photo.object[k] == point.object:
                value = photo.reflectance[k]
        return value

    @wp.func
    def reflectance_at(scene: SceneData, photo: PhotoReflectance, point: SurfacePoint) -> wp.vec3:
        value = scene.objects[point.object].reflectance
        if wp.static(flags.textures):
            texture = scene.objects[point.object].texture
            if texture >= 0:
                value = sample_texture(scene.textures, texture, texture_coordinates(scene, point))
        if wp.static(flags.photo):
            if (point.flags & PHOTO) != 0:
                value = from_photo(photo, point)
        return value

    @wp.func
    def bare_at(scene: SceneData, photo: PhotoReflectance, point: SurfacePoint) -> Surface:
        surface = Surface()
        surface.kind = scene.objects[point.object].kind
        surface.alpha = scene.objects[point.object].alpha
        surface.reflectance = wp.vec3(1.0, 1.0, 1.0)
        if wp.static(flags.principled):
            surface.metalness = scene.objects[point.object].metalness
            surface.f0 = scene.objects[point.object].f0
            surface.edge = scene.objects[point.object].edge
        if wp.static(flags.panes):
            surface.eta = scene.objects[point.object].ior
        return surface

    @wp.func
    def surface_at(scene: SceneData, photo: PhotoReflectance, point: SurfacePoint) -> Surface:
        surface = bare_at(scene, photo, point)
        surface.reflectance = reflectance_at(scene, photo, point)
        if wp.static(flags.principled and flags.textures):
            found = scene.objects[point.object].surface_texture
            if found >= 0:
                look = sample_texture(scene.textures, found, texture_coordinates(scene, point))
                surface.alpha = look[0]
                surface.metalness = look[1]
        return surface

    @wp.func
    def normal_at(scene: SceneData, point: SurfacePoint, viewer: wp.vec3) -> wp.vec3:
        result = point.ns
        if wp.static(flags.normal_maps):
            found = scene.objects[point.object].normal_texture
            if found >= 0:
                local = sample_texture(scene.textures, found, texture_coordinates(scene, point))
                result = bent_normal(scene, point, viewer, local)
        return result

    @wp.func
    def emission_at(scene: SceneData, point: SurfacePoint) -> wp.vec3:
        result = scene.objects[point.object].emission
        if wp.static(flags.textures):
            found = scene.objects[point.object].emission_texture
            if found >= 0:
                result = sample_texture(scene.textures, found, texture_coordinates(scene, point))
        return result

    return SurfaceFuncs(surface_at, bare_at, reflectance_at, normal_at, emission_at)
