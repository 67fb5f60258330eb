"""What the rules of a plan look at: the scene, every frame's cameras, and what the job asks for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mrbatch.film.window import Window
from mrbatch.scene.camera import Camera
from mrbatch.scene.moment import Moment
from mrbatch.scene.scene import Scene


@dataclass(frozen=True)
class FrameFacts:
    """One frame: its number, and by view the camera and the gain (3,). `moments`: at which scene and camera
    are looked at while the shutter is open; none: at the frame's own time alone."""

    number: int
    cameras: Mapping[str, Camera]
    gains: Mapping[str, np.ndarray]
    moments: tuple[Moment, ...] = ()

    @property
    def looks(self) -> tuple[Moment, ...]:
        """The moments, or the frame's own time."""
        return self.moments or (Moment(float(self.number), self.cameras),)

    def without_lens(self) -> FrameFacts:
        """As a pinhole sees it."""

        def sharp(cameras: Mapping[str, Camera]) -> dict[str, Camera]:
            return {view: camera.with_lens(None) for view, camera in cameras.items()}

        moments = tuple(replace(moment, cameras=sharp(moment.cameras)) for moment in self.moments)
        return replace(self, cameras=sharp(self.cameras), moments=moments)


@dataclass(frozen=True)
class ShotFacts:
    """Everything a rule may look at.

    `half_code`: half of the smallest step of the capture's code values, linear; 0 where the capture
    has none (floating point). `windows`: data window by view. `settings`: the method's. `everywhere`:
    something takes part whose reach is not known (a participant), so every tile is done.
    """

    scene: Scene
    frames: tuple[FrameFacts, ...]
    windows: Mapping[str, Window]
    settings: Any
    layers: frozenset[str]
    half_code: float
    everywhere: bool = False
