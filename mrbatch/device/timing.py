"""The timing tree: what ran, how long, how often, and which work it did. It is the pipeline, timed."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any


@dataclass
class TimingNode:
    """A named span of work.

    `seconds`: wall time spent inside, summed over calls; `thread_seconds`: summed over threads;
    `counters`: exact counts by name.
    """

    name: str
    seconds: float = 0.0
    thread_seconds: float = 0.0
    calls: int = 0
    launches: int = 0
    counters: dict[str, int] = field(default_factory=dict)
    children: dict[str, TimingNode] = field(default_factory=dict)

    def child(self, name: str) -> TimingNode:
        return self.children.setdefault(name, TimingNode(name))

    @contextmanager
    def measure(self, name: str) -> Iterator[TimingNode]:
        """Times a block as a child."""
        node = self.child(name)
        start = time.perf_counter()
        try:
            yield node
        finally:
            node.seconds += time.perf_counter() - start
            node.calls += 1

    def count(self, name: str, amount: int) -> None:
        self.counters[name] = self.counters.get(name, 0) + int(amount)

    def merge(self, other: TimingNode) -> None:
        """Adds another tree of the same root."""
        self.seconds += other.seconds
        self.thread_seconds += other.thread_seconds
        self.calls += other.calls
        self.launches += other.launches
        for name, amount in other.counters.items():
            self.count(name, amount)
        for name, node in other.children.items():
            self.child(name).merge(node)

    def total_counters(self) -> dict[str, int]:
        """Counts of the whole tree, by name."""
        total = dict(self.counters)
        for node in self.children.values():
            for name, amount in node.total_counters().items():
                total[name] = total.get(name, 0) + amount
        return dict(sorted(total.items()))

    def as_dict(self) -> dict:
        """JSON-ready."""
        return {
            "name": self.name,
            "seconds": self.seconds,
            "thread_seconds": self.thread_seconds,
            "calls": self.calls,
            "launches": self.launches,
            "counters": dict(sorted(self.counters.items())),
            "children": [node.as_dict() for node in self.children.values()],
        }


def timing_from_dict(data: Mapping[str, Any]) -> TimingNode:
    """The tree that `as_dict` described. Raises KeyError, TypeError or ValueError for anything else."""
    node = TimingNode(
        str(data["name"]),
        float(data["seconds"]),
        float(data["thread_seconds"]),
        int(data["calls"]),
        int(data["launches"]),
        {str(name): int(count) for name, count in dict(data["counters"]).items()},
    )
    for child in data["children"]:
        made = timing_from_dict(child)
        node.children[made.name] = made
    return node


class ThreadClock:
    """Adds up seconds from several threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self.seconds = 0.0

    def add(self, seconds: float) -> None:
        with self._lock:
            self.seconds += seconds
