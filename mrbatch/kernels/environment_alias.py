"""Directions from a map by an alias table: one look-up, however many cells there are.

Walker, *An Efficient Method for Generating Discrete Random Variables with General Distributions*, ACM TOMS
3(3), 1977; Vose, IEEE TSE 17(9), 1991. Two 32-bit fractions name a row and a column of buckets, and what is
left of them the choice within the bucket and the place in the cell: no further number is needed. But a
bucket sends a part of its numbers anywhere, so that a net of random numbers does not stay one, as it does
with a search. How the table is made: `mrbatch.scene.environment_alias`.
"""

from __future__ import annotations

import warp as wp

from mrbatch.kernels.environment_cells import (
    AliasBucket,
    EnvironmentData,
    EnvironmentSample,
    direction_in_cell,
)

_S32 = wp.constant(wp.uint64(32))
_ONE_BIT = wp.constant(wp.uint32(1))
_PARTS = wp.constant(wp.uint32(1 << 31))
_HALF = wp.constant(wp.float64(0.5))
_TO_DOUBLE = wp.constant(wp.float64(2.0**-32))


@wp.func_native("""
#if !defined(__CUDACC__)
    __builtin_prefetch(table.data + element);
#endif
""")
def _prefetch(table: wp.array(dtype=AliasBucket), element: int): ...


@wp.func
def scaled(word: wp.uint32, count: int) -> wp.vec2ui:
    """Whole part and 32-bit fraction of a 32-bit fraction times `count`."""
    product = wp.uint64(word) * wp.uint64(wp.uint32(count))
    return wp.vec2ui(wp.uint32(product >> _S32), wp.uint32(product))


@wp.func
def alias_prefetch(env: EnvironmentData, bits: wp.vec2ui):
    """Asks the memory for what `alias_sample` of these bits will read first."""
    row = int(scaled(bits[0], env.rows)[0])
    _prefetch(env.buckets, row * env.columns + int(scaled(bits[1], env.columns)[0]))


@wp.func
def alias_sample(env: EnvironmentData, bits: wp.vec2ui) -> EnvironmentSample:
    """A direction drawn in proportion to the map's cells, without a search; `bits`: two 32-bit fractions."""
    vertical = scaled(bits[0], env.rows)
    horizontal = scaled(bits[1], env.columns)
    row = int(vertical[0])
    column = int(horizontal[0])
    bucket = env.buckets[row * env.columns + column]
    down = (wp.float64(vertical[1]) + _HALF) * _TO_DOUBLE
    part = horizontal[1] >> _ONE_BIT
    result = EnvironmentSample()
    # What the choice leaves of the number is the place in the cell.
    if part < bucket.keep:
        across = (wp.float64(part) + _HALF) / wp.float64(bucket.keep)
        result.pdf = bucket.own_density
    else:
        across = (wp.float64(part - bucket.keep) + _HALF) / wp.float64(_PARTS - bucket.keep)
        row = bucket.other / env.columns
        column = bucket.other - row * env.columns
        result.pdf = bucket.other_density
    result.direction = direction_in_cell(env, row, column, down, across)
    return result
