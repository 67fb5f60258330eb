"""Sampling of discs, spheres, visible microfacet normals and pixel filters, as `wp.func`s.

All take `u`, a point of the unit square with both coordinates in [0, 1), and are continuous maps of
it but for seams of measure zero, so that a low-discrepancy `u` stays stratified.
"""

from __future__ import annotations

import functools
import math
from typing import Any, Literal

import warp as wp

from mrbatch.kernels.numerics import sine_cosine, sine_cosine_turns

PixelFilter = Literal["box", "gaussian", "blackman-harris"]

PI = wp.constant(wp.float32(math.pi))
_QUARTER_PI = wp.constant(wp.float32(0.25 * math.pi))

# Blackman and Harris's window of four terms, written about its centre (all cosines positive).
_BH = (0.35875, 0.48829, 0.14128, 0.01168)


@wp.func
def concentric_disk(u: wp.vec2) -> wp.vec2:
    """Uniform point of the unit disc; area preserving with bounded distortion (Shirley and Chiu 1997)."""
    x = 2.0 * u[0] - 1.0
    y = 2.0 * u[1] - 1.0
    # Which of both is longer is a coin's toss: chosen, not branched on.
    wide = wp.abs(x) > wp.abs(y)
    longer = wp.where(wide, x, y)
    shorter = wp.where(wide, y, x)
    part = sine_cosine(_QUARTER_PI * (shorter / wp.where(longer == 0.0, 1.0, longer)))
    along = longer * part[1]
    across = longer * part[0]
    return wp.vec2(wp.where(wide, along, across), wp.where(wide, across, along))


@wp.func
def cosine_hemisphere(u: wp.vec2) -> wp.vec3:
    """Direction about +z with density cos(theta) / pi (Malley's method)."""
    d = concentric_disk(u)
    return wp.vec3(d[0], d[1], wp.sqrt(wp.max(0.0, 1.0 - d[0] * d[0] - d[1] * d[1])))


@wp.func
def uniform_sphere(u: wp.vec2) -> wp.vec3:
    """Direction with density 1 / (4 pi): z = 1 - 2 u0, azimuth 2 pi u1.

    sin(theta) = 2 sqrt(u0 (1 - u0)), which keeps its digits at the poles where 1 - z^2 loses them.
    """
    sine = 2.0 * wp.sqrt(u[0] * (1.0 - u[0]))
    azimuth = sine_cosine_turns(u[1])
    return wp.vec3(sine * azimuth[1], sine * azimuth[0], 1.0 - 2.0 * u[0])


@wp.func
def ggx_visible_normal(wo: wp.vec3, alpha: float, u: wp.vec2) -> wp.vec3:
    """Unit microfacet normal of the isotropic GGX distribution as seen from `wo` (wo.z > 0, z the normal).

    Density max(0, wo.m) D(m) G1(wo) / wo.z. Dupuy and Benyoub 2023, listing 1: a uniform point of the
    spherical cap z > -wo.z of the stretched space, added to the stretched `wo`. Their
    z = (1 - u1)(1 + wo.z) - wo.z is never formed where it would cancel: the sum's height is
    (1 - u1)(1 + wo.z), and sin^2 = (1 - z)(1 + z) with 1 - z = u1 (1 + wo.z).
    """
    view = wp.normalize(wp.vec3(alpha * wo[0], alpha * wo[1], wo[2]))
    below = u[1] * (1.0 + view[2])
    sine = wp.sqrt(wp.max(0.0, below * (2.0 - below)))
    azimuth = sine_cosine_turns(u[0])
    hx = sine * azimuth[1] + view[0]
    hy = sine * azimuth[0] + view[1]
    hz = (1.0 - u[1]) * (1.0 + view[2])
    return wp.normalize(wp.vec3(alpha * hx, alpha * hy, hz))


def make_pixel_filter(kind: PixelFilter = "box", *, radius: float = 1.5, stddev: float = 0.5) -> Any:
    """A sampler of a pixel filter: `wp.func` (u: vec2) -> vec2, the offset from the pixel's centre in pixels.

    The filters are positive and sampled exactly, so every sample weighs 1 and a pixel owns its samples.
    `box`: [-1/2, 1/2). `gaussian`: standard deviation `stddev`, cut at `radius`. `blackman-harris`:
    the four-term window over [-radius, radius]. Equal arguments give the same function object.
    Raises ValueError for an unknown kind, or a radius or deviation that is not positive and finite.
    """
    if kind not in ("box", "gaussian", "blackman-harris"):
        raise ValueError(f"unknown pixel filter `{kind}`: expected box, gaussian or blackman-harris")
    if not (0.0 < radius < math.inf and 0.0 < stddev < math.inf):
        raise ValueError(f"pixel filter: radius {radius} and stddev {stddev} must be positive and finite")
    if kind == "box":
        return _box_filter
    if kind == "gaussian":
        return _gaussian_filter(float(radius), float(stddev))
    return _blackman_harris_filter(float(radius))


@wp.func
def _box_filter(u: wp.vec2) -> wp.vec2:
    return wp.vec2(u[0] - 0.5, u[1] - 0.5)


@functools.cache
def _gaussian_filter(radius: float, stddev: float) -> Any:
    scale = math.sqrt(2.0) * stddev
    mass = math.erf(radius / scale)
    tag = f"{radius}_{stddev}".replace(".", "p").replace("-", "m").replace("+", "")

    @wp.func(name=f"gaussian_offset_{tag}")
    def offset(u: float) -> float:
        x = wp.static(float(scale)) * wp.erfinv(wp.static(float(mass)) * (2.0 * u - 1.0))
        return wp.clamp(x, wp.static(-radius), wp.static(float(radius)))

    @wp.func(name=f"gaussian_filter_{tag}")
    def gaussian_filter(u: wp.vec2) -> wp.vec2:
        return wp.vec2(offset(u[0]), offset(u[1]))

    return gaussian_filter


@functools.cache
def _blackman_harris_filter(radius: float) -> Any:
    a0, a1, a2, a3 = _BH
    # The window's own standard deviation, as a fraction of its radius: a Gaussian of that width starts
    # Newton's iteration next to the root.
    a = _BH
    variance = 1.0 / 3.0 + sum(4.0 * a[k] / a[0] * (-1) ** k / (k * math.pi) ** 2 / 2.0 for k in (1, 2, 3))
    start = math.sqrt(2.0 * variance)
    tag = f"{radius}".replace(".", "p").replace("-", "m").replace("+", "")

    @wp.func(name=f"blackman_harris_offset_{tag}")
    def offset(u: float) -> float:
        # Solves F(x) = 1/2 + x/2 + sum a_k sin(k pi x) / (2 k pi a0) = u on [-1, 1]; safeguarded Newton.
        low = float(-1.0)
        high = float(1.0)
        guess = wp.erfinv(wp.clamp(2.0 * u - 1.0, -0.999999, 0.999999))
        x = wp.clamp(wp.static(float(start)) * guess, -1.0, 1.0)
        for _ in range(12):
            s = wp.sin(PI * x)
            c = wp.cos(PI * x)
            s2 = 2.0 * s * c
            c2 = 2.0 * c * c - 1.0
            s3 = s2 * c + c2 * s
            c3 = c2 * c - s2 * s
            residual = (
                0.5 * (1.0 + x)
                + wp.static(a1 / (2.0 * math.pi * a0)) * s
                + wp.static(a2 / (4.0 * math.pi * a0)) * s2
                + wp.static(a3 / (6.0 * math.pi * a0)) * s3
                - u
            )
            if residual > 0.0:
                high = x
            else:
                low = x
            density = 0.5 + wp.static(0.5 / a0) * (
                wp.static(float(a1)) * c + wp.static(float(a2)) * c2 + wp.static(float(a3)) * c3
            )
            step = x - residual / wp.max(density, 1.0e-5)
            if step < low or step > high:
                step = 0.5 * (low + high)
            moved = wp.abs(step - x)
            x = step
            if moved < 1.0e-6:
                break
        return wp.static(float(radius)) * x

    @wp.func(name=f"blackman_harris_filter_{tag}")
    def blackman_harris_filter(u: wp.vec2) -> wp.vec2:
        return wp.vec2(offset(u[0]), offset(u[1]))

    return blackman_harris_filter
