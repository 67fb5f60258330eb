"""The pipeline of a method that traces light paths from the camera: one kernel over the pixels of each view,
with what it needs before (reflectance from the photo) and after (data layers of first hits)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from mrbatch.contracts import Pass, Pipeline
from mrbatch.film.binding import bind_view
from mrbatch.film.first_hit import first_hit_buffers, first_hit_pass
from mrbatch.film.guides import guide_buffers, guide_pass
from mrbatch.film.outputs import FrameInput, Outputs
from mrbatch.film.photo_reflectance import photo_buffers, photo_passes
from mrbatch.film.pixel_pass import pixel_pass
from mrbatch.scene.counters import COUNTERS
from mrbatch.scene.lamp_table import is_lamp
from mrbatch.scene.lamps import lamp_strategy
from mrbatch.scene.light_paths import PathFlags, path_numbers
from mrbatch.scene.path_settings import PathSettings
from mrbatch.scene.scene_data import DeviceScene
from mrbatch.scene.shading import ShadingFlags


@dataclass(frozen=True)
class CameraPathFlags(PathFlags):
    """What a kernel of camera paths contains; each that is off leaves no code in it."""

    pixel_filter: str = "box"
    virtual_seen: bool = True
    """The camera sees virtual objects."""
    light_change: bool = True
    """Real surfaces are seen and can change."""
    holdout: bool = False
    lens: bool = False
    """The lens has a width."""


def camera_path_flags(
    scene: DeviceScene, outputs: Outputs, settings: PathSettings, on: Callable[[str], bool]
) -> dict[str, Any]:
    """The fields of `CameraPathFlags` for one shot. `on(effect)`: whether the plan simulates an effect."""
    kinds = {"diffuse"}
    if on("glossy"):
        kinds |= {o.material.kind for o in scene.scene.objects}
    view = outputs.views[0]
    light = scene.scene.environment
    return {
        "engine": scene.engine,
        "bsdf_kinds": frozenset(kinds),
        "masking": settings.masking,
        "ray_start": settings.ray_start,
        "camera_model": view.model,
        "distortion": view.distortion and on("lens-distortion"),
        "interpolation": light.interpolation,
        "sampler": settings.sampler,
        "light_sampler": scene.light_sampler(settings.light_sampler),
        "light_candidates": settings.light_candidates,
        "several_lights": settings.light_samples > 1,
        "strategy": settings.strategy if on("environment-light") else "bsdf",
        "lamps": lamp_strategy(settings.strategy, on("emission") and any(map(is_lamp, scene.scene.objects))),
        "shading": ShadingFlags(
            textures=on("textures"),
            photo=on("photo-reflectance"),
            principled="principled" in kinds,
            normal_maps=on("normal-maps"),
            emission=on("emission"),
            transmission=on("transmission"),
            cutouts=on("alpha"),
            panes=on("thin-glass"),
        ),
        "unreceptive": on("receive-switch"),
        "pixel_filter": settings.pixel_filter,
        "virtual_seen": on("virtual"),
        "light_change": on("light-change"),
        "holdout": on("holdout"),
        "lens": on("depth-of-field"),
    }


def camera_path_pipeline(
    scene: DeviceScene,
    outputs: Outputs,
    settings: PathSettings,
    flags: CameraPathFlags,
    make_kernel: Callable[[], Any],
    *,
    title: str,
) -> Pipeline:
    """The pipeline of one shot.

    The kernel takes SceneData, FrameParams, `PathNumbers` and FilmData, then what every pixel pass gives; it
    is made only where there is something to do.
    """
    numbers = path_numbers(settings.max_depth, settings.roulette_depth, settings.light_samples)
    photo = flags.shading.photo
    frame_passes: list[Pass] = []
    refine: list[Pass] = []
    finish: list[Pass] = []
    buffers: list[Any] = []
    if flags.virtual_seen or flags.light_change:
        kernel = make_kernel()
        for view in outputs.views:
            if photo:
                frame_passes.extend(photo_passes(scene, view, outputs, flags.distortion))
                buffers.extend(photo_buffers(view, len(scene.scene.objects)))
            layout = outputs.layout(view)
            refine.append(
                pixel_pass(
                    f"{title} {view.name}".strip(),
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
        if step is not None and flags.virtual_seen:
            finish.append(step)
            buffers.extend(first_hit_buffers(view, outputs))
        step = guide_pass(scene, view, outputs, flags.shading, flags.distortion, settings.pixel_filter)
        if step is not None and refine:
            finish.append(step)
            buffers.extend(guide_buffers(view, outputs))

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
