"""`SceneData`: the one struct that every kernel takes, and how it is filled."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from mrbatch.device.rays import BuiltSet, Engine, RayMesh, RaySet, build_set
from mrbatch.device.startup import start
from mrbatch.errors import InputError
from mrbatch.kernels.bsdf import KINDS
from mrbatch.kernels.environment import EnvironmentData
from mrbatch.kernels.texture import TextureAtlas, build_texture_atlas
from mrbatch.scene.lamp_table import LampData, emits, lamp_table
from mrbatch.scene.mesh import Mesh
from mrbatch.scene.scene import MAX_TRIANGLES, Scene, Texture

VIRTUAL = wp.constant(wp.int32(1))
RECEIVE = wp.constant(wp.int32(2))
HOLDOUT = wp.constant(wp.int32(4))
PHOTO = wp.constant(wp.int32(8))
SMOOTH = wp.constant(wp.int32(16))
SEE_THROUGH = wp.constant(wp.int32(32))


@wp.struct
class TriangleData:
    """What every hit asks for, in one line of the cache: first corner `a`, edges to the others, unit normal
    `ng`; `object` number, `flags` of the object; `lamp`: density over area with which light is looked for
    there (`scene.lamp_table`), 1/m^2."""

    a: wp.vec3
    e1: wp.vec3
    e2: wp.vec3
    ng: wp.vec3
    object: wp.int32
    flags: wp.int32
    lamp: wp.float32
    _unused: wp.float32


@wp.struct
class ObjectData:
    """One object: flags (bits above), BSDF kind, reflectance, GGX alpha, texture number or -1, and what
    only a principled surface has (`kernels.bsdf.Surface`). Of a dielectric: index of refraction, absorption
    1/m, priority among overlapping ones (`scene.media`). Opacity, its texture or -1, and where that is cut
    to 0 or 1 (`scene.see_through`)."""

    flags: wp.int32
    kind: wp.int32
    reflectance: wp.vec3
    alpha: wp.float32
    texture: wp.int32
    metalness: wp.float32
    f0: wp.float32
    edge: wp.vec3
    surface_texture: wp.int32
    normal_texture: wp.int32
    emission: wp.vec3
    emission_texture: wp.int32
    ior: wp.float32
    priority: wp.int32
    absorption: wp.vec3
    opacity: wp.float32
    opacity_texture: wp.int32
    opacity_cutoff: wp.float32


@wp.struct
class SceneData:
    """Geometry, materials and light. Positions are metres relative to the scene's origin.

    Ray sets: `camera_set` is what the camera sees (real and virtual), `photo_set` its real part;
    `all_set` what surfaces see, `real_set` and `virtual_set` its two parts; `lamp_set` what of it emits
    light. `corners`: each triangle's places in `normals` and `uvs`. `origin`: in the world.
    """

    origin: wp.vec3
    camera_set: RaySet
    photo_set: RaySet
    all_set: RaySet
    real_set: RaySet
    virtual_set: RaySet
    lamp_set: RaySet
    triangles: wp.array(dtype=TriangleData)
    corners: wp.array(dtype=wp.vec3i)
    normals: wp.array(dtype=wp.vec3)
    uvs: wp.array(dtype=wp.vec2)
    objects: wp.array(dtype=ObjectData)
    textures: TextureAtlas
    environment: EnvironmentData
    lamps: LampData


@wp.struct
class SurfacePoint:
    """A point on a surface, with normals that face the side it was seen from.

    `ng` geometric, `ns` shading normal; `object` number and its `flags`; `triangle` and the weights `b` of
    its second and third corner. `reach`: the length that the float error of `p` along `ng` is relative to.
    """

    p: wp.vec3
    ng: wp.vec3
    ns: wp.vec3
    object: wp.int32
    flags: wp.int32
    triangle: wp.int32
    b: wp.vec2
    reach: wp.float32


@wp.func
def surface_point(scene: SceneData, triangle: wp.int32, u: float, v: float, d: wp.vec3) -> SurfacePoint:
    """The surface at barycentrics (u, v) of a triangle, seen along `d`.

    The position is interpolated from the corners: exact to their float spacing, where origin plus
    distance times direction is not.
    """
    t = scene.triangles[triangle]
    a = t.a
    e1 = t.e1
    e2 = t.e2
    point = SurfacePoint()
    point.object = t.object
    point.flags = t.flags
    point.triangle = triangle
    point.b = wp.vec2(u, v)
    point.p = a + e1 * u + e2 * v
    point.ng = t.ng
    point.ns = point.ng
    # Terms of the interpolation as they enter along the normal: 0 for a plane through an axis plane
    # of the origin, whose points are exact, however large its triangles.
    point.reach = (
        wp.abs(point.ng[0]) * (wp.abs(a[0]) + u * wp.abs(e1[0]) + v * wp.abs(e2[0]))
        + wp.abs(point.ng[1]) * (wp.abs(a[1]) + u * wp.abs(e1[1]) + v * wp.abs(e2[1]))
        + wp.abs(point.ng[2]) * (wp.abs(a[2]) + u * wp.abs(e1[2]) + v * wp.abs(e2[2]))
    )
    if (t.flags & SMOOTH) != 0:
        c = scene.corners[triangle]
        n = scene.normals[c[0]] * (1.0 - u - v) + scene.normals[c[1]] * u + scene.normals[c[2]] * v
        length = wp.length(n)
        if length > 0.0:
            point.ns = n / length
    # The shading normal decides nothing about sides: it follows the geometric one.
    if wp.dot(point.ns, point.ng) < 0.0:
        point.ns = -point.ns
    if wp.dot(point.ng, d) > 0.0:
        point.ng = -point.ng
        point.ns = -point.ns
    return point


@wp.func
def texture_coordinates(scene: SceneData, point: SurfacePoint) -> wp.vec2:
    """UV of a surface point."""
    c = scene.corners[point.triangle]
    u = point.b[0]
    v = point.b[1]
    return scene.uvs[c[0]] * (1.0 - u - v) + scene.uvs[c[1]] * u + scene.uvs[c[2]] * v


@dataclass
class DeviceScene:
    """`data` for kernels, and what must stay alive with it. `scene`: of the whole shot; where it moves,
    `show` puts its objects where they are at a frame."""

    data: Any
    scene: Scene
    engine: Engine
    kept: tuple[Any, ...]
    device: str = "cpu"
    first: Any = None

    def show(self, time: float, frame: int | None = None) -> None:
        """Puts objects where they are at a time in frames; `frame` as in `SceneObject.at`.

        Whoever launches kernels afterwards takes `data` anew. A still scene costs nothing.
        """
        if self.scene.moves:
            # Textures and light stay where they are: whoever made them has to live on.
            self.first = self.first or self.data
            now = upload(self.scene.at(time, frame), self.engine, self.device, shared=self.first)
            self.data, self.kept = now.data, now.kept

    def light_sampler(self, wanted: str) -> Any:
        """The name of the light sampler for the setting `wanted`, whose tables are then in `data`."""
        light = self.scene.environment
        name: Any = light.light_sampler if wanted == "auto" else wanted
        light.provide(self.data.environment, name)
        return name


_TRIANGLE = TriangleData.numpy_dtype()


def _triangles(vertices: np.ndarray, mesh: Mesh, number: int, flags: int) -> np.ndarray:
    """`TriangleData` of an object's faces; `vertices` (n, 3) float32, relative to the scene's origin."""
    records = np.zeros(len(mesh.faces), dtype=_TRIANGLE)
    corners = vertices[mesh.faces]
    records["a"] = corners[:, 0]
    records["e1"] = corners[:, 1] - corners[:, 0]
    records["e2"] = corners[:, 2] - corners[:, 0]
    records["ng"] = mesh.face_normals()
    records["object"], records["flags"] = number, flags
    return records


def upload(scene: Scene, engine: Engine, device: str = "cpu", *, shared: Any = None) -> DeviceScene:
    """Builds the hierarchies and arrays of a scene. `shared`: data of the same scene at another frame, whose
    textures and light are taken.

    Raises InputError where there are more triangles than an index can number.
    """
    start()
    data = SceneData()
    data.origin = wp.vec3(*(float(c) for c in scene.origin))
    meshes: list[RayMesh] = []
    triangles, normals, uvs, corners = [], [], [], []
    objects = []
    textures: list[np.ndarray] = []
    n_vertices = n_triangles = 0

    def placed(texture: Texture | None) -> int:
        # Its number in the atlas, or -1.
        if texture is None:
            return -1
        textures.append(texture.pixels)
        return len(textures) - 1

    for number, item in enumerate(scene.objects):
        mesh = item.mesh
        local = (mesh.vertices - scene.origin).astype(np.float32)
        n = len(local)
        # Normals that are the triangles' own, as planes and boxes from files carry them, say nothing new.
        smooth = not mesh.normals_are_flat()
        normals.append(mesh.normals if mesh.normals is not None else np.zeros((n, 3), np.float32))
        uvs.append(mesh.uvs if mesh.uvs is not None else np.zeros((n, 2), np.float32))
        corners.append(mesh.faces + n_vertices)
        meshes.append(RayMesh(number, local, mesh.faces, n_triangles))
        n_vertices += n
        n_triangles += len(mesh.faces)
        entry = ObjectData()
        entry.flags = (
            int(item.virtual)
            | int(item.receive) * 2
            | int(item.holdout) * 4
            | int(item.material.from_photo) * 8
            | int(smooth) * 16
            | int(item.material.see_through) * 32
        )
        triangles.append(_triangles(local, mesh, number, entry.flags))
        entry.kind = KINDS[item.material.kind]
        entry.reflectance = wp.vec3(*item.material.reflectance)
        entry.alpha = item.material.alpha
        entry.metalness = item.material.metalness
        entry.f0 = item.material.f0
        entry.ior = item.material.ior
        entry.priority = item.material.priority
        entry.absorption = wp.vec3(*item.material.absorption)
        entry.edge = wp.vec3(*item.material.edge)
        entry.texture = placed(item.material.texture)
        entry.surface_texture = placed(item.material.surface_texture)
        entry.normal_texture = placed(item.material.normal_texture)
        entry.emission = wp.vec3(*item.material.emission)
        entry.emission_texture = placed(item.material.emission_texture)
        entry.opacity = item.material.opacity
        entry.opacity_cutoff = item.material.opacity_cutoff
        entry.opacity_texture = placed(item.material.opacity_texture)
        objects.append(entry)
    if n_triangles > MAX_TRIANGLES:
        raise InputError(f"{n_triangles} triangles are more than {MAX_TRIANGLES}")

    def joined(parts: list[np.ndarray], width: int, dtype: type) -> np.ndarray:
        return np.concatenate(parts).astype(dtype) if parts else np.zeros((1, width), dtype)

    data.normals = wp.array(joined(normals, 3, np.float32), dtype=wp.vec3, device=device)
    data.uvs = wp.array(joined(uvs, 2, np.float32), dtype=wp.vec2, device=device)
    data.corners = wp.array(joined(corners, 3, np.int32), dtype=wp.vec3i, device=device)
    records = np.concatenate(triangles) if triangles else np.zeros(1, _TRIANGLE)
    data.lamps = lamp_table(scene.objects, records, [m.first_triangle for m in meshes], device)
    data.triangles = wp.array(records, dtype=TriangleData, device=device)
    data.objects = wp.array(objects or [ObjectData()], dtype=ObjectData, device=device)
    if shared is None:
        data.textures = build_texture_atlas(textures, device=device)
        data.environment = scene.environment.upload(device)
    else:
        data.textures, data.environment = shared.textures, shared.environment

    built: dict[tuple[int, ...], BuiltSet] = {}

    def ray_set(chosen: list[int]) -> Any:
        # Two sets of the same objects share one hierarchy.
        key = tuple(chosen)
        if key not in built:
            built[key] = build_set([meshes[i] for i in chosen], engine, device)
        return built[key].data

    items = list(enumerate(scene.objects))
    data.camera_set = ray_set([i for i, o in items if o.camera])
    data.photo_set = ray_set([i for i, o in items if o.camera and not o.virtual])
    data.all_set = ray_set([i for i, o in items if o.cast_shadow])
    data.real_set = ray_set([i for i, o in items if o.cast_shadow and not o.virtual])
    data.virtual_set = ray_set([i for i, o in items if o.cast_shadow and o.virtual])
    data.lamp_set = ray_set([i for i, o in items if emits(o)])
    return DeviceScene(data, scene, engine, tuple(built.values()) + (meshes,), device)
