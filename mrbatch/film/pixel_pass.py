"""The usual pass over the pixels of a view: one kernel, one thread a pixel, samples added to the film."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import warp as wp

from mrbatch.contracts import TILE, Counter, Pass, PassContext, Span
from mrbatch.film.outputs import ViewOutput


def pixel_pass(
    name: str,
    view: ViewOutput,
    kernel: Any,
    inputs: Callable[[PassContext], list[Any]],
    *,
    reads: tuple[str, ...] = (),
    writes: tuple[str, ...] = (),
    counters: tuple[Counter, ...] = (),
    everywhere: bool = False,
    seen: bool = False,
    each_moment: bool = False,
    device: str = "cpu",
) -> Pass:
    """A pass whose kernel takes what `inputs` gives, then the units and the first unit of the span,
    half, first sample, samples, and the counters."""

    def launch(context: PassContext, span: Span) -> None:
        wp.launch(
            kernel,
            dim=span.count * TILE * TILE,
            inputs=[
                *inputs(context),
                context.units,
                span.first,
                context.half,
                context.first_sample,
                context.samples,
                context.counters,
            ],
            device=device,
        )

    return Pass(
        name=name,
        domain=view.window.domain(view.name),
        launch=launch,
        reads=reads,
        writes=writes,
        kernels=(kernel,),
        counters=counters,
        everywhere=everywhere,
        seen=seen,
        each_moment=each_moment,
    )
