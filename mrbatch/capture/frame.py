"""One frame of a captured shot, as the rooms to the right see it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction

import numpy as np

from mrbatch.kernels.transfer import decode_table
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
class ViewGeometry:
    """What is known of a view before its picture is read: camera with pose, and gain (3,) float64."""

    camera: Camera
    gain: np.ndarray


@dataclass(frozen=True)
class CaptureFacts:
    """What holds for the whole capture.

    `source_bits`: bits a channel of the pictures (16 or 32 where `source_is_float`). `transfer`: the
    capture's transfer function, by its name in `kernels.transfer`, for previews. `frame_rate`: frames
    per second as an exact fraction, or None. `notes`: what the report has to say of the reading.
    """

    source_bits: int
    source_is_float: bool
    transfer: str
    frame_rate: Fraction | None
    notes: tuple[str, ...] = ()

    @property
    def half_code(self) -> float:
        """Half of the smallest step between code values, linear; 0 for floating-point pictures."""
        if self.source_is_float:
            return 0.0
        return float(np.diff(decode_table(self.transfer, self.source_bits)).min()) / 2


@dataclass(frozen=True)
class FrameData:
    """One frame: its number (as in file names), time in seconds, and views by name (mono: `""`)."""

    number: int
    time: float
    views: Mapping[str, ViewData] = field(default_factory=dict)
    flags: tuple[str, ...] = ()
    """What a person should know of this frame, for example `pose-held`."""
