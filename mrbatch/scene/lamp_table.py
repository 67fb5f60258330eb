"""What emits light, as a table from which kernels draw points: triangles by their power.

A *lamp* is a triangle of an object that emits and that other surfaces see. One is chosen with probability in
proportion to its area times its mean radiance (of a texture the mean over the triangle), and a point on it
uniformly, so that the density over area is the same for all triangles of one radiance. Sums are float64, and
areas are those of the triangles as rays meet them, in float32 coordinates.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp

from mrbatch.scene.scene import SceneObject

MOST_LEVELS = 5
"""A triangle's texture is read at no more than 4 to this many points: the mean only chooses."""


@wp.struct
class LampData:
    """`triangles` (count): the scene's numbers of the lamps, those of real objects, `real` of them, first.
    `cdf` (count + 1): how probably one of those before each is chosen; `real_share`: a real one."""

    triangles: wp.array(dtype=wp.int32)
    cdf: wp.array(dtype=wp.float64)
    count: wp.int32
    real: wp.int32
    real_share: wp.float64


def emits(item: SceneObject) -> bool:
    """Whether light of an object's own falls on others."""
    return item.cast_shadow and bool(item.material.most_emission.any())


def is_lamp(item: SceneObject) -> bool:
    """Whether points are drawn on it. Not on clear media: where they overlap, a ray may not see a boundary
    (`scene.media`), and a pane is met in part."""
    return emits(item) and item.material.kind not in ("dielectric", "thin_dielectric")


def lamp_table(
    objects: Sequence[SceneObject], records: np.ndarray, first: Sequence[int], device: str = "cpu"
) -> Any:
    """`LampData` of a scene. `records`: its `TriangleData`, whose `lamp` is set here: the density over area,
    1/m^2, with which a point of the triangle is drawn; `first`: number of each object's first triangle."""
    numbers: list[np.ndarray] = [np.zeros(0, np.int64)]
    powers: list[np.ndarray] = [np.zeros(0)]
    real = 0
    for virtual in (False, True):
        for item, start in zip(objects, first):
            if item.virtual != virtual or not is_lamp(item):
                continue
            found = records[start : start + len(item.mesh.faces)]
            edges = found["e1"].astype(np.float64), found["e2"].astype(np.float64)
            areas = 0.5 * np.linalg.norm(np.cross(*edges), axis=1)
            radiance = mean_radiance(item)
            records["lamp"][start : start + len(found)] = np.where(areas > 0.0, radiance, 0.0)
            chosen = np.nonzero(areas * radiance > 0.0)[0]
            numbers.append(start + chosen)
            powers.append((areas * radiance)[chosen])
            real += 0 if virtual else len(chosen)
    triangles, power = np.concatenate(numbers), np.concatenate(powers)
    cdf = np.concatenate([[0.0], np.cumsum(power)])
    if len(power):
        records["lamp"] /= cdf[-1]
        cdf /= cdf[-1]
    data: Any = LampData()
    data.count, data.real = len(triangles), real
    data.real_share = float(cdf[real])
    data.triangles = wp.array(np.append(triangles, 0).astype(np.int32), dtype=wp.int32, device=device)
    data.cdf = wp.array(cdf, dtype=wp.float64, device=device)
    return data


def mean_radiance(item: SceneObject) -> np.ndarray:
    """(m,) float64: the sum of the three channels of what each triangle emits, its mean over the triangle."""
    texture = item.material.emission_texture
    mesh = item.mesh
    if texture is None or mesh.uvs is None:
        return np.full(len(mesh.faces), float(np.sum(item.material.emission)))
    texels = texture.pixels.sum(axis=2, dtype=np.float64)
    height, width = texels.shape
    corners = mesh.uvs[mesh.faces].astype(np.float64)
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    covered = 0.5 * np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]) * width * height
    # Four points a texel, by halving edges.
    levels = np.ceil(np.log(np.maximum(4.0 * covered, 1.0)) / np.log(4.0)).clip(1, MOST_LEVELS).astype(int)
    means = np.zeros(len(mesh.faces))
    for level in np.unique(levels):
        rows = np.nonzero(levels == level)[0]
        total = np.zeros(len(rows))
        points = _middles(int(level))
        for b in points:
            total += _bilinear(texels, corners[rows, 0] + b[0] * u[rows] + b[1] * v[rows])
        means[rows] = total / len(points)
    return means


def _middles(level: int) -> np.ndarray:
    """(4^level, 2): weights of the second and third corner at the middles of equal parts of a triangle."""
    parts = np.array([[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]])
    for _ in range(level):
        a, b, c = parts[:, 0], parts[:, 1], parts[:, 2]
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        parts = np.concatenate(
            [np.stack(t, axis=1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
        )
    return parts.mean(axis=1)


def _bilinear(texels: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """As `kernels.texture.sample_texture` reads them."""
    height, width = texels.shape
    x = (uv[:, 0] - np.floor(uv[:, 0])) * width - 0.5
    y = (1.0 - (uv[:, 1] - np.floor(uv[:, 1]))) * height - 0.5
    x0, y0 = np.floor(x).astype(int), np.floor(y).astype(int)
    fx, fy = x - x0, y - y0
    upper = texels[y0 % height, x0 % width] * (1 - fx) + texels[y0 % height, (x0 + 1) % width] * fx
    below = (y0 + 1) % height
    lower = texels[below, x0 % width] * (1 - fx) + texels[below, (x0 + 1) % width] * fx
    return upper * (1 - fy) + lower * fy
