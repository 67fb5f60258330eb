"""A surface from a depth map: its file, and the mesh through its pixels' centres.

A vertex stands at each pixel centre that has a depth, along the ray that the lens sends there. Of each four
neighbouring pixels two triangles are made, cut along the diagonal whose ends lie nearer to each other in
depth; one, where one of the four is missing. Two pixels are joined only where their depths differ by less
than a share of the smaller one: beyond that a foreground ends and a background begins, and no skirt is drawn
between. A floor seen at a flat angle falls by more than that from row to row: up to four times the share is
allowed where the pixels before and after go on at the same slope (1 / z of a plane is affine in the
picture). One blurred pixel between foreground and background never passes: on one of its sides the slope
breaks.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from mrbatch.errors import InputError, Place
from mrbatch.scene.camera import Camera
from mrbatch.scene.depth_settings import DepthMap
from mrbatch.scene.mesh import Mesh
from mrbatch.scene.stored_picture import MAX_PIXELS, read_stored

WHAT = "depth map"
CHANNELS = ("Z", "depth.Z", "depth")
"""Names of the channel that holds the depth where there are several."""
ABSENT = 1e10
"""Depth of EXR files where nothing is; what is as far is no surface in any unit."""
SENSIBLE = (1e-3, 1e5)
"""Metres in which the middle of a depth map lies, if its unit is right."""
STEEPEST = 4.0
"""How many times the usual difference is allowed between pixels of a surface that goes on at one slope."""


def load_depth(path: Path) -> np.ndarray:
    """(H, W) float64 of the file's own values. Raises InputError for one that is no depth map."""
    place = Place(file=str(path))
    if path.suffix.lower() == ".npy":
        return _load_npy(path, place)
    stored = read_stored(path, what=WHAT, kinds=("PNG", "TIFF", "EXR", "PFM"), only=CHANNELS, upright=False)
    values = stored.values
    if values.dtype == np.uint8:
        raise InputError(
            "the depth map has 8 bits: 256 steps are not a surface",
            place=place,
            hint="write 16 bits or floats",
        )
    if values.shape[2] > 1 and not np.array_equal(
        values[..., :1].repeat(values.shape[2], axis=2), values, True
    ):
        raise InputError(
            f"the depth map has the channels {', '.join(stored.names)}, which differ",
            place=place,
            hint="write one channel, or call it Z",
        )
    with np.errstate(invalid="ignore"):  # a signalling NaN becomes a quiet one, a hole like others
        return values[..., 0].astype(np.float64)


def _load_npy(path: Path, place: Place) -> np.ndarray:
    if not path.is_file():
        raise InputError(f"there is no such {WHAT}", place=place)
    try:
        # Mapped: a header that announces more than the file holds is refused before memory is asked for.
        values: Any = np.load(path, mmap_mode="r", allow_pickle=False)
    except Exception as error:  # headers are Python literals: broken ones may raise anything
        raise InputError(f"the {WHAT} cannot be read ({error})", place=place) from None
    if not isinstance(values, np.ndarray) or values.ndim != 2 or values.dtype.kind not in "fu":
        kind = f"{values.dtype} of shape {values.shape}" if isinstance(values, np.ndarray) else "no array"
        raise InputError(
            f"the {WHAT} holds {kind}: expected (height, width), floats or whole numbers without sign",
            place=place,
        )
    if values.size > MAX_PIXELS:
        raise InputError(f"the {WHAT} has {values.size} pixels, more than {MAX_PIXELS}", place=place)
    return np.array(values, dtype=np.float64)


def load_depth_mesh(given: DepthMap, camera: Camera | None) -> tuple[Mesh, str]:
    """The surface in the world, and what a report says of it. `camera`: of the frame that saw it, or None.

    Raises InputError: a file that is no depth map, another shape than the frame's, no pixel with a depth, a
    unit that puts it out of reach, or no two neighbours at one depth.
    """
    place = Place(file=str(given.file))
    values = load_depth(given.file)
    height, width = values.shape
    if given.camera is not None:
        camera = given.camera.camera(width, height)
    assert camera is not None
    if camera.model != "perspective":
        raise InputError("a depth map of a panorama is not read", place=place)
    if width * camera.height != height * camera.width:
        raise InputError(
            f"the depth map has {width} x {height} pixels, the frame {camera.width} x {camera.height}: "
            "they do not show the same",
            place=place,
            hint="give the depth map's own `camera`, or bring it to the frame's shape",
        )
    with np.errstate(invalid="ignore"):
        there = np.isfinite(values) & (values > 0.0) & (values < ABSENT)
    if not there.any():
        raise InputError(
            "no pixel of the depth map has a depth above 0", place=place, hint="check which file was written"
        )
    middle = float(np.median(values[there])) * given.unit
    if not SENSIBLE[0] <= middle <= SENSIBLE[1]:
        raise InputError(
            f"the middle of the depth map is {middle:.3g} m away: its `unit` cannot be right",
            place=place,
            hint=f"its values reach from {values[there].min():g} to {values[there].max():g}",
        )
    depth = np.where(there, values * given.unit, np.nan)
    if given.farthest is not None:
        depth[~(depth <= given.farthest)] = np.nan
    mesh = depth_mesh(depth, camera.scaled(width, height), given.measures, given.edge)
    if len(mesh.faces) == 0:
        raise InputError(
            f"the depth map makes no surface: no three neighbouring pixels agree within {given.edge:.2%}",
            place=place,
            hint="check `unit` and `farthest`, or raise `edge`",
        )
    low, high = np.nanmin(depth), np.nanmax(depth)
    share = np.isfinite(depth).mean()
    return mesh, (
        f"{given.file.name}: {share:.0%} of {width} x {height} pixels have a depth, {low:.4g} to "
        f"{high:.4g} m; {len(mesh.faces)} triangles"
    )


def depth_mesh(depth: np.ndarray, camera: Camera, measures: str, edge: float) -> Mesh:
    """The surface through the pixels' centres of `depth` (H, W), metres, NaN where none is known.

    `measures`: `z` or `range`. `edge`: share by which the z of joined pixels may differ. Facets turn to the
    camera; uvs cover the picture, so that it fits the surface as a texture.
    """
    height, width = depth.shape
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    rays = camera.directions(np.stack([x.ravel(), y.ravel()], axis=1)).reshape(height, width, 3)
    if measures == "range":
        depth = depth / np.linalg.norm(rays, axis=2)
    z = np.where(np.isfinite(rays).all(axis=2), depth, np.nan)
    faces = _faces(z, edge)
    used = np.zeros(height * width, dtype=bool)
    used[faces.ravel()] = True
    number = np.cumsum(used) - 1
    points = (rays * z[..., None]).reshape(-1, 3)[used]
    pose = camera.world_from_camera
    uvs = np.stack([x.ravel() / width, 1.0 - y.ravel() / height], axis=1)[used]
    return Mesh(
        points @ pose[:3, :3].T + pose[:3, 3],
        number[faces].astype(np.int32),
        uvs=uvs.astype(np.float32),
    )


def _faces(z: np.ndarray, edge: float) -> np.ndarray:
    """(m, 3) indices of pixels, turned to the camera."""
    if min(z.shape) < 2:
        return np.zeros((0, 3), dtype=np.int64)
    index = np.arange(z.size).reshape(z.shape)
    corners = (index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1])
    a, b, c, d = (i.ravel() for i in corners)  # clockwise in the picture from the top left
    nearness = 1.0 / z
    # Beyond the border it goes on as it came: of a flat surface exactly so.
    padded = np.pad(nearness, 1, mode="reflect", reflect_type="odd")
    right, down = _joined(padded, 0, 1, edge), _joined(padded, 1, 0, edge)
    ab, dc = right[:-1, :-1].ravel(), right[1:, :-1].ravel()
    ad, bc = down[:-1, :-1].ravel(), down[:-1, 1:].ravel()
    ac = _joined(padded, 1, 1, edge)[:-1, :-1].ravel()
    bd = _joined(padded, 1, -1, edge)[:-1, 1:].ravel()
    flat = z.ravel()
    with np.errstate(invalid="ignore"):
        along = ac & (~bd | (np.abs(flat[a] - flat[c]) <= np.abs(flat[b] - flat[d])))
    halves = (
        (along & ad & dc, (a, d, c)),
        (along & bc & ab, (a, c, b)),
        (~along & bd & ad & ab, (a, d, b)),
        (~along & bd & dc & bc, (b, d, c)),
    )
    return np.concatenate([np.stack(triple, axis=1)[chosen] for chosen, triple in halves])


def _joined(padded: np.ndarray, down: int, right: int, edge: float) -> np.ndarray:
    """(H, W) whether each pixel and its neighbour in that direction lie on one surface. `padded`: 1 / z, with
    one more pixel all round; a hole is NaN."""

    def at(steps: int) -> np.ndarray:
        height, width = padded.shape
        rows = np.clip(np.arange(1, height - 1) + steps * down, 0, height - 1)
        columns = np.clip(np.arange(1, width - 1) + steps * right, 0, width - 1)
        return padded[np.ix_(rows, columns)]

    before, here, there, after = (at(steps) for steps in (-1, 0, 1, 2))
    with np.errstate(invalid="ignore"):
        least = np.minimum(here, there)
        gap = np.abs(here - there)
        # What the slope on either side, where no hole is, leaves to explain: nothing, on a plane.
        step = np.fmax(np.abs(2.0 * here - before - there), np.abs(2.0 * there - after - here))
        return (gap <= edge * least) | ((gap <= STEEPEST * edge * least) & (step <= edge * least))
