"""Look-ups and samples of an equirectangular environment light.

A direction `d` (unit, map frame) maps to u = 1/2 - atan2(d.y, d.x) / (2 pi), v = acos(d.z) / pi.
Radiance is given at nodes and bilinear in (u, v) between them; columns wrap. Sampling cells are the
rectangles between neighbouring nodes, so the density is positive wherever radiance is, and inside a
cell directions are uniform in solid angle: probability over solid angle is the exact density.

How the tables are made: `mrbatch.scene.environment`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import warp as wp

from mrbatch.kernels.environment_alias import alias_prefetch, alias_sample
from mrbatch.kernels.environment_cells import (
    EnvironmentData,
    EnvironmentSample,
    direction_in_cell,
)
from mrbatch.kernels.environment_sample_map import sample_map_prefetch, sample_map_sample
from mrbatch.kernels.numerics import arctangent2, sine_cosine_turns
from mrbatch.kernels.rng import uint_to_double, uint_to_float

_INV_PI = wp.constant(wp.float32(0.3183098861837907))
_INV_TWO_PI = wp.constant(wp.float32(0.15915494309189535))


@wp.func
def direction_to_uv(d: wp.vec3) -> wp.vec2:
    """Map-frame direction (any length but 0) to (u, v) in [0, 1]^2; accurate at the poles too."""
    return wp.vec2(
        0.5 - arctangent2(d[1], d[0]) * _INV_TWO_PI,
        arctangent2(wp.sqrt(d[0] * d[0] + d[1] * d[1]), d[2]) * _INV_PI,
    )


@wp.func
def environment_coordinates(env: EnvironmentData, d: wp.vec3) -> wp.vec2:
    """Column and row coordinate of a world direction in the table of cells."""
    uv = direction_to_uv(env.map_from_world @ d)
    return wp.vec2(uv[0] * env.column_scale + env.column_offset, uv[1] * env.row_scale + env.row_offset)


@wp.func
def _bilinear(env: EnvironmentData, row: int, column: int, fx: float, fy: float) -> wp.vec3:
    top = env.nodes[row, column] * (1.0 - fx) + env.nodes[row, column + 1] * fx
    bottom = env.nodes[row + 1, column] * (1.0 - fx) + env.nodes[row + 1, column + 1] * fx
    return top * (1.0 - fy) + bottom * fy


@wp.func
def _nearest(env: EnvironmentData, row: int, column: int, fx: float, fy: float) -> wp.vec3:
    return env.nodes[row, column]


@wp.func
def find_interval(
    cdf: wp.array(dtype=wp.float64),
    first: int,
    guide: wp.array(dtype=wp.uint16),
    guide_first: int,
    bins: int,
    u: wp.float64,
) -> int:
    """The i with cdf[first + i] <= u < cdf[first + i + 1], for u in [0, 1): never an empty interval."""
    # `bins` is a power of two, so the product is exact and the guide brackets the answer.
    k = wp.min(int(u * wp.float64(bins)), bins - 1)
    low = int(guide[guide_first + k])
    high = int(guide[guide_first + k + 1])
    while low < high:
        middle = (low + high + 1) >> 1
        if cdf[first + middle] <= u:
            low = middle
        else:
            high = middle - 1
    return low


@wp.func
def env_pdf(env: EnvironmentData, d: wp.vec3) -> float:
    """Density per steradian with which `env_sample` draws the unit world direction `d`."""
    st = environment_coordinates(env, d)
    return env.pdf[wp.clamp(int(st[1]), 0, env.rows - 1), wp.clamp(int(st[0]), 0, env.columns)]


@wp.func
def env_sample(env: EnvironmentData, bits: wp.vec2ui) -> EnvironmentSample:
    """A direction drawn in proportion to the map's cells; `bits`: two 32-bit fractions."""
    u = wp.vec2d(uint_to_double(bits[0]), uint_to_double(bits[1]))
    row = find_interval(env.row_cdf, 0, env.row_guide, 0, env.row_bins, u[0])
    below = env.row_cdf[row]
    row_width = env.row_cdf[row + 1] - below
    rest = (u[0] - below) / row_width
    first = row * (env.columns + 1)
    guide = row * (env.column_bins + 1)
    column = find_interval(env.column_cdf, first, env.column_guide, guide, env.column_bins, u[1])
    left = env.column_cdf[first + column]
    column_width = env.column_cdf[first + column + 1] - left
    fx = (u[1] - left) / column_width

    drop = env.row_z[row] - env.row_z[row + 1]
    result = EnvironmentSample()
    result.direction = direction_in_cell(env, row, column, rest, fx)
    # Probability over solid angle; reading it from `pdf` would be one more cache miss.
    result.pdf = float(row_width * column_width * env.density / drop)
    return result


@wp.func_native("""
#if !defined(__CUDACC__)
    __builtin_prefetch(table.data + element);
#endif
""")
def _prefetch(table: wp.array(dtype=wp.vec4), element: int): ...


@wp.func
def _leaf(env: EnvironmentData, bits: wp.vec2ui) -> int:
    lead = wp.uint32(env.leaf_bits)
    rest = wp.uint32(32) - lead
    return wp.int32(((bits[0] >> rest) << lead) | (bits[1] >> rest))


@wp.func
def median_cut_prefetch(env: EnvironmentData, bits: wp.vec2ui):
    """Asks the memory for what `median_cut_sample` of these bits will read."""
    _prefetch(env.leaves, _leaf(env, bits))


@wp.func
def no_prefetch(env: EnvironmentData, bits: wp.vec2ui):
    """A search reads many places, that are only known one after the other."""


@wp.func
def median_cut_sample(env: EnvironmentData, bits: wp.vec2ui) -> EnvironmentSample:
    """A direction from leaves of equal probability, without a search; `bits`: two 32-bit fractions."""
    # The leading bits name the leaf, those that follow the place in it.
    lead = wp.uint32(env.leaf_bits)
    leaf = env.leaves[_leaf(env, bits)]
    z = leaf[0] - uint_to_float(bits[0] << lead) * leaf[1]
    azimuth = sine_cosine_turns(0.5 - (leaf[2] + uint_to_float(bits[1] << lead) * leaf[3]))
    sine = wp.sqrt(wp.max((1.0 - z) * (1.0 + z), 0.0))
    result = EnvironmentSample()
    result.direction = wp.transpose(env.map_from_world) @ wp.vec3(sine * azimuth[1], sine * azimuth[0], z)
    area = leaf[1] * leaf[3]
    if area > 0.0:
        result.pdf = env.leaf_density / area
    return result


@wp.func
def median_cut_pdf(env: EnvironmentData, d: wp.vec3) -> float:
    """Density per steradian with which `median_cut_sample` draws the unit world direction `d`."""
    local = env.map_from_world @ d
    z = wp.clamp(local[2], -1.0, 1.0)
    u = 0.5 - arctangent2(local[1], local[0]) * _INV_TWO_PI
    # The leaves span one turn that starts a column's offset before 0.
    if u * env.column_scale + env.column_offset >= env.column_scale:
        u -= 1.0
    node = int(1)
    i = int(0)
    j = int(0)
    for _level in range(env.leaf_bits):
        below = wp.where(z < env.splits[node], 1, 0)
        node = 2 * node + below
        i = 2 * i + below
        right = wp.where(u >= env.splits[node], 1, 0)
        node = 2 * node + right
        j = 2 * j + right
    leaf = env.leaves[(i << env.leaf_bits) + j]
    area = leaf[1] * leaf[3]
    inside = z <= leaf[0] and z >= leaf[0] - leaf[1] and u >= leaf[2] and u <= leaf[2] + leaf[3]
    if inside and area > 0.0:
        return env.leaf_density / area
    return 0.0


@dataclass(frozen=True)
class EnvironmentFunctions:
    """`radiance(env, d) -> vec3`, `pdf(env, d) -> float`, `sample(env, bits: vec2ui) ->
    EnvironmentSample`; `prefetch(env, bits)` asks the memory for what `sample` will read."""

    interpolation: str
    radiance: Any
    pdf: Any
    sample: Any
    prefetch: Any


def _make(interpolate: Any) -> Any:
    @wp.func
    def env_radiance(env: EnvironmentData, d: wp.vec3) -> wp.vec3:
        """Radiance that arrives from the unit world direction `d`."""
        st = environment_coordinates(env, d)
        column = wp.clamp(int(st[0]), 0, env.columns)
        row = wp.clamp(int(st[1]), 0, env.rows - 1)
        # Rounding may carry v past 1 by a unit in the last place: no extrapolation there.
        fy = wp.clamp(st[1] - float(row), 0.0, 1.0)
        return interpolate(env, row, column, st[0] - float(column), fy)

    return env_radiance


env_radiance = _make(_bilinear)
_nearest_radiance = _make(_nearest)

LightSampler = Literal["median-cut", "cdf", "alias", "sample-map"]
"""How directions are drawn from a map: `median-cut`, leaves of equal probability found without a search;
`cdf`, cell by cell in proportion, found in sums of rows and columns; `alias`, the same, found in one look-up;
`sample-map`, from a fixed set of stored directions (biased)."""

_SAMPLERS = {
    "median-cut": (median_cut_pdf, median_cut_sample, median_cut_prefetch),
    "cdf": (env_pdf, env_sample, no_prefetch),
    "alias": (env_pdf, alias_sample, alias_prefetch),
    "sample-map": (env_pdf, sample_map_sample, sample_map_prefetch),
}


def make_environment(
    interpolation: Literal["bilinear", "nearest"] = "bilinear", sampler: LightSampler = "cdf"
) -> EnvironmentFunctions:
    """The functions for a map whose tables were made with this interpolation.

    `alias` and `sample-map` want tables that `Environment.provide` uploads. Raises ValueError for an unknown
    name.
    """
    radiances = {"bilinear": env_radiance, "nearest": _nearest_radiance}
    if interpolation not in radiances:
        raise ValueError(f"unknown interpolation `{interpolation}`: expected bilinear or nearest")
    if sampler not in _SAMPLERS:
        raise ValueError(f"unknown light sampler `{sampler}`: expected one of {', '.join(_SAMPLERS)}")
    return EnvironmentFunctions(interpolation, radiances[interpolation], *_SAMPLERS[sampler])
