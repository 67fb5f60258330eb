"""Sampling tables of an environment map: cells, their probabilities, their running sums.

What the kernels do with them: `mrbatch.kernels.environment`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

Rows = Literal["centres", "endpoints"]
Interpolation = Literal["bilinear", "nearest"]


@dataclass(frozen=True)
class EnvironmentTables:
    """What the kernels read (`mrbatch.kernels.environment.EnvironmentData`), as NumPy arrays.

    R x W cells. `nodes` (Rn, Wn, 3) float32, padded; `pdf` (R, W + 1) float64 per steradian;
    `row_z` (R + 1,) cosine of the polar angle at cell edges, falling from 1 to -1; `row_cdf`
    (R + 1,), `column_cdf` (R, W + 1) float64; guides uint16; `weight` (R, W) float64, what the cells'
    probabilities are in proportion to.
    """

    nodes: np.ndarray
    pdf: np.ndarray
    row_z: np.ndarray
    row_cdf: np.ndarray
    row_guide: np.ndarray
    column_cdf: np.ndarray
    column_guide: np.ndarray
    weight: np.ndarray
    row_scale: float
    row_offset: float
    column_scale: float
    column_offset: float


def _node_rows(radiance: np.ndarray, rows: Rows) -> np.ndarray:
    """Padded nodes (Rn, W + 2, 3): columns wrap; with `centres` the outer rows are repeated."""
    if rows == "centres":
        radiance = np.concatenate([radiance[:1], radiance, radiance[-1:]])
    return np.concatenate([radiance[:, -1:], radiance, radiance[:, :1]], axis=1)


def _mean_square(nodes: np.ndarray) -> np.ndarray:
    """(R, W) float64: mean over each bilinear cell, in (u, v), of the sum over channels of L^2.

    Along one edge from a to b the mean of the square is (a^2 + a b + b^2) / 3; the cell is the
    tensor product. Summed row by row to keep the float64 copies small.
    """

    def row_form(p: np.ndarray, q: np.ndarray) -> np.ndarray:
        # Mean over u of p(u) q(u), both linear between neighbouring nodes.
        a, b, c, d = p[:-1], p[1:], q[:-1], q[1:]
        return ((2.0 * (a * c + b * d) + a * d + b * c) / 6.0).sum(axis=1)

    count, width = nodes.shape[0] - 1, nodes.shape[1] - 2
    result = np.empty((count, width))
    upper = nodes[0, : width + 1].astype(np.float64)
    upper_square = row_form(upper, upper)
    for row in range(count):
        lower = nodes[row + 1, : width + 1].astype(np.float64)
        lower_square = row_form(lower, lower)
        result[row] = (upper_square + row_form(upper, lower) + lower_square) / 3.0
        upper, upper_square = lower, lower_square
    return result


def _cdf(weight: np.ndarray) -> np.ndarray:
    """Running sums of (..., n) weights as (..., n + 1), ending in exactly 1; uniform where all are 0."""
    sums = np.cumsum(weight, axis=-1)
    total = sums[..., -1:]
    # Black rows are never drawn; their CDF only has to be one.
    uniform = np.arange(1, weight.shape[-1] + 1) / weight.shape[-1]
    with np.errstate(invalid="ignore", divide="ignore"):
        cdf = np.where(total > 0.0, sums / total, uniform)
    return np.concatenate([np.zeros(weight.shape[:-1] + (1,)), cdf], axis=-1)


def _guide(cdf: np.ndarray, bins: int) -> np.ndarray:
    """For k / bins, k = 0..bins - 1, the interval of `cdf` that holds it; last, the last that is drawn."""
    starts = np.arange(bins) / bins
    last = np.searchsorted(cdf, 1.0, side="left") - 1
    return np.append(np.searchsorted(cdf, starts, side="right") - 1, last).astype(np.uint16)


def _bins(cells: int) -> int:
    """A power of two, above `cells`."""
    return 1 << cells.bit_length()


def build_tables(
    radiance: np.ndarray, rows: Rows = "centres", interpolation: Interpolation = "bilinear"
) -> EnvironmentTables:
    """Tables of a (H, W, 3) map.

    A cell's probability is in proportion to its solid angle times the root mean square of its
    radiance over the cell and the channels: of all densities that are constant in each cell, this
    one has the least variance, summed over the channels. It is positive wherever any channel is, and
    for a grey map with flat cells it is the luminance.
    """
    height, width = radiance.shape[:2]
    if interpolation == "bilinear":
        nodes = _node_rows(radiance, rows)
        mean_square = _mean_square(nodes)
        row_scale, row_offset = (height, 0.5) if rows == "centres" else (height - 1, 0.0)
        column_offset = 0.5
    else:
        nodes = np.concatenate([radiance, radiance[:, :1]], axis=1)
        mean_square = (radiance.astype(np.float64) ** 2).sum(axis=2)
        row_scale, row_offset = (height, 0.0) if rows == "centres" else (height - 1, 0.5)
        column_offset = 0.0
    count = mean_square.shape[0]

    edges = np.clip((np.arange(count + 1) - row_offset) / row_scale, 0.0, 1.0)
    # cos(pi v) as sin(pi (1/2 - v)) is exactly symmetric and exactly 0 on the equator.
    row_z = np.sin(np.pi * (0.5 - edges))
    row_z[0], row_z[-1] = 1.0, -1.0
    # The difference of cosines as a product keeps its digits at the poles.
    middle, half = 0.5 * np.pi * (edges[1:] + edges[:-1]), 0.5 * np.pi * (edges[1:] - edges[:-1])
    omega = 2.0 * np.sin(middle) * np.sin(half) * (2.0 * np.pi / width)

    weight = np.sqrt(mean_square) * omega[:, None]
    row_cdf = _cdf(weight.sum(axis=1))
    column_cdf = _cdf(weight)
    pdf = np.zeros((count, width + 1))
    if weight.any():
        # From the stored CDFs, not from the weights: the density of what is really drawn.
        pdf[:, :width] = np.diff(row_cdf)[:, None] * np.diff(column_cdf, axis=1) / omega[:, None]
        pdf[:, width] = pdf[:, 0]
    bins = _bins(width)
    return EnvironmentTables(
        nodes=np.ascontiguousarray(nodes, dtype=np.float32),
        pdf=pdf,
        row_z=row_z,
        row_cdf=row_cdf,
        row_guide=_guide(row_cdf, 4 * _bins(count)),
        column_cdf=column_cdf,
        column_guide=np.stack([_guide(row, bins) for row in column_cdf]),
        weight=weight,
        row_scale=float(row_scale),
        row_offset=float(row_offset),
        column_scale=float(width),
        column_offset=column_offset,
    )
