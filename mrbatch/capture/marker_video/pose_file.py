"""Camera poses from a file, and back into one.

Three layouts are read, all JSON:

- ours, as `save_poses` writes it: a list (or `{"poses": [...]}`) of `{"frame", "world_from_camera"}`
  with 4 x 4 matrices (3 x 4 is taken too);
- OpenCV's convention: entries with a rotation vector and a translation that take world points to the
  camera (`rvec`/`tvec`, also `rvec_cam_from_board`/`tvec_m`), metres;
- one key `world_from_camera` with a list of matrices, frame 0 first.

Where entries name no frame, they count from 0.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mrbatch.capture.data_file import parse_json, read_text
from mrbatch.document import shorten
from mrbatch.errors import InputError, Place

WHAT = "pose file"
MAX_BYTES = 16 << 20
"""Some forty thousand poses with all their digits."""
MAX_DISTANCE = 1e9
"""Metres from the world's origin to a camera: farther out, float64 itself is no longer exact to 1e-7 m."""
ORTHONORMAL_TOLERANCE = 1e-4
"""How far R R' may be from the identity: four written decimals, far below what a picture shows."""
_RVEC_KEYS = ("rvec", "rvec_camera_from_world", "rvec_cam_from_board")
_TVEC_KEYS = ("tvec", "tvec_m", "tvec_camera_from_world")


def rigid(matrix: Any, place: Place) -> np.ndarray:
    """(4, 4) float64 rigid motion, its rotation made exactly orthonormal.

    Raises InputError where the matrix is not finite, not of shape 4 x 4 or 3 x 4, or turns and scales.
    """
    try:
        given = np.array(matrix, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise InputError("the pose is not a matrix of numbers", place=place) from None
    if given.shape == (16,):
        given = given.reshape(4, 4)
    if given.shape not in ((4, 4), (3, 4)):
        raise InputError(f"the pose has shape {given.shape}, expected 4 x 4", place=place)
    if not np.all(np.isfinite(given)):
        raise InputError("the pose holds NaN or infinity", place=place)
    if given.shape == (4, 4) and not np.allclose(given[3], [0, 0, 0, 1], rtol=0, atol=1e-9):
        raise InputError(
            "the last row of the pose is not 0 0 0 1", place=place, hint="matrices are written row by row"
        )
    rotation = given[:3, :3]
    with np.errstate(over="ignore", invalid="ignore"):
        error = np.abs(rotation @ rotation.T - np.eye(3)).max()
    if not error <= ORTHONORMAL_TOLERANCE:  # so a NaN, from numbers too large to multiply, is refused too
        raise InputError(
            f"the pose's rotation is not orthonormal (R R' differs from the identity by {error:.2g})",
            place=place,
            hint="a camera pose turns and moves; take scale and shear out",
        )
    if np.linalg.det(rotation) < 0:
        raise InputError(
            "the pose's rotation is a mirror image (determinant -1)",
            place=place,
            hint="camera axes are x right, y down, z forward",
        )
    u, _, vt = np.linalg.svd(rotation)
    pose = np.eye(4)
    pose[:3, :3] = u @ vt
    pose[:3, 3] = given[:3, 3]
    return _within_reach(pose, place)


def _within_reach(pose: np.ndarray, place: Place) -> np.ndarray:
    """The pose itself. Raises InputError where the camera stands beyond `MAX_DISTANCE`, or nowhere."""
    farthest = float(np.abs(pose[:3, 3]).max())
    if not farthest <= MAX_DISTANCE or not np.all(np.isfinite(pose)):
        raise InputError(
            f"the camera stands {farthest:g} m from the origin", place=place, hint="poses are in metres"
        )
    return pose


def from_rvec_tvec(rvec: Any, tvec: Any, place: Place) -> np.ndarray:
    """(4, 4) world_from_camera of OpenCV's camera_from_world. Raises InputError for other than 3 + 3."""
    from scipy.spatial.transform import Rotation

    try:
        r = np.array(rvec, dtype=np.float64).ravel()
        t = np.array(tvec, dtype=np.float64).ravel()
    except (TypeError, ValueError, OverflowError):
        raise InputError("rvec and tvec are not numbers", place=place) from None
    if r.size != 3 or t.size != 3 or not np.all(np.isfinite([r, t])) or np.abs(r).max() > 1e6:
        raise InputError("rvec and tvec must be three finite numbers each", place=place)
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec(r).as_matrix().T
    with np.errstate(over="ignore", invalid="ignore"):
        pose[:3, 3] = -pose[:3, :3] @ t
    return _within_reach(pose, place)


def load_poses(path: str | Path) -> dict[int, np.ndarray]:
    """Frame number to `world_from_camera` (4, 4) float64, metres.

    Raises InputError naming the frame: missing file, unknown layout, a rotation that is none, a frame
    given twice.
    """
    path = Path(path)
    place = Place(file=str(path))
    content = parse_json(read_text(path, WHAT, max_bytes=MAX_BYTES), WHAT, place)
    entries: Any = content
    if isinstance(content, Mapping):
        entries = content.get("poses", content.get("frames", content.get("world_from_camera")))
    if not isinstance(entries, list):
        names = shorten(", ".join(content)) if isinstance(content, Mapping) else shorten(content)
        raise InputError(
            "no poses found",
            place=place,
            hint=f"the file has {names}; expected a list of {{frame, world_from_camera}}",
        )
    if not entries:
        raise InputError("the list of poses is empty", place=place)
    poses: dict[int, np.ndarray] = {}
    for index, entry in enumerate(entries):
        number = _frame_number(entry, index, place)
        at = Place(file=str(path), frame=number)
        if number in poses:
            raise InputError("the frame has two poses", place=at)
        poses[number] = _pose(entry, at)
    return poses


def _frame_number(entry: Any, index: int, place: Place) -> int:
    if not isinstance(entry, Mapping) or "frame" not in entry:
        return index
    number = entry["frame"]
    if isinstance(number, bool) or not isinstance(number, int):
        raise InputError(
            f"`frame` of entry {index} is {shorten(number)}, expected a whole number", place=place
        )
    return number


def _pose(entry: Any, place: Place) -> np.ndarray:
    if not isinstance(entry, Mapping):
        return rigid(entry, place)
    if "world_from_camera" in entry:
        return rigid(entry["world_from_camera"], place)
    rvec = next((entry[k] for k in _RVEC_KEYS if k in entry), None)
    tvec = next((entry[k] for k in _TVEC_KEYS if k in entry), None)
    if rvec is None or tvec is None:
        raise InputError(
            "the entry has neither `world_from_camera` nor `rvec` and `tvec`",
            place=place,
            hint=f"it has {shorten(', '.join(entry)) or 'no keys'}",
        )
    return from_rvec_tvec(rvec, tvec, place)


def save_poses(path: str | Path, poses: Mapping[int, np.ndarray]) -> None:
    """Writes poses in our own layout, in the order of frames; floats keep all their digits."""
    entries = [
        {"frame": int(number), "world_from_camera": np.asarray(pose, dtype=np.float64).tolist()}
        for number, pose in sorted(poses.items())
    ]
    lines = ",\n".join(json.dumps(entry) for entry in entries)
    Path(path).write_text(f"[\n{lines}\n]\n", encoding="utf-8")
