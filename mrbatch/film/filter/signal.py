"""What a filter smooths: the light on virtual and on real surfaces, without texture and coverage.

A pixel's P is light times reflectance times coverage a; its D is change of light times reflectance times
1 - a. Filters smooth the light alone, `sum w value / sum w weight`, and lay texture and coverage over it
again, so that neither is blurred. Virtual and real surfaces are apart, and so is each object.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mrbatch.film.accumulator import A, D, Developed, P
from mrbatch.film.guides import Guide, Guides

DARKEST = 0.05
"""Least reflectance that light on virtual surfaces is divided by: what shines on black is no texture."""


@dataclass(frozen=True)
class Signal:
    """One side of a frame, virtual (P) or real (D).

    `value` (h, w, 3) float64: P or D. `weight` (h, w, 3): reflectance times share of the pixel; value /
    weight is light. `halves`, `half_weights` (2, h, w, 3): the same of each half. `share` (h, w): of the
    pixel that this side fills, 0..1. `scatter` (h, w, 3): variance of `value` by its samples' scatter, 0
    where that is not known. `group` (h, w) int32: pixels of one number above 0 may be averaged; -1 shows
    several objects; those of 0 are left as they are.
    """

    value: np.ndarray
    weight: np.ndarray
    halves: np.ndarray
    half_weights: np.ndarray
    share: np.ndarray
    scatter: np.ndarray
    group: np.ndarray
    guide: Guide


def virtual_signal(developed: Developed, guides: Guides) -> Signal:
    """P by object."""
    guide = guides.virtual
    texture = np.maximum(guide.reflectance, DARKEST)
    return Signal(
        value=developed.P,
        weight=developed.a[..., None] * texture,
        halves=developed.halves[..., P : P + 3],
        half_weights=developed.halves[..., A, None] * texture,
        share=developed.a,
        # What is known is the composite's, in which texture and glints count as well.
        scatter=np.zeros(developed.P.shape),
        group=_groups(developed.a > 0, guide),
        guide=guide,
    )


def real_signal(developed: Developed, guides: Guides) -> Signal:
    """D by object; a pixel whose samples saw no change keeps the photo's bits, and gives nothing either."""
    guide = guides.real
    changed = (developed.a > 0) | np.any(developed.D != 0, axis=-1)
    visible = 1 - developed.a
    return Signal(
        value=developed.D,
        weight=visible[..., None] * guide.reflectance,
        halves=developed.halves[..., D : D + 3],
        half_weights=(1 - developed.halves[..., A, None]) * guide.reflectance,
        share=visible,
        scatter=np.where((developed.a == 0)[..., None], developed.variance, 0.0),
        group=_groups(changed & (visible > 0), guide),
        guide=guide,
    )


def _groups(taken: np.ndarray, guide: Guide) -> np.ndarray:
    return np.where(taken & (guide.object != 0), guide.object, 0).astype(np.int32)
