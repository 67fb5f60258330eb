"""How much of a filter's change to apply: as much as noise accounts for.

Of x, whose truth is t, a filter makes F = x + d. Of all x + s d the expected squared error is least at
s = E[(x - t)(-d)] / E[d^2]. For a mean in which the pixel itself has the share h, the numerator is
(1 - h) var x, and the two halves of the film tell the variance, (x_A - x_B)^2 / 4. Both means run over the
neighbours. Where a filter would blur what stands out of the noise, d^2 is large and s small; with samples s
goes to 0, and with it the filter's bias. (The principle is Stein's unbiased risk estimate, 1981, as Li, Wu
and Chuang brought it to rendering, *SURE-based Optimization for Adaptive Sampling and Reconstruction*, 2012.)
"""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from mrbatch.film.filter.neighbours import Surfaces, launch, surface_distance
from mrbatch.film.filter.signal import Signal

REACH = 4
"""Pixels to each side of which the means are taken: of fewer, s is noise itself, and as it is cut at 1 the
filter would be too weak."""


@wp.kernel(enable_backward=False, module="unique")
def _strength(
    s: Surfaces, radius: int, gain: wp.array2d(dtype=wp.vec2), strength: wp.array2d(dtype=float), row: int
):
    """`gain`: noise and squared change of each pixel."""
    band, x = wp.tid()
    y = row + band
    group = s.group[y, x]
    if group == 0:
        return
    normal = s.normal[y, x]
    position = s.position[y, x]
    total = wp.vec2(0.0, 0.0)
    for v in range(-radius, radius + 1):
        for u in range(-radius, radius + 1):
            distance = surface_distance(s, group, normal, position, y + v, x + u)
            if distance >= 0.0:
                total += gain[y + v, x + u] * wp.exp(-distance)
    if total[1] > 0.0:
        # Of a pixel without neighbours both are rounding errors, of either sign.
        strength[y, x] = wp.clamp(total[0] / total[1], 0.0, 1.0)


def strength_of(
    signal: Signal, surfaces: Any, change: np.ndarray, own: np.ndarray | float, threads: int
) -> np.ndarray:
    """s (h, w, 1), 0..1, one for all channels.

    `change` (h, w, 3): what the filter would add. `own` (h, w, 3): the share h of the pixel itself.
    """
    noise = (1 - own) * 0.25 * (signal.halves[0] - signal.halves[1]) ** 2
    both = np.stack([noise.sum(axis=-1), (change**2).sum(axis=-1)], axis=-1)
    gain: Any = wp.array(both.astype(np.float32), dtype=wp.vec2, device="cpu")
    strength: Any = wp.zeros(signal.group.shape, dtype=float, device="cpu")
    launch(_strength, signal.group.shape, [surfaces, REACH, gain, strength], threads)
    return strength.numpy()[..., None].astype(np.float64)
