"""The environment light: an equirectangular map of radiance, its file, and its sampling tables.

Directions, rows and rotation follow one rule: u = 1/2 - atan2(d.y, d.x) / (2 pi) and
v = acos(d.z) / pi of a unit direction in the map's frame; column c of W lies at u = (c + 1/2) / W;
row r of H at v = (r + 1/2) / H (`centres`) or r / (H - 1) (`endpoints`). +X is the centre of the
picture, +Z its top.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from mrbatch.errors import InputError, Place
from mrbatch.scene.environment_integrals import EnvironmentIntegrals

if TYPE_CHECKING:
    from mrbatch.kernels.environment import EnvironmentData

Rows = Literal["centres", "endpoints"]
Interpolation = Literal["bilinear", "nearest"]
MAX_PIXELS = 16384 * 8192
MAX_SIDE = 65000
"""Guides are 16-bit: half the memory, and a fifth of the sampling time, of 32-bit ones."""
_SHOWN = 5


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


def rotation_from_yaw(yaw: float) -> np.ndarray:
    """(3, 3) world_from_map of a map turned by `yaw` radians counter-clockwise about world +Z."""
    # Quarter turns are exact, so that a map turned by 90 degrees has exact zeros in its matrix.
    quarters = yaw / (0.5 * np.pi)
    if quarters == round(quarters):
        c, s = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[round(quarters) % 4]
    else:
        c, s = float(np.cos(yaw)), float(np.sin(yaw))
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


@dataclass(frozen=True, eq=False)
class Environment:
    """A map of arriving radiance, scene-linear Rec.709.

    `radiance` (H, W, 3) float32, finite, not negative. `rows`: where its rows lie. `world_from_map`
    (3, 3) float64, a rotation (never a mirror). `source`: the file it came from, and what was done.
    Raises InputError for values or a matrix that cannot be.
    """

    radiance: np.ndarray
    rows: Rows = "centres"
    world_from_map: np.ndarray = field(default_factory=lambda: np.eye(3))
    interpolation: Interpolation = "bilinear"
    source: str = ""

    def __post_init__(self) -> None:
        place = Place(file=self.source) if self.source else None
        radiance = np.ascontiguousarray(self.radiance, dtype=np.float32)
        if radiance.ndim != 3 or radiance.shape[2] != 3 or 0 in radiance.shape:
            raise InputError(f"an environment of shape {radiance.shape}: expected (H, W, 3)", place=place)
        _check_values(radiance, place)
        if self.rows not in ("centres", "endpoints"):
            raise InputError(
                f"unknown row convention `{self.rows}`: expected centres or endpoints", place=place
            )
        if self.rows == "endpoints" and radiance.shape[0] < 2:
            raise InputError(
                "a map of one row cannot have its rows at the end points",
                place=place,
                hint="use `rows: centres`",
            )
        if max(radiance.shape[:2]) > MAX_SIDE:
            raise InputError(
                f"a map of {radiance.shape[1]} x {radiance.shape[0]} texels: at most {MAX_SIDE} a side",
                place=place,
                hint="scale it down with an area filter",
            )
        if self.interpolation not in ("bilinear", "nearest"):
            raise InputError(
                f"unknown interpolation `{self.interpolation}`: expected bilinear or nearest", place=place
            )
        rotation = np.array(self.world_from_map, dtype=np.float64).reshape(3, 3)
        orthonormal = np.allclose(rotation @ rotation.T, np.eye(3), rtol=0.0, atol=1e-6)
        if not orthonormal or np.linalg.det(rotation) < 0.0:
            raise InputError(
                "world_from_map is not a rotation",
                place=place,
                hint="give orthonormal rows with determinant +1; a map is never mirrored silently",
            )
        radiance.flags.writeable = False
        object.__setattr__(self, "radiance", radiance)
        object.__setattr__(self, "world_from_map", rotation)

    @property
    def height(self) -> int:
        return self.radiance.shape[0]

    @property
    def width(self) -> int:
        return self.radiance.shape[1]

    @property
    def black(self) -> bool:
        """True where no light comes from anywhere."""
        return not bool(self.radiance.any())

    def tables(self) -> EnvironmentTables:
        """Sampling tables, float64; made once."""
        return self._tables

    @cached_property
    def _tables(self) -> EnvironmentTables:
        return build_tables(self.radiance, self.rows, self.interpolation)

    @cached_property
    def _integrals(self) -> EnvironmentIntegrals:
        return EnvironmentIntegrals(self.tables(), self.interpolation)

    def irradiance(self, normals: np.ndarray) -> np.ndarray:
        """Irradiance (n, 3) float64 on unoccluded surfaces with unit world normals (n, 3).

        The integral of L max(0, n.w) over all directions, L interpolated as the kernels do, summed
        in float64: exact to about 1e-6 relative.
        """
        n = np.atleast_2d(np.asarray(normals, dtype=np.float64))
        return self._integrals.irradiance(n @ self.world_from_map)

    def fluence(self) -> np.ndarray:
        """(3,) float64: integral of L over all directions."""
        return self._integrals.total

    def bound_in_cones(self, axis: np.ndarray, cos_half_angle: np.ndarray) -> np.ndarray:
        """Upper bound (n, 3) float64 of the integral of L over cones of directions.

        `axis` (n, 3) unit, world; `cos_half_angle` (n,), from 1 (a ray) to -1 (the whole sphere).
        Never below the true integral; looser by the light within one coarse cell (about 6 degrees)
        of the rim.
        """
        a = np.atleast_2d(np.asarray(axis, dtype=np.float64))
        cosine = np.atleast_1d(np.asarray(cos_half_angle, dtype=np.float64))
        return self._integrals.bound_in_cones(a @ self.world_from_map, cosine)

    def upload(self, device: str = "cpu") -> EnvironmentData:
        """The tables as the struct that kernels take."""
        import warp as wp

        from mrbatch.kernels.environment import EnvironmentData

        t = self.tables()
        data = EnvironmentData()
        data.map_from_world = wp.mat33(*self.world_from_map.T.astype(np.float32).ravel().tolist())
        data.row_scale, data.row_offset = t.row_scale, t.row_offset
        data.column_scale, data.column_offset = t.column_scale, t.column_offset
        data.rows, data.columns = t.weight.shape
        data.row_bins = t.row_guide.size - 1
        data.column_bins = t.column_guide.shape[1] - 1
        data.step = 2.0 * np.pi / self.width
        data.density = 0.0 if self.black else 1.0 / data.step

        def array(values: np.ndarray, dtype: Any) -> wp.array:
            return wp.array(np.ascontiguousarray(values), dtype=dtype, device=device)

        data.nodes = array(t.nodes, wp.vec3)
        data.pdf = array(t.pdf.astype(np.float32), wp.float32)
        data.row_z = array(t.row_z, wp.float64)
        data.row_cdf = array(t.row_cdf, wp.float64)
        data.row_guide = array(t.row_guide, wp.uint16)
        data.column_cdf = array(t.column_cdf.ravel(), wp.float64)
        data.column_guide = array(t.column_guide.ravel(), wp.uint16)
        return data


def _check_values(radiance: np.ndarray, place: Place | None) -> None:
    bad = ~np.isfinite(radiance) | (radiance < 0.0)
    if not bad.any():
        return
    texels = np.argwhere(bad.any(axis=2))
    shown = ", ".join(
        f"({column}, {row}) = {tuple(float(v) for v in radiance[row, column])}"
        for row, column in texels[:_SHOWN]
    )
    kinds = {
        "NaN": int(np.isnan(radiance).any(axis=2).sum()),
        "infinite": int(np.isinf(radiance).any(axis=2).sum()),
        "negative": int((radiance < 0.0).any(axis=2).sum()),
    }
    count = ", ".join(f"{number} {kind}" for kind, number in kinds.items() if number)
    raise InputError(
        f"{len(texels)} texels of the environment are no radiance ({count}); "
        f"first, as (column, row): {shown}",
        place=place,
        hint="repair the map, or load it with `repair` to set such values to 0",
    )


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


def load_environment(
    path: str | Path,
    *,
    rows: Rows = "centres",
    world_from_map: np.ndarray | None = None,
    yaw: float = 0.0,
    scale: float | Sequence[float] = 1.0,
    repair: bool = False,
    interpolation: Interpolation = "bilinear",
    max_pixels: int = MAX_PIXELS,
) -> Environment:
    """Reads an equirectangular EXR or HDR map as scene-linear Rec.709.

    `yaw` (radians) turns the map about world +Z, before `world_from_map` (3, 3). `scale`: factor,
    one or three, on the file's values. `repair`: set NaN, infinite and negative values to 0 (the
    count is in `source`) instead of refusing the map. Raises InputError for a file that is missing,
    cannot be read, holds 8- or 16-bit codes, more than `max_pixels`, or values that are no radiance.
    """
    import OpenImageIO as oiio

    path = Path(path)
    place = Place(file=str(path))
    if not path.is_file():
        raise InputError("the environment map does not exist", place=place, hint="check the path in the job")
    image = oiio.ImageInput.open(str(path))
    if image is None:
        raise InputError(
            f"the environment map cannot be read ({oiio.geterror() or 'unknown format'})",
            place=place,
            hint="give an OpenEXR (.exr) or Radiance (.hdr) file",
        )
    try:
        spec = image.spec()
        if str(spec.format) not in ("half", "float", "double"):
            raise InputError(
                f"the environment map holds {spec.format} codes, not radiance",
                place=place,
                hint="give a linear map with high dynamic range, OpenEXR (.exr) or Radiance (.hdr)",
            )
        if spec.width * spec.height > max_pixels:
            raise InputError(
                f"the environment map has {spec.width} x {spec.height} texels, more than {max_pixels}",
                place=place,
                hint="scale it down with an area filter",
            )
        if (spec.width, spec.height) != (spec.full_width, spec.full_height):
            raise InputError(
                f"the environment map holds only {spec.width} x {spec.height} of its "
                f"{spec.full_width} x {spec.full_height} texels",
                place=place,
                hint="write it without cropping its data window",
            )
        channels = _colour_channels(list(spec.channelnames), place)
        values = image.read_image(0, 0, 0, spec.nchannels, oiio.FLOAT)
        if values is None:
            raise InputError(
                f"the environment map cannot be read ({image.geterror()})",
                place=place,
                hint="the file may be cut short; copy it again",
            )
    finally:
        image.close()

    values = np.asarray(values, dtype=np.float32).reshape(spec.height, spec.width, spec.nchannels)
    radiance = values[:, :, channels]
    source = str(path)
    if repair:
        bad = ~np.isfinite(radiance) | (radiance < 0.0)
        radiance = np.where(bad, np.float32(0.0), radiance)
        if bad.any():
            source += f" ({int(bad.any(axis=2).sum())} texels set to 0)"
    _check_values(radiance, place)
    with np.errstate(over="ignore"):
        radiance = (radiance * np.asarray(scale, dtype=np.float64)).astype(np.float32)
    rotation = rotation_from_yaw(yaw)
    if world_from_map is not None:
        rotation = np.asarray(world_from_map, dtype=np.float64).reshape(3, 3) @ rotation
    return Environment(radiance, rows, rotation, interpolation, source)


def _colour_channels(names: list[str], place: Place) -> list[int]:
    upper = [name.upper() for name in names]
    if all(name in upper for name in "RGB"):
        return [upper.index(name) for name in "RGB"]
    if len(names) == 1 or upper[:1] == ["Y"]:
        return [0, 0, 0]
    raise InputError(
        f"the environment map has channels {', '.join(names)}, not R, G and B",
        place=place,
        hint="export one layer with channels R, G, B",
    )
