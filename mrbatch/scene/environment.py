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
from mrbatch.kernels.transfer import to_rec709
from mrbatch.scene.environment_alias import alias_table
from mrbatch.scene.environment_integrals import EnvironmentIntegrals
from mrbatch.scene.environment_median_cut import MedianCut, best_cut
from mrbatch.scene.environment_sample_map import sample_map
from mrbatch.scene.environment_tables import EnvironmentTables, Interpolation, Rows, build_tables
from mrbatch.scene.stored_picture import MAX_PIXELS, colour_channels, primaries_of, read_stored

if TYPE_CHECKING:
    from mrbatch.kernels.environment import EnvironmentData, LightSampler

WHAT = "environment map"
MAX_SIDE = 65000
"""Guides are 16-bit: half the memory, and a fifth of the sampling time, of 32-bit ones."""
_SHOWN = 5


def rotation_from_yaw(yaw: float) -> np.ndarray:
    """(3, 3) world_from_map of a map turned by `yaw` radians counter-clockwise about world +Z."""
    # Quarter turns are exact, so that a map turned by 90 degrees has exact zeros in its matrix.
    # An angle written in degrees is some rounding errors away from its quarter, however many turns it has.
    quarters = yaw / (0.5 * np.pi)
    if abs(quarters - round(quarters)) <= 1e-12 * max(1.0, abs(quarters)):
        c, s = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[round(quarters) % 4]
    else:
        c, s = float(np.cos(yaw)), float(np.sin(yaw))
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


@dataclass(frozen=True, eq=False)
class Environment:
    """A map of arriving radiance, scene-linear Rec.709.

    `radiance` (H, W, 3) float32, finite, not negative. `rows`: where its rows lie. `world_from_map`
    (3, 3) float64, a rotation (never a mirror). `source`: the file it came from, and what was done.
    `notes`: what a report has to say of the reading.
    Raises InputError for values or a matrix that cannot be.
    """

    radiance: np.ndarray
    rows: Rows = "centres"
    world_from_map: np.ndarray = field(default_factory=lambda: np.eye(3))
    interpolation: Interpolation = "bilinear"
    source: str = ""
    notes: tuple[str, ...] = ()

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
    def median_cut(self) -> MedianCut:
        """Leaves of equal probability; made once."""
        return best_cut(self.tables())

    @property
    def light_sampler(self) -> Literal["median-cut", "cdf"]:
        """The faster way to draw directions from this map at equal noise."""
        return "median-cut" if self.median_cut.worth_it else "cdf"

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

    def most_irradiance(self) -> np.ndarray:
        """(3,) float64: no less than the irradiance on an unoccluded surface, however it is turned."""
        return self._integrals.most_irradiance()

    def most_radiance(self) -> np.ndarray:
        """(3,) float64: no less than the radiance of the map in any direction."""
        return self._integrals.most_radiance()

    def bound_in_cones(
        self, axis: np.ndarray, cos_half_angle: np.ndarray, solid_angle: np.ndarray | None = None
    ) -> np.ndarray:
        """Upper bound (n, 3) float64 of the integral of L over cones of directions.

        `axis` (n, 3) unit, world; `cos_half_angle` (n,), from 1 (a ray) to -1 (the whole sphere).
        Never below the true integral; looser by the light within one coarse cell (about 6 degrees)
        of the rim. `solid_angle` (n,): of what lies somewhere in the cone, where that is less than all
        of it; the bound is then of the light from there.
        """
        a = np.atleast_2d(np.asarray(axis, dtype=np.float64))
        cosine = np.atleast_1d(np.asarray(cos_half_angle, dtype=np.float64))
        return self._integrals.bound_in_cones(a @ self.world_from_map, cosine, solid_angle)

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
        data.step = wp.float64(2.0 * np.pi / self.width)
        data.density = wp.float64(0.0 if self.black else self.width / (2.0 * np.pi))

        def array(values: np.ndarray, dtype: Any) -> wp.array:
            return wp.array(np.ascontiguousarray(values), dtype=dtype, device=device)

        data.nodes = array(t.nodes, wp.vec3)
        data.pdf = array(t.pdf.astype(np.float32), wp.float32)
        data.row_z = array(t.row_z, wp.float64)
        data.row_cdf = array(t.row_cdf, wp.float64)
        data.row_guide = array(t.row_guide, wp.uint16)
        data.column_cdf = array(t.column_cdf.ravel(), wp.float64)
        data.column_guide = array(t.column_guide.ravel(), wp.uint16)
        cut = self.median_cut
        data.leaf_bits = cut.bits
        data.leaf_density = 0.0 if self.black else 1.0 / (4.0**cut.bits * 2.0 * np.pi)
        data.leaves = array(cut.leaves.reshape(-1, 4), wp.vec4)
        data.splits = array(cut.splits, wp.float32)
        return data

    def provide(self, data: EnvironmentData, light_sampler: LightSampler) -> None:
        """Uploads into `data`, which `upload` made, what this sampler alone reads, unless it is there.

        The other samplers need no more than what `upload` gives.
        """
        import warp as wp

        from mrbatch.kernels.environment_cells import AliasBucket

        device = data.nodes.device
        if light_sampler == "alias" and not data.buckets:
            table = alias_table(self.tables())
            record: Any = AliasBucket
            buckets: np.ndarray = np.zeros(table.keep.size, dtype=record.numpy_dtype())
            buckets["keep"], buckets["other"] = table.keep, table.other
            buckets["own_density"], buckets["other_density"] = table.density, table.density[table.other]
            data.buckets = wp.array(buckets, dtype=record, device=device)
        if light_sampler == "sample-map" and not data.stored:
            stored = sample_map(self.tables(), self.height, self.width)
            data.stored = wp.array(stored, dtype=wp.vec4, device=device)


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

    Other primaries that an EXR names as `chromaticities` are converted, once, here; colours outside of
    Rec.709 are clamped to 0 in the channel that lacks them, and `notes` say so.

    `yaw` (radians) turns the map about world +Z, before `world_from_map` (3, 3). `scale`: factor,
    one or three, on the file's values. `repair`: set NaN, infinite and negative values to 0 (the
    count is in `source`) instead of refusing the map. Raises InputError for a file that is missing,
    cannot be read whole, holds 8- or 16-bit codes, more than `max_pixels`, or values that are no radiance.
    """
    path = Path(path)
    place = Place(file=str(path))
    if not path.is_file():
        raise InputError("the environment map does not exist", place=place, hint="check the path in the job")

    def check(spec: Any, place: Place) -> None:
        _check_header(spec, place, max_pixels)

    stored = read_stored(path, what=WHAT, kinds=("EXR", "HDR"), check=check, upright=False)
    radiance = colour_channels(stored, place)[0].astype(np.float32)
    source = str(path)
    notes = []
    if repair:
        bad = ~np.isfinite(radiance) | (radiance < 0.0)
        radiance = np.where(bad, np.float32(0.0), radiance)
        if bad.any():
            source += f" ({int(bad.any(axis=2).sum())} texels set to 0)"
    _check_values(radiance, place)
    primaries, matrix, _ = primaries_of(stored, place)
    if primaries != "bt709":
        radiance = to_rec709(radiance, matrix)
        beyond = radiance < 0.0
        clamped = int(beyond.any(axis=2).sum())
        radiance = np.where(beyond, np.float32(0.0), radiance)
        notes.append(
            f"the {WHAT} is converted to Rec.709 from the primaries that its file names"
            + (f"; {clamped} texels lie outside and are clamped" if clamped else "")
        )
    with np.errstate(over="ignore"):
        radiance = (radiance * np.asarray(scale, dtype=np.float64)).astype(np.float32)
    rotation = rotation_from_yaw(yaw)
    if world_from_map is not None:
        rotation = np.asarray(world_from_map, dtype=np.float64).reshape(3, 3) @ rotation
    return Environment(radiance, rows, rotation, interpolation, source, tuple(notes))


def _check_header(spec: Any, place: Place, max_pixels: int) -> None:
    """Raises InputError for a file that is no environment map, before its pixels are read."""
    if str(spec.format) not in ("half", "float", "double"):
        raise InputError(
            f"the {WHAT} holds {spec.format} codes, not radiance",
            place=place,
            hint="give a linear map with high dynamic range, OpenEXR (.exr) or Radiance (.hdr)",
        )
    if spec.width * spec.height > max_pixels:
        raise InputError(
            f"the {WHAT} has {spec.width} x {spec.height} texels, more than {max_pixels}",
            place=place,
            hint="scale it down with an area filter",
        )
    if (spec.width, spec.height) != (spec.full_width, spec.full_height):
        raise InputError(
            f"the {WHAT} holds only {spec.width} x {spec.height} of its "
            f"{spec.full_width} x {spec.full_height} texels",
            place=place,
            hint="write it without cropping its data window",
        )
    names = [name.upper() for name in spec.channelnames]
    if not set("RGB") <= set(names) and len(names) != 1 and names[:1] != ["Y"]:
        raise InputError(
            f"the {WHAT} has channels {', '.join(spec.channelnames[:8])}, not R, G and B",
            place=place,
            hint="export one layer with channels R, G, B",
        )
