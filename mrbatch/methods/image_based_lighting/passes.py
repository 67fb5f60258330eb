"""From scene, plan and settings to the passes of image-based lighting."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mrbatch.contracts import Pass, Pipeline
from mrbatch.effects.plan import Plan
from mrbatch.film.binding import bind_view
from mrbatch.film.first_hit import first_hit_buffers, first_hit_pass
from mrbatch.film.guides import guide_buffers, guide_pass
from mrbatch.film.outputs import FrameInput, Outputs
from mrbatch.film.pixel_pass import pixel_pass
from mrbatch.methods.image_based_lighting.kernels import Flags, make_kernel
from mrbatch.methods.image_based_lighting.settings import ImageBasedLightingSettings
from mrbatch.scene.counters import COUNTERS
from mrbatch.scene.lamp_table import is_lamp
from mrbatch.scene.lamps import lamp_strategy
from mrbatch.scene.scene_data import DeviceScene
from mrbatch.scene.shading import ShadingFlags


def make_flags(
    scene: DeviceScene, plan: Plan, settings: ImageBasedLightingSettings, outputs: Outputs
) -> Flags:
    """What the kernel of this shot contains."""
    kinds = {"diffuse"}
    if plan.on("glossy"):
        kinds |= {o.material.kind for o in scene.scene.virtual}
    view = outputs.views[0]
    return Flags(
        engine=scene.engine,
        bsdf_kinds=frozenset(kinds),
        masking=settings.masking,
        ray_start=settings.ray_start,
        camera_model=view.model,
        distortion=view.distortion and plan.on("lens-distortion"),
        interpolation=scene.scene.environment.interpolation,
        sampler=settings.sampler,
        light_sampler=scene.light_sampler(settings.light_sampler),
        pixel_filter=settings.pixel_filter,
        strategy=settings.strategy,
        lamps=lamp_strategy(
            settings.strategy, plan.on("emission") and any(map(is_lamp, scene.scene.objects))
        ),
        shading=ShadingFlags(
            textures=plan.on("textures"),
            principled="principled" in kinds,
            normal_maps=plan.on("normal-maps"),
            transmission=plan.on("transmission"),
            cutouts=plan.on("alpha"),
            panes=plan.on("thin-glass"),
            emission=plan.on("emission"),
        ),
        occlusion=plan.on("occlusion"),
        lens=plan.on("depth-of-field"),
    )


def build(scene: DeviceScene, plan: Plan, settings: ImageBasedLightingSettings, outputs: Outputs) -> Pipeline:
    """The pipeline of one shot."""
    flags = make_flags(scene, plan, settings, outputs)
    refine: list[Pass] = []
    finish: list[Pass] = []
    buffers: list[Any] = []
    if plan.on("virtual"):
        kernel = make_kernel(flags)
        for view in outputs.views:
            layout = outputs.layout(view)
            refine.append(
                pixel_pass(
                    f"image-based lighting {view.name}".strip(),
                    view,
                    kernel,
                    lambda context, name=view.name: [scene.data, *context.bound[name][:2]],
                    writes=tuple(b.name for b in layout.buffers()),
                    counters=COUNTERS,
                    device=outputs.device,
                )
            )
            step = first_hit_pass(
                scene, view, outputs, flags.shading, flags.distortion, settings.pixel_filter
            )
            if step is not None:
                finish.append(step)
                buffers.extend(first_hit_buffers(view, outputs))
            step = guide_pass(scene, view, outputs, flags.shading, flags.distortion, settings.pixel_filter)
            if step is not None:
                finish.append(step)
                buffers.extend(guide_buffers(view, outputs))

    def bind(frame: FrameInput) -> Mapping[str, Any]:
        return {view.name: bind_view(scene, outputs, view, frame, photo=False) for view in outputs.views}

    return Pipeline(
        refine=tuple(refine), finish=tuple(finish), buffers=tuple(buffers), batch=settings.batch, bind=bind
    )
