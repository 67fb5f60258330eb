"""Laying what was rendered over what was filmed.

A contribution to a picture has three parts: `P`, virtual light, premultiplied by coverage; `a`, the
coverage; `D`, the signed light change that virtual things cause on real ones, already weighted by
what of the background stays visible (averaged with the subsamples, so that `1 - a` is not applied
to it a second time). All are linear, in photo units, float32 or float64. A negative composite is
cut once, here, never in the estimators, where the cut would be a bias.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

LUMINANCE = (0.2126, 0.7152, 0.0722)
"""Weights of linear Rec.709 red, green and blue (ITU-R BT.709-6, item 3.2)."""


@dataclass(frozen=True)
class Contribution:
    """What one method or participant gives for one view.

    `P` (h, w, 3): virtual radiance, premultiplied. `a` (h, w): coverage, 0..1. `D` (h, w, 3): light
    change on what is real, signed. `D_indirect` (h, w, 3) or None: the part of D that comes or stays
    away over other surfaces, signed; the rest is direct light taken away.
    """

    P: np.ndarray
    a: np.ndarray
    D: np.ndarray
    D_indirect: np.ndarray | None = None


def composite(P: np.ndarray, a: np.ndarray, B: np.ndarray, D: np.ndarray) -> np.ndarray:
    """`C = max(0, P + (1 - a) B + D)`, and exactly B, bit for bit, where P, a and D are all zero.

    Shapes: P, B, D (h, w, 3), a (h, w). The exception keeps what the maximum would touch: a
    photo's negative values (colours outside Rec.709) and the sign of zero.
    """
    a = np.asarray(a)[..., None]
    mixed = P + (1 - a) * B + D
    untouched = (a == 0) & np.all((P == 0) & (D == 0), axis=-1, keepdims=True)
    return np.where(untouched, B, np.maximum(mixed, 0))


def over(front: Contribution, back: Contribution) -> Contribution:
    """A participant laid over what is behind it: P = Pf + (1 - af) Pb, and so for a, D and its part."""
    rest = 1 - front.a
    return Contribution(
        P=front.P + rest[..., None] * back.P,
        a=front.a + rest * back.a,
        D=front.D + rest[..., None] * back.D,
        D_indirect=_over(front.D_indirect, back.D_indirect, rest),
    )


def _over(front: np.ndarray | None, back: np.ndarray | None, rest: np.ndarray) -> np.ndarray | None:
    if back is None:
        return front
    return rest[..., None] * back + (0 if front is None else front)


def behind_matte(contribution: Contribution, matte: np.ndarray | None) -> Contribution:
    """The contribution where something real stands in front, `matte` (h, w) of the pixel: times 1 - m.

    What stands in front is part of the photo, so it hides P and a, and no light change shows on it.
    """
    if matte is None:
        return contribution
    rest = 1 - np.asarray(matte, dtype=contribution.P.dtype)
    part = contribution.D_indirect
    return Contribution(
        P=contribution.P * rest[..., None],
        a=contribution.a * rest,
        D=contribution.D * rest[..., None],
        D_indirect=None if part is None else part * rest[..., None],
    )


def shadow_matte(a: np.ndarray, B: np.ndarray, blocked: np.ndarray) -> np.ndarray:
    """Share of the visible background's luminance that virtual things take away directly, 0..1.

    `max(0, -Y(blocked)) / Y((1 - a) B)`, cut at 1; 0 where no background is visible or it is black.
    Y is Rec.709 luminance. Shape (h, w).
    """
    weights = np.array(LUMINANCE, dtype=np.float64)
    lost = np.maximum(-(np.asarray(blocked, dtype=np.float64) @ weights), 0.0)
    there = (1.0 - np.asarray(a, dtype=np.float64)) * (np.asarray(B, dtype=np.float64) @ weights)
    share = np.divide(lost, there, out=np.zeros_like(lost), where=there > 0.0)
    return np.minimum(share, 1.0)
