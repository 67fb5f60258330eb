"""Reading meshes from files. Texture coordinates count from the lower left; glTF's are turned here."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from mrbatch.errors import InputError, Place, ResourceError
from mrbatch.scene.gltf_header import SUFFIXES as GLTF_SUFFIXES
from mrbatch.scene.gltf_header import check_gltf_header, material_extensions, picture_files, read_gltf_header
from mrbatch.scene.mesh import Mesh, concatenate, normals_or_up
from mrbatch.scene.ply_header import check_ply_header

MAX_TRIANGLES = 2**31 // 3 - 1
"""Indices of a mesh are int32, and 3 m of them are addressed."""
MAX_FILE_BYTES = 8 * 2**30
_SUFFIXES = (".ply", ".obj", ".stl", ".glb", ".gltf")
# PLY: else trimesh splits and rounds the coordinates of vertices that have their own. OBJ: its
# `maintain_order` is not given, because it averages over seams and loses the normals.
_READER_OPTIONS: dict[str, dict[str, Any]] = {
    ".ply": {"fix_texture": False, "skip_materials": True},
    ".obj": {"skip_materials": True},
}


def load_mesh(path: str | Path) -> Mesh:
    """All triangles of a mesh file as one mesh; see `load_parts`."""
    return concatenate([part.mesh for part in load_parts(path)])


@dataclass(frozen=True)
class Part:
    """A mesh of a file, placed by its node, and the file's own description of its material (or None), with
    what extensions of glTF say of it. `local`: the mesh in its node's own frame; `node`: the node's name, as
    the reader gives it."""

    mesh: Mesh
    material: Any
    local: Mesh
    node: str
    extensions: Mapping[str, Any] = field(default_factory=dict)


def load_parts(path: str | Path, *, pictures: bool = False) -> list[Part]:
    """The meshes of a PLY, OBJ, STL, GLB or GLTF file, placed by its nodes.

    `pictures`: whether the textures of a glTF file's materials are read too.

    The file's own vertex normals and texture coordinates are kept, its vertices are neither merged nor
    reordered (OBJ: one for each used combination of position, texture coordinate and normal; STL: three
    a triangle). Polygons are cut into triangles. Texture coordinates of a glTF primitive without
    material, and those that a PLY file gives for faces, are not read. Triangles
    that are not finite, have repeated corners or no area are left out and counted in `dropped`.
    Raises InputError for a missing, unreadable or truncated file, one without triangles, or one whose
    indices point nowhere; ResourceError for one that is too large.
    """
    path = Path(path)
    place = Place(file=str(path))
    suffix = path.suffix.lower()
    if suffix not in _SUFFIXES:
        raise InputError(
            f"unknown kind of mesh file `{path.suffix}`",
            place=place,
            hint=f"convert it to one of {', '.join(_SUFFIXES)}",
        )
    if not path.is_file():
        raise InputError("the mesh file does not exist", place=place, hint="check the path in the job")
    size = path.stat().st_size
    if size == 0:
        raise InputError("the mesh file is empty", place=place, hint="export the mesh again")
    if size > MAX_FILE_BYTES:
        raise ResourceError(
            f"the mesh file has {size / 2**30:.1f} GiB, more than {MAX_FILE_BYTES >> 30}",
            place=place,
            hint="simplify the mesh",
        )
    if suffix == ".ply":
        check_ply_header(path, size, place)
    parts = []
    for part, matrix, node in _read(path, suffix, place, pictures):
        local = _from_trimesh(part, suffix, place)
        try:
            mesh = local.transformed(matrix)
        except ValueError as error:
            raise InputError(f"a node of the file cannot be placed: {error}", place=place) from error
        parts.append(Part(mesh, getattr(part.visual, "material", None), local, node))
    if pictures and suffix in GLTF_SUFFIXES:
        extensions = material_extensions(read_gltf_header(path, place))
        parts = [
            replace(part, extensions=extensions.get(part.material.name, {})) if part.material else part
            for part in parts
        ]
    triangles = sum(len(part.mesh.faces) for part in parts)
    dropped = sum(part.mesh.dropped for part in parts)
    if triangles + dropped == 0:
        raise InputError(
            "the mesh has no faces",
            place=place,
            hint="export it with triangles; a point cloud cannot stand as an object",
        )
    if triangles == 0:
        raise InputError(
            f"none of the mesh's {dropped} triangles is usable (not finite, or without area)",
            place=place,
            hint="repair or export the mesh again",
        )
    return parts


def _read(path: Path, suffix: str, place: Place, pictures: bool) -> list[tuple[Any, np.ndarray, str]]:
    """The file's meshes with transform and name of each of their nodes."""
    import trimesh

    # What the reader may open beside the file: a glTF's own buffers, its pictures, no material library.
    beside: dict[str, bytes] = {}
    if suffix in GLTF_SUFFIXES:
        files = check_gltf_header(path, place)
        if pictures:
            files |= picture_files(path, read_gltf_header(path, place))
        beside = {uri: file.read_bytes() for uri, file in files.items()}
    try:
        options = _READER_OPTIONS.get(suffix, {})
        scene = trimesh.load_scene(str(path), process=False, resolver=beside, **options)
    except MemoryError:
        raise ResourceError(
            "out of memory while reading the mesh file", place=place, hint="simplify the mesh"
        ) from None
    except Exception as error:  # a parser that meets broken bytes may raise anything
        raise InputError(
            f"the mesh file cannot be read ({type(error).__name__}: {error})",
            place=place,
            hint="it may be damaged or truncated: export it again",
        ) from error
    parts = []
    triangles = 0
    for node in scene.graph.nodes_geometry:
        matrix, name = scene.graph[node]
        geometry = scene.geometry[name]
        if isinstance(geometry, trimesh.Trimesh):
            # Many nodes may show one mesh, so a small file can ask for any number.
            triangles += len(geometry.faces)
            if triangles > MAX_TRIANGLES:
                raise ResourceError(f"the file's nodes show more than {MAX_TRIANGLES} triangles", place=place)
            parts.append((geometry, np.asarray(matrix, dtype=np.float64), str(node)))
    return parts


def _from_trimesh(part: Any, suffix: str, place: Place) -> Mesh:
    vertices, faces = np.array(part.vertices, dtype=np.float64), np.asarray(part.faces)
    if vertices.size and vertices.shape[1:] != (3,) or faces.size and faces.shape[1:] != (3,):
        raise InputError(
            f"the mesh's positions have the shape {vertices.shape}, its faces {faces.shape}; expected (n, 3)",
            place=place,
            hint="the file is damaged: export it again",
        )
    vertices, faces = vertices.reshape(-1, 3), faces.reshape(-1, 3)
    if len(faces) > MAX_TRIANGLES:
        raise ResourceError(f"the mesh has {len(faces)} triangles, more than {MAX_TRIANGLES}", place=place)
    if len(faces) and (faces.min() < 0 or faces.max() >= len(vertices)):
        raise InputError(
            f"the mesh's faces name vertices up to {faces.max()}, but it has {len(vertices)}",
            place=place,
            hint="the file is damaged or truncated: export it again",
        )
    normals = None
    # STL stores facet normals only; what trimesh would give for vertices is its own estimate.
    if suffix != ".stl" and "vertex_normals" in part._cache.cache:
        given = np.array(part._cache.cache["vertex_normals"], dtype=np.float64)
        if given.shape == vertices.shape:
            normals = normals_or_up(np.where(np.isfinite(given), given, 0.0))
    uvs = None
    given_uv = getattr(part.visual, "uv", None)
    if given_uv is not None and len(given_uv) == len(vertices):
        uvs = np.nan_to_num(np.asarray(given_uv, dtype=np.float32)[:, :2], posinf=0.0, neginf=0.0)
    faces, dropped = _usable_faces(vertices, faces.astype(np.int32))
    vertices[~np.isfinite(vertices).all(axis=1)] = 0.0
    return Mesh(vertices, faces, normals, uvs, dropped)


def _usable_faces(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, int]:
    """Faces that are finite, have three different corners, and an area in float64; and how many are not."""
    finite = np.isfinite(vertices).all(axis=1)[faces].all(axis=1)
    a, b, c = faces[:, 0], faces[:, 1], faces[:, 2]
    good = finite & (a != b) & (b != c) & (a != c)
    with np.errstate(invalid="ignore", over="ignore"):
        u, v = vertices[b] - vertices[a], vertices[c] - vertices[a]
        longest = np.maximum(np.abs(u).max(axis=1, initial=0.0), np.abs(v).max(axis=1, initial=0.0))
        scale = np.where((longest > 0.0) & np.isfinite(longest), longest, 1.0)[:, None]
        good &= np.cross(u / scale, v / scale).any(axis=1)
    return np.ascontiguousarray(faces[good]), int(len(faces) - np.count_nonzero(good))
