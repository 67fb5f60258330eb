"""How much light a boundary reflects, by angle: metals by F82-tint, clear media by Fresnel's equations."""

from __future__ import annotations

import warp as wp


@wp.func
def fifth(c: float) -> float:
    """(1 - c)^5, as Schlick's curve has it."""
    x = wp.clamp(1.0 - c, 0.0, 1.0)
    return x * x * x * x * x


@wp.func
def f82_tint(base: wp.vec3, edge: wp.vec3, cosine: float) -> wp.vec3:
    """Fresnel reflectance of metal: Schlick through `base`, its value at cos 1/7 multiplied by `edge`."""
    white = wp.vec3(1.0, 1.0, 1.0)
    at_edge = base + (white - base) * wp.static((6.0 / 7.0) ** 5)
    dip = wp.cw_mul(at_edge, white - edge) * wp.static(1.0 / (1.0 / 7.0 * (6.0 / 7.0) ** 6))
    c = wp.clamp(cosine, 0.0, 1.0)
    f = base + (white - base) * fifth(c) - dip * (c * fifth(c) * (1.0 - c))
    return wp.vec3(wp.clamp(f[0], 0.0, 1.0), wp.clamp(f[1], 0.0, 1.0), wp.clamp(f[2], 0.0, 1.0))


@wp.func
def f82_mean(base: wp.vec3, edge: wp.vec3) -> wp.vec3:
    """Cosine-weighted mean of `f82_tint` over the hemisphere: 2 integral of F mu d mu."""
    white = wp.vec3(1.0, 1.0, 1.0)
    at_edge = base + (white - base) * wp.static((6.0 / 7.0) ** 5)
    dip = wp.cw_mul(at_edge, white - edge) * wp.static(1.0 / (1.0 / 7.0 * (6.0 / 7.0) ** 6))
    # 2 int mu (1 - mu)^5 = 1 / 21; 2 int mu^2 (1 - mu)^6 = 1 / 126.
    f = base + (white - base) * wp.static(1.0 / 21.0) - dip * wp.static(1.0 / 126.0)
    return wp.vec3(wp.clamp(f[0], 0.0, 1.0), wp.clamp(f[1], 0.0, 1.0), wp.clamp(f[2], 0.0, 1.0))


@wp.func
def fresnel_dielectric(cosine: float, eta: float) -> float:
    """Share of unpolarized light that is reflected, 1 beyond the critical angle; `cosine`: viewer's side."""
    c = wp.clamp(cosine, 0.0, 1.0)
    if eta == 1.0:
        return 0.0
    g2 = eta * eta - 1.0 + c * c
    if g2 <= 0.0:
        return 1.0
    # Walter et al. 2007, equation 22: no angle behind the boundary, and no cancellation at grazing ones.
    g = wp.sqrt(g2)
    a = (g - c) / (g + c)
    b = (c * (g + c) - 1.0) / (c * (g - c) + 1.0)
    return 0.5 * a * a * (1.0 + b * b)
