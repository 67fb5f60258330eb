"""Triangle meshes: what a surface is, and simple shapes. Texture coordinates count from the lower left."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True)
class Mesh:
    """Triangles.

    `vertices` (n, 3) float64, metres or the file's unit; `faces` (m, 3) int32, counter-clockwise seen
    from outside; `normals` (n, 3) float32 unit, per vertex, or None (the facets' own); `uvs` (n, 2)
    float32, origin at the lower left of the picture, or None. `dropped`: how many triangles a reader
    left out (not finite, repeated corners, or without area).
    """

    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray | None = None
    uvs: np.ndarray | None = None
    dropped: int = 0

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Least and greatest corner (3,) of the vertices that triangles use.

        Raises ValueError for a mesh without triangles.
        """
        if len(self.faces) == 0:
            raise ValueError("a mesh without triangles has no bounds")
        used = self.vertices[np.unique(self.faces)]
        return used.min(axis=0), used.max(axis=0)

    def size(self) -> float:
        """Length of the bounding box's diagonal."""
        low, high = self.bounds()
        return float(np.linalg.norm(high - low))

    def face_areas(self) -> np.ndarray:
        """(m,) float64."""
        return 0.5 * np.linalg.norm(self._face_vectors(), axis=1)

    def face_normals(self) -> np.ndarray:
        """(m, 3) float64 unit normals of the triangles; 0 for one without area."""
        return _unit(self._face_vectors())

    def is_closed(self) -> bool:
        """Whether every edge has triangles on both sides; vertices at the same place are one."""
        _, same = np.unique(self.vertices, axis=0, return_inverse=True)
        faces = same.reshape(-1)[self.faces]
        edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
        # Each edge is walked as often forth as back.
        forth = np.where(edges[:, 0] < edges[:, 1], 1, -1)
        _, number = np.unique(np.sort(edges, axis=1), axis=0, return_inverse=True)
        return bool(np.all(np.bincount(number.reshape(-1), weights=forth) == 0))

    def normals_are_flat(self) -> bool:
        """Whether there are no vertex normals, or they are the triangles' own to float32's last digits,
        on either side."""
        if self.normals is None:
            return True
        facet = self.face_normals()[:, None]
        return bool(np.all(np.abs((self.normals[self.faces] * facet).sum(axis=2)) > 1.0 - 2.0**-20))

    def _face_vectors(self) -> np.ndarray:
        a, b, c = (self.vertices[self.faces[:, k]] for k in range(3))
        return np.cross(b - a, c - a)

    def with_angle_weighted_normals(self) -> Mesh:
        """The same mesh with vertex normals: facet normals weighted by their angle at the vertex.

        Thuermer and Wuethrich 1998, over vertices as they are indexed (a seam stays sharp): what
        Mitsuba does for a file without normals. A vertex whose normals cancel gets (0, 0, 1).
        """
        corners = self.vertices[self.faces]
        facet = self.face_normals()
        total = np.zeros_like(self.vertices)
        for k in range(3):
            u = _unit(corners[:, (k + 1) % 3] - corners[:, k])
            v = _unit(corners[:, (k + 2) % 3] - corners[:, k])
            # Kahan's angle: exact to the last digits where an arc cosine has lost half of them.
            angle = 2.0 * np.arctan2(np.linalg.norm(u - v, axis=1), np.linalg.norm(u + v, axis=1))
            for axis in range(3):
                total[:, axis] += np.bincount(
                    self.faces[:, k], weights=angle * facet[:, axis], minlength=len(total)
                )
        return replace(self, normals=normals_or_up(total))

    def transformed(self, matrix: np.ndarray) -> Mesh:
        """The mesh under an affine `matrix` (4, 4), target_from_mesh.

        Normals go by the inverse transpose; a mirroring matrix reverses the corners' order, so that
        facets still turn outward. Raises ValueError for a singular or not finite matrix.
        """
        m = np.asarray(matrix, dtype=np.float64).reshape(4, 4)
        linear = m[:3, :3]
        if not np.isfinite(m).all() or not np.array_equal(m[3], (0.0, 0.0, 0.0, 1.0)):
            raise ValueError("the transform must be finite and affine (last row 0 0 0 1)")
        # The cofactor matrix is det * inverse transpose, without dividing by what may be tiny.
        cofactor = np.stack(
            [np.cross(linear[1], linear[2]), np.cross(linear[2], linear[0]), np.cross(linear[0], linear[1])]
        )
        determinant = float(linear[0] @ cofactor[0])
        if determinant == 0.0:
            raise ValueError("the transform is singular: it flattens the mesh")
        vertices = self.vertices @ linear.T + m[:3, 3]
        faces = self.faces if determinant > 0.0 else np.ascontiguousarray(self.faces[:, ::-1])
        normals = None
        if self.normals is not None:
            turned = self.normals.astype(np.float64) @ cofactor.T * np.sign(determinant)
            normals = normals_or_up(turned)
        return replace(self, vertices=vertices, faces=faces, normals=normals)


def _unit(v: np.ndarray) -> np.ndarray:
    """Rows of unit length; rows of length 0 stay 0. Scaled first, so that tiny rows do not underflow."""
    largest = np.abs(v).max(axis=1, keepdims=True, initial=0.0)
    scaled = np.divide(v, largest, out=np.zeros_like(v), where=largest > 0.0)
    length = np.linalg.norm(scaled, axis=1, keepdims=True)
    return np.divide(scaled, length, out=np.zeros_like(v), where=length > 0.0)


def normals_or_up(v: np.ndarray) -> np.ndarray:
    n = _unit(v)
    n[~n.any(axis=1)] = (0.0, 0.0, 1.0)
    return n.astype(np.float32)


def plane_of(mesh: Mesh) -> tuple[np.ndarray, float] | None:
    """Unit normal n and offset c with n . x = c for every vertex, or None where the mesh is not flat.

    Flat within the float32 spacing of its coordinates.
    """
    areas = mesh.face_areas()
    if len(areas) == 0 or areas.max() == 0.0:
        return None
    n = mesh.face_normals()[int(np.argmax(areas))]
    n = n / np.linalg.norm(n)
    used = mesh.vertices[np.unique(mesh.faces)]
    offsets = used @ n
    spacing = np.spacing(np.float32(np.abs(used).max()))
    if offsets.max() - offsets.min() > 4 * spacing:
        return None
    return n, float(offsets.mean())


def concatenate(meshes: Sequence[Mesh]) -> Mesh:
    """One mesh of several, vertices and triangles in order.

    Normals, where only some have them, are filled with angle-weighted ones; missing uvs with 0.
    Raises ValueError for an empty list.
    """
    if not meshes:
        raise ValueError("no mesh to concatenate")
    first = np.cumsum([0] + [len(m.vertices) for m in meshes[:-1]])
    if any(m.normals is not None for m in meshes):
        meshes = [m if m.normals is not None else m.with_angle_weighted_normals() for m in meshes]
    uvs = None
    if any(m.uvs is not None for m in meshes):
        uvs = np.concatenate(
            [m.uvs if m.uvs is not None else np.zeros((len(m.vertices), 2), np.float32) for m in meshes]
        )
    return Mesh(
        np.concatenate([m.vertices for m in meshes]),
        np.concatenate([m.faces + np.int32(k) for m, k in zip(meshes, first)]).astype(np.int32),
        None if meshes[0].normals is None else np.concatenate([m.normals for m in meshes]),
        uvs,
        sum(m.dropped for m in meshes),
    )


def plane(size_x: float, size_y: float, *, centre: Sequence[float] = (0.0, 0.0, 0.0)) -> Mesh:
    """A rectangle of two triangles in the plane z = centre[2], normal +z, uvs 0..1 along x and y."""
    x, y = 0.5 * size_x, 0.5 * size_y
    corners = np.array([[-x, -y, 0.0], [x, -y, 0.0], [x, y, 0.0], [-x, y, 0.0]]) + np.asarray(centre, float)
    faces = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)
    uvs = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=np.float32)
    return Mesh(corners, faces, np.tile(np.array([0, 0, 1], dtype=np.float32), (4, 1)), uvs)


def box(size: Sequence[float], *, centre: Sequence[float] = (0.0, 0.0, 0.0)) -> Mesh:
    """An axis-aligned box of twelve triangles, facets outward, four vertices and uvs 0..1 a side."""
    half = 0.5 * np.asarray(size, dtype=np.float64)
    sides = []
    for axis in range(3):
        u, v = np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3]
        for sign in (1.0, -1.0):
            # For the negative side u is turned, so that u x v still points outward.
            pose = np.eye(4)
            pose[:3, :3] = np.stack([sign * u * half, v * half, sign * np.eye(3)[axis]], axis=1)
            pose[:3, 3] = np.asarray(centre, float) + sign * np.eye(3)[axis] * half
            sides.append(plane(2.0, 2.0).transformed(pose))
    return concatenate(sides)


def uv_sphere(
    radius: float, *, segments: int = 32, rings: int = 16, centre: Sequence[float] = (0.0, 0.0, 0.0)
) -> Mesh:
    """A sphere of `segments` meridians and `rings` bands about z; poles and seam close exactly.

    Vertices lie on the sphere (the mesh lies inside it); normals are the sphere's own; no uvs.
    Raises ValueError for fewer than 3 segments or 2 rings.
    """
    if segments < 3 or rings < 2:
        raise ValueError(f"a sphere of {segments} segments and {rings} rings is not closed")
    polar = np.pi * np.arange(1, rings) / rings
    azimuth = 2.0 * np.pi * np.arange(segments) / segments
    band = np.stack(
        [
            np.sin(polar)[:, None] * np.cos(azimuth),
            np.sin(polar)[:, None] * np.sin(azimuth),
            np.broadcast_to(np.cos(polar)[:, None], (rings - 1, segments)),
        ],
        axis=-1,
    ).reshape(-1, 3)
    points = np.concatenate([[[0.0, 0.0, 1.0]], band, [[0.0, 0.0, -1.0]]])
    here = np.arange(segments)
    there = (here + 1) % segments
    faces = [np.stack([np.zeros_like(here), 1 + here, 1 + there], axis=1)]
    for ring in range(rings - 2):
        top, bottom = 1 + ring * segments, 1 + (ring + 1) * segments
        faces.append(np.stack([top + here, bottom + here, bottom + there], axis=1))
        faces.append(np.stack([top + here, bottom + there, top + there], axis=1))
    last = 1 + (rings - 2) * segments
    faces.append(np.stack([last + here, np.full_like(here, len(points) - 1), last + there], axis=1))
    return Mesh(
        radius * points + np.asarray(centre, float),
        np.concatenate(faces).astype(np.int32),
        points.astype(np.float32),
    )


def icosphere(radius: float, *, subdivisions: int = 3, centre: Sequence[float] = (0.0, 0.0, 0.0)) -> Mesh:
    """A sphere of 20 x 4^subdivisions nearly equal triangles, vertices on the sphere, its own normals."""
    golden = (1.0 + np.sqrt(5.0)) / 2.0
    corners = np.array(
        [[0, s, t * golden] for s in (-1, 1) for t in (-1, 1)]
        + [[s, t * golden, 0] for s in (-1, 1) for t in (-1, 1)]
        + [[t * golden, 0, s] for s in (-1, 1) for t in (-1, 1)]
    )
    # Faces of the icosahedron: the triples at mutual distance 2, turned outward.
    near = np.abs(np.linalg.norm(corners[:, None] - corners[None], axis=-1) - 2.0) < 1e-9
    triples = [
        (a, b, c)
        for a in range(12)
        for b in range(a + 1, 12)
        for c in range(b + 1, 12)
        if near[a, b] and near[b, c] and near[a, c]
    ]
    points = _unit(corners)
    faces = np.array(triples)
    inward = np.linalg.det(points[faces]) < 0.0
    faces[inward] = faces[inward][:, ::-1]
    for _ in range(subdivisions):
        edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        unique, index = np.unique(edges, axis=0, return_inverse=True)
        middle = len(points) + index.reshape(-1, 3)
        points = np.concatenate([points, _unit(points[unique].sum(axis=1))])
        a, b, c = faces.T
        ab, bc, ca = middle.T
        faces = np.concatenate(
            [np.stack(t, axis=1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
        )
    return Mesh(
        radius * points + np.asarray(centre, float), faces.astype(np.int32), points.astype(np.float32)
    )
