"""Poses of a shot smoothed over time without lag, each weighed by its covariance.

The path of rotations is unrolled onto a tangent along the path itself (Jupp and Kent 1987), so that angles
become a path in a flat space; that path is smoothed, and unrolled again along the result until it stays.
How much the camera accelerates is estimated from the shot (`pose_motion`), so how far poses may move follows
from their own covariance alone. A jump starts a new segment, over which nothing is smoothed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation, Slerp
from scipy.stats import chi2, norm

from mrbatch.capture.marker_video.pose_motion import (
    STILL,
    Motion,
    likeliest_motion,
    run_filter,
    run_smoother,
)
from mrbatch.capture.marker_video.pose_table import FramePose

FAR_SIGMA = 3.0
"""A pose that is moved by more (as likely as so many standard deviations of one number) is told."""
MIN_FRAMES = 3
"""Fewer poses say nothing of how a camera moves."""
_UNROLLINGS = 20
_SETTLED = 1e-9
"""Radians by which the last unrolling may change a rotation."""


@dataclass(frozen=True)
class Shift:
    """How far smoothing moved one pose. `metres`; `radians`; `sigma`: as unlikely, by the pose's
    covariance, as so many standard deviations of one number."""

    metres: float
    radians: float
    sigma: float


@dataclass(frozen=True)
class Smoothed:
    """A smoothed shot. `rows`: with new poses and covariances, and of lost frames what the path says of
    them, if they were to be filled. `shifts` by frame number. `starts`: numbers of the segments' first
    frames. `still`: numbers of the first frames of segments in which the camera
    does not move. `motion`: the model, None where there were too few poses."""

    rows: list[FramePose]
    shifts: dict[int, Shift]
    starts: tuple[int, ...] = ()
    still: tuple[int, ...] = ()
    motion: Motion | None = None

    def as_json(self) -> dict[str, Any]:
        """For a report: `segments` and `still` (first frames of segments), `far` (frames), and of the
        shifts `rms` and `largest` (with its frame) in mm and degrees, and each frame's own."""
        frames = {
            n: {"mm": 1e3 * s.metres, "deg": float(np.degrees(s.radians)), "sigma": s.sigma}
            for n, s in self.shifts.items()
        }
        report: dict[str, Any] = {
            "segments": list(self.starts),
            "still": list(self.still),
            "far": self.far,
            "frames": {str(n): shift for n, shift in frames.items()},
        }
        if frames:
            for unit in ("mm", "deg"):
                values = {n: shift[unit] for n, shift in frames.items()}
                worst = max(values, key=lambda n: values[n])
                rms = float(np.sqrt(np.mean(np.square(list(values.values())))))
                report[unit] = {"rms": rms, "largest": values[worst], "largest_frame": worst}
        return report

    @property
    def far(self) -> list[int]:
        """Frames that were moved by more than `FAR_SIGMA`."""
        return [number for number, shift in self.shifts.items() if shift.sigma > FAR_SIGMA]


def smooth_poses(rows: Sequence[FramePose], *, order: int = 2, fill: bool = False) -> Smoothed:
    """Smooths the poses of `rows`, frames in order of time; those without a pose stay without.

    `order`: 2, velocity wanders; 3, acceleration wanders. `fill`: frames without a pose that lie between
    frames of one segment get the path's pose and the flag `interpolated`. Every row with a pose needs its
    covariance (6, 6).
    """
    rows = list(rows)
    seen = [i for i, row in enumerate(rows) if row.world_from_camera is not None]
    if len(seen) < MIN_FRAMES:
        return Smoothed(rows, {})
    span = slice(seen[0], seen[-1] + 1)
    inner = rows[span]
    times = _increasing(np.array([row.time for row in inner]))
    measured = np.array([row.world_from_camera is not None for row in inner])
    covariances = np.array(
        [_tangent(row.covariance) if ok else np.eye(6) for row, ok in zip(inner, measured, strict=True)]
    )
    unknown = np.full((4, 4), np.nan)
    found = np.array([unknown if row.world_from_camera is None else row.world_from_camera for row in inner])
    places, turns = found[:, :3, 3], found[:, :3, :3]
    along = _filled(times, turns, measured)
    motion: Motion | None = None
    for unrolling in range(_UNROLLINGS):
        unrolled = _unroll(along)
        y = np.column_stack([unrolled, places])
        y[measured, :3] += _log(np.swapaxes(along[measured], 1, 2) @ turns[measured])
        y[~measured] = np.nan
        if unrolling < 2:  # the measured path drifts by its own noise; the smoothed one does not
            motion = likeliest_motion(times, y, covariances, order, near=motion)
            starts = run_filter(times, y, covariances, motion).starts
            parts = [slice(a, b) for a, b in zip(starts, [*starts[1:], len(inner)], strict=True)]
            models = [_model(times[p], y[p], covariances[p], motion) for p in parts]
        path, spread = np.empty_like(y), np.empty_like(covariances)
        for p, model in zip(parts, models, strict=True):
            path[p], spread[p] = run_smoother(run_filter(times[p], y[p], covariances[p], model, cut=False))
        step = path[:, :3] - unrolled
        along = along @ Rotation.from_rotvec(step).as_matrix()
        if np.abs(step).max() < _SETTLED:
            break
    result, shifts = list(rows), {}
    for p in parts:
        last = p.start + int(np.flatnonzero(measured[p])[-1])
        for k in range(p.start, last + 1):
            row, pose = inner[k], np.eye(4)
            pose[:3, :3], pose[:3, 3] = along[k], path[k, 3:]
            new = replace(row, world_from_camera=pose, covariance=_tangent(spread[k]))
            if measured[k]:
                shift = shifts[row.number] = _shift(row, pose)
                flags = ("moved-far",) * (shift.sigma > FAR_SIGMA)
                result[span.start + k] = replace(new, flags=(*row.flags, *flags))
            elif fill:
                result[span.start + k] = replace(new, flags=(*row.flags, "interpolated"))
    first = [inner[p.start].number for p in parts]
    quiet = tuple(n for n, model in zip(first, models, strict=True) if model is STILL)
    return Smoothed(result, shifts, tuple(first), quiet, motion)


def _model(times: np.ndarray, y: np.ndarray, covariances: np.ndarray, motion: Motion) -> Motion:
    """A still camera where the segment is at least as likely under that."""
    if np.count_nonzero(~np.isnan(y[:, 0])) < MIN_FRAMES:
        return motion
    moving = run_filter(times, y, covariances, motion, cut=False).cost
    return STILL if run_filter(times, y, covariances, STILL, cut=False).cost <= moving else motion


def _shift(row: FramePose, pose: np.ndarray) -> Shift:
    old, covariance = row.world_from_camera, row.covariance
    assert old is not None and covariance is not None
    moved = np.concatenate([_log(old[:3, :3].T @ pose[:3, :3]), pose[:3, 3] - old[:3, 3]])
    distance = float(moved @ np.linalg.solve(_tangent(covariance), moved))
    chance = float(chi2.sf(distance, 6))
    # Beyond 1e-300 the chance is no number any more; there the two measures nearly agree.
    sigma = float(norm.isf(0.5 * chance)) if chance > 1e-300 else float(np.sqrt(distance))
    return Shift(float(np.linalg.norm(moved[3:])), float(np.linalg.norm(moved[:3])), sigma)


def _tangent(covariance: np.ndarray | None) -> np.ndarray:
    """(6, 6) covariance of (turn of the camera in its own axes, place), from `FramePose.covariance` and back.

    A row's covariance is of the scene's turn about the camera's axes, which is the camera's turn reversed.
    """
    assert covariance is not None
    sign = np.array([-1.0, -1.0, -1.0, 1.0, 1.0, 1.0])
    return covariance * np.outer(sign, sign)


def _log(rotations: np.ndarray) -> np.ndarray:
    return Rotation.from_matrix(rotations).as_rotvec()


def _unroll(rotations: np.ndarray) -> np.ndarray:
    """(n, 3) sums of the turns from frame to frame, each in the axes of its frame; the first is 0."""
    turns = _log(np.swapaxes(rotations[:-1], 1, 2) @ rotations[1:]).reshape(-1, 3)
    return np.concatenate([np.zeros((1, 3)), np.cumsum(turns, axis=0)])


def _filled(times: np.ndarray, rotations: np.ndarray, known: np.ndarray) -> np.ndarray:
    """(n, 3, 3) with a steady turn over frames that are not known."""
    return Slerp(times[known], Rotation.from_matrix(rotations[known]))(times).as_matrix()


def _increasing(times: np.ndarray) -> np.ndarray:
    """Times whose steps are above 0: footage may show two frames at one time."""
    steps = np.diff(times)
    usual = float(np.median(steps[steps > 0])) if np.any(steps > 0) else 1.0
    return times[0] + np.concatenate([[0.0], np.cumsum(np.maximum(steps, 1e-3 * usual))])
