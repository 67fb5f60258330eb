"""The poses of a shot: a row a frame, with what is known of how good each is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from mrbatch.capture.marker_video.pose_solver import Root


@dataclass(frozen=True)
class FramePose:
    """The pose of one frame.

    `world_from_camera` (4, 4) float64 metres, None where the frame has no usable pose. `roots`: all
    poses that explain the picture, best first; `chosen` indexes them (None: lost). `rms`: reprojection
    error in pixels of the pose: the chosen root, smoothed if the job says so. `covariance` (6, 6): rotation
    about the camera's axes (radians), then its place in the world (metres); None where the pose is neither
    measured nor smoothed. `flags`: `lost` (nothing usable was seen), `ambiguous` (two roots not told apart;
    refused), `held`, `interpolated`, `moved-far` (by smoothing, beyond the pose's covariance), `poor-fit`
    (used, but the print is bent or the calibration off). `points`: how many points were seen. `repaired`:
    ids whose wrong bits were corrected. `fault`: why the picture cannot be used at all, such as a marker
    that is seen twice; such a frame is no lost one.
    """

    number: int
    time: float
    world_from_camera: np.ndarray | None
    roots: tuple[Root, ...] = ()
    chosen: int | None = None
    rms: float | None = None
    covariance: np.ndarray | None = None
    flags: tuple[str, ...] = ()
    points: int = 0
    repaired: tuple[int, ...] = ()
    fault: str | None = None

    @property
    def other(self) -> Root | None:
        """The root that was not chosen, where there are two."""
        if self.chosen is None or len(self.roots) < 2:
            return None
        return self.roots[1 - self.chosen]

    @property
    def ratio(self) -> float:
        """rms of the second root over the first's; infinite where there is one root only."""
        if len(self.roots) < 2:
            return float("inf")
        return self.roots[1].rms / max(self.roots[0].rms, 1e-12)


@dataclass(frozen=True)
class PoseTable:
    """Poses of a shot, one row a frame in the order given.

    `median_rms`: median reprojection error in pixels of the measured frames. `noise`: standard deviation of
    detected points relative to what their covariance says. `layout`: world_from_tag (4, 4) by
    id where it was estimated. `smoothing`: what a report says of it, where poses were smoothed.
    """

    frames: tuple[FramePose, ...]
    median_rms: float
    noise: float
    layout: dict[int, np.ndarray] | None = None
    smoothing: dict[str, Any] | None = None

    def poses(self) -> dict[int, np.ndarray]:
        """Frame number to world_from_camera of every frame that has one."""
        return {f.number: f.world_from_camera for f in self.frames if f.world_from_camera is not None}

    def row(self, number: int) -> FramePose:
        """The row of one frame. Raises KeyError where there is none."""
        for frame in self.frames:
            if frame.number == number:
                return frame
        raise KeyError(number)

    def as_json(self) -> list[dict[str, Any]]:
        """One mapping a frame, ready for JSON (`load_poses` reads such a list where no pose is null)."""
        return [
            {
                "frame": f.number,
                "time": f.time,
                "world_from_camera": None if f.world_from_camera is None else f.world_from_camera.tolist(),
                "rms_px": f.rms,
                "points": f.points,
                "roots_rms_px": [root.rms for root in f.roots],
                "other_root": None
                if f.other is None
                else {"world_from_camera": f.other.world_from_camera.tolist(), "rms_px": f.other.rms},
                "sigma_deg": _degrees(f.covariance),
                "sigma_m": None if f.covariance is None else float(np.sqrt(np.trace(f.covariance[3:, 3:]))),
                "repaired_ids": list(f.repaired),
                "flags": list(f.flags),
            }
            for f in self.frames
        ]


def _degrees(covariance: np.ndarray | None) -> float | None:
    return None if covariance is None else float(np.degrees(np.sqrt(np.trace(covariance[:3, :3]))))
