"""A mean over neighbours that differ by no more than their noise, which the two halves of the film tell.

Non-local means with a dual buffer, after Rousselle, Knaus and Zwicker, *Adaptive Rendering with Non-Local
Means Filtering* (2012), eq. 4 and section 3.1: the weights for one half come from the other, so that noise
does not choose its own company, which would be a bias. Two pixels p, q of the other half have the distance

    d^2 = ((p - q)^2 - (var p + var q)) / (k^2 (var p + var q)),   w = exp(-max(0, d^2))

in place of patches the larger of two: of means over 3 x 3 pixels, and of the pixels themselves with a larger
k. The weights of `neighbours.py` come on top. The variance is a mean over 5 x 5 pixels of (A - B)^2 / 2.
Where it is small next to what the picture shows, or 0, no neighbour is alike: with samples the weights of
all others go to 0, and with them the bias. What few bright samples among dark ones lose is given back
(`residual.py`). In place of exp(-x) stands (1 - x / 4)^4, 0 from 4 on.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from mrbatch.film.filter.neighbours import Surfaces, launch, picture, surface_distance, surfaces_of
from mrbatch.film.filter.residual import mean_kept
from mrbatch.film.filter.signal import Signal

K2 = wp.constant(wp.float32(0.5))
"""k^2 of means over 3 x 3: the larger, the more alike. (Rousselle et al.: k = 0.45, patches of 7 x 7.)"""
SINGLE = wp.constant(wp.float32(4.0))
"""k^2 of single pixels, which noise often sets apart: what is finer than 3 x 3 shows only there."""

TINY = wp.constant(wp.float32(1.0e-12))


@wp.struct
class Half:
    """A half's light and its weight (h, w), and `pilot`, the mean of the light over 3 x 3."""

    light: wp.array2d(dtype=wp.vec3)
    pilot: wp.array2d(dtype=wp.vec3)
    weight: wp.array2d(dtype=wp.vec3)


@wp.func
def quotient(a: wp.vec3, b: wp.vec3) -> wp.vec3:
    r = wp.vec3(0.0, 0.0, 0.0)
    for c in range(3):
        if b[c] > 0.0:
            r[c] = a[c] / b[c]
    return r


@wp.func
def falling(distance: float) -> float:
    """(1 - distance / 4)^4: like exp(-distance), a third of its time, and 0 from 4 on."""
    root = wp.max(1.0 - 0.25 * distance, 0.0)
    return root * root * root * root


@wp.kernel(enable_backward=False, module="unique")
def _pilot(
    s: Surfaces,
    first: Half,
    second: Half,
    variance: wp.array2d(dtype=wp.vec3),
    fewer: wp.array2d(dtype=float),
    row: int,
):
    """The pilots; `variance`: of the light of a half, from 5 x 5; `fewer`: that of its pilot over it."""
    band, x = wp.tid()
    y = row + band
    group = s.group[y, x]
    if group <= 0:
        return
    normal = s.normal[y, x]
    position = s.position[y, x]
    values_a = wp.vec3(0.0, 0.0, 0.0)
    values_b = wp.vec3(0.0, 0.0, 0.0)
    weights_a = wp.vec3(0.0, 0.0, 0.0)
    weights_b = wp.vec3(0.0, 0.0, 0.0)
    squares = wp.vec3(0.0, 0.0, 0.0)
    count = float(0.0)
    near = float(0.0)
    near_squares = float(0.0)
    for v in range(-2, 3):
        for u in range(-2, 3):
            distance = surface_distance(s, group, normal, position, y + v, x + u)
            if distance >= 0.0:
                w = falling(distance)
                i = y + v
                j = x + u
                apart = first.light[i, j] - second.light[i, j]
                squares += wp.cw_mul(apart, apart) * w
                count += w
                if u * u <= 1 and v * v <= 1:
                    weight_a = first.weight[i, j] * w
                    weight_b = second.weight[i, j] * w
                    values_a += wp.cw_mul(first.light[i, j], weight_a)
                    values_b += wp.cw_mul(second.light[i, j], weight_b)
                    weights_a += weight_a
                    weights_b += weight_b
                    near += w
                    near_squares += w * w
    first.pilot[y, x] = quotient(values_a, weights_a)
    second.pilot[y, x] = quotient(values_b, weights_b)
    variance[y, x] = squares * (0.5 / count)
    fewer[y, x] = near_squares / (near * near)


@wp.func
def unlike(apart: wp.vec3, variance: wp.vec3, k2: float) -> float:
    """d^2, mean over the channels, 0 or more. Where neither has noise, only equals are alike."""
    far = float(0.0)
    for c in range(3):
        far += (apart[c] * apart[c] - variance[c]) / (3.0 * k2 * variance[c] + TINY)
    return wp.max(far, 0.0)


@wp.kernel(enable_backward=False, module="unique")
def _mean(
    s: Surfaces,
    radius: int,
    first: Half,
    second: Half,
    variance: wp.array2d(dtype=wp.vec3),
    fewer: wp.array2d(dtype=float),
    value: wp.array2d(dtype=wp.vec3),
    weight: wp.array2d(dtype=wp.vec3),
    part: wp.array2d(dtype=wp.vec3),
    has_part: int,
    change: wp.array2d(dtype=wp.vec3),
    part_change: wp.array2d(dtype=wp.vec3),
    row: int,
):
    """What the filter adds to `value`, and to `part` with the same weights."""
    band, x = wp.tid()
    y = row + band
    group = s.group[y, x]
    if group <= 0:
        return
    normal = s.normal[y, x]
    position = s.position[y, x]
    pilot_a = first.pilot[y, x]
    pilot_b = second.pilot[y, x]
    light_a = first.light[y, x]
    light_b = second.light[y, x]
    single = variance[y, x]
    means = single * fewer[y, x]
    total_a = float(0.0)
    total_b = float(0.0)
    values_a = wp.vec3(0.0, 0.0, 0.0)
    values_b = wp.vec3(0.0, 0.0, 0.0)
    weights_a = wp.vec3(0.0, 0.0, 0.0)
    weights_b = wp.vec3(0.0, 0.0, 0.0)
    parts_a = wp.vec3(0.0, 0.0, 0.0)
    parts_b = wp.vec3(0.0, 0.0, 0.0)
    for v in range(-radius, radius + 1):
        for u in range(-radius, radius + 1):
            distance = surface_distance(s, group, normal, position, y + v, x + u)
            if distance >= 0.0:
                i = y + v
                j = x + u
                other = variance[i, j]
                both = single + other
                both_means = means + other * fewer[i, j]
                far_a = unlike(pilot_a - first.pilot[i, j], both_means, K2)
                far_b = unlike(pilot_b - second.pilot[i, j], both_means, K2)
                far_a = wp.max(far_a, unlike(light_a - first.light[i, j], both, SINGLE))
                far_b = wp.max(far_b, unlike(light_b - second.light[i, j], both, SINGLE))
                w_a = falling(distance + far_b)
                w_b = falling(distance + far_a)
                weight_a = first.weight[i, j] * w_a
                weight_b = second.weight[i, j] * w_b
                total_a += w_a
                total_b += w_b
                values_a += wp.cw_mul(first.light[i, j], weight_a)
                values_b += wp.cw_mul(second.light[i, j], weight_b)
                weights_a += weight_a
                weights_b += weight_b
                if has_part != 0:
                    parts_a += part[i, j] * w_a
                    parts_b += part[i, j] * w_b
    own = weight[y, x]
    weights = weights_a / total_a + weights_b / total_b
    change[y, x] = wp.cw_mul(own, quotient(values_a / total_a + values_b / total_b, weights)) - value[y, x]
    if has_part != 0:
        parts = quotient(parts_a / total_a + parts_b / total_b, weights)
        part_change[y, x] = wp.cw_mul(own, parts) - part[y, x]


def variance_guided(
    signal: Signal, radius: int, also: tuple[np.ndarray, ...] = (), threads: int = 1
) -> tuple[np.ndarray, ...]:
    """What to add to `signal.value`, then to `also` (at most one part of it) with the same weights.

    (h, w, 3) float64; 0 where the group is 0 or less. Reads pixels up to radius + 2 + `residual.REACH` away.
    """
    shape = signal.group.shape
    surfaces = surfaces_of(signal.group, signal.guide)
    halves = []
    for value, weight in zip(signal.halves, signal.half_weights):
        half = Half()
        there = weight > 0
        half.light = picture(np.divide(value, weight, out=np.zeros(value.shape), where=there))
        half.weight = picture(weight)
        half.pilot = wp.zeros(shape, dtype=wp.vec3, device="cpu")
        halves.append(half)
    variance: Any = wp.zeros(shape, dtype=wp.vec3, device="cpu")
    fewer: Any = wp.zeros(shape, dtype=float, device="cpu")
    launch(_pilot, shape, [surfaces, *halves, variance, fewer], threads)
    (part,) = also or (np.zeros((1, 1, 3)),)
    change: Any = wp.zeros(shape, dtype=wp.vec3, device="cpu")
    part_change: Any = wp.zeros(shape if also else (1, 1), dtype=wp.vec3, device="cpu")
    inputs = [surfaces, radius, *halves, variance, fewer, picture(signal.value), picture(signal.weight)]
    inputs += [picture(part), len(also), change, part_change]
    launch(_mean, shape, inputs, threads)
    found = [one.numpy().astype(np.float64) for one in ((change, part_change) if also else (change,))]
    return tuple(mean_kept(one, signal.weight, signal.group) for one in found)
