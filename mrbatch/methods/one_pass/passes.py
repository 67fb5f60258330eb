"""From scene, plan and settings to the passes of one-pass differential path tracing."""

from __future__ import annotations

from mrbatch.contracts import Pipeline
from mrbatch.effects.plan import Plan
from mrbatch.film.outputs import Outputs
from mrbatch.film.path_pipeline import CameraPathFlags, camera_path_flags, camera_path_pipeline
from mrbatch.methods.one_pass.kernels import make_kernel
from mrbatch.methods.one_pass.settings import OnePassSettings
from mrbatch.scene.scene_data import DeviceScene


def build(scene: DeviceScene, plan: Plan, settings: OnePassSettings, outputs: Outputs) -> Pipeline:
    """The pipeline of one shot."""
    flags = CameraPathFlags(**camera_path_flags(scene, outputs, settings, plan.on))
    return camera_path_pipeline(
        scene, outputs, settings, flags, lambda: make_kernel(flags), title="one-pass paths"
    )
