"""Scattering of surfaces: diffuse (Lambert), conductor (single-scattering GGX), principled, dielectric, pane.

Local frame: z is the shading normal; `wo` (to the viewer) and `wi` (to the light) are unit and point
away from the surface. A caller who wants two sides flips the frame to the viewer first. Below the
horizon, `wo.z <= 0` or `wi.z <= 0`, every kind gives exactly 0, diffuse too: a Lambert lobe that
ignored the side of `wo` would be brighter at rims of interpolated normals, but would not be
reciprocal there, and would disagree with other renderers, which cut it as well. Only a dielectric
(`mrbatch.kernels.dielectric`) lets light through, from directions with `wi.z < 0`. A thin one scatters
what it returns (`mrbatch.kernels.thin_dielectric`): whoever stops at one did so as often as light does not
pass, so that a sample's weight is the returned share of that.

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

Principled: a mixture by `metalness` of metal and of a diffuse base under a dielectric interface, as in
OpenPBR and glTF, but so that white returns exactly what it gets (`ggx_albedo` gives E):

    metal:       F82-tint Fresnel times D G2 (above), and light of further microfacets
                 (1 - E1(wo)) (1 - E1(wi)) / (pi (1 - <E1>)) F_ms,  F_ms = <F>^2 <E1> / (1 - <F> (1 - <E1>))
                 (Kulla and Conty 2017; E1 with F = 1, <> cosine-weighted means)
    dielectric:  Schlick Fresnel times D G2 over
                 base / pi (1 - E(wo)) (1 - E(wi)) / (1 - <E>)
                 (Kelemen and Szirmay-Kalos 2001: reciprocal, where glTF's own base (1 - F) is brighter than
                 white at grazing angles)

F82-tint (Kutz, Hasan, Edmondson 2021): Schlick's curve through `reflectance` at 0 and, at 82 degrees
(cos 1/7), its own value there times `edge`.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Any, Literal

import warp as wp

from mrbatch.kernels.dielectric import CERTAIN, make_dielectric
from mrbatch.kernels.fresnel import f82_mean, f82_tint, fifth
from mrbatch.kernels.ggx import ALPHA_MIN, ggx_distribution, ggx_slope_term
from mrbatch.kernels.ggx_albedo import ggx_albedo, ggx_albedo_mean
from mrbatch.kernels.sampling import cosine_hemisphere, ggx_visible_normal
from mrbatch.kernels.thin_dielectric import pane_shares

Masking = Literal["height-correlated", "separable"]

DIFFUSE = wp.constant(0)
CONDUCTOR = wp.constant(1)
PRINCIPLED = wp.constant(2)
DIELECTRIC = wp.constant(3)
THIN_DIELECTRIC = wp.constant(4)
KINDS = {"diffuse": 0, "conductor": 1, "principled": 2, "dielectric": 3, "thin_dielectric": 4}
"""Number of each kind of surface, as `Surface.kind` holds it."""

_INV_PI = wp.constant(wp.float32(1.0 / math.pi))


@wp.struct
class Surface:
    """What scatters at a point: kind, reflectance (linear Rec.709, 0..1), GGX roughness alpha (conductor).

    Principled: `reflectance` is the base colour; `metalness` 0..1; `f0` reflectance of the dielectric
    interface at normal incidence; `edge` tint of metal at 82 degrees, 0..1. Dielectric: `eta`, index of
    refraction behind the surface over that on the viewer's side. Thin dielectric: `eta` of the glass,
    `reflectance` is its colour.
    """

    kind: wp.int32
    reflectance: wp.vec3
    alpha: wp.float32
    metalness: wp.float32
    f0: wp.float32
    edge: wp.vec3
    eta: wp.float32


@wp.struct
class _Layers:
    # A principled surface as seen along wo: albedo terms of its interface, and how it is sampled.
    single: wp.float32  # 1 - E1(wo), what a lobe with F = 1 leaves for further microfacets
    single_mean: wp.float32  # 1 - <E1>
    under: wp.float32  # 1 - E(wo) of the dielectric interface
    under_mean: wp.float32
    multiple: wp.vec3  # F_ms
    mirror: wp.float32  # probability of sampling the GGX lobe


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
    """

    kinds: frozenset[str]
    masking: Masking
    evaluate: Any
    pdf: Any
    sample: Any


@wp.func
def _largest(a: wp.vec3) -> float:
    return wp.max(a[0], wp.max(a[1], a[2]))


@wp.func
def _again(u: float) -> float:
    # A random number that was cut and stretched may round up to 1.
    return wp.min(u, wp.static(1.0 - 2.0**-24))


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
    has_principled = "principled" in kinds
    has_dielectric = "dielectric" in kinds
    has_thin = "thin_dielectric" in kinds
    several = len(kinds) > 1
    correlated = masking == "height-correlated"
    glass = make_dielectric(correlated)
    dielectric_evaluate, dielectric_pdf, dielectric_sample = glass.evaluate, glass.pdf, glass.sample
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

    @wp.func(name=f"thin_sample_{tag}")
    def thin_sample(s: Surface, wo: wp.vec3) -> BsdfSample:
        sample = BsdfSample()
        pane = pane_shares(wo[2], s.eta, s.reflectance)
        if pane.stops > 0.0:
            sample.wi = wp.vec3(-wo[0], -wo[1], wo[2])
            sample.weight = pane.returned / pane.stops
            sample.pdf = CERTAIN
        return sample

    @wp.func(name=f"principled_layers_{tag}")
    def layers(s: Surface, wo: wp.vec3) -> _Layers:
        found = _Layers()
        white = wp.vec3(1.0, 1.0, 1.0)
        here = ggx_albedo(wo[2], s.alpha)
        mean = ggx_albedo_mean(s.alpha)
        found.single = 1.0 - here[0] - here[1]
        found.single_mean = 1.0 - mean[0] - mean[1]
        dielectric = s.f0 * here[0] + here[1]
        found.under = 1.0 - dielectric
        found.under_mean = 1.0 - s.f0 * mean[0] - mean[1]
        f = f82_mean(s.reflectance, s.edge)
        back = white - f * found.single_mean
        for c in range(3):
            found.multiple[c] = f[c] * f[c] * (1.0 - found.single_mean) / back[c]
        # Shares of what each way of leaving returns, by the brightest channel.
        metal = f82_tint(s.reflectance, s.edge, wo[2])
        mirrored = s.metalness * _largest(metal) * (1.0 - found.single) + (1.0 - s.metalness) * dielectric
        spread = s.metalness * _largest(found.multiple) * found.single
        spread += (1.0 - s.metalness) * _largest(s.reflectance) * found.under
        found.mirror = 1.0
        if spread > 0.0:
            # In proportion to what they return; the lobe is never rare, for it is bright where it is narrow.
            found.mirror = wp.clamp(mirrored / (mirrored + spread), 0.1, wp.static(1.0 - 2.0**-10))
        return found

    @wp.func(name=f"principled_evaluate_{tag}")
    def principled_evaluate(s: Surface, found: _Layers, wo: wp.vec3, wi: wp.vec3) -> wp.vec3:
        h = wp.normalize(wo + wi)
        cosine = wp.dot(wo, h)
        so = ggx_slope_term(s.alpha, wo[2])
        si = ggx_slope_term(s.alpha, wi[2])
        lobe = ggx_distribution(s.alpha, wo + wi) * 0.5 * wi[2] / (wo[2] * si + wi[2] * so)
        there = ggx_albedo(wi[2], s.alpha)
        flat = _INV_PI * wi[2]
        metal = f82_tint(s.reflectance, s.edge, cosine) * lobe
        if found.single_mean > 0.0:
            left = found.single * (1.0 - there[0] - there[1]) / found.single_mean
            metal += found.multiple * (left * flat)
        under = found.under * (1.0 - s.f0 * there[0] - there[1]) / found.under_mean
        fresnel = s.f0 + (1.0 - s.f0) * fifth(cosine)
        plastic = wp.vec3(lobe, lobe, lobe) * fresnel + s.reflectance * (under * flat)
        return metal * s.metalness + plastic * (1.0 - s.metalness)

    @wp.func(name=f"principled_pdf_{tag}")
    def principled_pdf(s: Surface, found: _Layers, wo: wp.vec3, wi: wp.vec3) -> float:
        return found.mirror * conductor_pdf(s, wo, wi) + (1.0 - found.mirror) * _INV_PI * wi[2]

    @wp.func(name=f"principled_sample_{tag}")
    def principled_sample(s: Surface, wo: wp.vec3, u: wp.vec2) -> BsdfSample:
        sample = BsdfSample()
        # Known from wo alone: found once for the choice, the density and the value.
        found = layers(s, wo)
        mirror = found.mirror
        # The second number chooses the way, and what is left of it is used again.
        if u[1] < mirror:
            m = ggx_visible_normal(wo, wp.max(s.alpha, ALPHA_MIN), wp.vec2(u[0], _again(u[1] / mirror)))
            sample.wi = wp.normalize(2.0 * wp.dot(wo, m) * m - wo)
        else:
            sample.wi = cosine_hemisphere(wp.vec2(u[0], _again((u[1] - mirror) / (1.0 - mirror))))
        if sample.wi[2] > 0.0:
            sample.pdf = principled_pdf(s, found, wo, sample.wi)
            sample.weight = principled_evaluate(s, found, wo, sample.wi) / sample.pdf
        return sample

    @wp.func(name=f"bsdf_evaluate_{tag}")
    def evaluate(s: Surface, wo: wp.vec3, wi: wp.vec3) -> wp.vec3:
        value = wp.vec3(0.0, 0.0, 0.0)
        if wo[2] > 0.0 and wi[2] > 0.0:
            if wp.static(has_conductor):
                if wp.static(several):
                    if s.kind == CONDUCTOR:
                        value = conductor_evaluate(s, wo, wi)
                else:
                    value = conductor_evaluate(s, wo, wi)
            if wp.static(has_principled):
                if wp.static(several):
                    if s.kind == PRINCIPLED:
                        value = principled_evaluate(s, layers(s, wo), wo, wi)
                else:
                    value = principled_evaluate(s, layers(s, wo), wo, wi)
            if wp.static(has_diffuse):
                if wp.static(several):
                    if s.kind == DIFFUSE:
                        value = s.reflectance * (_INV_PI * wi[2])
                else:
                    value = s.reflectance * (_INV_PI * wi[2])
        if wp.static(has_dielectric):
            if s.kind == DIELECTRIC:
                value = s.reflectance * dielectric_evaluate(s.alpha, s.eta, wo, wi)
        return value

    @wp.func(name=f"bsdf_pdf_{tag}")
    def pdf(s: Surface, wo: wp.vec3, wi: wp.vec3) -> float:
        value = float(0.0)
        if wo[2] > 0.0 and wi[2] > 0.0:
            if wp.static(has_conductor):
                if wp.static(several):
                    if s.kind == CONDUCTOR:
                        value = conductor_pdf(s, wo, wi)
                else:
                    value = conductor_pdf(s, wo, wi)
            if wp.static(has_principled):
                if wp.static(several):
                    if s.kind == PRINCIPLED:
                        value = principled_pdf(s, layers(s, wo), wo, wi)
                else:
                    value = principled_pdf(s, layers(s, wo), wo, wi)
            if wp.static(has_diffuse):
                if wp.static(several):
                    if s.kind == DIFFUSE:
                        value = _INV_PI * wi[2]
                else:
                    value = _INV_PI * wi[2]
        if wp.static(has_dielectric):
            if s.kind == DIELECTRIC:
                value = dielectric_pdf(s.alpha, s.eta, wo, wi)
        return value

    @wp.func(name=f"bsdf_sample_{tag}")
    def sample(s: Surface, wo: wp.vec3, u: wp.vec2) -> BsdfSample:
        drawn = BsdfSample()
        if wo[2] > 0.0:
            if wp.static(has_conductor):
                if wp.static(several):
                    if s.kind == CONDUCTOR:
                        drawn = conductor_sample(s, wo, u)
                else:
                    drawn = conductor_sample(s, wo, u)
            if wp.static(has_principled):
                if wp.static(several):
                    if s.kind == PRINCIPLED:
                        drawn = principled_sample(s, wo, u)
                else:
                    drawn = principled_sample(s, wo, u)
            if wp.static(has_diffuse):
                if wp.static(several):
                    if s.kind == DIFFUSE:
                        drawn = diffuse_sample(s, u)
                else:
                    drawn = diffuse_sample(s, u)
            if wp.static(has_dielectric):
                if s.kind == DIELECTRIC:
                    bent = dielectric_sample(s.alpha, s.eta, wo, u)
                    drawn.wi = bent.wi
                    drawn.weight = s.reflectance * bent.weight
                    drawn.pdf = bent.pdf
            if wp.static(has_thin):
                if s.kind == THIN_DIELECTRIC:
                    drawn = thin_sample(s, wo)
        return drawn

    return Bsdf(kinds, masking, evaluate, pdf, sample)
