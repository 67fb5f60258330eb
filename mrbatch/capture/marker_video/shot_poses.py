"""The camera poses of a marker video's frames: given in a file, or found from the target."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mrbatch.capture.marker_video.calibration import Calibration
from mrbatch.capture.marker_video.footage import Footage
from mrbatch.capture.marker_video.pose_file import load_poses
from mrbatch.capture.marker_video.settings import MarkerVideoSettings
from mrbatch.contracts import Progress
from mrbatch.errors import InputError, Place
from mrbatch.kernels.transfer import from_linear

_LUMINANCE = np.array([0.2126, 0.7152, 0.0722], dtype=np.float32)
SolvePoses = Callable[..., Any]
"""`mrbatch.capture.marker_video.pose.solve_poses` or a stand-in for it."""


def grey_codes_of(linear: np.ndarray, floating: bool) -> np.ndarray:
    """(height, width) luminance for finding markers: 16-bit sRGB codes, or linear floats as they are."""
    r, g, b = (linear[..., c] * _LUMINANCE[c] for c in range(3))
    luminance = r + g + b
    return luminance if floating else from_linear(luminance, "srgb", 16)


def check_size(linear: np.ndarray, about: Mapping[str, Any], path: Path, number: int) -> None:
    """Raises InputError for a picture (height, width, 3) of another size than the footage's."""
    height, width = linear.shape[:2]
    if (width, height) != (about["width"], about["height"]):
        raise InputError(
            f"the frame is {width}x{height}, the others are {about['width']}x{about['height']}",
            place=Place(file=str(path), frame=number),
        )


def find_poses(
    settings: MarkerVideoSettings,
    footage: Footage,
    numbers: tuple[int, ...],
    about: Mapping[str, Any],
    calibration: Calibration,
    broken: dict[int, str],
    progress: Progress,
    *,
    solve: SolvePoses | None = None,
) -> tuple[Sequence[Any], dict[str, Any]]:
    """Rows of `FramePose`, in the target's frame, and what a report says of them; fills `broken`.

    `about`: how the footage is read. Raises InputError: no frame has a pose, or `lost` is `stop` and
    one has none.
    """
    from mrbatch.capture.marker_video.lost_frames import fill_lost
    from mrbatch.capture.marker_video.pose import solve_poses
    from mrbatch.capture.marker_video.pose_table import FramePose

    if settings.poses is not None:
        given = load_poses(settings.poses)
        rows = [
            FramePose(n, float(footage.time(n)), given.get(n), flags=() if n in given else ("lost",))
            for n in numbers
        ]
        if not any(n in given for n in numbers):
            raise InputError(
                f"no frame of {numbers[0]} to {numbers[-1]} has a pose in the file, which has "
                f"{min(given)} to {max(given)}",
                place=Place(file=str(settings.poses)),
                hint="poses carry the numbers of the shot's frames; `start_frame` renumbers the frames",
            )
        report: dict[str, Any] = {"source": "file"}
        if settings.smoothing is not None:
            from mrbatch.capture.marker_video.pose_smoothing import smooth_poses

            angle, length = settings.smoothing.sigma_angle, settings.smoothing.sigma_place
            covariance = np.diag(np.repeat([angle, length], 3).astype(np.float64) ** 2)
            rows = [replace(row, covariance=covariance) for row in rows]
            smoothed = smooth_poses(rows, order=settings.smoothing.order, fill=settings.lost == "interpolate")
            rows, report["smoothing"] = smoothed.rows, smoothed.as_json()
        return fill_lost(rows, settings.lost), report

    def pictures() -> Iterator[tuple[int, float, Callable[[], np.ndarray]]]:
        for number in numbers:
            try:
                linear = footage.picture(number, about).linear
                check_size(linear, about, footage.paths((number,))[0], number)
            except InputError as error:
                broken[number] = error.message
                continue
            grey = grey_codes_of(linear, about["float"])
            yield number, float(footage.time(number)), lambda grey=grey: grey

    seen: list[bool] = []

    def looked(number: int, found: bool) -> None:
        seen.append(found)
        detail = f"seen in {sum(seen)}"
        progress("looking for the target", len(seen) + len(broken), len(numbers), detail)

    solver: SolvePoses = solve or solve_poses
    how: dict[str, Any] = {"lost": settings.lost}
    if settings.smoothing is not None:
        how["smoothing"] = settings.smoothing.order
    try:
        found = solver(pictures(), calibration, settings.target, progress=looked, **how)
    except InputError:
        if len(broken) == len(numbers):
            raise InputError(
                f"none of the {len(numbers)} frames can be read: {broken[numbers[0]]}",
                place=Place(frame=numbers[0]),
            ) from None
        raise
    rows_json = found.as_json()
    place_marker = settings.world_from_marker.array()
    for row in rows_json:
        row.pop("world_from_camera", None)
        other = row.get("other_root")
        if other is not None:
            other["world_from_camera"] = (place_marker @ np.array(other["world_from_camera"])).tolist()
    layout = found.layout or {}
    report = {
        "source": "target",
        "median_rms_px": found.median_rms,
        "noise": found.noise,
        "layout": {str(i): np.asarray(m).tolist() for i, m in layout.items()},
        "frames": rows_json,
    }
    if settings.smoothing is not None:
        report["smoothing"] = found.smoothing
    return found.frames, report
