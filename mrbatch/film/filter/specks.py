"""Lone bright samples: their light is spread before a filter makes dots or squares of them.

A path that finds a small lamp by chance, in a mirror or through glass, makes one pixel of one half many times
as bright as those around it. A filter that averages pixels lays that over its window: a blurred dot, or a
square where the other half, which knows nothing of it, gives the weights. So such a half takes the other
one's light before filtering, and what it loses is given back as all that filters take from the mean is,
blurred (`residual.py`). A speck is a half

- that is far from the other: by `BEYOND` times as much, in the largest channel, as all but `OTHERS` of the 24
  pixels around it on the same surface. What both halves see is none, however bright, and noise that is alike
  all round is none;
- and that lies outside of what is around it: farther from the mean of those pixels than twice the range of
  their means. The noise at the edge of a shadow, which the pixels beside it lack, lies within.

By chance both halves of a pixel may have one. On real surfaces, where light hardly changes within a pixel but
at a caustic, the samples' own scatter tells: a pixel that lies outside of what is around it, by no more than
`FEW` samples may account for, takes the mean of those around it. (On virtual ones that would be the glint
of a lamp in metal.)

With samples the halves come together, and specks become few.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import warp as wp

from mrbatch.film.filter.neighbours import Surfaces, launch, picture, surface_distance, surfaces_of
from mrbatch.film.filter.signal import Signal

RADIUS = 2
OTHERS = 6
"""So many of the neighbours may be specks too."""
BEYOND = wp.constant(wp.float32(8.0))
"""Times the difference of the next one."""
FEW = wp.constant(wp.float32(9.0))
"""Squared deviation over its variance: of a pixel to which n samples of many bring all light it is n."""
FEWEST = 12
"""Neighbours that it takes to tell; at the corner of an object there are fewer."""
NEAR = wp.constant(wp.float32(4.0))
"""Surface distance from which a pixel tells nothing: its weight is below 2 %."""

_RANKS = wp.constant(OTHERS + 1)
_Ranked = wp.types.vector(length=OTHERS + 1, dtype=wp.float32)


@wp.struct
class Halves:
    """Light of both halves (h, w); `apart` (h, w): their difference, in the largest channel; `scatter` (h, w)
    the variance of their mean by the samples' scatter, 0 where it is not known."""

    first: wp.array2d(dtype=wp.vec3)
    second: wp.array2d(dtype=wp.vec3)
    apart: wp.array2d(dtype=float)
    scatter: wp.array2d(dtype=wp.vec3)


@wp.kernel(enable_backward=False, module="unique")
def _specks(
    s: Surfaces,
    halves: Halves,
    first_change: wp.array2d(dtype=wp.vec3),
    second_change: wp.array2d(dtype=wp.vec3),
    row: int,
):
    """What to add to each half's light; 0 where the pixel is no speck."""
    band, x = wp.tid()
    y = row + band
    group = s.group[y, x]
    if group <= 0:
        return
    normal = s.normal[y, x]
    position = s.position[y, x]
    largest = _Ranked()
    count = int(0)
    for v in range(-RADIUS, RADIUS + 1):
        for u in range(-RADIUS, RADIUS + 1):
            if u != 0 or v != 0:
                distance = surface_distance(s, group, normal, position, y + v, x + u)
                if distance >= 0.0 and distance < NEAR:
                    count += 1
                    rest = halves.apart[y + v, x + u]
                    for k in range(_RANKS):
                        if rest > largest[k]:
                            swapped = largest[k]
                            largest[k] = rest
                            rest = swapped
    if count < FEWEST:
        return
    bound = BEYOND * largest[_RANKS - 1]
    own = halves.apart[y, x]
    alone = own > bound
    scatter = halves.scatter[y, x]
    if not alone and wp.max(scatter) <= 0.0:
        return
    usual = wp.vec3(0.0, 0.0, 0.0)
    low = wp.vec3(float(wp.inf), float(wp.inf), float(wp.inf))
    high = -low
    taken = float(0.0)
    for v in range(-RADIUS, RADIUS + 1):
        for u in range(-RADIUS, RADIUS + 1):
            i = y + v
            j = x + u
            distance = surface_distance(s, group, normal, position, i, j)
            if distance >= 0.0 and distance < NEAR:
                if halves.apart[i, j] <= bound and (u != 0 or v != 0):
                    mean = 0.5 * (halves.first[i, j] + halves.second[i, j])
                    usual += mean
                    low = wp.min(low, mean)
                    high = wp.max(high, mean)
                    taken += 1.0
    usual /= taken
    first = halves.first[y, x]
    second = halves.second[y, x]
    far_first = wp.max(wp.abs(first - usual))
    far_second = wp.max(wp.abs(second - usual))
    outside = 2.0 * wp.max(high - low)
    if alone:
        if wp.max(far_first, far_second) > outside:
            if far_first > far_second:
                first_change[y, x] = second - first
            else:
                second_change[y, x] = first - second
        return
    if wp.min(far_first, far_second) > outside:
        off = 0.5 * (first + second) - usual
        if wp.length_sq(off) <= FEW * (scatter[0] + scatter[1] + scatter[2]):
            first_change[y, x] = usual - first
            second_change[y, x] = usual - second


def without_specks(signal: Signal, threads: int = 1) -> Signal | None:
    """The signal with its specks taken out, in `halves` and `value`; None where it has none.

    A pixel depends on those up to `RADIUS` away.
    """
    shape = signal.group.shape
    weights = signal.half_weights
    # A half that shows nothing of the surface has no light to compare, and tells neighbours nothing.
    whole = np.all(weights > 0, axis=(0, -1))
    group = np.where(whole, signal.group, 0)
    light = np.divide(signal.halves, weights, out=np.zeros(weights.shape), where=whole[..., None])
    apart = np.abs(light[0] - light[1]).max(axis=-1)
    halves = Halves()
    halves.first, halves.second = picture(light[0]), picture(light[1])
    halves.apart = wp.array(np.ascontiguousarray(apart, np.float32), dtype=float, device="cpu")
    known = whole[..., None] & (signal.weight > 0)
    squares = signal.weight**2
    halves.scatter = picture(np.divide(signal.scatter, squares, out=np.zeros(squares.shape), where=known))
    changes: list[Any] = [wp.zeros(shape, dtype=wp.vec3, device="cpu") for _ in range(2)]
    launch(_specks, shape, [surfaces_of(group, signal.guide), halves, *changes], threads)
    change = np.stack([one.numpy() for one in changes]).astype(np.float64) * weights
    if not change.any():
        return None
    return replace(signal, halves=signal.halves + change, value=signal.value + change.mean(axis=0))
