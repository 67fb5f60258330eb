"""Random numbers: pure functions of (seed, frame, view, half, element, sample, dimension).

A *key* stands for everything but sample index and dimension. No state is carried, so a number
depends neither on tiles and threads nor on which other numbers are drawn.

Three samplers share one interface. `owen`: Sobol's first two dimensions, Owen-scrambled by hashing
and padded (Burley, Practical Hash-based Owen Scrambling, JCGT 9(4), 2020): each dimension number is
a fresh pair, with its own scramble and its own nested permutation of the sample index, so that
pairs are independent of each other while each pair keeps its net. `independent`: a counter-based
hash. `cranley-patterson`, a baseline: the same points, shifted instead of scrambled.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import warp as wp

from mrbatch.kernels.sobol import (
    reverse_bits,
    scramble_lanes,
    scramble_reversed,
    second_sobol_reversed,
    vec8ui,
)

_GOLDEN = wp.constant(wp.uint64(0x9E3779B97F4A7C15))
_STRIDE = wp.constant(wp.uint64(0xD1342543DE82EF95))
_STRIDE_C = wp.constant(wp.uint64(0xAF251AF3B0F025B5))
_STRIDE_D = wp.constant(wp.uint64(0xF1357AEA2E62A9C5))
_MIX_A = wp.constant(wp.uint64(0xBF58476D1CE4E5B9))
_MIX_B = wp.constant(wp.uint64(0x94D049BB133111EB))
_S27 = wp.constant(wp.uint64(27))
_S30 = wp.constant(wp.uint64(30))
_S31 = wp.constant(wp.uint64(31))
_S32 = wp.constant(wp.uint64(32))
_LOW = wp.constant(wp.uint64(0xFFFFFFFF))
_NONE = wp.constant(wp.uint32(0))
_ONE64 = wp.constant(wp.uint64(1))

_TO_FLOAT = wp.constant(wp.float32(2.0**-24))
_TO_DOUBLE = wp.constant(wp.float64(2.0**-32))
_HALF = wp.constant(wp.float64(0.5))


@wp.func
def mix64(x: wp.uint64) -> wp.uint64:
    """A bijection of 64 bits in which every bit of the input moves every bit of the output.

    Stafford's variant 13 of MurmurHash3's finaliser, as in SplitMix64 (Steele et al., OOPSLA 2014).
    """
    z = (x ^ (x >> _S30)) * _MIX_A
    z = (z ^ (z >> _S27)) * _MIX_B
    return z ^ (z >> _S31)


@wp.func
def element_key(seed: wp.uint32, frame: int, view: int, half: int, element: wp.int64) -> wp.uint64:
    """Key of an element that is no pixel (voxel, point, texel): its absolute id in `element`.

    Each half of the film has a key, and with it a scramble, of its own.
    """
    h = mix64(((wp.uint64(seed) << _S32) | (wp.uint64(wp.uint32(frame)))) + _GOLDEN)
    h = mix64(h + ((wp.uint64(wp.uint32(view)) << _S32) | wp.uint64(wp.uint32(half))) + _GOLDEN)
    return mix64(h + wp.uint64(element) + _GOLDEN)


@wp.func
def pixel_key(seed: wp.uint32, frame: int, view: int, half: int, x: int, y: int) -> wp.uint64:
    """Key of the absolute pixel (x, y); both may be negative (overscan)."""
    packed = (wp.uint64(wp.uint32(y)) << _S32) | wp.uint64(wp.uint32(x))
    return element_key(seed, frame, view, half, wp.int64(packed))


@wp.func
def _dimension_hash(key: wp.uint64, dimension: int) -> wp.uint64:
    return mix64(key + (wp.uint64(wp.uint32(dimension)) + _ONE64) * _STRIDE)


@wp.func
def _low(h: wp.uint64) -> wp.uint32:
    return wp.uint32(h & _LOW)


@wp.func
def _high(h: wp.uint64) -> wp.uint32:
    return wp.uint32(h >> _S32)


@wp.func
def uint_to_float(x: wp.uint32) -> float:
    """The upper 24 bits as a float in [0, 1 - 2^-24]: x * 2^-32 would round to 1."""
    return wp.float32(x >> wp.uint32(8)) * _TO_FLOAT


@wp.func
def uint_to_double(x: wp.uint32) -> wp.float64:
    """All 32 bits as the middle of their interval, in (0, 1)."""
    return (wp.float64(x) + _HALF) * _TO_DOUBLE


@wp.func
def _owen_index(index: int, h: wp.uint64) -> wp.uint32:
    return reverse_bits(scramble_reversed(reverse_bits(wp.uint32(index)), _low(h)))


@wp.func
def _owen_x(permuted: wp.uint32, h: wp.uint64) -> wp.uint32:
    return reverse_bits(scramble_reversed(permuted, _high(h)))


@wp.func
def _owen_y(permuted: wp.uint32, h: wp.uint64) -> wp.uint32:
    # The upper half of an odd multiple of mixed bits: as good as mixing again, at a third of the cost.
    seed = _high(h * _STRIDE)
    return reverse_bits(scramble_reversed(second_sobol_reversed(permuted), seed))


@wp.func
def owen_1d(key: wp.uint64, index: int, dimension: int) -> float:
    """Owen-scrambled van der Corput sequence in [0, 1)."""
    h = _dimension_hash(key, dimension)
    return uint_to_float(_owen_x(_owen_index(index, h), h))


@wp.func
def owen_2d(key: wp.uint64, index: int, dimension: int) -> wp.vec2:
    """Owen-scrambled Sobol pair in [0, 1)^2; the first 2^k indices form a (0, k, 2)-net in base 2."""
    h = _dimension_hash(key, dimension)
    permuted = _owen_index(index, h)
    return wp.vec2(uint_to_float(_owen_x(permuted, h)), uint_to_float(_owen_y(permuted, h)))


@wp.func
def owen_2d_bits(key: wp.uint64, index: int, dimension: int) -> wp.vec2ui:
    """The same pair with all its 32 bits."""
    h = _dimension_hash(key, dimension)
    permuted = _owen_index(index, h)
    return wp.vec2ui(_owen_x(permuted, h), _owen_y(permuted, h))


@wp.func
def _independent_bits(key: wp.uint64, index: int, dimension: int) -> wp.uint64:
    h = _dimension_hash(key, dimension)
    return mix64(h + (wp.uint64(wp.uint32(index)) + _ONE64) * _GOLDEN)


@wp.func
def independent_1d(key: wp.uint64, index: int, dimension: int) -> float:
    """A random number in [0, 1)."""
    return uint_to_float(_high(_independent_bits(key, index, dimension)))


@wp.func
def independent_2d(key: wp.uint64, index: int, dimension: int) -> wp.vec2:
    """A random pair in [0, 1)^2."""
    bits = _independent_bits(key, index, dimension)
    return wp.vec2(uint_to_float(_high(bits)), uint_to_float(_low(bits)))


@wp.func
def independent_2d_bits(key: wp.uint64, index: int, dimension: int) -> wp.vec2ui:
    """The same pair with all its 32 bits."""
    bits = _independent_bits(key, index, dimension)
    return wp.vec2ui(_high(bits), _low(bits))


@wp.struct
class VertexNumbers:
    """Random numbers of a path's vertex, as pairs of 32-bit fractions: for a direction to the light, and for
    a scattered one."""

    light: wp.vec2ui
    scatter: wp.vec2ui


@wp.struct
class StartNumbers:
    """Random numbers of a path's start: of the point in the pixel, and of the vertex that it sees."""

    pixel: wp.vec2ui
    vertex: VertexNumbers


@wp.func
def shifted_2d_bits(key: wp.uint64, index: int, dimension: int) -> wp.vec2ui:
    """Sobol pair as 32-bit fractions, each shifted round by one random number a key and dimension.

    Cranley and Patterson, *Randomization of Number Theoretic Methods for Multiple Integration*, SIAM J.
    Numer. Anal. 13(6), 1976. In integers a shift cannot round to 1. Each dimension takes the points in an
    order of its own, as `owen_2d` does: shifted copies of one order, as printed in Xu et al., would tie pairs
    to each other in every pixel.
    """
    h = _dimension_hash(key, dimension)
    permuted = _owen_index(index, h)
    return wp.vec2ui(
        reverse_bits(permuted) + _high(h),
        reverse_bits(second_sobol_reversed(permuted)) + _high(h * _STRIDE),
    )


@wp.func
def shifted_2d(key: wp.uint64, index: int, dimension: int) -> wp.vec2:
    """The same pair as floats in [0, 1)^2."""
    bits = shifted_2d_bits(key, index, dimension)
    return wp.vec2(uint_to_float(bits[0]), uint_to_float(bits[1]))


@wp.func
def shifted_1d(key: wp.uint64, index: int, dimension: int) -> float:
    """The first of the pair."""
    h = _dimension_hash(key, dimension)
    return uint_to_float(reverse_bits(_owen_index(index, h)) + _high(h))


@wp.func
def _owen_lanes(a: wp.uint32, h: wp.uint64, b: wp.uint32, g: wp.uint64) -> vec8ui:
    # Pairs of the permuted indices a and b, with scrambles from the hashes h and g: one of a, two of b.
    a2 = second_sobol_reversed(a)
    b2 = second_sobol_reversed(b)
    return scramble_lanes(
        vec8ui(a, a2, b, b2, b, b2, _NONE, _NONE),
        vec8ui(
            _high(h),
            _high(h * _STRIDE),
            _high(g),
            _high(g * _STRIDE),
            _high(g * _STRIDE_C),
            _high(g * _STRIDE_D),
            _NONE,
            _NONE,
        ),
    )


@wp.func
def owen_vertex(key: wp.uint64, index: int, dimension: int) -> VertexNumbers:
    """Two Owen-scrambled Sobol pairs of one permutation of the index; the first is `owen_2d_bits`.

    Both are scrambled on their own, so that numbers of one pair are independent of the other's, of whatever
    index: a sum of a function of the first and one of the second, as light and scattered directions are
    added at a vertex, has the variance of pairs with permutations of their own. Not for a function of both.
    """
    h = _dimension_hash(key, dimension)
    x = _owen_lanes(_NONE, h, _owen_index(index, h), h)
    result = VertexNumbers()
    result.light = wp.vec2ui(x[2], x[3])
    result.scatter = wp.vec2ui(x[4], x[5])
    return result


@wp.func
def owen_start(key: wp.uint64, index: int, pixel: int, vertex: int) -> StartNumbers:
    """A pair of the dimension `pixel`, and `owen_vertex` of the dimension `vertex`.

    The pixel's pair takes samples in the sequence's own order, which saves a permutation: all others have
    one of their own, so that it is no less independent of them.
    """
    h = _dimension_hash(key, pixel)
    g = _dimension_hash(key, vertex)
    x = _owen_lanes(wp.uint32(index), h, _owen_index(index, g), g)
    result = StartNumbers()
    result.pixel = wp.vec2ui(x[0], x[1])
    result.vertex.light = wp.vec2ui(x[2], x[3])
    result.vertex.scatter = wp.vec2ui(x[4], x[5])
    return result


@wp.func
def independent_vertex(key: wp.uint64, index: int, dimension: int) -> VertexNumbers:
    """Two random pairs."""
    result = VertexNumbers()
    result.light = independent_2d_bits(key, index, dimension)
    result.scatter = independent_2d_bits(key, index, dimension + 1)
    return result


@wp.func
def independent_start(key: wp.uint64, index: int, pixel: int, vertex: int) -> StartNumbers:
    """A random pair of the dimension `pixel`, and those of the vertex."""
    result = StartNumbers()
    result.pixel = independent_2d_bits(key, index, pixel)
    result.vertex = independent_vertex(key, index, vertex)
    return result


@wp.func
def shifted_vertex(key: wp.uint64, index: int, dimension: int) -> VertexNumbers:
    """Two shifted pairs, each in an order of its own."""
    result = VertexNumbers()
    result.light = shifted_2d_bits(key, index, dimension)
    result.scatter = shifted_2d_bits(key, index, dimension + 1)
    return result


@wp.func
def shifted_start(key: wp.uint64, index: int, pixel: int, vertex: int) -> StartNumbers:
    """A shifted pair of the dimension `pixel`, and those of the vertex."""
    result = StartNumbers()
    result.pixel = shifted_2d_bits(key, index, pixel)
    result.vertex = shifted_vertex(key, index, vertex)
    return result


@wp.func
def unit_pair(bits: wp.vec2ui) -> wp.vec2:
    """Both as floats in [0, 1 - 2^-24]."""
    return wp.vec2(uint_to_float(bits[0]), uint_to_float(bits[1]))


@dataclass(frozen=True)
class Sampler:
    """`wp.func`s of (key: uint64, index: int, dimension: int).

    `sample_1d` gives a float, `sample_2d` a vec2, both in [0, 1 - 2^-24]; `sample_2d_bits` a
    vec2ui whose words are 32-bit fractions; `sample_vertex` the `VertexNumbers` of a dimension and the
    next; `sample_start`, of (key, index, dimension of the pixel, dimension of the vertex), `StartNumbers`,
    at less than the price of the parts. Any `dimension` number may be used (0 to 2^32 - 1 as
    unsigned); calls with the same one are the same numbers, a 1-D call being the first of the pair.
    """

    kind: str
    sample_1d: Any
    sample_2d: Any
    sample_2d_bits: Any
    sample_vertex: Any
    sample_start: Any


_SAMPLERS = {
    "owen": Sampler("owen", owen_1d, owen_2d, owen_2d_bits, owen_vertex, owen_start),
    "independent": Sampler(
        "independent",
        independent_1d,
        independent_2d,
        independent_2d_bits,
        independent_vertex,
        independent_start,
    ),
    "cranley-patterson": Sampler(
        "cranley-patterson", shifted_1d, shifted_2d, shifted_2d_bits, shifted_vertex, shifted_start
    ),
}


def make_sampler(kind: Literal["owen", "independent", "cranley-patterson"] = "owen") -> Sampler:
    """The sampler of this name. Raises ValueError for another name."""
    if kind not in _SAMPLERS:
        raise ValueError(f"unknown sampler `{kind}`: expected one of {', '.join(_SAMPLERS)}")
    return _SAMPLERS[kind]
