"""The structs of one view of one frame, as the kernels of surface methods take them."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from mrbatch.film.accumulator import picture_data
from mrbatch.film.first_hit import first_hit_data
from mrbatch.film.outputs import FrameInput, Outputs, ViewOutput
from mrbatch.film.photo_reflectance import photo_struct
from mrbatch.kernels.camera import camera_data
from mrbatch.scene.frame_params import FrameParams
from mrbatch.scene.scene_data import DeviceScene


def bind_view(
    scene: DeviceScene, outputs: Outputs, view: ViewOutput, frame: FrameInput, *, photo: bool
) -> tuple[Any, ...]:
    """(FrameParams, FilmData, FirstHitData), and with `photo`, where real surfaces take their reflectance
    from the picture, the whole picture as FilmData."""
    given = frame.views[view.name]
    params = FrameParams()
    params.camera = camera_data(given.camera, scene.scene.origin)
    params.gain = wp.vec3(*(float(g) for g in given.gain))
    params.seed = wp.uint32(outputs.seed if frame.seed is None else frame.seed)
    params.frame = frame.number
    params.view = view.index
    # The photo's reflectance is told once a frame, by the camera of the frame's own time.
    own = params.camera
    if given.frame_camera is not None:
        own = camera_data(given.frame_camera, scene.scene.origin)
    params.photo = photo_struct(view, frame, own, photo, outputs.device)
    film = outputs.layout(view).data(frame.buffers, given.background)
    later = given.next_camera or given.frame_camera or given.camera
    there = camera_data(later, scene.scene.origin)
    # The last frame of a shot tells motion to itself.
    still = np.tile(np.eye(4), (len(scene.scene.objects) or 1, 1, 1))
    shifts = still if given.shifts is None else given.shifts
    hits = first_hit_data(view, outputs, frame, there, shifts)
    hits.frame_camera = own
    home = still if given.home is None else given.home
    hits.home = wp.array(home.astype(np.float32), dtype=wp.mat44, device=outputs.device)
    if not photo:
        return params, film, hits
    whole = given.background if given.photo is None else given.photo
    return params, film, hits, picture_data(view.whole, whole, outputs.device)
