"""What a pipeline has to produce, and what it gets for one frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from mrbatch.device.rays import Engine
from mrbatch.film.accumulator import BASE_CHANNELS, SPLIT_CHANNELS, FilmLayout
from mrbatch.film.window import Window
from mrbatch.scene.camera import Camera


@dataclass(frozen=True)
class ViewOutput:
    """One view: its name and number (part of every random key), data window, and kind of camera.

    `picture`: the whole picture's pixels, where the data window is not all of it.
    """

    name: str
    index: int
    window: Window
    model: str = "perspective"
    distortion: bool = False
    picture: Window | None = None

    @property
    def whole(self) -> Window:
        """Pixels of the whole picture, without crop and overscan."""
        return self.picture or self.window


@dataclass(frozen=True)
class Outputs:
    """Views and estimates (names of `mrbatch.film.layers.ESTIMATES`) that are asked for.

    `source`: under which name the pipeline's film is kept, `method` or a participant's own; a participant
    puts it before the names of its buffers, so that two of one type do not share them. `lens`: it has a
    width; `shutter`: frames are looked at at several moments.
    """

    views: tuple[ViewOutput, ...]
    needs: frozenset[str]
    seed: int
    engine: Engine
    device: str = "cpu"
    source: str = "method"
    lens: bool = False
    shutter: bool = False

    def layout(self, view: ViewOutput, source: str | None = None) -> FilmLayout:
        """The film of a view, of this pipeline or another `source`: with D split where a layer needs it."""
        channels = SPLIT_CHANNELS if "D_indirect" in self.needs else BASE_CHANNELS
        return FilmLayout(view.window, view.name, self.source if source is None else source, channels)


@dataclass(frozen=True)
class ViewInput:
    """One view of one frame on its data window: `background` (h, w, 3) float32, `gain` (3,), the camera
    of this frame and, where motion is asked for, of the next. `photo` (H, W, 3): the whole picture at
    the output's scale, where the data window is not all of it. `shifts` (objects, 4, 4): where points of each
    object, relative to the scene's origin, are in the next frame; None where nothing moves.

    While the shutter is open `camera` is that of a moment, `frame_camera` that of the frame's own time, and
    `home` (objects, 4, 4) takes points from where they are at the moment to where they are then."""

    camera: Camera
    background: np.ndarray
    gain: np.ndarray
    next_camera: Camera | None = None
    photo: np.ndarray | None = None
    shifts: np.ndarray | None = None
    frame_camera: Camera | None = None
    home: np.ndarray | None = None


@dataclass(frozen=True)
class FrameInput:
    """What `Pipeline.bind` gets: the frame's number, its views, and the pipeline's arrays by name; of a frame
    that is looked at at several `moments` which `moment` it is, from 0. `seed`: in place of the job's."""

    number: int
    views: Mapping[str, ViewInput]
    buffers: Mapping[str, Any]
    moment: int = 0
    moments: int = 1
    seed: int | None = None
