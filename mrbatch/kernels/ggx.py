"""The GGX distribution of microfacets and its masking, as metal, gloss and glass share them."""

from __future__ import annotations

import math

import warp as wp

ALPHA_MIN = wp.constant(wp.float32(1.0e-4))
"""Smallest roughness; smaller ones (0: nearly smooth) are raised to it.

The half vector of two float32 directions is off by about 2^-24 in length, so D, which goes with its
fourth power over alpha, is off by 4 x 2^-24 / alpha or 0.3 % here, and by more than it is worth
below. A lobe of 1e-4 rad is a tenth of a pixel of a camera with focal length 1000.
"""

_INV_PI = wp.constant(wp.float32(1.0 / math.pi))


@wp.func
def ggx_distribution(alpha: float, h: wp.vec3) -> float:
    """D of the half vector `h` (any length but 0), 1/sr."""
    a = wp.max(alpha, ALPHA_MIN)
    ratio = a * wp.dot(h, h) / (a * a * h[2] * h[2] + h[0] * h[0] + h[1] * h[1])
    return _INV_PI * ratio * ratio


@wp.func
def ggx_slope_term(alpha: float, cosine: float) -> float:
    """S(w) = sqrt(a^2 + (1 - a^2) w_z^2) of the masking function."""
    a = wp.max(alpha, ALPHA_MIN)
    return wp.sqrt(a * a + (1.0 - a * a) * cosine * cosine)
