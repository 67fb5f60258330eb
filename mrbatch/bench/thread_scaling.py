"""How many times faster a pass is on more threads."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mrbatch.batch.prepare import Prepared
from mrbatch.bench.subject import Subject
from mrbatch.metrics.statistics import Interval, paired_ratio


@dataclass(frozen=True)
class ThreadScaling:
    """`speedup`: seconds on one thread over seconds on `threads`, in pairs; `same`: the pixels agree."""

    threads: int
    speedup: Interval
    one: tuple[float, ...]
    many: tuple[float, ...]
    same: bool


def thread_scaling(prepared: Prepared, frame: int, *, threads: int = 2, repeats: int = 9) -> ThreadScaling:
    """Renders `frame` on one thread and on `threads` in turn; seconds are those of the refining passes."""
    with Subject(prepared, frame, threads=1) as single, Subject(prepared, frame, threads=threads) as team:
        same = bool(np.array_equal(single.run().composite, team.run().composite))
        one, many = [], []
        for turn in range(repeats):
            order = (single, team) if turn % 2 else (team, single)
            seconds = {id(subject): subject.run().seconds for subject in order}
            one.append(seconds[id(single)])
            many.append(seconds[id(team)])
    return ThreadScaling(threads, paired_ratio(one, many, seed=1), tuple(one), tuple(many), same)
