"""Scattering of the boundary between two clear media: smooth, or of GGX microfacets.

Frame and forms as in `mrbatch.kernels.bsdf`: z is the normal on the viewer's side, `wo.z > 0`; a transmitted
`wi` has z < 0. `eta` is the index of refraction behind the boundary over that in front of it. Fresnel's
equations are exact, for unpolarized light. Radiance changes with the square of the index, so that what passes
is divided by eta^2 (and multiplied again where it leaves).

Rough (Walter et al. 2007, equations 16 and 21; `wi` is the light's side, radiance not importance):

    h    = wo + wi, or -(wo + eta wi) turned to z > 0: not normalized, for D takes any length
    reflected    f cos = F D G2 / (4 wo_z)
    transmitted  f cos = (1 - F) D G2 |wi.h| |wo.h| / (wo_z (wo.h + eta wi.h)^2),   h unit
    pdf          = P D_v / (4 |wo.h|),  (1 - P) D_v eta^2 |wi.h| / (wo.h + eta wi.h)^2,
                   D_v = G1(wo) |wo.h| D / wo_z

P is Fresnel's value at the normal, kept off 0 and 1: known before the microfacet is drawn, so that two random
numbers do. G2 of transmission is the product of both G1: light passes to the other side of the microsurface.
Light of further microfacets is not added, so a rough boundary of index 1.5 loses some of it: 1 % from outside
and 3 % from inside at alpha 0.1, 4 and 20 % at 0.3.

Smooth (alpha 0): both directions are certain; `pdf` of a sample is infinite, so that the balance heuristic
gives it all the weight, and `evaluate` and `pdf` are 0.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import warp as wp

from mrbatch.kernels.fresnel import fresnel_dielectric
from mrbatch.kernels.ggx import ggx_distribution, ggx_slope_term
from mrbatch.kernels.sampling import ggx_visible_normal

CERTAIN = wp.constant(wp.float32(float("inf")))
"""Density of a direction that is the only one."""
_LAST = wp.constant(wp.float32(1.0 - 2.0**-24))


@wp.struct
class DielectricSample:
    """A direction: `weight` = f cos / pdf, grey; `pdf` per steradian, infinite of a smooth boundary; both 0
    where it failed."""

    wi: wp.vec3
    weight: float
    pdf: float


@wp.func
def refract(wo: wp.vec3, m: wp.vec3, eta: float) -> wp.vec3:
    """Where light from behind comes to leave along `wo`, at a facet `m` with wo.m > 0; 0 if none can."""
    c = wp.dot(wo, m)
    sine2 = wp.max(1.0 - c * c, 0.0) / (eta * eta)
    if sine2 >= 1.0:
        return wp.vec3(0.0, 0.0, 0.0)
    cosine = wp.sqrt(1.0 - sine2)
    return wp.normalize((c / eta - cosine) * m - wo / eta)


@wp.func
def _reflecting(wo: wp.vec3, eta: float) -> float:
    # Probability of following the reflected light of a rough boundary.
    if eta == 1.0:
        return 0.0
    return wp.clamp(fresnel_dielectric(wo[2], eta), 0.1, 0.9)


@wp.func
def _facet(wo: wp.vec3, wi: wp.vec3, eta: float) -> wp.vec3:
    # The unit microfacet normal that takes wi to wo, z > 0; 0 where none does.
    h = wo + wi
    if wi[2] < 0.0:
        h = wo + wi * eta
    length = wp.length(h)
    if length == 0.0:
        return wp.vec3(0.0, 0.0, 0.0)
    h = h / length
    if h[2] < 0.0:
        h = -h
    # Both must be seen from the facet's right sides.
    if wp.dot(wo, h) <= 0.0 or wp.dot(wi, h) * wi[2] <= 0.0:
        return wp.vec3(0.0, 0.0, 0.0)
    return h


@dataclass(frozen=True)
class DielectricFunctions:
    """`wp.func`s of (alpha, eta, wo, wi) -> float: `evaluate` f cos, `pdf`; `sample(alpha, eta, wo, u: vec2)
    -> DielectricSample`."""

    evaluate: Any
    pdf: Any
    sample: Any


@functools.cache
def make_dielectric(correlated: bool) -> DielectricFunctions:
    """`correlated`: masking and shadowing of reflected light are (Ross et al. 2005)."""
    tag = "correlated" if correlated else "separable"

    @wp.func(name=f"dielectric_evaluate_{tag}")
    def evaluate(alpha: float, eta: float, wo: wp.vec3, wi: wp.vec3) -> float:
        if alpha == 0.0 or wo[2] <= 0.0 or wi[2] == 0.0:
            return 0.0
        h = _facet(wo, wi, eta)
        if h[2] <= 0.0:
            return 0.0
        seen = wp.dot(wo, h)
        reflected = fresnel_dielectric(seen, eta)
        lit = wp.abs(wi[2])
        so = ggx_slope_term(alpha, wo[2])
        si = ggx_slope_term(alpha, lit)
        d = ggx_distribution(alpha, h)
        # G2 over 4 wo_z wi_z.
        masked = 1.0 / ((wo[2] + so) * (lit + si))
        if wi[2] > 0.0:
            if wp.static(correlated):
                masked = 0.5 / (wo[2] * si + lit * so)
            return reflected * d * masked * lit
        passing = wp.dot(wi, h)
        bend = seen + eta * passing
        return (1.0 - reflected) * d * masked * 4.0 * lit * wp.abs(passing) * seen / (bend * bend)

    @wp.func(name=f"dielectric_pdf_{tag}")
    def pdf(alpha: float, eta: float, wo: wp.vec3, wi: wp.vec3) -> float:
        if alpha == 0.0 or wo[2] <= 0.0 or wi[2] == 0.0:
            return 0.0
        h = _facet(wo, wi, eta)
        if h[2] <= 0.0:
            return 0.0
        # Density of the visible normal over |wo.h|: G1 D / wo_z.
        visible = 2.0 * ggx_distribution(alpha, h) / (wo[2] + ggx_slope_term(alpha, wo[2]))
        p = _reflecting(wo, eta)
        if wi[2] > 0.0:
            return 0.25 * p * visible
        passing = wp.dot(wi, h)
        seen = wp.dot(wo, h)
        bend = seen + eta * passing
        return (1.0 - p) * visible * seen * eta * eta * wp.abs(passing) / (bend * bend)

    @wp.func(name=f"dielectric_sample_{tag}")
    def sample(alpha: float, eta: float, wo: wp.vec3, u: wp.vec2) -> DielectricSample:
        drawn = DielectricSample()
        if alpha == 0.0:
            p = fresnel_dielectric(wo[2], eta)
            if u[0] < p:
                drawn.wi = wp.vec3(-wo[0], -wo[1], wo[2])
                drawn.weight = 1.0
                drawn.pdf = CERTAIN
            else:
                drawn.wi = refract(wo, wp.vec3(0.0, 0.0, 1.0), eta)
                if drawn.wi[2] < 0.0:
                    drawn.weight = 1.0 / (eta * eta)
                    drawn.pdf = CERTAIN
            return drawn
        p = _reflecting(wo, eta)
        # The second number chooses the way, and what is left of it is used again.
        if u[1] < p:
            m = ggx_visible_normal(wo, alpha, wp.vec2(u[0], wp.min(u[1] / p, _LAST)))
            drawn.wi = wp.normalize(2.0 * wp.dot(wo, m) * m - wo)
            if drawn.wi[2] <= 0.0:
                return drawn
        else:
            m = ggx_visible_normal(wo, alpha, wp.vec2(u[0], wp.min((u[1] - p) / (1.0 - p), _LAST)))
            drawn.wi = refract(wo, m, eta)
            if drawn.wi[2] >= 0.0:
                return drawn
        drawn.pdf = pdf(alpha, eta, wo, drawn.wi)
        if drawn.pdf > 0.0:
            drawn.weight = evaluate(alpha, eta, wo, drawn.wi) / drawn.pdf
        return drawn

    return DielectricFunctions(evaluate, pdf, sample)
