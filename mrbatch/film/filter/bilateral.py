"""The cross-bilateral filter of Xu et al. (section 4: size 5 x 5), put right.

*Delta Path Tracing for Real-Time Global Illumination in Mixed Reality* filters the radiance with weights
from guides. On a plane all guides are equal, so that is a plain blur: it rounds off every shadow. Here light
is filtered without texture and coverage, each object apart (`signal.py`), and the change is applied as far as
noise accounts for it (`strength.py`). The strength takes a little of the mean, which is given back
(`residual.py`).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from mrbatch.film.filter.neighbours import Surfaces, launch, picture, surface_distance, surfaces_of
from mrbatch.film.filter.residual import mean_kept
from mrbatch.film.filter.signal import Signal
from mrbatch.film.filter.strength import strength_of


@wp.kernel(enable_backward=False, module="unique")
def _mean(
    s: Surfaces,
    radius: int,
    value: wp.array2d(dtype=wp.vec3),
    weight: wp.array2d(dtype=wp.vec3),
    change: wp.array2d(dtype=wp.vec3),
    share: wp.array2d(dtype=wp.vec3),
    row: int,
):
    """`change`: what the filter adds. `share`: of the pixel itself in the mean."""
    band, x = wp.tid()
    y = row + band
    group = s.group[y, x]
    if group <= 0:
        return
    normal = s.normal[y, x]
    position = s.position[y, x]
    # The spatial weight falls to 0.41 at the radius.
    fall = 0.5 / (0.75 * 0.75 * float(radius) * float(radius))
    values = wp.vec3(0.0, 0.0, 0.0)
    weights = wp.vec3(0.0, 0.0, 0.0)
    for v in range(-radius, radius + 1):
        for u in range(-radius, radius + 1):
            distance = surface_distance(s, group, normal, position, y + v, x + u)
            if distance >= 0.0:
                w = wp.exp(-distance - float(u * u + v * v) * fall)
                values += value[y + v, x + u] * w
                weights += weight[y + v, x + u] * w
    d = wp.vec3(0.0, 0.0, 0.0)
    h = wp.vec3(1.0, 1.0, 1.0)
    for c in range(3):
        own = weight[y, x][c]
        if own > 0.0:
            d[c] = own * values[c] / weights[c] - value[y, x][c]
            h[c] = own / weights[c]
    change[y, x] = d
    share[y, x] = h


def bilateral(
    signal: Signal, radius: int, also: tuple[np.ndarray, ...] = (), threads: int = 1
) -> tuple[np.ndarray, ...]:
    """What to add to `signal.value`, then to each of `also` (parts of it, (h, w, 3)) with the same weights.

    (h, w, 3) float64; 0 where the group is 0 or less. Reads pixels up to radius + `strength.REACH` +
    `residual.REACH` away. `radius` 2 is 5 x 5.
    """
    surfaces = surfaces_of(signal.group, signal.guide)
    shape = signal.group.shape
    weight = picture(signal.weight)

    def mean(value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        change: Any = wp.zeros(shape, dtype=wp.vec3, device="cpu")
        share: Any = wp.zeros(shape, dtype=wp.vec3, device="cpu")
        launch(_mean, shape, [surfaces, radius, picture(value), weight, change, share], threads)
        return change.numpy().astype(np.float64), share.numpy()

    change, share = mean(signal.value)
    s = strength_of(signal, surfaces, change, share, threads)
    changes = [change, *(mean(part)[0] for part in also)]
    return tuple(mean_kept(s * one, signal.weight, signal.group) for one in changes)
