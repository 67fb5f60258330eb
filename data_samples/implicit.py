"""Smooth bodies from signed distances, and their meshes: what the sample's figures are made of.

A body is a function of points (n, 3) to distances (n,), metres, negative inside. Bodies are joined by
smooth minima, so that limbs flow into each other; `surface_net` turns one into triangles.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

Body = Callable[[np.ndarray], np.ndarray]


def ellipsoid(
    centre: tuple[float, float, float],
    radii: tuple[float, float, float],
    turn: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Body:
    """An ellipsoid turned by degrees about x, then y, then z.

    The distance is Quilez' bound k0 (k0 - 1) / k1: exact on the surface and first order near it.
    """
    axes, r = _rotation(turn), np.asarray(radii, float)

    def distance(p: np.ndarray) -> np.ndarray:
        q = (p - np.asarray(centre)) @ axes
        k0 = np.linalg.norm(q / r, axis=1)
        k1 = np.linalg.norm(q / (r * r), axis=1)
        return k0 * (k0 - 1.0) / np.maximum(k1, 1e-12)

    return distance


def capsule(a: tuple[float, float, float], b: tuple[float, float, float], radius: float) -> Body:
    """All points within `radius` of the segment from a to b."""
    start, along = np.asarray(a, float), np.subtract(b, a)

    def distance(p: np.ndarray) -> np.ndarray:
        t = np.clip((p - start) @ along / (along @ along), 0.0, 1.0)
        return np.linalg.norm(p - start - t[:, None] * along, axis=1) - radius

    return distance


def smooth_min(a: np.ndarray, b: np.ndarray, k: float) -> np.ndarray:
    """Quilez' cubic smooth minimum: differs from the minimum only where |a - b| < k."""
    h = np.maximum(k - np.abs(a - b), 0.0) / k
    return np.minimum(a, b) - h * h * h * k / 6.0


def smooth_max(a: np.ndarray, b: np.ndarray, k: float) -> np.ndarray:
    return -smooth_min(-a, -b, k)


def join(first: Body, *others: tuple[Body, float]) -> Body:
    """Bodies flowing into `first`, one after the other, each over its own width."""

    def distance(p: np.ndarray) -> np.ndarray:
        d = first(p)
        for body, k in others:
            d = smooth_min(d, body(p), k)
        return d

    return distance


def carve(body: Body, *others: tuple[Body, float]) -> Body:
    """`body` without the others, edges rounded over the widths given."""

    def distance(p: np.ndarray) -> np.ndarray:
        d = body(p)
        for other, k in others:
            d = smooth_max(d, -other(p), k)
        return d

    return distance


def gradient(body: Body, p: np.ndarray, step: float) -> np.ndarray:
    """(n, 3) by central differences."""
    parts = []
    for axis in range(3):
        e = np.zeros(3)
        e[axis] = step
        parts.append((body(p + e) - body(p - e)) / (2.0 * step))
    return np.stack(parts, axis=1)


def surface_net(
    body: Body, low: tuple[float, float, float], high: tuple[float, float, float], cell: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices (n, 3), unit normals (n, 3) and triangles (m, 3), counter-clockwise from outside.

    Gibson's surface nets (1998): a vertex in every cell that the surface crosses, a quad round every
    crossed edge. Vertices then go down the gradient onto the surface, and normals are the gradient's,
    so shading does not know the grid. The box must hold the whole body.
    """
    counts = [int(np.ceil((b - a) / cell)) + 1 for a, b in zip(low, high)]
    axes = [a + cell * np.arange(n) for a, n in zip(low, counts)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    values = np.concatenate([body(part) for part in np.array_split(grid.reshape(-1, 3), 64)])
    inside = values.reshape(counts) < 0.0

    number = np.full([n - 1 for n in counts], -1, dtype=np.int64)
    corners = sum(
        inside[i : counts[0] - 1 + i, j : counts[1] - 1 + j, k : counts[2] - 1 + k].astype(np.int8)
        for i in (0, 1)
        for j in (0, 1)
        for k in (0, 1)
    )
    cells = np.argwhere((corners > 0) & (corners < 8))
    number[tuple(cells.T)] = np.arange(len(cells))
    vertices = np.asarray(low) + cell * (cells + 0.5)

    triangles = []
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        ahead = np.roll(inside, -1, axis=axis)
        crossed = np.argwhere(inside != ahead)
        keep = (crossed[:, axis] < counts[axis] - 1) & (crossed[:, u] > 0) & (crossed[:, v] > 0)
        at = crossed[keep]
        eu, ev = np.eye(3, dtype=np.int64)[u], np.eye(3, dtype=np.int64)[v]
        quad = [number[tuple((at - shift).T)] for shift in (0 * eu, eu, eu + ev, ev)]
        out = inside[tuple(at.T)]
        a, b, c, d = (np.where(out, quad[i], quad[3 - i]) for i in range(4))
        triangles += [np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)]
    faces = np.concatenate(triangles)

    step = 0.02 * cell
    for _ in range(6):
        g = gradient(body, vertices, step)
        move = body(vertices)[:, None] * g / np.maximum((g * g).sum(axis=1, keepdims=True), 1e-6)
        length = np.linalg.norm(move, axis=1, keepdims=True)
        vertices = vertices - move * np.minimum(1.0, 0.5 * cell / np.maximum(length, 1e-12))
    normals = gradient(body, vertices, step)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return vertices, normals, faces


def _rotation(turn: tuple[float, float, float]) -> np.ndarray:
    """(3, 3) world_from_body of degrees about x, then y, then z."""
    (cx, cy, cz), (sx, sy, sz) = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x
