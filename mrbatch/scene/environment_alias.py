"""The alias table behind the `alias` light sampler, in integers.

Each cell of a map has a whole number of parts in proportion to its weight; each of as many buckets as there
are cells holds `PARTS` of them, of one cell or of two. So the table says exactly what is drawn how often, and
its densities are those of the table, not of what was wanted.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mrbatch.scene.environment_tables import EnvironmentTables

PARTS = 1 << 31


@dataclass(frozen=True)
class AliasTable:
    """`parts` (n,) int64: parts of each cell, `PARTS` * n in all; `keep` (n,) int64, 0..PARTS: of each
    bucket's parts, those of its own cell; `other` (n,) int64: the cell that has the rest. `density` (n,)
    float64: of each cell, per steradian; 0 for a black map. Cells row after row."""

    parts: np.ndarray
    keep: np.ndarray
    other: np.ndarray
    density: np.ndarray


def alias_table(tables: EnvironmentTables) -> AliasTable:
    """The table of a map's cells."""
    rows, columns = tables.weight.shape
    weight = tables.weight.ravel()
    parts = whole_parts(weight)
    keep, other = fill_buckets(parts)
    omega = np.repeat(-np.diff(tables.row_z) * (2.0 * np.pi / columns), columns)
    density = parts / (float(PARTS) * parts.size * omega) if weight.any() else np.zeros(weight.size)
    return AliasTable(parts, keep, other, density)


def whole_parts(weight: np.ndarray) -> np.ndarray:
    """(n,) int64 in proportion to `weight` (n,) float64, `PARTS` * n in all.

    0 where, and only where, a weight is 0: what has light is drawn. All alike where all weights are 0.
    """
    total = PARTS * weight.size
    sums = np.cumsum(weight)
    if sums[-1] == 0.0:
        return np.full(weight.size, PARTS, dtype=np.int64)
    # Rounded sums, not rounded weights: they end in the total.
    edges = np.rint(sums / sums[-1] * total).astype(np.int64)
    parts = np.diff(edges, prepend=np.int64(0))
    lost = (weight > 0.0) & (parts == 0)
    parts[lost] = 1
    parts[np.argmax(parts)] -= int(lost.sum())
    return parts


def fill_buckets(parts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`keep` and `other` (n,) of an alias table of `parts` (n,) int64, `PARTS` * n in all.

    One sweep over light and heavy cells in their order: light buckets are filled up from the first heavy cell
    that has more than its bucket holds, and a heavy cell that has too little left from the next heavy one
    (Huebschle-Schneider and Sanders, *Parallel Weighted Random Sampling*, ACM TOMS 48(3), 2022).
    As sums of what lacks and what is too much, it needs no loop.
    """
    keep = np.minimum(parts, PARTS)
    other = np.arange(parts.size)
    light, heavy = np.flatnonzero(parts <= PARTS), np.flatnonzero(parts > PARTS)
    if heavy.size == 0:
        return keep, other
    lacking = np.cumsum(PARTS - parts[light])
    spare = np.cumsum(parts[heavy] - PARTS)
    before = lacking - (PARTS - parts[light])
    giver = np.searchsorted(spare, before, side="right")
    other[light] = heavy[np.minimum(giver, heavy.size - 1)]
    spent = np.searchsorted(lacking, spare, side="left")
    keep[heavy] = PARTS + spare - lacking[spent]
    other[heavy[:-1]] = heavy[1:]
    return keep, other
