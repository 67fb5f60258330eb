"""What changes from frame to frame, as kernels take it."""

from __future__ import annotations

import warp as wp

from mrbatch.kernels.camera import CameraData
from mrbatch.scene.shading import PhotoReflectance


@wp.struct
class FrameParams:
    """One view of one frame: camera, gain (photo = gain x radiance), and what keys random numbers."""

    camera: CameraData
    photo: PhotoReflectance
    gain: wp.vec3
    seed: wp.uint32
    frame: wp.int32
    view: wp.int32
