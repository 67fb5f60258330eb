"""Small numerics that every method shares: ray starts, tangent frames, weights of sampling techniques.

All functions are `wp.func`s in float32 unless they say otherwise. Nothing here holds a bare
tolerance: distances are relative to the float's spacing at the place where they are used.
"""

from __future__ import annotations

import warp as wp

OFFSET = wp.constant(wp.float32(2.0**-20))
"""Relative length of the step off a surface: 8 to 16 units in the last place of the larger of |p|, t."""

_PI = wp.constant(wp.float32(3.141592653589793))
_HALF_PI = wp.constant(wp.float32(1.5707963267948966))
_QUARTER_PI = wp.constant(wp.float32(0.7853981633974483))
_TWO_PI = wp.constant(wp.float32(6.283185307179586))
_ONE = wp.constant(wp.float64(1.0))
_ZERO = wp.constant(wp.float64(0.0))


@wp.func
def max_component(a: wp.vec3) -> float:
    """Largest of the three components."""
    return wp.max(wp.max(a[0], a[1]), a[2])


@wp.func
def min_component(a: wp.vec3) -> float:
    """Smallest of the three components."""
    return wp.min(wp.min(a[0], a[1]), a[2])


@wp.func
def luminance(a: wp.vec3) -> float:
    """Relative luminance of linear Rec.709 (ITU-R BT.709-6, item 3.2)."""
    return 0.2126 * a[0] + 0.7152 * a[1] + 0.0722 * a[2]


@wp.func
def arctangent2(y: float, x: float) -> float:
    """atan2 to 3e-7 rad, 0 at (0, 0), from nothing but exactly rounded operations.

    Five times as fast as the mathematical library's on a CPU, and the same bits with every library.
    Reduction and polynomial of Cephes' `atanf` (Moshier), with one division and no branch.
    """
    ax = wp.abs(x)
    ay = wp.abs(y)
    larger = wp.max(ax, ay)
    smaller = wp.min(ax, ay)
    # atan(q) = pi / 4 + atan((q - 1) / (q + 1)) above q = tan(pi / 8).
    far = smaller > 0.41421356 * larger
    above = wp.where(far, smaller - larger, smaller)
    under = wp.where(far, smaller + larger, larger)
    q = above / wp.where(under > 0.0, under, 1.0)
    z = q * q
    p = ((0.080537446 * z - 0.138776854) * z + 0.199777111) * z - 0.333329499
    angle = wp.where(far, _QUARTER_PI, 0.0) + (p * z * q + q)
    angle = wp.where(ay > ax, _HALF_PI - angle, angle)
    angle = wp.where(x < 0.0, _PI - angle, angle)
    return wp.where(y < 0.0, -angle, angle)


@wp.func
def sine_cosine(angle: float) -> wp.vec2:
    """(sin, cos) for |angle| <= pi / 4, to about a unit in the last place, from nothing but exactly
    rounded operations. Polynomials of Cephes' `sinf` and `cosf` (Moshier)."""
    z = angle * angle
    sine = ((-1.9515295891e-4 * z + 8.3321608736e-3) * z - 1.6666654611e-1) * z * angle + angle
    cosine = ((2.443315711809948e-5 * z - 1.388731625493765e-3) * z + 4.166664568298827e-2) * z * z
    return wp.vec2(sine, cosine - 0.5 * z + 1.0)


@wp.func
def sine_cosine_turns(turns: float) -> wp.vec2:
    """(sin, cos) of 2 pi `turns`, for some turns around 0: reduced exactly, then `sine_cosine`."""
    quarter = wp.floor(4.0 * turns + 0.5)
    part = sine_cosine(_TWO_PI * (turns - 0.25 * quarter))
    k = int(quarter) & 3
    sine = wp.where((k & 1) == 1, part[1], part[0])
    cosine = wp.where((k & 1) == 1, part[0], part[1])
    return wp.vec2(wp.where(k >= 2, -sine, sine), wp.where(k == 1 or k == 2, -cosine, cosine))


@wp.func
def offset_origin(p: wp.vec3, ng: wp.vec3, d: wp.vec3, t: float) -> wp.vec3:
    """Start of a ray that leaves the surface point `p` in direction `d`.

    `ng`: unit geometric normal (either side), `t`: distance that the ray which found `p` has
    travelled. A point o + t d is wrong by some units in the last place of its largest term, so the
    start moves along the geometric normal, to the side of `d`, by 2^-20 of the larger of |p|
    (largest component) and t. Waechter and Binder (Ray Tracing Gems, chapter 6) step each component
    by its own spacing and need a constant near zero; this form has none, so a scene scaled by a
    power of two gives exactly scaled starts.
    """
    reach = wp.max(max_component(wp.vec3(wp.abs(p[0]), wp.abs(p[1]), wp.abs(p[2]))), wp.abs(t))
    step = OFFSET * reach
    if wp.dot(ng, d) < 0.0:
        step = -step
    return p + step * ng


@wp.func
def orthonormal_basis(n: wp.vec3) -> wp.mat33:
    """Right-handed frame round the unit vector `n`: columns t, b, n.

    Duff et al., Building an Orthonormal Basis, Revisited (JCGT 6(1), 2017), listing 3.
    """
    sign = 1.0
    if n[2] < 0.0:
        sign = -1.0
    a = -1.0 / (sign + n[2])
    b = n[0] * n[1] * a
    return wp.mat33(
        1.0 + sign * n[0] * n[0] * a,
        b,
        n[0],
        sign * b,
        sign + n[1] * n[1] * a,
        n[1],
        -sign * n[0],
        -n[1],
        n[2],
    )


@wp.func
def to_world(basis: wp.mat33, local: wp.vec3) -> wp.vec3:
    """From the frame of `orthonormal_basis` (z along n) to where n is given."""
    return basis @ local


@wp.func
def to_local(basis: wp.mat33, world: wp.vec3) -> wp.vec3:
    """Into the frame of `orthonormal_basis` (z along n)."""
    return wp.transpose(basis) @ world


@wp.func
def _share(a: wp.float64, b: wp.float64) -> float:
    # a / (a + b) for a, b >= 0 without forming a sum: no overflow, and inf against finite is 1.
    if a <= _ZERO:
        return 0.0
    if a == b:
        # Also inf against inf: two deltas at one place share evenly.
        return 0.5
    if a > b:
        return float(_ONE / (_ONE + b / a))
    r = a / b
    return float(r / (_ONE + r))


@wp.func
def balance_heuristic(pa: float, pb: float) -> float:
    """Weight of the technique with density `pa` against the one with `pb`: pa / (pa + pb).

    0 where both are 0; 1 where only `pa` is infinite. Veach 1997, equation 9.8.
    """
    return _share(wp.float64(pa), wp.float64(pb))


@wp.func
def balance_heuristic_counts(na: float, pa: float, nb: float, pb: float) -> float:
    """The balance heuristic for `na` samples of density `pa` and `nb` of `pb` (Veach 1997, eq. 9.8).

    The products are taken in float64, so counts times densities near the float's end stay finite.
    A technique that draws nothing weighs nothing, whatever its density.
    """
    a = _ZERO
    b = _ZERO
    if na > 0.0:
        a = wp.float64(na) * wp.float64(pa)
    if nb > 0.0:
        b = wp.float64(nb) * wp.float64(pb)
    return _share(a, b)


@wp.func
def power_heuristic(pa: float, pb: float) -> float:
    """Weight pa^2 / (pa^2 + pb^2) (Veach 1997, equation 9.13, beta = 2), 0 where both are 0.

    Formed from the ratio, because p^2 leaves float32 above 1.8e19.
    """
    if pa <= 0.0:
        return 0.0
    if pa == pb:
        return 0.5
    if pa > pb:
        r = wp.float64(pb) / wp.float64(pa)
        return float(_ONE / (_ONE + r * r))
    q = wp.float64(pa) / wp.float64(pb)
    return float(q * q / (_ONE + q * q))
