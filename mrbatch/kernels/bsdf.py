"""Scattering of opaque surfaces: diffuse (Lambert) and conductor (single-scattering GGX).

Local frame: z is the shading normal; `wo` (to the viewer) and `wi` (to the light) are unit and point
away from the surface. A caller who wants two sides flips the frame to the viewer first. Below the
horizon, `wo.z <= 0` or `wi.z <= 0`, every kind gives exactly 0, diffuse too: a Lambert lobe that
ignored the side of `wo` would be brighter at rims of interpolated normals, but would not be
reciprocal there, and would disagree with other renderers, which cut it as well.

Conductor: D is GGX (Walter et al. 2007, eq. 33), masking is Smith's, Fresnel is the constant
`reflectance` (a perfect conductor times a tint; white metal is reflectance 1). Only light that leaves
after one microfacet counts, so rough metal loses energy (BSDF-02). Every form is written so that
nothing divides by a cosine:

    D = (1/pi) (a |h|^2 / (a^2 h_z^2 + h_x^2 + h_y^2))^2,   h = wo + wi, not normalized
    S(w) = sqrt(a^2 + (1 - a^2) w_z^2),                     G1(w) = 2 w_z / (w_z + S(w))
    f cos(wi) = F D wi_z / (2 (wo_z S(wi) + wi_z S(wo)))            height-correlated
              = F D wi_z / ((wo_z + S(wo)) (wi_z + S(wi)))          separable
    pdf = D / (2 (wo_z + S(wo)))                            visible normals (Heitz 2018, eq. 17)
    f cos / pdf = F G2 / G1(wo), from the same terms without D
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Any, Literal

import warp as wp

from mrbatch.kernels.sampling import cosine_hemisphere, ggx_visible_normal

Masking = Literal["height-correlated", "separable"]

DIFFUSE = wp.constant(0)
CONDUCTOR = wp.constant(1)
KINDS = {"diffuse": 0, "conductor": 1}
"""Number of each kind of surface, as `Surface.kind` holds it."""

ALPHA_MIN = wp.constant(wp.float32(1.0e-4))
"""Smallest roughness; smaller ones (0: nearly smooth) are raised to it.

The half vector of two float32 directions is off by about 2^-24 in length, so D, which goes with its
fourth power over alpha, is off by 4 x 2^-24 / alpha or 0.3 % here, and by more than it is worth
below. A lobe of 1e-4 rad is a tenth of a pixel of a camera with focal length 1000.
"""

_INV_PI = wp.constant(wp.float32(1.0 / math.pi))


@wp.struct
class Surface:
    """What scatters at a point: kind, reflectance (linear Rec.709, 0..1), GGX roughness alpha (conductor)."""

    kind: wp.int32
    reflectance: wp.vec3
    alpha: wp.float32


@wp.struct
class BsdfSample:
    """A direction drawn from a surface: `weight` = f cos / pdf; pdf per steradian; both 0 where it failed."""

    wi: wp.vec3
    weight: wp.vec3
    pdf: wp.float32


@dataclass(frozen=True)
class Bsdf:
    """Scattering functions made for a set of kinds. `wp.func`s:

    `evaluate(s: Surface, wo: vec3, wi: vec3) -> vec3`: f cos(wi), 1/sr.
    `pdf(s, wo, wi) -> float`: density with which `sample` draws `wi`, 1/sr.
    `sample(s, wo, u: vec2) -> BsdfSample`.
    `albedo_bound(s) -> float`: no less than the share of light that the surface returns, any channel.
    """

    kinds: frozenset[str]
    masking: Masking
    evaluate: Any
    pdf: Any
    sample: Any
    albedo_bound: Any


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


def make_bsdf(kinds: frozenset[str] = frozenset(KINDS), *, masking: Masking = "height-correlated") -> Bsdf:
    """Scattering functions for the named kinds; others leave no code.

    With one kind, `Surface.kind` is not read. `masking`: how masking and shadowing of microfacets
    combine; `height-correlated` (Ross et al. 2005, Heitz 2014 eq. 99) is the exact one for Smith's
    surface, `separable` (Walter et al. 2007) the product of both that other renderers use.
    Equal arguments give the same object. Raises ValueError for an unknown kind, none, or an unknown masking.
    """
    kinds = frozenset(kinds)
    unknown = sorted(kinds - set(KINDS))
    if unknown or not kinds:
        raise ValueError(f"kinds of surface {unknown}: expected some of {', '.join(KINDS)}")
    if masking not in ("height-correlated", "separable"):
        raise ValueError(f"unknown masking `{masking}`: expected height-correlated or separable")
    return _make_bsdf(kinds, masking)


@functools.cache
def _make_bsdf(kinds: frozenset[str], masking: Masking) -> Bsdf:
    has_diffuse = "diffuse" in kinds
    has_conductor = "conductor" in kinds
    both = has_diffuse and has_conductor
    correlated = masking == "height-correlated"
    tag = "_".join(sorted(kinds)) + ("" if correlated else "_separable")

    @wp.func(name=f"conductor_evaluate_{tag}")
    def conductor_evaluate(s: Surface, wo: wp.vec3, wi: wp.vec3) -> wp.vec3:
        so = ggx_slope_term(s.alpha, wo[2])
        si = ggx_slope_term(s.alpha, wi[2])
        masked = float(0.0)
        if wp.static(correlated):
            masked = 0.5 * wi[2] / (wo[2] * si + wi[2] * so)
        else:
            masked = wi[2] / ((wo[2] + so) * (wi[2] + si))
        return s.reflectance * (ggx_distribution(s.alpha, wo + wi) * masked)

    @wp.func(name=f"conductor_pdf_{tag}")
    def conductor_pdf(s: Surface, wo: wp.vec3, wi: wp.vec3) -> float:
        return 0.5 * ggx_distribution(s.alpha, wo + wi) / (wo[2] + ggx_slope_term(s.alpha, wo[2]))

    @wp.func(name=f"conductor_sample_{tag}")
    def conductor_sample(s: Surface, wo: wp.vec3, u: wp.vec2) -> BsdfSample:
        sample = BsdfSample()
        m = ggx_visible_normal(wo, wp.max(s.alpha, ALPHA_MIN), u)
        wi = wp.normalize(2.0 * wp.dot(wo, m) * m - wo)
        sample.wi = wi
        if wi[2] > 0.0:
            so = ggx_slope_term(s.alpha, wo[2])
            si = ggx_slope_term(s.alpha, wi[2])
            share = float(0.0)
            if wp.static(correlated):
                share = wi[2] * (wo[2] + so) / (wo[2] * si + wi[2] * so)
            else:
                share = 2.0 * wi[2] / (wi[2] + si)
            sample.weight = s.reflectance * share
            # From wi and not from m, so that it is bit for bit what `pdf` gives: MIS weights add up to 1.
            sample.pdf = conductor_pdf(s, wo, wi)
        return sample

    @wp.func(name=f"diffuse_sample_{tag}")
    def diffuse_sample(s: Surface, u: wp.vec2) -> BsdfSample:
        sample = BsdfSample()
        wi = cosine_hemisphere(u)
        sample.wi = wi
        if wi[2] > 0.0:
            sample.weight = s.reflectance
            sample.pdf = _INV_PI * wi[2]
        return sample

    @wp.func(name=f"bsdf_evaluate_{tag}")
    def evaluate(s: Surface, wo: wp.vec3, wi: wp.vec3) -> wp.vec3:
        value = wp.vec3(0.0, 0.0, 0.0)
        if wo[2] > 0.0 and wi[2] > 0.0:
            if wp.static(both):
                if s.kind == CONDUCTOR:
                    value = conductor_evaluate(s, wo, wi)
                else:
                    value = s.reflectance * (_INV_PI * wi[2])
            elif wp.static(has_conductor):
                value = conductor_evaluate(s, wo, wi)
            else:
                value = s.reflectance * (_INV_PI * wi[2])
        return value

    @wp.func(name=f"bsdf_pdf_{tag}")
    def pdf(s: Surface, wo: wp.vec3, wi: wp.vec3) -> float:
        value = float(0.0)
        if wo[2] > 0.0 and wi[2] > 0.0:
            if wp.static(both):
                if s.kind == CONDUCTOR:
                    value = conductor_pdf(s, wo, wi)
                else:
                    value = _INV_PI * wi[2]
            elif wp.static(has_conductor):
                value = conductor_pdf(s, wo, wi)
            else:
                value = _INV_PI * wi[2]
        return value

    @wp.func(name=f"bsdf_sample_{tag}")
    def sample(s: Surface, wo: wp.vec3, u: wp.vec2) -> BsdfSample:
        drawn = BsdfSample()
        if wo[2] > 0.0:
            if wp.static(both):
                if s.kind == CONDUCTOR:
                    drawn = conductor_sample(s, wo, u)
                else:
                    drawn = diffuse_sample(s, u)
            elif wp.static(has_conductor):
                drawn = conductor_sample(s, wo, u)
            else:
                drawn = diffuse_sample(s, u)
        return drawn

    return Bsdf(kinds, masking, evaluate, pdf, sample, _albedo_bound)


@wp.func
def _albedo_bound(s: Surface) -> float:
    return wp.max(s.reflectance[0], wp.max(s.reflectance[1], s.reflectance[2]))
