"""One `trace` and one `occluded` for every kernel, made for the chosen ray engine.

A `RaySet` is a set of meshes under one hierarchy. Embree is the engine on the CPU; Warp's own
hierarchy is the other one, the oracle of the first and the only one on other devices.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import warp as wp

from mrbatch.device import embree
from mrbatch.errors import ResourceError

Engine = Literal["embree", "warp", "embree-recording"]
"""`embree-recording` notes every ray at the set's `log`: for benches, on one thread."""
FAR = wp.constant(wp.float32(3.0e38))
"""A distance beyond every scene: rays towards the environment end here."""


@wp.struct
class RaySet:
    """Handle of a set of meshes, as kernels take it; `scene` is 0 where the set is empty.

    `triangles` gives the scene's triangle number of a hit: indexed by mesh id and added to the face
    (Embree), or by the face of the merged mesh (Warp). `log`: where rays are noted, 0 for nowhere.
    """

    scene: wp.uint64
    intersect: wp.uint64
    occluded: wp.uint64
    log: wp.uint64
    triangles: wp.array(dtype=wp.int32)


@wp.struct
class Hit:
    """Nearest hit: distance `t` in units of the direction's length, barycentrics of the triangle's
    second and third corner, and the scene's triangle number; -1 where nothing is hit."""

    t: wp.float32
    u: wp.float32
    v: wp.float32
    triangle: wp.int32


@dataclass(frozen=True)
class Rays:
    """`trace(set, origin, direction, tfar) -> Hit` and `occluded(set, origin, direction, tfar) -> bool`."""

    engine: Engine
    trace: Any
    occluded: Any


@dataclass(frozen=True)
class RayMesh:
    """A mesh for a ray set: vertices (n, 3) float32, faces (m, 3) int32, id, and the scene's number of
    its first triangle."""

    identity: int
    vertices: np.ndarray
    faces: np.ndarray
    first_triangle: int


@dataclass(frozen=True)
class BuiltSet:
    """A ray set and what has to stay alive while kernels use it."""

    data: Any
    kept: Any


vec5 = wp.types.vector(length=5, dtype=wp.float32)


@wp.func_native(embree.INTERSECT_SOURCE)
def _embree_intersect(function: wp.uint64, scene: wp.uint64, o: wp.vec3, d: wp.vec3, tfar: float) -> vec5: ...


@wp.func_native(embree.OCCLUDED_SOURCE)
def _embree_occluded(function: wp.uint64, scene: wp.uint64, o: wp.vec3, d: wp.vec3, tfar: float) -> bool: ...


@wp.func
def _no_hit() -> Hit:
    hit = Hit()
    hit.t = FAR
    hit.triangle = wp.int32(-1)
    return hit


@wp.func
def _trace_embree(rays: RaySet, o: wp.vec3, d: wp.vec3, tfar: float) -> Hit:
    hit = _no_hit()
    if rays.scene != wp.uint64(0):
        found = _embree_intersect(rays.intersect, rays.scene, o, d, tfar)
        mesh = wp.cast(found[3], wp.int32)
        if mesh != wp.int32(-1):
            hit.t = found[0]
            hit.u = found[1]
            hit.v = found[2]
            hit.triangle = rays.triangles[mesh] + wp.cast(found[4], wp.int32)
    return hit


@wp.func
def _occluded_embree(rays: RaySet, o: wp.vec3, d: wp.vec3, tfar: float) -> bool:
    if rays.scene == wp.uint64(0):
        return False
    return _embree_occluded(rays.occluded, rays.scene, o, d, tfar)


@wp.func_native(embree.RECORD_SOURCE)
def _record(
    log: wp.uint64, scene: wp.uint64, o: wp.vec3, d: wp.vec3, tfar: float, kind: wp.int32
) -> bool: ...


@wp.func
def _trace_recording(rays: RaySet, o: wp.vec3, d: wp.vec3, tfar: float) -> Hit:
    if rays.scene != wp.uint64(0):
        _record(rays.log, rays.scene, o, d, tfar, wp.int32(0))
    return _trace_embree(rays, o, d, tfar)


@wp.func
def _occluded_recording(rays: RaySet, o: wp.vec3, d: wp.vec3, tfar: float) -> bool:
    if rays.scene != wp.uint64(0):
        _record(rays.log, rays.scene, o, d, tfar, wp.int32(1))
    return _occluded_embree(rays, o, d, tfar)


@wp.func
def _trace_warp(rays: RaySet, o: wp.vec3, d: wp.vec3, tfar: float) -> Hit:
    hit = _no_hit()
    if rays.scene != wp.uint64(0):
        query = wp.mesh_query_ray(rays.scene, o, d, tfar)
        if query.result:
            hit.t = query.t
            # Warp weighs the first two corners; the house weighs the second and third.
            hit.u = query.v
            hit.v = 1.0 - query.u - query.v
            hit.triangle = rays.triangles[query.face]
    return hit


@wp.func
def _occluded_warp(rays: RaySet, o: wp.vec3, d: wp.vec3, tfar: float) -> bool:
    if rays.scene == wp.uint64(0):
        return False
    return wp.mesh_query_ray_anyhit(rays.scene, o, d, tfar)


_ENGINES = {
    "embree": Rays("embree", _trace_embree, _occluded_embree),
    "warp": Rays("warp", _trace_warp, _occluded_warp),
    "embree-recording": Rays("embree-recording", _trace_recording, _occluded_recording),
}


def rays(engine: Engine) -> Rays:
    """The functions of an engine, to be called inside kernels."""
    return _ENGINES[engine]


@functools.cache
def resolve_engine(asked: Literal["auto", "embree", "warp"], device: str = "cpu") -> Engine:
    """The engine a job gets: `auto` is Embree on the CPU where it can be had, else Warp's.

    Raises ResourceError where the engine asked for is not available here.
    """
    if asked == "warp":
        return "warp"
    try:
        if device != "cpu":
            raise ResourceError("the ray engine Embree runs on the CPU only", hint="--set engine=warp")
        embree.library()
    except ResourceError:
        if asked == "embree":
            raise
        return "warp"
    return "embree"


def build_set(meshes: Sequence[RayMesh], engine: Engine, device: str = "cpu") -> BuiltSet:
    """Builds the hierarchy over some meshes."""
    data = RaySet()
    meshes = [mesh for mesh in meshes if len(mesh.faces)]
    if not meshes:
        data.triangles = wp.zeros(1, dtype=wp.int32, device=device)
        return BuiltSet(data, None)
    if engine != "warp":
        shared = []
        first = np.zeros(max(mesh.identity for mesh in meshes) + 1, dtype=np.int32)
        for mesh in meshes:
            padded = np.zeros((len(mesh.vertices), 4), dtype=np.float32)
            padded[:, :3] = mesh.vertices
            shared.append((mesh.identity, padded, np.ascontiguousarray(mesh.faces, dtype=np.uint32)))
            first[mesh.identity] = mesh.first_triangle
        scene = embree.EmbreeScene(shared)
        functions = embree.library()
        data.scene = wp.uint64(scene.handle)
        data.intersect = wp.uint64(functions.intersect)
        data.occluded = wp.uint64(functions.occluded)
        data.triangles = wp.array(first, dtype=wp.int32, device=device)
        return BuiltSet(data, scene)
    offsets = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes[:-1]])
    vertices = np.concatenate([mesh.vertices for mesh in meshes]).astype(np.float32)
    faces = np.concatenate([mesh.faces + offset for mesh, offset in zip(meshes, offsets)]).astype(np.int32)
    numbers = np.concatenate([mesh.first_triangle + np.arange(len(mesh.faces)) for mesh in meshes])
    tree = wp.Mesh(
        points=wp.array(vertices, dtype=wp.vec3, device=device),
        indices=wp.array(faces.ravel(), dtype=wp.int32, device=device),
    )
    data.scene = wp.uint64(tree.id)
    data.triangles = wp.array(numbers.astype(np.int32), dtype=wp.int32, device=device)
    return BuiltSet(data, tree)
