"""From scene, plan and settings to the passes of delta path tracing."""

from __future__ import annotations

from mrbatch.contracts import Pipeline
from mrbatch.effects.plan import Plan
from mrbatch.film.outputs import Outputs
from mrbatch.film.path_pipeline import camera_path_flags, camera_path_pipeline
from mrbatch.methods.delta_path_tracing.kernels import Flags, make_kernel
from mrbatch.methods.delta_path_tracing.settings import DeltaPathTracingSettings
from mrbatch.scene.scene_data import DeviceScene


def make_flags(scene: DeviceScene, plan: Plan, settings: DeltaPathTracingSettings, outputs: Outputs) -> Flags:
    """What the kernel of this shot contains."""
    return Flags(
        **camera_path_flags(scene, outputs, settings, plan.on),
        real_on_real=plan.on("real-on-real"),
        virtual_paths=plan.on("bleeding"),
        glossy_real=plan.on("glossy") and any(o.material.kind != "diffuse" for o in scene.scene.real),
        split="D_indirect" in outputs.needs,
    )


def build(scene: DeviceScene, plan: Plan, settings: DeltaPathTracingSettings, outputs: Outputs) -> Pipeline:
    """The pipeline of one shot."""
    flags = make_flags(scene, plan, settings, outputs)
    return camera_path_pipeline(
        scene, outputs, settings, flags, lambda: make_kernel(flags).kernel, title="delta paths"
    )
