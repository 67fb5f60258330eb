"""One frame of a captured shot, as the rooms to the right see it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from mrbatch.scene.camera import Camera


@dataclass(frozen=True)
class ViewData:
    """One view of a frame.

    `camera`: with its pose. `background` (height, width, 3) float32: the captured picture,
    scene-linear Rec.709, in photo units (photo = gain x radiance). `gain` (3,) float64 per channel.
    `matte` (height, width) float32 in 0..1, how much of the pixel something in front covers (it cuts
    the virtual layers), or None. `codes`: the picture's own code values where they were integers
    (uint8 or uint16, (height, width, 3)), else None.
    """

    camera: Camera
    background: np.ndarray
    gain: np.ndarray
    matte: np.ndarray | None = None
    codes: np.ndarray | None = None


@dataclass(frozen=True)
class FrameData:
    """One frame: its number (as in file names), time in seconds, and views by name (mono: `""`)."""

    number: int
    time: float
    views: Mapping[str, ViewData] = field(default_factory=dict)
    flags: tuple[str, ...] = ()
    """What a person should know of this frame, for example `pose-held`."""
