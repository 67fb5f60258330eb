"""Frames for which no pose was found, treated as the job says."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from mrbatch.capture.marker_video.pose_table import FramePose
from mrbatch.errors import InputError, Place
from mrbatch.scene.motion import rigid_between

LostPolicy = Literal["stop", "skip", "hold-last", "interpolate"]


def fill_lost(rows: list[FramePose], lost: LostPolicy) -> list[FramePose]:
    """Frames without a pose, treated by the policy."""
    missing = [row for row in rows if row.world_from_camera is None]
    if not missing or lost == "skip":
        return rows
    if lost == "stop":
        numbers = ", ".join(f"{row.number} ({row.flags[0]})" for row in missing[:10])
        more = f" and {len(missing) - 10} more" if len(missing) > 10 else ""
        raise InputError(
            f"no pose for {len(missing)} of {len(rows)} frames: {numbers}{more}",
            place=Place(frame=missing[0].number),
            hint="set `lost` to skip, hold-last or interpolate, or leave these frames out",
        )
    known = [i for i, row in enumerate(rows) if row.world_from_camera is not None]
    filled = list(rows)
    for i, row in enumerate(rows):
        if row.world_from_camera is not None:
            continue
        pose: np.ndarray | None
        before = max((k for k in known if k < i), default=None)
        after = min((k for k in known if k > i), default=None)
        if lost == "interpolate" and before is not None and after is not None:
            pose, flag = interpolate(rows[before], rows[after], row.time), "interpolated"
        elif before is not None:
            pose, flag = rows[before].world_from_camera, "held"
        elif lost == "interpolate" and after is not None:
            pose, flag = rows[after].world_from_camera, "held"
        else:
            continue
        filled[i] = replace(row, world_from_camera=pose, covariance=None, flags=(*row.flags, flag))
    return filled


def interpolate(before: FramePose, after: FramePose, time: float) -> np.ndarray:
    """(4, 4) pose between two frames: rotation along the shortest arc, place along the line, by time."""
    a, b = before.world_from_camera, after.world_from_camera
    assert a is not None and b is not None
    span = after.time - before.time
    return rigid_between(a, b, (time - before.time) / span if span > 0 else 0.5)
