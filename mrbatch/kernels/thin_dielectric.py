"""Panes of glass so thin that light leaves them where it came in: a slab without thickness.

With R Fresnel's reflectance of one side and t the share of light that one way through the glass leaves,
what goes to and fro inside adds up as a geometric series:

    passed    T = (1 - R)^2 t / (1 - R^2 t^2)
    returned      R + (1 - R)^2 R t^2 / (1 - R^2 t^2) = R (1 + t T)

Clear glass, t = 1: (1 - R) / (1 + R) and 2 R / (1 + R). t is the `colour` at normal incidence; along a ray
that goes through at an angle, the way is longer by 1 / cos of the angle inside.

Light that passes keeps its direction, so that a ray may go on through a pane to a light
(`scene.see_through`); what is left for scattering is the mirror image alone.
"""

from __future__ import annotations

import warp as wp

from mrbatch.kernels.fresnel import fresnel_dielectric


@wp.struct
class PaneShares:
    """Shares of light, linear Rec.709: `passed` straight on, `returned` as by a mirror. `stops`: what does
    not pass of the channel of which most does."""

    passed: wp.vec3
    returned: wp.vec3
    stops: wp.float32


@wp.func
def pane_shares(cosine: float, ior: float, colour: wp.vec3) -> PaneShares:
    """By the cosine of incidence, 0..1, the index of refraction, 1 or more, and the colour, above 0..1."""
    shares = PaneShares()
    c = wp.clamp(cosine, 0.0, 1.0)
    r = fresnel_dielectric(c, ior)
    longer = 1.0 / wp.sqrt(wp.max(1.0 - (1.0 - c * c) / (ior * ior), wp.static(2.0**-24)))
    for k in range(3):
        t = float(1.0)
        if colour[k] < 1.0:
            t = wp.pow(colour[k], longer)
        through = float(0.0)
        # At grazing incidence all is reflected, and 0 / 0 must not be.
        if r * t < 1.0:
            through = (1.0 - r) * (1.0 - r) * t / (1.0 - r * r * t * t)
        shares.passed[k] = through
        shares.returned[k] = r * (1.0 + t * through)
    shares.stops = 1.0 - wp.max(shares.passed[0], wp.max(shares.passed[1], shares.passed[2]))
    return shares
