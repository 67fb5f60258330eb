"""One moment of an exposure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from mrbatch.scene.camera import Camera


@dataclass(frozen=True)
class Moment:
    """`time` in frames, whole at a frame's own time; by view the camera where it then is."""

    time: float
    cameras: Mapping[str, Camera]
