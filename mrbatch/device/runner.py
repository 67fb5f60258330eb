"""Runs pipelines: compiles first, then launches passes over spans of units on a pool of threads.

A launch of Warp on the CPU is one thread and releases the interpreter lock, so tiles on a thread
pool scale. Nothing that a pass computes depends on how its units were grouped into launches.
"""

from __future__ import annotations

import os
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from mrbatch.contracts import Buffer, Pass, Pipeline, Span
from mrbatch.device.startup import cache_error, start
from mrbatch.device.timing import ThreadClock, TimingNode

LAUNCHES_PER_THREAD = 8
"""Enough pieces that an uneven picture still keeps all threads busy to the end."""
MAX_UNITS_PER_LAUNCH = 64


@dataclass(frozen=True)
class RunContext:
    """What a running pass sees (contracts.PassContext)."""

    bound: Any
    buffers: Mapping[str, Any]
    units: Any
    counters: Any
    half: int
    first_sample: int
    samples: int


def usable_cores() -> int:
    """Cores that this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:
        return os.cpu_count() or 1


class Runner:
    """Threads, compiled kernels and the size of launches.

    `units_per_launch`: how many units (for pictures: tiles of 16x16 pixels) one launch takes; by
    default chosen from the number of units and threads.
    """

    def __init__(
        self, threads: int | None = None, *, units_per_launch: int | None = None, device: str = "cpu"
    ) -> None:
        start()
        self.threads = max(1, threads or usable_cores())
        self.units_per_launch = units_per_launch
        self.device = device
        self._pool = ThreadPoolExecutor(self.threads, thread_name_prefix="tiles")

    def close(self) -> None:
        self._pool.shutdown(wait=True, cancel_futures=True)

    def __enter__(self) -> Runner:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def compile(self, pipelines: Sequence[Pipeline], timing: TimingNode) -> int:
        """Loads every kernel of the pipelines before any thread launches one.

        Two threads that launch the same unloaded kernel would both compile it. Gives the number of
        modules. Raises ResourceError where compiled kernels cannot be written.
        """
        modules = {}
        for pipeline in pipelines:
            for step in pipeline.passes():
                for kernel in step.kernels:
                    modules[id(kernel.module)] = kernel.module
        with timing.measure("compile"):
            for module in modules.values():
                # A launch on the CPU asks for blocks of one thread, and the size is part of the cache key.
                block = 1 if self.device == "cpu" else None
                try:
                    wp.load_module(module, self.device, block_dim=block)
                except OSError as error:
                    raise cache_error(error) from error
        return len(modules)

    def allocate(self, buffers: Sequence[Buffer]) -> dict[str, Any]:
        """Zeroed arrays of some buffers, by name."""
        return {
            buffer.name: wp.zeros(
                buffer.shape, dtype=wp.dtype_from_numpy(np.dtype(buffer.dtype)), device=self.device
            )
            for buffer in buffers
        }

    def run(
        self,
        step: Pass,
        bound: Any,
        buffers: Mapping[str, Any],
        timing: TimingNode,
        *,
        units: np.ndarray | None = None,
        half: int = 0,
        first_sample: int = 0,
        samples: int = 0,
    ) -> None:
        """Runs one pass over `units` (ids; all of its domain where None) and waits for its end."""
        start = time.perf_counter()
        ids = np.arange(step.domain.units, dtype=np.int32) if units is None else units.astype(np.int32)
        node = timing.child(step.name)
        node.calls += 1
        total = len(ids)
        if total == 0:
            for counter in step.counters:
                node.count(counter.name, 0)
            return
        unit_ids: Any = wp.array(ids, dtype=wp.int32, device=self.device)
        size = self.units_per_launch or max(
            1, min(MAX_UNITS_PER_LAUNCH, -(-total // (LAUNCHES_PER_THREAD * self.threads)))
        )
        spans = [Span(first, min(size, total - first)) for first in range(0, total, size)]
        clock = ThreadClock()

        def launch(span: Span) -> np.ndarray:
            began = time.perf_counter()
            counters = wp.zeros(max(1, len(step.counters)), dtype=wp.int64, device=self.device)
            context = RunContext(bound, buffers, unit_ids, counters, half, first_sample, samples)
            step.launch(context, span)
            counts = counters.numpy()
            clock.add(time.perf_counter() - began)
            return counts

        counts = (
            [launch(span) for span in spans] if self.threads == 1 else list(self._pool.map(launch, spans))
        )
        for k, counter in enumerate(step.counters):
            node.count(counter.name, sum(int(count[k]) for count in counts))
        node.launches += len(spans)
        node.seconds += time.perf_counter() - start
        node.thread_seconds += clock.seconds
