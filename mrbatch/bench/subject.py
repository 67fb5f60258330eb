"""One frame of a job, ready to be rendered again and again while the clock runs."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mrbatch.batch.framing import framed
from mrbatch.batch.prepare import Prepared
from mrbatch.batch.render import ShotRenderer
from mrbatch.device.timing import TimingNode


@dataclass(frozen=True)
class Run:
    """What one rendering of the frame took: seconds of its refining passes alone, over all threads, and
    of the whole frame (reading and developing included). `composite` (h, w, 3) and, where the job has the
    layer `virtual`, `coverage` (h, w), are those of the first view."""

    seconds: float
    thread_seconds: float
    frame_seconds: float
    counters: dict[str, int]
    composite: np.ndarray
    coverage: np.ndarray


class Subject:
    """Frame `frame` of a prepared job, compiled and warm, on its own renderer.

    `engine` replaces the shot's. Use as a context manager.
    """

    def __init__(self, prepared: Prepared, frame: int, *, threads: int, engine: str | None = None) -> None:
        if engine is not None:
            prepared = replace(prepared, shot=replace(prepared.shot, engine=engine))
        self.frame = frame
        self.renderer = ShotRenderer(prepared, TimingNode("bench"), threads=threads)

    def __enter__(self) -> Subject:
        return self

    def __exit__(self, *_: object) -> None:
        self.renderer.close()

    @property
    def scene_data(self) -> Any:
        return self.renderer.scene.data

    def run(self, seed: int | None = None) -> Run:
        """Renders the frame, by the job's seed or another."""
        before = self._refining()
        frame = self.renderer.render(self.frame, None, seed=seed)
        after = self._refining()
        name, composite = next(iter(frame.composites.items()))
        coverage = frame.image.views[name].channels.get("virtual.A", np.zeros(composite.shape[:2]))
        return Run(
            seconds=after[0] - before[0],
            thread_seconds=after[1] - before[1],
            frame_seconds=frame.seconds,
            counters=dict(frame.counters),
            composite=composite,
            coverage=coverage,
        )

    def photo(self) -> np.ndarray:
        """(h, w, 3): the captured picture of the first view, as the composite holds it."""
        prepared = self.renderer.prepared
        view = self.renderer.outputs.views[0]
        given = prepared.capture.frame(self.frame, prepared.shot.table).views[view.name].background
        size = prepared.display[view.name]
        return framed(framed(given, size, view.whole), size, prepared.windows[view.name])

    def _refining(self) -> tuple[float, float]:
        """Seconds and thread seconds of the refining passes so far."""
        names = {p.name for source in self.renderer.renderer.sources for p in source.pipeline.refine}
        spent = self.renderer.timing.child("frames").children
        nodes = [node for name, node in spent.items() if name in names]
        return sum(n.seconds for n in nodes), sum(n.thread_seconds for n in nodes)
