"""Integrals over an environment map in float64: irradiance, and bounds of the light in a cone.

Inside a cell radiance is bilinear in (theta, phi), so its moments against 1 and against the
direction are products of one-dimensional integrals over a row and over a column. Those are smooth
and taken with Gauss-Legendre's rule to the last digits of float64. Only cells that the horizon of
a surface cuts need a rule in two dimensions.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from mrbatch.scene.environment_tables import EnvironmentTables, Interpolation

_COARSE_ROWS, _COARSE_COLUMNS = 32, 64
_FINE_ROWS, _FINE_COLUMNS = 128, 256
_ROW_BLOCK = 32
_CONE_BLOCK = 256
_CUT_NODES = 20
"""Nodes each way in a cell that the horizon cuts: its kink keeps a rule of 8 off by 4e-6 of the whole."""
_ROUNDING = 1e-9
"""Relative room for float64 rounding in what must be a bound; sums of millions err by less."""


def _gauss_legendre(count: int) -> tuple[np.ndarray, np.ndarray]:
    x, w = np.polynomial.legendre.leggauss(count)
    return 0.5 * (x + 1.0), 0.5 * w


def _directions(theta: np.ndarray, phi: np.ndarray) -> np.ndarray:
    """(..., 3) unit vectors of broadcast polar angles and azimuths."""
    theta, phi = np.broadcast_arrays(theta, phi)
    sine = np.sin(theta)
    return np.stack([sine * np.cos(phi), sine * np.sin(phi), np.cos(theta)], axis=-1)


class EnvironmentIntegrals:
    """Integrals of one map, in the map's own frame (rotation is the caller's).

    Small maps are cut into at least 128 x 256 cells first: a part of a bilinear cell is bilinear.
    """

    def __init__(self, tables: EnvironmentTables, interpolation: Interpolation):
        rows, columns = tables.weight.shape
        nodes = tables.nodes
        theta = np.pi * np.clip((np.arange(rows + 1) - tables.row_offset) / tables.row_scale, 0.0, 1.0)
        u = (np.arange(columns + 1) - tables.column_offset) / tables.column_scale
        if interpolation == "bilinear":
            upper, lower = nodes[:rows], nodes[1 : rows + 1]
            corners = [
                upper[:, :columns],
                upper[:, 1 : columns + 1],
                lower[:, :columns],
                lower[:, 1 : columns + 1],
            ]
        else:
            corners = [nodes[:rows, :columns]] * 4
        cut_rows, cut_columns = -(-_FINE_ROWS // rows), -(-_FINE_COLUMNS // columns)
        if cut_rows > 1 or cut_columns > 1:
            corners = _subdivide(corners, cut_rows, cut_columns)
            theta = np.interp(np.arange(rows * cut_rows + 1) / cut_rows, np.arange(rows + 1), theta)
            u = np.interp(np.arange(columns * cut_columns + 1) / cut_columns, np.arange(columns + 1), u)
        self.corners = corners
        """Radiance (R, W, 3) at the cells' upper left, upper right, lower left, lower right corner."""
        self.theta = theta
        self.phi = 2.0 * np.pi * (0.5 - u)
        self._row_weights = _edge_weights(
            theta, lambda t: (np.sin(t) ** 2, np.sin(t) ** 2, np.sin(t) * np.cos(t), np.sin(t))
        )
        # Azimuth falls along a row; the length of the step is what counts.
        self._column_weights = -_edge_weights(
            self.phi, lambda p: (np.cos(p), np.sin(p), np.ones_like(p), np.ones_like(p))
        )

    def _moments(self, rows: slice, parts: slice) -> np.ndarray:
        """(rows, W, 3 channels, parts): integral over each cell of L times x, y, z, 1 (those in `parts`)."""
        result: np.ndarray | float = 0.0
        for corner, values in enumerate(self.corners):
            along_row = self._row_weights[corner // 2, rows, parts]
            along_column = self._column_weights[corner % 2, :, parts]
            weight = along_row[:, None, None, :] * along_column[None, :, None, :]
            result = result + values[rows].astype(np.float64)[..., None] * weight
        return np.asarray(result)

    def _blocks(self):
        rows = self.theta.size - 1
        for first in range(0, rows, _ROW_BLOCK):
            yield slice(first, min(first + _ROW_BLOCK, rows))

    @cached_property
    def total(self) -> np.ndarray:
        """(3,): integral of L over the sphere."""
        return sum(
            (self._moments(b, slice(3, 4))[..., 0].sum(axis=(0, 1)) for b in self._blocks()), np.zeros(3)
        )

    def irradiance(self, normals: np.ndarray) -> np.ndarray:
        """(n, 3): integral of L max(0, n.w) for unit normals (n, 3)."""
        result = np.zeros((len(normals), 3))
        middle_theta = 0.5 * (self.theta[1:] + self.theta[:-1])
        middle_phi = 0.5 * (self.phi[1:] + self.phi[:-1])
        # The centre of a cell is nearest to its own corners: the same for all cells of a row.
        sine = np.sin(_radii(self.theta, self.phi[:2])[:, 0])
        for block in self._blocks():
            moments = self._moments(block, slice(0, 3))
            centres = _directions(middle_theta[block, None], middle_phi[None])
            limit = sine[block, None]
            for index, normal in enumerate(normals):
                cosine = centres @ normal
                above = cosine >= limit
                # Wholly above the horizon: n times the vector moment.
                result[index] += np.tensordot(above.astype(np.float64), moments, axes=2) @ normal
                row, column = np.nonzero(np.abs(cosine) < limit)
                result[index] += self._cut_cells(row + block.start, column, normal)
        return result

    def _cut_cells(self, row: np.ndarray, column: np.ndarray, normal: np.ndarray) -> np.ndarray:
        if row.size == 0:
            return np.zeros(3)
        x, w = _gauss_legendre(_CUT_NODES)
        height = np.diff(self.theta)[row, None]
        step = np.abs(np.diff(self.phi))[column, None]
        theta = self.theta[row, None] + height * x
        phi = self.phi[column, None] - step * x
        wanted = np.maximum(_directions(theta[:, :, None], phi[:, None, :]) @ normal, 0.0)
        wanted *= (np.sin(theta) * height * w)[:, :, None] * (step * w)[:, None, :]
        result = np.zeros(3)
        for corner, values in enumerate(self.corners):
            fy = x if corner // 2 else 1.0 - x
            fx = x if corner % 2 else 1.0 - x
            result += np.einsum("nij,i,j->n", wanted, fy, fx) @ values[row, column].astype(np.float64)
        return result

    @cached_property
    def _coarse(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Coarse cells: centres (m, 3), angular radii (m,), integral of L (m, 3), largest L (m, 3)."""
        rows, columns = self.theta.size - 1, self.phi.size - 1
        row_edge = np.arange(_COARSE_ROWS + 1) * rows // _COARSE_ROWS
        column_edge = np.arange(_COARSE_COLUMNS + 1) * columns // _COARSE_COLUMNS
        energy = np.empty((_COARSE_ROWS, _COARSE_COLUMNS, 3))
        largest = np.empty((_COARSE_ROWS, _COARSE_COLUMNS, 3), dtype=np.float32)
        for index in range(_COARSE_ROWS):
            block = slice(row_edge[index], row_edge[index + 1])
            light = self._moments(block, slice(3, 4))[..., 0].sum(axis=0)
            energy[index] = np.add.reduceat(light, column_edge[:-1], axis=0)
            peak = np.max([corner[block].max(axis=0) for corner in self.corners], axis=0)
            peak = np.maximum.reduceat(peak, column_edge[:-1], axis=0)
            # Rounded up: corners of cut cells are float64.
            largest[index] = np.nextafter(peak.astype(np.float32), np.float32(np.inf))
        theta, phi = self.theta[row_edge], self.phi[column_edge]
        centres = _directions(0.5 * (theta[1:] + theta[:-1])[:, None], 0.5 * (phi[1:] + phi[:-1])[None])
        radii = _radii(theta, phi)
        return centres.reshape(-1, 3), radii.ravel(), energy.reshape(-1, 3), largest.reshape(-1, 3)

    def most_radiance(self) -> np.ndarray:
        """(3,): no less than L in any direction."""
        return self._coarse[3].max(axis=0).astype(np.float64)

    def most_irradiance(self) -> np.ndarray:
        """(3,): no less than the integral of L max(0, n.w) for any unit n.

        Every normal lies in one of the coarse cells, and light comes from no nearer to it than the
        distance between the two cells' centres less their radii.
        """
        centres, radii, energy, _ = self._coarse
        apart = np.arccos(np.clip(centres @ centres.T, -1.0, 1.0)) - radii[:, None] - radii[None]
        cosine = np.cos(np.clip(apart, 0.0, 0.5 * np.pi))
        return (cosine @ energy).max(axis=0) * (1.0 + _ROUNDING)

    def bound_in_cones(
        self, axis: np.ndarray, cosine: np.ndarray, solid_angle: np.ndarray | None = None
    ) -> np.ndarray:
        """(n, 3): no less than the integral of L over each cone, or over any part of it of `solid_angle`.

        The smaller of two bounds: all light of the coarse cells that the cone may touch, and the
        largest radiance in those cells times the solid angle (the cone's, where None).
        """
        centres, radii, energy, largest = self._coarse
        cosine = np.clip(cosine, -1.0, 1.0)
        half = np.arccos(cosine)
        # cos(half + radius) by the sum rule: two outer products in place of a cosine for each pair.
        turn = np.stack([cosine, -np.sin(half)], axis=1)
        cell = np.stack([np.cos(radii), np.sin(radii)])
        result = np.empty((len(axis), 3))
        for first in range(0, len(axis), _CONE_BLOCK):
            part = slice(first, first + _CONE_BLOCK)
            touched = axis[part] @ centres.T >= turn[part] @ cell - _ROUNDING
            touched |= half[part, None] + radii >= np.pi
            light = touched.astype(np.float64) @ energy
            omega = 2.0 * np.pi * (1.0 - cosine[part]) if solid_angle is None else solid_angle[part]
            for channel in range(3):
                brightest = np.where(touched, largest[:, channel], np.float32(0.0)).max(axis=1)
                light[:, channel] = np.minimum(light[:, channel], brightest * omega)
            result[part] = light * (1.0 + _ROUNDING)
        return result


def _subdivide(corners: list[np.ndarray], cut_rows: int, cut_columns: int) -> list[np.ndarray]:
    """The four corners of every part when each bilinear cell is cut into cut_rows x cut_columns."""
    rows, columns = corners[0].shape[:2]
    a, b, c, d = (np.repeat(np.repeat(v, cut_rows, 0), cut_columns, 1).astype(np.float64) for v in corners)
    fy = np.tile(np.arange(cut_rows), rows)[:, None, None]
    fx = np.tile(np.arange(cut_columns), columns)[None, :, None]

    def at(down: int, right: int) -> np.ndarray:
        y, x = (fy + down) / cut_rows, (fx + right) / cut_columns
        return (a * (1 - x) + b * x) * (1 - y) + (c * (1 - x) + d * x) * y

    return [at(0, 0), at(0, 1), at(1, 0), at(1, 1)]


def _edge_weights(edges: np.ndarray, functions) -> np.ndarray:
    """(2, n, 4): integral over each of n intervals of f (1 - x) and of f x, for four functions f."""
    x, w = _gauss_legendre(16)
    step = np.diff(edges)[:, None]
    values = np.stack(functions(edges[:-1, None] + step * x), axis=-1) * (step * w)[..., None]
    return np.stack([np.einsum("nqk,q->nk", values, 1.0 - x), np.einsum("nqk,q->nk", values, x)])


def _radii(theta: np.ndarray, phi: np.ndarray) -> np.ndarray:
    """(R, W): largest angle between a cell's centre and its corners, for cells under a quarter turn wide.

    No other point is farther: along a meridian the cosine of the distance has one maximum and no
    minimum inside, along a parallel it falls with the difference in azimuth.
    """
    centre = _directions(0.5 * (theta[1:] + theta[:-1])[:, None], 0.5 * (phi[1:] + phi[:-1])[None])
    nearest = np.full(centre.shape[:2], 1.0)
    for rows in (slice(None, -1), slice(1, None)):
        for columns in (slice(None, -1), slice(1, None)):
            corner = _directions(theta[rows, None], phi[None, columns])
            nearest = np.minimum(nearest, (centre * corner).sum(axis=-1))
    return np.arccos(np.clip(nearest, -1.0, 1.0)) * (1.0 + _ROUNDING)
