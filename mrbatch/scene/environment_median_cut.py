"""Leaves of equal probability: the table behind the `median-cut` light sampler.

The sphere is cut into 4^bits rectangles of (z, azimuth), each time where half of the light lies on
either side, in turn between rows and columns (Debevec, *A Median Cut Algorithm for Light Probe
Sampling*, 2005, with alternating axes instead of the longer side). A leaf is found from the leading
bits of two random numbers, without any search, and nets of random numbers stay nets. Inside a leaf
directions are uniform in solid angle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mrbatch.scene.environment_tables import EnvironmentTables

CHOICES = (7, 8)
"""Bits of each of the two random numbers that choose the leaf: 16,384 leaves in 0.3 MB, or four times
that. With more the table leaves the cache and is no faster than the search that it replaces."""
MOST_EXCESS = 1.1
"""The second moment of L / pdf over that of texel-by-texel sampling, up to which leaves are worth it:
they save about a quarter of the time on maps like windows and skies, and lose far more than that in
noise where small lamps share a leaf with dark walls."""


@dataclass(frozen=True)
class MedianCut:
    """`leaves` (2^bits, 2^bits, 4) float32: z at the upper edge, height in z, u at the left edge, width
    in u (u may lie below 0: azimuth wraps). `splits` (4^bits,) float32: cut of each inner node in heap
    order from 1; rows (z) at even depth, columns (u) at odd. `excess`: second moment of L / pdf over that
    of texel-by-texel sampling."""

    leaves: np.ndarray
    splits: np.ndarray
    bits: int
    excess: float

    @property
    def worth_it(self) -> bool:
        return self.excess <= MOST_EXCESS


def best_cut(tables: EnvironmentTables) -> MedianCut:
    """The smallest table that is worth it, else the largest."""
    for bits in CHOICES[:-1]:
        cut = median_cut(tables, bits)
        if cut.worth_it:
            return cut
    return median_cut(tables, CHOICES[-1])


def median_cut(tables: EnvironmentTables, bits: int = CHOICES[0]) -> MedianCut:
    """Cuts the cells of a map, whose density is constant over the solid angle of each cell."""
    weight = tables.weight
    rows, columns = weight.shape
    sums = np.zeros((rows + 1, columns + 1))
    np.cumsum(np.cumsum(weight, axis=0), axis=1, out=sums[1:, 1:])
    if sums[-1, -1] == 0.0:
        # A black map is never sampled; any table will do.
        solid = np.repeat(-np.diff(tables.row_z)[:, None], columns, axis=1)
        np.cumsum(np.cumsum(solid, axis=0), axis=1, out=sums[1:, 1:])

    low = np.array([[0.0], [0.0]])
    high = np.array([[float(rows)], [float(columns)]])
    splits = np.zeros(4**bits, dtype=np.float64)
    for depth in range(2 * bits):
        axis = depth % 2
        cut = _cut(sums, low, high, axis, 0.5)
        first = 1 << depth
        splits[first : 2 * first] = _edge(tables, cut, axis)
        left_high, right_low = high.copy(), low.copy()
        left_high[axis], right_low[axis] = cut, cut
        low = np.stack([low, right_low], axis=-1).reshape(2, -1)
        high = np.stack([left_high, high], axis=-1).reshape(2, -1)
    if np.any(weight == 0.0) and np.any(weight > 0.0):
        # Cells without light at the rim of a leaf are never drawn: shrink to what holds all of it.
        for axis in (0, 1):
            shrunk_low = _cut(sums, low, high, axis, 0.0)
            shrunk_high = _cut(sums, low, high, axis, 1.0)
            low[axis], high[axis] = shrunk_low, np.maximum(shrunk_high, shrunk_low)
    z0, z1 = _edge(tables, low[0], 0), _edge(tables, high[0], 0)
    u0, u1 = _edge(tables, low[1], 1), _edge(tables, high[1], 1)
    # Heap order interleaves the bits of row and column; the kernel wants [row bits, column bits].
    order = np.arange(4**bits)
    i = sum(((order >> (2 * (bits - 1 - b) + 1)) & 1) << (bits - 1 - b) for b in range(bits))
    j = sum(((order >> (2 * (bits - 1 - b))) & 1) << (bits - 1 - b) for b in range(bits))
    leaves = np.zeros((1 << bits, 1 << bits, 4), dtype=np.float32)
    leaves[i, j] = np.stack([z0, z0 - z1, u0, u1 - u0], axis=-1)
    return MedianCut(leaves, splits.astype(np.float32), bits, _excess(tables, low, high))


def _excess(tables: EnvironmentTables, low: np.ndarray, high: np.ndarray) -> float:
    """K sum of (solid angle x integral of L^2) over K leaves, over (sum of cell weights)^2; a cell's
    weight is its solid angle times the root mean square of its radiance."""
    omega = -np.diff(tables.row_z)[:, None] * (2.0 * np.pi / tables.weight.shape[1])
    total = tables.weight.sum()
    if total == 0.0:
        return 1.0
    squares = tables.weight**2 / omega
    sums = np.zeros((squares.shape[0] + 1, squares.shape[1] + 1))
    np.cumsum(np.cumsum(squares, axis=0), axis=1, out=sums[1:, 1:])
    inside = (
        _at(sums, high[0], high[1])
        - _at(sums, low[0], high[1])
        - _at(sums, high[0], low[1])
        + _at(sums, low[0], low[1])
    )
    height = _edge(tables, low[0], 0) - _edge(tables, high[0], 0)
    width = 2.0 * np.pi * (_edge(tables, high[1], 1) - _edge(tables, low[1], 1))
    return float(low.shape[1] * np.sum(height * width * np.maximum(inside, 0.0)) / total**2)


def _edge(tables: EnvironmentTables, position: np.ndarray, axis: int) -> np.ndarray:
    """z of a continuous row coordinate, u of a column coordinate."""
    if axis == 1:
        return (position - tables.column_offset) / tables.column_scale
    row = np.minimum(position.astype(np.int64), len(tables.row_z) - 2)
    top, bottom = tables.row_z[row], tables.row_z[row + 1]
    return top + (position - row) * (bottom - top)


def _at(sums: np.ndarray, row: np.ndarray, column: np.ndarray) -> np.ndarray:
    """The summed-area table between its nodes: exact, for the density is constant in a cell."""
    r = np.minimum(row.astype(np.int64), sums.shape[0] - 2)
    c = np.minimum(column.astype(np.int64), sums.shape[1] - 2)
    fr, fc = row - r, column - c
    top = sums[r, c] * (1 - fc) + sums[r, c + 1] * fc
    bottom = sums[r + 1, c] * (1 - fc) + sums[r + 1, c + 1] * fc
    return top * (1 - fr) + bottom * fr


def _cut(sums: np.ndarray, low: np.ndarray, high: np.ndarray, axis: int, share: float) -> np.ndarray:
    """Where along `axis` the given share of each rectangle's light lies before the cut.

    Share 0: the last point without light before it; share 1: the first point with all light before.
    """
    other = 1 - axis

    def mass(position: np.ndarray) -> np.ndarray:
        def corner(side: np.ndarray) -> np.ndarray:
            return _at(sums, position, side) if axis == 0 else _at(sums, side, position)

        return corner(high[other]) - corner(low[other])

    start = mass(low[axis])
    total = mass(high[axis]) - start
    # Sums of millions of terms: what lies within rounding of none or all counts as none or all.
    slack = 8 * np.finfo(np.float64).eps * sums[-1, -1]
    if share == 0.0:
        target = start + slack
    elif share == 1.0:
        target = start + total - slack
    else:
        target = start + share * total
    a = np.floor(low[axis]).astype(np.int64)
    b = np.ceil(high[axis]).astype(np.int64)
    # The last edge of a cell, within the rectangle, that has no more than the target before it.
    left, right = a.copy(), b.copy()
    while np.any(right - left > 1):
        middle = (left + right) // 2
        before = mass(np.clip(middle.astype(np.float64), low[axis], high[axis])) <= target
        left = np.where(before & (right - left > 1), middle, left)
        right = np.where(~before & (right - left > 1), middle, right)
    x0 = np.clip(left.astype(np.float64), low[axis], high[axis])
    x1 = np.clip(right.astype(np.float64), low[axis], high[axis])
    m0, m1 = mass(x0), mass(x1)
    with np.errstate(divide="ignore", invalid="ignore"):
        inside = np.where(m1 > m0, (target - m0) / (m1 - m0), 0.5)
    return x0 + np.clip(inside, 0.0, 1.0) * (x1 - x0)
