"""Decision tiles: 16x16 pixels counted from absolute pixel (0, 0), whatever part of a frame is at hand."""

from __future__ import annotations

import numpy as np

from mrbatch.contracts import TILE


def tile_edges(length: int, first: int) -> np.ndarray:
    """Where tiles begin within `length` pixels whose first has the absolute coordinate `first`."""
    offset = -first % TILE
    edges = np.arange(offset, length, TILE)
    return edges if offset == 0 else np.concatenate([[0], edges])


def tile_sums(values: np.ndarray, origin: tuple[int, int] = (0, 0)) -> np.ndarray:
    """Sums over 16x16 tiles from absolute pixel (0, 0), in float64; tiles at the edge may be smaller."""
    rows, columns = tile_edges(values.shape[0], origin[1]), tile_edges(values.shape[1], origin[0])
    a = np.asarray(values, dtype=np.float64)
    return np.add.reduceat(np.add.reduceat(a, rows, axis=0), columns, axis=1)
