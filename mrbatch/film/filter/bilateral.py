"""The cross-bilateral filter of Xu et al. (section 4: size 5 x 5), put right.

*Delta Path Tracing for Real-Time Global Illumination in Mixed Reality* filters the radiance with weights
from guides. On a plane all guides are equal, so that is a plain blur: it rounds off every shadow. Here

- light is filtered without texture and coverage, each object apart (`signal.py`);
- the change that the filter makes is applied in part, by the strength s that makes the expected squared
  error least: d = F - x, s = E[(x - t)(-d)] / E[d^2]. For a filter whose own pixel has the share h, the
  numerator is (1 - h) var x, and the variance is known from the two halves, (x_A - x_B)^2 / 4. Both means
  run over the same neighbours. Where the filter would blur something that stands out of the noise, d^2 is
  large and s small; with samples s goes to 0, and with it the bias.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from mrbatch.film.filter.neighbours import Surfaces, picture, same_surface, surfaces_of
from mrbatch.film.filter.signal import Signal

WIDER = 1
"""Pixels that the mean of the strength reaches further than the filter: of a few pixels, the strength is
noise itself, and as it is cut at 1 the filter would be too weak."""


@wp.kernel(enable_backward=False, module="unique")
def _mean(
    s: Surfaces,
    radius: int,
    value: wp.array2d(dtype=wp.vec3),
    weight: wp.array2d(dtype=wp.vec3),
    variance: wp.array2d(dtype=wp.vec3),
    change: wp.array2d(dtype=wp.vec3),
    gain: wp.array2d(dtype=wp.vec2),
):
    """`change`: what the filter adds. `gain`: (1 - h) times the variance, square of the change."""
    y, x = wp.tid()
    group = s.group[y, x]
    if group == 0:
        return
    normal = s.normal[y, x]
    position = s.position[y, x]
    # The spatial weight falls to 0.41 at the radius.
    fall = 0.5 / (0.75 * 0.75 * float(radius) * float(radius))
    values = wp.vec3(0.0, 0.0, 0.0)
    weights = wp.vec3(0.0, 0.0, 0.0)
    for v in range(-radius, radius + 1):
        for u in range(-radius, radius + 1):
            w = same_surface(s, group, normal, position, y + v, x + u)
            if w > 0.0:
                w *= wp.exp(-float(u * u + v * v) * fall)
                values += value[y + v, x + u] * w
                weights += weight[y + v, x + u] * w
    d = wp.vec3(0.0, 0.0, 0.0)
    both = wp.vec2(0.0, 0.0)
    for c in range(3):
        own = weight[y, x][c]
        if own > 0.0:
            d[c] = own * values[c] / weights[c] - value[y, x][c]
            both[0] = both[0] + (1.0 - own / weights[c]) * variance[y, x][c]
            both[1] = both[1] + d[c] * d[c]
    change[y, x] = d
    gain[y, x] = both


@wp.kernel(enable_backward=False, module="unique")
def _strength(s: Surfaces, radius: int, gain: wp.array2d(dtype=wp.vec2), strength: wp.array2d(dtype=float)):
    """s of each pixel, 0..1."""
    y, x = wp.tid()
    group = s.group[y, x]
    if group == 0:
        return
    total = wp.vec2(0.0, 0.0)
    for v in range(-radius, radius + 1):
        for u in range(-radius, radius + 1):
            w = same_surface(s, group, s.normal[y, x], s.position[y, x], y + v, x + u)
            if w > 0.0:
                total += gain[y + v, x + u] * w
    if total[1] > 0.0:
        # Of a pixel without neighbours both are rounding errors, of either sign.
        strength[y, x] = wp.clamp(total[0] / total[1], 0.0, 1.0)


def bilateral(signal: Signal, radius: int, also: tuple[np.ndarray, ...] = ()) -> tuple[np.ndarray, ...]:
    """What to add to `signal.value`, then to each of `also` (parts of it, (h, w, 3)) with the same weights.

    (h, w, 3) float64; 0 where the group is 0. Reads pixels up to 2 radius + 1 away. `radius` 2 is 5 x 5.
    """
    surfaces = surfaces_of(signal.group, signal.guide)
    shape = signal.group.shape
    variance = picture(0.25 * (signal.halves[0] - signal.halves[1]) ** 2)
    weight = picture(signal.weight)

    def mean(value: np.ndarray) -> tuple[np.ndarray, Any]:
        change: Any = wp.zeros(shape, dtype=wp.vec3, device="cpu")
        gain: Any = wp.zeros(shape, dtype=wp.vec2, device="cpu")
        inputs = [surfaces, radius, picture(value), weight, variance, change, gain]
        wp.launch(_mean, dim=shape, inputs=inputs, device="cpu")
        return change.numpy().astype(np.float64), gain

    change, gain = mean(signal.value)
    strength: Any = wp.zeros(shape, dtype=float, device="cpu")
    wp.launch(_strength, dim=shape, inputs=[surfaces, radius + WIDER, gain, strength], device="cpu")
    s = strength.numpy()[..., None].astype(np.float64)
    return (s * change, *(s * mean(part)[0] for part in also))
