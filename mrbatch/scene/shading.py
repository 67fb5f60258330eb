"""What a surface point is made of, for kernels: textures, the photo as reflectance, local frames."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import warp as wp

from mrbatch.kernels.bsdf import Surface
from mrbatch.kernels.camera import CameraData, CameraFuncs
from mrbatch.kernels.texture import sample_texture
from mrbatch.scene.scene_data import PHOTO, SceneData, SurfacePoint


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


def make_surface(flags: ShadingFlags, camera: CameraFuncs) -> Any:
    """`wp.func (scene, photo, point) -> Surface`: the scattering properties at a point."""

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
    def surface_at(scene: SceneData, photo: PhotoReflectance, point: SurfacePoint) -> Surface:
        item = scene.objects[point.object]
        surface = Surface()
        surface.kind = item.kind
        surface.reflectance = item.reflectance
        surface.alpha = item.alpha
        if wp.static(flags.textures):
            if item.texture >= 0:
                surface.reflectance = sample_texture(scene.textures, item.texture, point.uv)
        if wp.static(flags.photo):
            if (item.flags & PHOTO) != 0:
                surface.reflectance = from_photo(photo, point)
        return surface

    return surface_at
