"""A toy participant: cells of fog, filled once a frame from a table made once a shot, seen by every pixel."""

from __future__ import annotations

import functools
from typing import Any

import warp as wp
from pydantic import Field

from mrbatch.contracts import (
    Buffer,
    Counter,
    Domain,
    Participant,
    Pass,
    PassContext,
    Pipeline,
    Rule,
    Span,
    Verdict,
)
from mrbatch.film.accumulator import FilmData, film_add, film_load, film_pixel, film_store
from mrbatch.film.outputs import FrameInput, Outputs
from mrbatch.film.pixel_pass import pixel_pass
from mrbatch.kernels.rng import make_sampler, pixel_key
from mrbatch.quantities import Reflectance, Settings

CELLS, CELLS_A_UNIT = 1000, 48
FILLED = (Counter("cells", "cells", "cells that were filled"),)


class ToyFogSettings(Settings):
    """Fog."""

    density: Reflectance = Field(0.3, description="How thick, 0..1")


@functools.cache
def _kernels() -> tuple[Any, Any, Any]:
    sample_2d = make_sampler("independent").sample_2d

    @wp.kernel(enable_backward=False, module="unique")
    def tabulate(
        table: wp.array(dtype=wp.float32),
        seed: wp.uint32,
        units: wp.array(dtype=wp.int32),
        first_unit: int,
        counters: wp.array(dtype=wp.int64),
    ):
        cell = units[first_unit + wp.tid() / CELLS_A_UNIT] * CELLS_A_UNIT + wp.tid() % CELLS_A_UNIT
        if cell < CELLS:
            table[cell] = sample_2d(pixel_key(seed, 0, 0, 0, cell, 1), 0, wp.int32(0))[0]
            wp.atomic_add(counters, 0, wp.int64(1))

    @wp.kernel(enable_backward=False, module="unique")
    def fill(
        table: wp.array(dtype=wp.float32),
        cells: wp.array(dtype=wp.float32),
        seed: wp.uint32,
        frame: int,
        density: float,
        units: wp.array(dtype=wp.int32),
        first_unit: int,
        counters: wp.array(dtype=wp.int64),
    ):
        cell = units[first_unit + wp.tid() / CELLS_A_UNIT] * CELLS_A_UNIT + wp.tid() % CELLS_A_UNIT
        if cell < CELLS:
            u = sample_2d(pixel_key(seed, frame, 0, 0, cell, 0), 0, wp.int32(1))
            cells[cell] = density * u[0] * (table[cell] + table[(cell + 1) % CELLS])
            wp.atomic_add(counters, 0, wp.int64(1))

    @wp.kernel(enable_backward=False, module="unique")
    def see(
        film: FilmData,
        cells: wp.array(dtype=wp.float32),
        seed: wp.uint32,
        frame: int,
        view: int,
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
        key = pixel_key(seed, frame, view, half, pixel.x, pixel.y)
        total = film_load(film, half, pixel.index)
        for n in range(samples):
            u = sample_2d(key, first_sample + n, wp.int32(0))
            cell = (pixel.x * 7 + pixel.y * 31 + wp.int32(u[0] * 5.0)) % CELLS
            covered = float(0.0)
            if u[1] < cells[cell]:
                covered = 1.0
            light = wp.vec3(0.8, 0.9, 1.0) * covered
            total = film_add(total, light, covered, wp.vec3(), film.background[pixel.index])
        film_store(film, half, pixel.index, total, samples)

    return tabulate, fill, see


def build(scene: Any, plan: Any, settings: ToyFogSettings, outputs: Outputs) -> Pipeline:
    if not plan.on("toy-fog"):
        return Pipeline()
    tabulate, fill, see = _kernels()
    names = table, cells = f"{outputs.source}/table", f"{outputs.source}/cells"
    seed = wp.uint32(outputs.seed)
    domain = Domain("voxels", -(-CELLS // CELLS_A_UNIT), CELLS_A_UNIT, CELLS)

    def launch(kernel: Any, inputs: Any) -> Any:
        def run(context: PassContext, span: Span) -> None:
            given = [*inputs(context), context.units, span.first, context.counters]
            wp.launch(kernel, dim=span.count * CELLS_A_UNIT, inputs=given, device="cpu")

        return run

    def bind(frame: FrameInput) -> Any:
        films = {
            view.name: outputs.layout(view).data(frame.buffers, frame.views[view.name].background)
            for view in outputs.views
        }
        return frame.number, films

    shot = Pass(
        "fog table",
        domain,
        launch(tabulate, lambda context: [context.buffers[table], seed]),
        writes=(table,),
        kernels=(tabulate,),
        counters=FILLED,
    )
    frame = Pass(
        "fog cells",
        domain,
        launch(
            fill,
            lambda c: [c.buffers[table], c.buffers[cells], seed, c.bound[0], settings.density],
        ),
        reads=(table,),
        writes=(cells,),
        kernels=(fill,),
        counters=FILLED,
    )
    refine = tuple(
        pixel_pass(
            f"fog {view.name}".strip(),
            view,
            see,
            lambda c, view=view: [c.bound[1][view.name], c.buffers[cells], seed, c.bound[0], view.index],
            reads=(cells,),
        )
        for view in outputs.views
    )
    buffers = (
        Buffer(table, (CELLS,), "float32", "shot"),
        Buffer(cells, (CELLS,), "float32", "frame"),
    )
    assert names == tuple(b.name for b in buffers)
    return Pipeline(shot=(shot,), frame=(frame,), refine=refine, buffers=buffers, batch=2, bind=bind)


def _fog(facts: Any) -> Verdict:
    if facts.settings.density == 0.0:
        return Verdict("absent", "no fog", bound=0.0)
    return Verdict("needed", "there is fog", {"density": facts.settings.density})


PARTICIPANT = Participant(
    name="toy-fog",
    meaning="fog in cells",
    settings=ToyFogSettings,
    build=build,
    rules=(Rule("toy-fog", "fog", _fog),),
)
