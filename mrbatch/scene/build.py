"""From what a job says of the scene to the scene itself: meshes, textures and the light are read here."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from mrbatch.errors import InputError, Place
from mrbatch.scene import material_settings as looks
from mrbatch.scene import settings as given
from mrbatch.scene.alignment_settings import Alignment
from mrbatch.scene.camera import Camera
from mrbatch.scene.depth_map import load_depth_mesh
from mrbatch.scene.environment import Environment, load_environment
from mrbatch.scene.environment_tables import Rows
from mrbatch.scene.given_material import material_of, surface_of
from mrbatch.scene.gltf_header import SUFFIXES as GLTF_SUFFIXES
from mrbatch.scene.gltf_header import further_files
from mrbatch.scene.gltf_material import material_from_gltf
from mrbatch.scene.gltf_parts import Playing, moving_parts
from mrbatch.scene.map_parallax import parallax_warning, seen_from
from mrbatch.scene.mesh import Mesh, box, icosphere, plane
from mrbatch.scene.mesh_file import load_mesh
from mrbatch.scene.motion import ALWAYS, Motion, Played, Still
from mrbatch.scene.opacity import given_opacity
from mrbatch.scene.scene import (
    Material,
    Scene,
    SceneObject,
    centre,
    virtual_bounds,
)

SPHERE_SUBDIVISIONS = 6

CameraOf = Callable[[int], Camera]
"""The camera of a frame, with its pose; raises InputError for a frame that has none."""
Turned = tuple[np.ndarray, str]
"""(3, 3) world_from_map that was found in the shot, and what a report says of it."""


def needs_cameras(real: Sequence[given.RealObject]) -> bool:
    """Whether the scene can be built only when the cameras of its frames are known."""
    return any(item.depth_map is not None and item.depth_map.frame is not None for item in real)


def build_scene(
    environment: given.Environment | None,
    real: Sequence[given.RealObject],
    virtual: Sequence[given.VirtualObject],
    camera_of: CameraOf | None = None,
    turned: Turned | None = None,
) -> Scene:
    """Reads every file of the scene. Raises InputError for one that cannot be used.

    `camera_of`: of frames that the settings name (`needs_cameras`). `turned`: of a map whose turn the
    settings leave to a mirror ball.
    """
    told: list[str] = []
    if environment is None:
        light = Environment(radiance=np.zeros((1, 2, 3), np.float32))
    else:
        matrix = None if environment.world_from_map is None else np.array(environment.world_from_map)
        if environment.align is not None:
            if environment.align.probe is None:
                turned = _aligned(environment.align, environment.rows)
            assert turned is not None, "the map's turn has to be found in the shot first"
            matrix = turned[0]
            told.append(turned[1])
        light = load_environment(
            environment.file,
            rows=environment.rows,
            yaw=environment.yaw,
            world_from_map=matrix,
            scale=environment.scale,
            interpolation=environment.interpolation,
        )
    seen: list[tuple[SceneObject, tuple[str, ...]]] = []
    for item in virtual:
        seen += _virtual(item)
    seen = [_real(item, camera_of) for item in real] + seen
    objects = tuple(found for found, _ in seen)
    told += [note for _, more in seen for note in more]
    if environment is not None and environment.position is not None:
        light, note = _as_seen_there(environment, light, objects)
        told.append(note)
    textures = [item.material.texture for item in objects if item.material.texture is not None]
    notes = (*light.notes, *told, *(note for texture in textures for note in texture.notes))
    return Scene(objects, light, centre(objects), tuple(dict.fromkeys(notes)))


def scene_files(
    environment: given.Environment | None,
    real: Sequence[given.RealObject],
    virtual: Sequence[given.VirtualObject],
) -> list[Path]:
    """Every file that the scene's pixels depend on, in the order of the settings that name them.

    Raises InputError for a mesh file whose further files cannot be told.
    """
    files: list[Path] = [environment.file] if environment else []
    items: list[given.RealObject | given.VirtualObject] = [*real, *virtual]
    for item in items:
        if item.mesh is not None:
            files += [item.mesh, *further_files(item.mesh)]
        if isinstance(item, given.RealObject) and item.depth_map is not None:
            files.append(item.depth_map.file)
        look = item.material or (item if isinstance(item, given.RealObject) else None)
        reflectance = getattr(look, "reflectance", None)
        if isinstance(reflectance, looks.Texture):
            files.append(reflectance.texture)
        opacity = getattr(item, "opacity", None)
        if isinstance(opacity, looks.OpacityTexture):
            files.append(opacity.texture)
    return files


def _as_seen_there(
    settings: given.Environment, light: Environment, objects: Sequence[SceneObject]
) -> tuple[Environment, str]:
    """The map as it looks from the virtual objects, or as it is, with what has to be said of that."""
    assert settings.position is not None
    position = np.array(settings.position)
    low, high = virtual_bounds(objects)
    middle = 0.5 * (low + high)
    if settings.proxy is None:
        return light, parallax_warning(position, middle)
    return seen_from(light, position, settings.proxy, middle, float(np.linalg.norm(high - low)))


def _aligned(alignment: Alignment, rows: Rows) -> Turned:
    found = alignment.solved(rows)
    off = ", ".join(f"{math.degrees(r):.2f}" for r in found.residuals)
    return found.world_from_map, (
        f"the environment map is turned to meet {len(found.residuals)} marked directions: they are {off} "
        "degrees off"
    )


def _real(item: given.RealObject, camera_of: CameraOf | None) -> tuple[SceneObject, tuple[str, ...]]:
    """The object, and notes on it."""
    if item.material is not None:
        material = surface_of(item.material)
    elif item.reflectance == "photo":
        material = Material(from_photo=True)
    else:
        material = material_of("diffuse", item.reflectance, 0.0)
    if item.emission is not None:
        material = replace(material, emission=item.emission)
    notes: tuple[str, ...] = ()
    if item.depth_map is not None:
        mesh, note = load_depth_mesh(item.depth_map, _camera_of_frame(item, item.depth_map.frame, camera_of))
        mesh, notes = _shaded(mesh, item), (note,)
    else:
        mesh = _shape(item)
    return _object(item, material, mesh, virtual=False, holdout=item.holdout), notes


def _camera_of_frame(item: given.RealObject, frame: int | None, camera_of: CameraOf | None) -> Camera | None:
    if frame is None:
        return None
    assert camera_of is not None, "a depth map of a frame needs the cameras"
    try:
        return camera_of(frame)
    except InputError as error:
        raise InputError(
            f"the depth map of `{item.name}` was taken in frame {frame}, which cannot be used: "
            f"{error.message}",
            place=error.place,
            hint="name a frame of the shot, or give the depth map's own `camera`",
        ) from None


def _virtual(item: given.VirtualObject) -> list[tuple[SceneObject, tuple[str, ...]]]:
    """The object, or one of its name for each material of a glTF file; with notes on each."""
    look = item.material
    if look is None:
        if item.mesh is not None and item.mesh.suffix.lower() in GLTF_SUFFIXES:
            return _as_its_file_says(item, item.mesh)
        look = looks.Diffuse()
    material = surface_of(look)
    if item.emission is not None:
        material = replace(material, emission=item.emission)
    material = given_opacity(material, item.opacity)
    if item.clip is None:
        found = [_object(item, material, _shape(item), virtual=True, holdout=item.holdout)]
    else:
        assert item.mesh is not None
        found = [
            _object(item, material, mesh, virtual=True, holdout=item.holdout, played=played)
            for _, mesh, played in moving_parts(item.mesh, item.clip, by_material=False)
        ]
    return [_told(each) for each in found]


def _told(item: SceneObject) -> tuple[SceneObject, tuple[str, ...]]:
    """The object, and what has to be said of one that light passes."""
    look = item.material
    unseen = ""
    if look.opacity == 0.0:
        unseen = "has the opacity 0"
    if look.kind in ("dielectric", "thin_dielectric") and look.ior == 1.0 and not look.most_emission.any():
        if not any(look.absorption) and look.reflectance == (1.0, 1.0, 1.0):
            unseen = "is clear and has the index of refraction of air"
    if unseen:
        note = f"`{item.name}` {unseen}: it cannot be seen"
        return replace(item, camera=False, cast_shadow=False), (note,)
    if look.kind == "dielectric" and not item.mesh.is_closed():
        return item, (f"the mesh of `{item.name}` is not closed: light that goes in may not come out of it",)
    return item, ()


def _as_its_file_says(item: given.VirtualObject, path: Path) -> list[tuple[SceneObject, tuple[str, ...]]]:
    """One scene object for each material (and, of an animation, way of moving) of the glTF file, all of the
    object's name."""
    place = Place(file=str(path))
    found: list[tuple[SceneObject, tuple[str, ...]]] = []
    for part, whole, played in moving_parts(path, item.clip, by_material=True):
        mesh = _shaded(whole, item)
        material, left_out = material_from_gltf(part.material, place, part.extensions)
        name = str(getattr(part.material, "name", None) or "")
        if mesh.uvs is None:
            material = replace(
                material,
                texture=None,
                surface_texture=None,
                normal_texture=None,
                emission_texture=None,
                opacity_texture=None,
            )
        if material.kind == "principled":
            if item.emission is not None:
                material = replace(material, emission=item.emission, emission_texture=None)
            material = given_opacity(material, item.opacity)
        elif item.emission is not None or item.opacity is not None:
            left_out += ("what the job says of opacity and emission",)
        notes = (f"{path.name}: {', '.join(left_out)} of its material left out",) if left_out else ()
        material = replace(material, name=name or item.name)
        made = _object(item, material, mesh, virtual=True, holdout=item.holdout, played=played)
        built, more = _told(made)
        found.append((built, notes + more))
    return found


def _object(
    item: given.Object,
    material: Material,
    mesh: Mesh,
    *,
    virtual: bool,
    holdout: bool,
    played: Playing | None = None,
) -> SceneObject:
    if (material.texture is not None or material.opacity_texture is not None) and mesh.uvs is None:
        raise InputError(
            f"the object `{item.name}` has a texture, but its mesh has no texture coordinates",
            place=Place(file=str(item.mesh)) if item.mesh else None,
            hint="give the mesh UVs, or a number in place of the texture",
        )
    motion: Motion | Still | Played | None = None
    if isinstance(item, given.VirtualObject):
        motion = _motion(item)
        if played is not None:
            motion = Played(motion or Still(item.transform.world_from_object()), *played)
    matrix = item.transform.world_from_object() if motion is None else motion.world_from_object(-np.inf)
    return SceneObject(
        name=item.name,
        # What is scaled to nothing at first has no place yet.
        mesh=mesh.transformed(matrix) if np.linalg.det(matrix[:3, :3]) else mesh,
        material=material,
        virtual=virtual,
        camera=item.camera,
        cast_shadow=item.cast_shadow,
        receive=item.receive,
        holdout=holdout,
        motion=motion,
        still=None if motion is None else mesh,
    )


def _motion(item: given.VirtualObject) -> Motion | Still | None:
    """How it moves over the frames; None where it does not, and is always there."""
    visible = ALWAYS if item.visible is None else tuple((float(a), float(b)) for a, b in item.visible)
    if item.animation is None:
        if item.visible is None:
            return None
        return Still(item.transform.world_from_object(), visible)
    keys = item.animation
    turns = [given.rotation_matrix(key.rotate) for key in keys]
    return Motion(
        np.array([float(k.frame) for k in keys]),
        np.array([k.translate for k in keys], dtype=np.float64),
        Rotation.from_matrix(turns).as_quat(),
        np.array([k.scale for k in keys], dtype=np.float64),
        visible,
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
    return _shaded(mesh, item)


def _shaded(mesh: Mesh, item: given.Object) -> Mesh:
    """With the normals that the object asks for."""
    if item.normals == "smooth":
        return mesh.with_angle_weighted_normals()
    if item.normals == "flat":
        return replace(mesh, normals=None)
    return mesh
