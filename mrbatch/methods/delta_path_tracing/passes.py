"""From scene, plan and settings to the passes of delta path tracing."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mrbatch.contracts import Pass, Pipeline
from mrbatch.effects.plan import Plan
from mrbatch.film.binding import bind_view
from mrbatch.film.first_hit import first_hit_buffers, first_hit_pass
from mrbatch.film.outputs import FrameInput, Outputs
from mrbatch.film.photo_reflectance import photo_buffers, photo_passes
from mrbatch.film.pixel_pass import pixel_pass
from mrbatch.methods.delta_path_tracing.kernels import Flags, Settings, make_kernel
from mrbatch.methods.delta_path_tracing.settings import DeltaPathTracingSettings
from mrbatch.scene.counters import COUNTERS
from mrbatch.scene.scene_data import DeviceScene
from mrbatch.scene.shading import ShadingFlags

UNLIMITED = 1 << 20


def make_flags(scene: DeviceScene, plan: Plan, settings: DeltaPathTracingSettings, outputs: Outputs) -> Flags:
    """What the kernel of this shot contains."""
    kinds = {"diffuse"}
    if plan.on("glossy"):
        kinds |= {o.material.kind for o in scene.scene.objects}
    view = outputs.views[0]
    return Flags(
        engine=scene.engine,
        bsdf_kinds=frozenset(kinds),
        masking=settings.masking,
        camera_model=view.model,
        distortion=view.distortion and plan.on("lens-distortion"),
        interpolation=scene.scene.environment.interpolation,
        sampler=settings.sampler,
        light_sampler=scene.scene.environment.light_sampler
        if settings.light_sampler == "auto"
        else settings.light_sampler,
        pixel_filter=settings.pixel_filter,
        strategy=settings.strategy if plan.on("environment-light") else "bsdf",
        shading=ShadingFlags(
            textures=plan.on("textures"),
            photo=plan.on("photo-reflectance"),
            principled="principled" in kinds,
        ),
        virtual_seen=plan.on("virtual"),
        light_change=plan.on("light-change"),
        real_on_real=plan.on("real-on-real"),
        virtual_paths=plan.on("bleeding"),
        unreceptive=plan.on("receive-switch"),
        holdout=plan.on("holdout"),
        split="D_indirect" in outputs.needs,
    )


def build(scene: DeviceScene, plan: Plan, settings: DeltaPathTracingSettings, outputs: Outputs) -> Pipeline:
    """The pipeline of one shot."""
    flags = make_flags(scene, plan, settings, outputs)
    numbers = Settings()
    numbers.max_edges = settings.max_depth or UNLIMITED
    numbers.light_samples = settings.light_samples
    numbers.roulette_from = UNLIMITED if settings.max_depth else settings.roulette_depth
    frame_passes: list[Pass] = []
    refine: list[Pass] = []
    finish: list[Pass] = []
    buffers: list[Any] = []
    photo = plan.on("photo-reflectance")
    working = plan.on("virtual") or plan.on("light-change")
    if working:
        kernel = make_kernel(flags).kernel
        for view in outputs.views:
            if photo:
                frame_passes.extend(photo_passes(scene, view, outputs, flags.distortion))
                buffers.extend(photo_buffers(view, len(scene.scene.objects)))
            layout = outputs.layout(view)
            refine.append(
                pixel_pass(
                    f"delta paths {view.name}".strip(),
                    view,
                    kernel,
                    lambda context, name=view.name: [
                        scene.data,
                        context.bound[name][0],
                        numbers,
                        context.bound[name][1],
                    ],
                    writes=(layout.name("sums"), layout.name("squares"), layout.name("counts")),
                    counters=COUNTERS,
                    device=outputs.device,
                )
            )
    for view in outputs.views:
        step = first_hit_pass(scene, view, outputs, flags.shading, flags.distortion, settings.pixel_filter)
        if step is not None and plan.on("virtual"):
            finish.append(step)
            buffers.extend(first_hit_buffers(view, outputs))

    def bind(frame: FrameInput) -> Mapping[str, Any]:
        return {view.name: bind_view(scene, outputs, view, frame, photo=photo) for view in outputs.views}

    return Pipeline(
        frame=tuple(frame_passes),
        refine=tuple(refine),
        finish=tuple(finish),
        buffers=tuple(buffers),
        batch=settings.batch,
        bind=bind,
    )
