"""The stored directions behind the `sample-map` light sampler, a biased baseline for comparisons."""

from __future__ import annotations

import numpy as np

from mrbatch.scene.environment_tables import EnvironmentTables


def sample_map(tables: EnvironmentTables, height: int, width: int) -> np.ndarray:
    """(height, width, 4) float32: unit directions in the map's frame, and their densities per steradian.

    The CDF inverted at the middles of height x width equal squares, rows first, continuously within a cell.
    (Mehta et al. and Xu et al. store so many; where in a square is not said.) The density is that of drawing
    from the CDF, as printed: not of drawing from this set, which has none.
    """
    result = np.empty((height, width, 4), dtype=np.float32)
    down = (np.arange(height) + 0.5) / height
    across = (np.arange(width) + 0.5) / width
    rows = np.searchsorted(tables.row_cdf, down, side="right") - 1
    columns = tables.weight.shape[1]
    for line, (row, u) in enumerate(zip(rows, down)):
        cdf = tables.column_cdf[row]
        column = np.searchsorted(cdf, across, side="right") - 1
        rest = (u - tables.row_cdf[row]) / (tables.row_cdf[row + 1] - tables.row_cdf[row])
        z = tables.row_z[row] + rest * (tables.row_z[row + 1] - tables.row_z[row])
        inside = (across - cdf[column]) / (cdf[column + 1] - cdf[column])
        phi = np.pi - (column + inside - tables.column_offset) * (2.0 * np.pi / columns)
        sine = np.sqrt((1.0 - z) * (1.0 + z))
        result[line, :, 0], result[line, :, 1] = sine * np.cos(phi), sine * np.sin(phi)
        result[line, :, 2], result[line, :, 3] = z, tables.pdf[row, column]
    return result
