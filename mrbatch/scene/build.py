"""From what a job says of the scene to the scene itself: meshes, textures and the light are read here."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenImageIO as oiio

from mrbatch.errors import InputError, Place
from mrbatch.kernels.transfer import to_linear
from mrbatch.scene import settings as given
from mrbatch.scene.environment import Environment, load_environment
from mrbatch.scene.mesh import Mesh, box, icosphere, load_mesh, plane
from mrbatch.scene.scene import Material, Scene, SceneObject, Texture, centre

SPHERE_SUBDIVISIONS = 6


def build_scene(
    environment: given.Environment | None,
    real: Sequence[given.RealObject],
    virtual: Sequence[given.VirtualObject],
) -> Scene:
    """Reads every file of the scene. Raises InputError for one that cannot be used."""
    if environment is None:
        light = Environment(radiance=np.zeros((1, 2, 3), np.float32))
    else:
        light = load_environment(
            environment.file,
            rows=environment.rows,
            world_from_map=environment.rotation(),
            scale=environment.scale,
            interpolation=environment.interpolation,
        )
    objects = tuple(
        [_real(item) for item in real] + [_virtual(item) for item in virtual],
    )
    return Scene(objects, light, centre(objects))


def scene_files(
    environment: given.Environment | None,
    real: Sequence[given.RealObject],
    virtual: Sequence[given.VirtualObject],
) -> list[Path]:
    """Every file that the scene's pixels depend on, each once."""
    files: list[Path] = [environment.file] if environment else []
    items: list[given.RealObject | given.VirtualObject] = [*real, *virtual]
    for item in items:
        if item.mesh is not None:
            files.append(item.mesh)
        reflectance = item.material.reflectance if isinstance(item, given.VirtualObject) else item.reflectance
        if isinstance(reflectance, given.Texture):
            files.append(reflectance.texture)
    return list(dict.fromkeys(files))


def _real(item: given.RealObject) -> SceneObject:
    if item.reflectance == "photo":
        material = Material(from_photo=True)
    else:
        material = _material("diffuse", item.reflectance, 0.0)
    return _object(item, material, virtual=False, holdout=False)


def _virtual(item: given.VirtualObject) -> SceneObject:
    look = item.material
    alpha = look.roughness if isinstance(look, given.Conductor) else 0.0
    material = replace(_material(look.type, look.reflectance, alpha), name=look.name or "")
    return _object(item, material, virtual=True, holdout=item.holdout)


def _object(item: given.Object, material: Material, *, virtual: bool, holdout: bool) -> SceneObject:
    mesh = _shape(item)
    if material.texture is not None and mesh.uvs is None:
        raise InputError(
            f"the object `{item.name}` has a texture, but its mesh has no texture coordinates",
            place=Place(file=str(item.mesh)) if item.mesh else None,
            hint="give the mesh UVs, or a constant reflectance",
        )
    mesh = mesh.transformed(item.transform.world_from_object())
    return SceneObject(
        name=item.name,
        mesh=mesh,
        material=material,
        virtual=virtual,
        camera=item.camera,
        cast_shadow=item.cast_shadow,
        receive=item.receive,
        holdout=holdout,
    )


def _shape(item: given.Object) -> Mesh:
    if item.plane is not None:
        return plane(*item.plane.size)
    if item.box is not None:
        return box(item.box.size)
    if item.sphere is not None:
        mesh = icosphere(item.sphere.radius, subdivisions=SPHERE_SUBDIVISIONS)
    else:
        assert item.mesh is not None
        mesh = load_mesh(item.mesh)
    if item.normals == "smooth":
        return mesh.with_angle_weighted_normals()
    if item.normals == "flat":
        return replace(mesh, normals=None)
    return mesh


def _material(kind: str, reflectance: object, alpha: float) -> Material:
    if isinstance(reflectance, given.Texture):
        pixels = _texture(reflectance.texture, reflectance.colour)
        if reflectance.mean is not None:
            mean = pixels.reshape(-1, 3).mean(axis=0, dtype=np.float64)
            factor = np.divide(reflectance.mean, mean, out=np.zeros(3), where=mean > 0)
            pixels = (pixels * factor).astype(np.float32)
        average = tuple(float(c) for c in pixels.reshape(-1, 3).mean(axis=0, dtype=np.float64))
        texture = Texture(pixels, str(reflectance.texture))
        return Material(kind, average, alpha, texture)  # type: ignore[arg-type]
    return Material(kind=kind, alpha=alpha, reflectance=tuple(reflectance))  # type: ignore[arg-type]


@functools.lru_cache(maxsize=16)
def _texture(path: Path, colour: str) -> np.ndarray:
    """(H, W, 3) float32, linear. Raises InputError."""
    place = Place(file=str(path))
    picture = oiio.ImageInput.open(str(path))
    if picture is None:
        raise InputError(f"cannot read the texture: {oiio.geterror().strip()}", place=place)
    spec = picture.spec()
    bits = {"uint8": 8, "uint16": 16}.get(str(spec.format))
    if bits and colour == "srgb":
        codes = picture.read_image("uint8" if bits == 8 else "uint16")
    else:
        codes = picture.read_image("float")
    picture.close()
    if codes is None:
        raise InputError("the texture is damaged: its pixels cannot be read", place=place)
    codes = np.repeat(codes[..., :1], 3, axis=2) if codes.shape[2] < 3 else codes[..., :3]
    pixels = to_linear(codes, "srgb", bits) if bits and colour == "srgb" else codes.astype(np.float32)
    if not np.isfinite(pixels).all():
        raise InputError("the texture holds NaN or infinity", place=place)
    if pixels.min() < 0.0 or pixels.max() > 1.0:
        raise InputError(
            f"the texture reaches from {pixels.min():g} to {pixels.max():g}: a reflectance lies in 0..1",
            place=place,
            hint="scale the texture, or name its `colour` right",
        )
    pixels.setflags(write=False)
    return pixels
