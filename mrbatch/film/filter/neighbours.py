"""Arrays and weights that the kernels of filters share: which neighbours lie on the same smooth surface."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from mrbatch.film.guides import Guide

ANGLE = wp.constant(wp.float32(0.2))
"""Radians: standard deviation of the angle between two normals, and of the angle at which the line from
one point to the other leaves the tangent plane. Both are independent of the scene's and picture's scale."""


@wp.struct
class Surfaces:
    """Guides (h, w) as kernels take them; `group` 0 is left alone. Normals have unit length."""

    width: wp.int32
    height: wp.int32
    group: wp.array2d(dtype=wp.int32)
    normal: wp.array2d(dtype=wp.vec3)
    position: wp.array2d(dtype=wp.vec3)


def surfaces_of(group: np.ndarray, guide: Guide) -> Any:
    """`Surfaces` on the CPU."""
    data = Surfaces()
    data.height, data.width = group.shape
    length = np.linalg.norm(guide.normal, axis=-1, keepdims=True)
    data.group = wp.array(np.ascontiguousarray(group, np.int32), dtype=wp.int32, device="cpu")
    data.normal = picture(guide.normal / np.maximum(length, 1e-20))
    data.position = picture(guide.position)
    return data


def picture(values: np.ndarray) -> Any:
    """(h, w, 3) to a Warp array (h, w) of vec3 on the CPU."""
    return wp.array(np.ascontiguousarray(values, np.float32), dtype=wp.vec3, device="cpu")


@wp.func
def same_surface(
    s: Surfaces, group: wp.int32, normal: wp.vec3, position: wp.vec3, y: wp.int32, x: wp.int32
) -> float:
    """Weight of pixel (x, y) as a neighbour, 0..1, alike both ways; 0 for another object."""
    if y < 0 or x < 0 or y >= s.height or x >= s.width:
        return 0.0
    if s.group[y, x] != group:
        return 0.0
    other = s.normal[y, x]
    along = s.position[y, x] - position
    turned = 1.0 - wp.dot(normal, other)
    off = float(0.0)
    square = wp.dot(along, along)
    if square > 0.0:
        first = wp.dot(normal, along)
        second = wp.dot(other, along)
        off = 0.5 * (first * first + second * second) / square
    return wp.exp(-(turned + 0.5 * off) / (ANGLE * ANGLE))
