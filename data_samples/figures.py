"""The sample's bodies: the bunny, which is virtual, and the mug, which really stood on the table."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from implicit import Body, capsule, carve, ellipsoid, join, smooth_max, surface_net

BUNNY_CELL = 1.15e-3
FACE_CELL = 0.4e-3


def bunny() -> Body:
    """A sitting bunny, 115 mm high, looking along -y; it stands on z = 0."""
    s = 0.001

    def mm(*values: float) -> tuple[float, float, float]:
        return (values[0] * s, values[1] * s, values[2] * s)

    def pair(make) -> list[Body]:
        return [make(-1.0), make(1.0)]

    trunk = join(
        ellipsoid(mm(0, 6, 25), mm(26, 27, 25)),
        (ellipsoid(mm(0, -3, 42), mm(18.5, 18, 22)), 14 * s),
        (ellipsoid(mm(0, 31, 17), mm(9, 9, 9)), 4 * s),  # tail
    )
    haunches = pair(lambda x: ellipsoid(mm(20 * x, 2, 16), mm(11, 18, 16), (12, 0, 8 * x)))
    feet = pair(lambda x: ellipsoid(mm(17 * x, -20, 5.2), mm(8.5, 17, 6.6), (3, 0, -9 * x)))
    arms = pair(lambda x: capsule(mm(14.5 * x, -12, 44), mm(6.5 * x, -24.5, 32), 5.6 * s))
    head = join(
        ellipsoid(mm(0, -8, 70), mm(20.5, 20, 18.5)),
        (ellipsoid(mm(-9.5, -16, 65), mm(9.5, 9, 8.5)), 8 * s),  # cheeks
        (ellipsoid(mm(9.5, -16, 65), mm(9.5, 9, 8.5)), 8 * s),
        (ellipsoid(mm(0, -25, 66.5), mm(6.5, 5.5, 5.2)), 7 * s),  # muzzle
    )
    ears = [
        carve(
            ellipsoid(mm(12.5 * x, -1, 97), mm(7.6, 5.0, 21.5), (-9, 13 * x, -14 * x)),
            (ellipsoid(mm(13.2 * x, -6.2, 97.5), mm(4.6, 3.6, 16.5), (-9, 13 * x, -14 * x)), 2.2 * s),
        )
        for x in (-1.0, 1.0)
    ]
    whole = join(
        trunk,
        *((h, 7 * s) for h in haunches),
        *((f, 4 * s) for f in feet),
        *((a, 3.5 * s) for a in arms),
        (head, 7 * s),
        *((e, 4.5 * s) for e in ears),
    )
    mouth = pair(lambda x: capsule(mm(0.0, -31.5, 64.2), mm(4.6 * x, -29.2, 60.9), 0.75 * s))
    toes = [
        capsule(mm(17 * x + dx + 2.2 * x, -38.5, 7.5), mm(17 * x + dx + 1.2 * x, -31.0, 12.0), 0.75 * s)
        for x in (-1.0, 1.0)
        for dx in (-2.7, 2.7)
    ]
    carved = carve(whole, *((b, 1.2 * s) for b in [*mouth, *toes]))
    done = join(carved, *((part, 0.4 * s) for part in face_parts(0.0)))
    # The sole: what reaches below the ground is cut off, over a width that leaves a rounded edge.
    return lambda p: smooth_max(done(p), -p[:, 2], 1.5 * s)


def face_parts(swell: float) -> list[Body]:
    """The bunny's eyes and nose, grown by `swell` metres."""
    at = [((-8.6e-3, -24.6e-3, 73.5e-3), -20.0), ((8.6e-3, -24.6e-3, 73.5e-3), 20.0)]
    eyes = [
        ellipsoid(centre, (3.1e-3 + swell, 2.2e-3 + swell, 4.0e-3 + swell), (8.0, 0.0, turn))
        for centre, turn in at
    ]
    nose = ellipsoid((0.0, -30.3e-3, 68.6e-3), (2.9e-3 + swell, 2.0e-3 + swell, 2.0e-3 + swell))
    return [*eyes, nose]


def face() -> Body:
    """Eyes and nose alone, just outside those of the bunny: they can have a material of their own."""
    first, *others = face_parts(0.12e-3)
    return join(first, *((other, 1e-6) for other in others))


def mug() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A mug of 84 mm width and 92 mm height with a handle along +x: vertices, normals, triangles.

    Turned on a lathe, because its lip is too fine for a grid; the handle's ends lie within the wall.
    """
    radius, height, wall, around = 42e-3, 92e-3, 5e-3, 160
    bend = np.linspace(0.0, 0.5 * np.pi, 9)

    def corner(r: float, z: float, size: float, first: float) -> list[tuple[float, float, float, float]]:
        # A quarter circle about (r, z), counter-clockwise; a negative size turns normals to its centre.
        c, s = np.cos(first + np.sign(size) * bend), np.sin(first + np.sign(size) * bend)
        sign = np.sign(size)
        return list(zip(r + abs(size) * c, z + abs(size) * s, sign * c, sign * s))

    foot, lip, inner = 2.5e-3, 0.5 * wall, 9e-3
    quarter = 0.5 * np.pi
    profile = [
        (0.0, 0.0, 0.0, -1.0),
        *corner(radius - foot, foot, foot, -quarter),
        *corner(radius - lip, height - lip, lip, 0.0),
        *corner(radius - lip, height - lip, lip, quarter)[1:],
        *corner(radius - wall - inner, wall + inner, -inner, 0.0),
        (0.0, wall, 0.0, 1.0),
    ]
    r, z, nr, nz = np.array(profile).T
    turn = 2.0 * np.pi * np.arange(around) / around
    cup = _sweep(
        np.stack([np.outer(r, np.cos(turn)), np.outer(r, np.sin(turn)), np.tile(z, (around, 1)).T], -1),
        np.stack([np.outer(nr, np.cos(turn)), np.outer(nr, np.sin(turn)), np.tile(nz, (around, 1)).T], -1),
    )

    tube = 5e-3
    along, about = np.linspace(-quarter, quarter, 49), 2.0 * np.pi * np.arange(32) / 32
    middle = np.stack([39.5e-3 + 25e-3 * np.cos(along), 0 * along, 48e-3 + 28e-3 * np.sin(along)], axis=1)
    outward = np.stack([np.cos(along) / 25e-3, 0 * along, np.sin(along) / 28e-3], axis=1)
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    side = np.array([0.0, 1.0, 0.0])
    normals = np.cos(about)[None, :, None] * side - np.sin(about)[None, :, None] * outward[:, None, :]
    handle = _sweep(middle[:, None, :] + tube * normals, normals)

    faces = np.concatenate([cup[2], handle[2] + len(cup[0])])
    return np.concatenate([cup[0], handle[0]]), np.concatenate([cup[1], handle[1]]), faces


def _sweep(points: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rings (n, m, 3), one after the other, closed round m, as vertices, normals and triangles."""
    n, m = points.shape[:2]
    here = np.arange((n - 1) * m)
    there = here // m * m + (here + 1) % m
    a, b, c, d = here, there, there + m, here + m
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    p = points.reshape(-1, 3)
    area = np.linalg.norm(np.cross(p[faces[:, 1]] - p[faces[:, 0]], p[faces[:, 2]] - p[faces[:, 0]]), axis=1)
    return p, normals.reshape(-1, 3), faces[area > 0.0]


def write_bunny(path: Path) -> None:
    vertices, normals, faces = surface_net(bunny(), (-0.05, -0.06, -0.006), (0.05, 0.055, 0.13), BUNNY_CELL)
    vertices[:, 2] -= vertices[:, 2].min()
    write_mesh(path, vertices, normals, faces)


def write_face(path: Path) -> None:
    write_mesh(path, *surface_net(face(), (-0.016, -0.036, 0.062), (0.016, -0.018, 0.082), FACE_CELL))


def write_mug(path: Path) -> None:
    write_mesh(path, *mug())


def write_mesh(path: Path, vertices: np.ndarray, normals: np.ndarray, faces: np.ndarray) -> None:
    """A binary PLY with normals."""
    rows = np.concatenate([vertices, normals], axis=1).astype("<f4")
    triangles = np.zeros(len(faces), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    triangles["count"], triangles["corners"] = 3, faces
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"element vertex {len(rows)}",
        *(f"property float {name}" for name in ("x", "y", "z", "nx", "ny", "nz")),
        f"element face {len(faces)}",
        "property list uchar int vertex_indices",
        "end_header",
    ]
    path.write_bytes(("\n".join(header) + "\n").encode("ascii") + rows.tobytes() + triangles.tobytes())
