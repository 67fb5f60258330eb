"""Tables of an equirectangular environment light as kernels see them, and directions within their cells.

How the tables are made: `mrbatch.scene.environment`.
"""

from __future__ import annotations

import warp as wp

_PI = wp.constant(wp.float64(3.141592653589793))
_ONE = wp.constant(wp.float64(1.0))
_ZERO = wp.constant(wp.float64(0.0))


@wp.struct
class AliasBucket:
    """One of as many equal shares of probability as the map has cells. The first `keep` of its 2^31 parts are
    the bucket's own cell, the rest is the cell `other`; both cells' densities per steradian."""

    keep: wp.uint32
    other: wp.int32
    own_density: wp.float32
    other_density: wp.float32


@wp.struct
class EnvironmentData:
    """Tables of one map; R x W sampling cells.

    `map_from_world`: a rotation. `nodes` (Rn, Wn): radiance, padded so that a look-up needs neither
    wrap nor clamp. A point (u, v) has column coordinate u * column_scale + column_offset and row
    coordinate v * row_scale + row_offset; their whole parts name the cell. `pdf` (R, W + 1): per
    steradian, the last column a copy of the first. `row_z` (R + 1): cosine of the polar angle at the
    cells' edges. `row_cdf` (R + 1), `column_cdf` (R * (W + 1), row after row): float64, from 0 to
    exactly 1. `row_guide` (row_bins + 1), `column_guide` (R * (column_bins + 1)): for each of a power
    of two of equal intervals of [0, 1], the cell that holds its start.
    `step`: 2 pi / W; `density`: 1 / step, or 0 for a black map. `leaves` (4^leaf_bits), `splits`
    (4^leaf_bits): the median-cut table (`scene.environment_median_cut`); `leaf_density`: probability of a
    leaf over 2 pi, or 0 for a black map. `buckets` (R * W): the alias table (`scene.environment_alias`).
    `stored` (H, W): directions, map frame, and densities of the sample map (`scene.environment_sample_map`).
    The last two are there only where a shot asked for them.
    """

    map_from_world: wp.mat33
    row_scale: float
    row_offset: float
    column_scale: float
    column_offset: float
    rows: int
    columns: int
    row_bins: int
    column_bins: int
    density: wp.float64
    step: wp.float64
    nodes: wp.array2d(dtype=wp.vec3)
    pdf: wp.array2d(dtype=wp.float32)
    row_z: wp.array(dtype=wp.float64)
    row_cdf: wp.array(dtype=wp.float64)
    row_guide: wp.array(dtype=wp.uint16)
    column_cdf: wp.array(dtype=wp.float64)
    column_guide: wp.array(dtype=wp.uint16)
    leaf_bits: int
    leaf_density: float
    leaves: wp.array(dtype=wp.vec4)
    splits: wp.array(dtype=wp.float32)
    buckets: wp.array(dtype=AliasBucket)
    stored: wp.array2d(dtype=wp.vec4)


@wp.struct
class EnvironmentSample:
    """A sampled direction: unit, world frame; density per steradian.

    A black map gives density 0: check before dividing. The radiance from there is for the caller to
    read, who often finds first that it is not needed.
    """

    direction: wp.vec3
    pdf: float


@wp.func
def direction_in_cell(
    env: EnvironmentData, row: int, column: int, down: wp.float64, across: wp.float64
) -> wp.vec3:
    """World direction at the shares `down` (of the cell's solid angle) and `across` (of its azimuth)."""
    top = env.row_z[row]
    z = top - down * (top - env.row_z[row + 1])
    # (1 - z)(1 + z) keeps the sine's digits near the poles.
    sine = wp.sqrt(wp.max((_ONE - z) * (_ONE + z), _ZERO))
    phi = float(_PI - (wp.float64(column) + across - wp.float64(env.column_offset)) * env.step)
    fsine = float(sine)
    return wp.transpose(env.map_from_world) @ wp.vec3(fsine * wp.cos(phi), fsine * wp.sin(phi), float(z))
