"""From settings to the passes of the toy."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import warp as wp

from mrbatch.contracts import Counter, Pipeline
from mrbatch.effects.plan import Plan
from mrbatch.film.outputs import FrameInput, Outputs
from mrbatch.film.pixel_pass import pixel_pass
from toy_method.kernels import make_kernel
from toy_method.settings import ToyShadeSettings

SHADES = (Counter("shades", "samples", "random shares that were drawn"),)


def build(scene: Any, plan: Plan, settings: ToyShadeSettings, outputs: Outputs) -> Pipeline:
    """The pipeline of one shot; empty where no light is taken away."""
    if not plan.on("toy-shade"):
        return Pipeline()
    kernel = make_kernel()
    refine = tuple(
        pixel_pass(
            f"shade {view.name}".strip(),
            view,
            kernel,
            lambda context, view=view: [*context.bound[view.name], settings.darkness],
            counters=SHADES,
            everywhere=True,
        )
        for view in outputs.views
    )

    def bind(frame: FrameInput) -> Mapping[str, Any]:
        return {
            view.name: (
                outputs.layout(view).data(frame.buffers, frame.views[view.name].background),
                wp.uint32(outputs.seed),
                frame.number,
                view.index,
            )
            for view in outputs.views
        }

    return Pipeline(refine=refine, batch=settings.batch, bind=bind)
