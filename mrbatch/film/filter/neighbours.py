"""Arrays and weights that the kernels of filters share: which neighbours lie on the same smooth surface."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import warp as wp

from mrbatch.film.guides import Guide

ANGLE = wp.constant(wp.float32(0.2))
"""Radians: standard deviation of the angle between two normals, and of the angle at which the line from
one point to the other leaves the tangent plane. Both are independent of the scene's and picture's scale."""

BANDS = 8
"""Pieces of the picture a thread, so that uneven pictures keep all busy."""


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


def launch(kernel: Any, shape: tuple[int, int], inputs: list[Any], threads: int) -> None:
    """Runs a kernel over all pixels; its last argument is the first row. A pixel is written by one thread
    alone and nothing that is read is written, so the number of threads does not show."""
    rows = max(1, -(-shape[0] // (BANDS * threads)))

    def band(first: int) -> None:
        size = (min(rows, shape[0] - first), shape[1])
        wp.launch(kernel, dim=size, inputs=[*inputs, first], device="cpu")

    firsts = range(0, shape[0], rows)
    band(0)  # compiles, if need be, before threads ask for it
    if threads == 1:
        for first in firsts[1:]:
            band(first)
        return
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(band, firsts[1:]))


def picture(values: np.ndarray) -> Any:
    """(h, w, 3) to a Warp array (h, w) of vec3 on the CPU."""
    return wp.array(np.ascontiguousarray(values, np.float32), dtype=wp.vec3, device="cpu")


@wp.func
def surface_distance(
    s: Surfaces, group: wp.int32, normal: wp.vec3, position: wp.vec3, y: wp.int32, x: wp.int32
) -> float:
    """How little pixel (x, y) is of the same smooth surface, alike both ways: exp(-distance) is its weight.

    Negative for another object and outside the picture.
    """
    if y < 0 or x < 0 or y >= s.height or x >= s.width:
        return -1.0
    if s.group[y, x] != group:
        return -1.0
    other = s.normal[y, x]
    along = s.position[y, x] - position
    turned = wp.max(1.0 - wp.dot(normal, other), 0.0)
    off = float(0.0)
    square = wp.dot(along, along)
    if square > 0.0:
        first = wp.dot(normal, along)
        second = wp.dot(other, along)
        off = 0.5 * (first * first + second * second) / square
    return (turned + 0.5 * off) / (ANGLE * ANGLE)
