"""One frame of a job in several settings, timed in turns and held against one converged reference."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mrbatch.batch.prepare import Opened, Prepared, look_at, open_capture, prepare
from mrbatch.bench.subject import Subject
from mrbatch.device.timing import TimingNode
from mrbatch.job import load_job
from mrbatch.metrics.region import region_of_interest

_LAYERS = "output.layers=[virtual]"
"""All that is looked at beside the composite: which methods of a job give other layers differs."""
SEED_OF_REFERENCE = 1_000_003
"""Added to the job's seed: a reference has none of the numbers of what is held against it."""


class _Solved:
    """A capture whose shot has been seen already."""

    def __init__(self, capture: Any, table: Mapping[str, Any]) -> None:
        self._capture, self._table = capture, table

    def __getattr__(self, name: str) -> Any:
        return getattr(self._capture, name)

    def prepare(self, progress: Any) -> Mapping[str, Any]:
        return self._table


def solved(opened: Opened, prepared: Prepared) -> Opened:
    """An opened job whose capture needs not be solved again: as `prepared` from it holds it."""
    return replace(opened, capture=_Solved(opened.capture, prepared.shot.table))


class Variants:
    """Frame `frame` (None: the first) of the job at `path` with `settings`, and with others on top.

    The capture is opened and solved once. Raises MrbatchError where the job cannot be used.
    """

    def __init__(
        self,
        path: Path,
        settings: Sequence[str] = (),
        *,
        frame: int | None = None,
        confine: Path | None = None,
    ) -> None:
        self.path = path
        self.confine = confine
        self.settings = (*settings, _LAYERS)
        self._timing = TimingNode("bench")
        job = load_job(path, list(self.settings), confine=confine)
        opened = look_at(job, open_capture(job, self._timing)[0], self._timing)
        first = prepare(job, self._timing, opened=opened)
        self.job = job
        self.frame = first.shot.frames[0] if frame is None else frame
        self._opened = solved(opened, first)

    @property
    def spp(self) -> int:
        """Samples a pixel, both halves together."""
        return int(getattr(self.job.method, "spp", 2))

    def prepared(self, *settings: str) -> Prepared:
        """The job with these settings on top of its own, its plan made."""
        job = load_job(self.path, [*self.settings, *settings], confine=self.confine)
        return prepare(job, self._timing, opened=self._opened)

    def subject(self, *settings: str, threads: int = 1) -> Subject:
        """The frame with these settings on top of the job's."""
        return Subject(self.prepared(*settings), self.frame, threads=threads)


@dataclass(frozen=True)
class Reference:
    """A converged picture (h, w, 3), scene-linear, photo units, and what to judge others by.

    `changed` (h, w) bool: the region of interest, where virtual objects change the photo. `covered` (h, w):
    coverage by virtual objects. `error`: its own RMSE on the region, from two halves with seeds of their
    own; `noise`: half of their difference.
    """

    picture: np.ndarray
    changed: np.ndarray
    covered: np.ndarray
    spp: int
    error: float
    noise: np.ndarray

    def rmse(self, picture: np.ndarray, part: np.ndarray | None = None) -> float:
        """Root mean square of picture - reference over the region, or over the part of it in `part`."""
        where = self.changed if part is None else self.changed & part
        if not where.any():
            return float("nan")
        return float(np.sqrt(np.mean((picture.astype(np.float64) - self.picture)[where] ** 2)))


def converged(variants: Variants, spp: int, *settings: str, threads: int = 1) -> Reference:
    """The reference: two pictures of `spp` / 2 samples each, rounded to even numbers."""
    half = max(2, spp // 4 * 2)
    first_seed = variants.job.seed + SEED_OF_REFERENCE
    with variants.subject(*settings, f"method.spp={half}", threads=threads) as subject:
        runs = [subject.run(seed % (1 << 32)) for seed in (first_seed, first_seed + 1)]
        photo = subject.photo()
    one, two = (run.composite.astype(np.float64) for run in runs)
    picture = (one + two) / 2
    changed = region_of_interest(picture, photo.astype(np.float64), deviation=np.abs(one - two) / 2)
    noise = (one - two) / 2
    error = float(np.sqrt(np.mean(noise[changed] ** 2))) if changed.any() else 0.0
    return Reference(picture, changed, (runs[0].coverage + runs[1].coverage) / 2, 2 * half, error, noise)


def turn(names: Sequence[str], order: np.random.Generator) -> list[str]:
    """The names in an order drawn at random: which of two meets the slower moment is then a fair coin."""
    return [names[i] for i in order.permutation(len(names))]


def seconds_in_turns(
    subjects: Mapping[str, Subject], repeats: int, *, seed: int = 1
) -> dict[str, list[float]]:
    """Seconds of the refining passes of each, `repeats` times, one after the other and in random order,
    so that a slow moment hits all."""
    names, order = list(subjects), np.random.default_rng(seed)
    spent: dict[str, list[float]] = {name: [] for name in names}
    for _ in range(repeats):
        for name in turn(names, order):
            spent[name].append(subjects[name].run().seconds)
    return spent
