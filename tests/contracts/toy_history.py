"""A toy with history: the photo becomes a running mean over frames and neighbouring pixels, plus noise."""

from __future__ import annotations

import functools
from typing import Annotated, Any

import warp as wp
from pydantic import Field

from mrbatch.contracts import Buffer, Method, Pipeline
from mrbatch.film.accumulator import FilmData, film_add, film_load, film_pixel, film_store
from mrbatch.film.outputs import FrameInput, Outputs
from mrbatch.film.pixel_pass import pixel_pass
from mrbatch.kernels.rng import make_sampler, pixel_key
from mrbatch.quantities import Settings


class ToyHistorySettings(Settings):
    """A running mean."""

    spp: Annotated[int, Field(ge=2)] = Field(2, description="Samples a pixel")
    segment: Annotated[int, Field(ge=1)] | None = Field(None, description="Longest run of frames")
    warm_up: Annotated[int, Field(ge=0)] = Field(0, description="Frames that warm up after a cut for length")


@functools.cache
def _kernels() -> tuple[Any, Any, Any]:
    sample_2d = make_sampler("independent").sample_2d

    @wp.kernel(enable_backward=False, module="unique")
    def gather(
        film: FilmData,
        mean: wp.array(dtype=wp.float32),
        result: wp.array(dtype=wp.float32),
        units: wp.array(dtype=wp.int32),
        first_unit: int,
        half: int,
        first_sample: int,
        samples: int,
        counters: wp.array(dtype=wp.int64),
    ):
        thread = wp.tid()
        pixel = film_pixel(film, units[first_unit + (thread >> 8)], thread & 255)
        if pixel.index < 0:
            return
        i = pixel.x - film.x
        j = pixel.y - film.y
        for c in range(3):
            total = float(0.0)
            for dy in range(-1, 2):
                for dx in range(-1, 2):
                    x = wp.clamp(i + dx, 0, film.width - 1)
                    y = wp.clamp(j + dy, 0, film.height - 1)
                    total += mean[(y * film.width + x) * 3 + c]
            result[pixel.index * 3 + c] = 0.7 * total / 9.0 + 0.3 * film.background[pixel.index][c]

    @wp.kernel(enable_backward=False, module="unique")
    def keep(
        film: FilmData,
        mean: wp.array(dtype=wp.float32),
        result: wp.array(dtype=wp.float32),
        units: wp.array(dtype=wp.int32),
        first_unit: int,
        half: int,
        first_sample: int,
        samples: int,
        counters: wp.array(dtype=wp.int64),
    ):
        thread = wp.tid()
        pixel = film_pixel(film, units[first_unit + (thread >> 8)], thread & 255)
        if pixel.index >= 0:
            for c in range(3):
                mean[pixel.index * 3 + c] = result[pixel.index * 3 + c]

    @wp.kernel(enable_backward=False, module="unique")
    def show(
        film: FilmData,
        mean: wp.array(dtype=wp.float32),
        seed: wp.uint32,
        frame: int,
        units: wp.array(dtype=wp.int32),
        first_unit: int,
        half: int,
        first_sample: int,
        samples: int,
        counters: wp.array(dtype=wp.int64),
    ):
        thread = wp.tid()
        pixel = film_pixel(film, units[first_unit + (thread >> 8)], thread & 255)
        if pixel.index < 0:
            return
        key = pixel_key(seed, frame, 0, half, pixel.x, pixel.y)
        total = film_load(film, half, pixel.index)
        k = pixel.index * 3
        delta = wp.vec3(mean[k], mean[k + 1], mean[k + 2]) - film.background[pixel.index]
        for n in range(samples):
            u = sample_2d(key, first_sample + n, wp.int32(0))
            total = film_add(total, wp.vec3(), 0.0, delta * (0.9 + 0.2 * u[0]), film.background[pixel.index])
        film_store(film, half, pixel.index, total, samples)

    return gather, keep, show


def build(scene: Any, plan: Any, settings: ToyHistorySettings, outputs: Outputs) -> Pipeline:
    gather, keep, show = _kernels()
    (view,) = outputs.views
    n = view.window.pixels * 3
    buffers = (Buffer("mean", (n,), "float32", "history"), Buffer("next", (n,), "float32", "frame"))

    def arrays(context: Any) -> list[Any]:
        return [context.bound[0], context.buffers["mean"], context.buffers["next"]]

    def bind(frame: FrameInput) -> Any:
        film = outputs.layout(view).data(frame.buffers, frame.views[view.name].background)
        return film, wp.uint32(outputs.seed), frame.number

    frame = (
        pixel_pass("gather", view, gather, arrays, reads=("mean",), writes=("next",), everywhere=True),
        pixel_pass("keep", view, keep, arrays, reads=("next",), writes=("mean",), everywhere=True),
    )
    refine = (
        pixel_pass(
            "show",
            view,
            show,
            lambda context: [context.bound[0], context.buffers["mean"], *context.bound[1:]],
            reads=("mean",),
            everywhere=True,
        ),
    )
    return Pipeline(frame=frame, refine=refine, buffers=buffers, batch=1, bind=bind)


METHOD = Method(
    name="toy-history",
    meaning="a running mean",
    capture_kinds=("toy-capture",),
    settings=ToyHistorySettings,
    build=build,
    layers=("composite", "background", "delta"),
    history=True,
    segment=lambda settings: (settings.segment, settings.warm_up),
)
