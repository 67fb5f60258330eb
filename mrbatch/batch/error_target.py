"""Samples until the noise of a frame is as low as asked: which tiles go on, decided half by half.

The error is the relMSE of the region of interest, as `mrbatch.metrics.errors` has it. Of its two estimates
neither alone will do: a quarter of the squared difference of the halves has no bias, but says little of a
single tile and couples both halves; the scatter of one half's samples tells tiles apart, but overstates the
noise of well-spread points. So tiles are weighed by the scatter of the *other* half, times the ratio of the
two estimates over the whole region.

A tile goes on while it has more than its share of the error: the level t with sum of min(error, t) = target,
so that what quiet tiles leave over goes to noisy ones.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from mrbatch.batch.time_limit import Referee
from mrbatch.film.accumulator import Developed
from mrbatch.film.steering import Counts
from mrbatch.film.window import Window
from mrbatch.metrics.noise import Noise, Z, noise_between
from mrbatch.metrics.region import changed_region
from mrbatch.metrics.tiles import tile_sums

Outcome = Literal["reached", "limit", "converged-floor"]
SURE = 1.28 * math.sqrt(2.0)
"""Standard errors of the estimate by which it has to be below the target: the error that a frame happens to
have differs from the expected one as the estimate does, and 90 % of frames shall be below."""
MOST_GROWTH = 2.0
"""A round at most doubles a tile's samples: what noisy estimates ask for is looked at again."""
RATIOS = (0.02, 2.0)
"""Sane ratios of the halves' difference to their scatter."""
FLAT = 0.9
"""Four times the samples that leave this share of the error or more: something else than noise is left."""


@dataclass(frozen=True)
class Judged:
    """What a view looks like so far.

    The composites `picture` and those of the two `halves`, and the `background` (h, w, 3); `scatter`
    (2, h, w, 3): variance of each half's composite from its own samples; `changed` (h, w) bool.
    """

    picture: np.ndarray
    halves: tuple[np.ndarray, np.ndarray]
    background: np.ndarray
    scatter: np.ndarray
    changed: np.ndarray


@dataclass(frozen=True)
class Step:
    """After a round: mean samples a pixel of the tiles that are done, and the estimated error."""

    spp: float
    relmse: float
    standard_error: float


class ErrorTarget:
    """Steers a frame to relMSE `target` on its region of interest; `limit`: most samples a pixel and half.

    `judge` gives the view's `Judged` from its estimates by source. Of several views each has to be good
    enough; `referee` may end it before. `steps`: what was found on the way; `noise` by view: the last of it;
    `outcome` is there when it asked for nothing more.
    """

    looks = True

    def __init__(
        self,
        target: float,
        windows: Mapping[str, Window],
        judge: Callable[[str, Mapping[str, Developed]], Judged],
        *,
        batch: int,
        limit: int,
        unit: int = 1,
        referee: Referee | None = None,
    ) -> None:
        self.target = target
        self.unit = unit
        self.steps: list[Step] = []
        self.noise = {name: Noise(0.0, 0.0, 0.0, 0, 0) for name in windows}
        self.outcome: Outcome | None = None
        self._windows = windows
        self._judge = judge
        # A single sample has no scatter.
        self._batch = -(-max(2, batch) // unit) * unit
        self._limit = max(self._batch, limit // unit * unit)
        self._share = 0.0
        self._referee = referee

    @property
    def share(self) -> float:
        return self._share

    @property
    def spp(self) -> int:
        """Samples a pixel, mean of the tiles that are done."""
        return round(self.steps[-1].spp)

    def more(
        self,
        estimates: Mapping[str, Mapping[str, Developed]] | None,
        tiles: Mapping[str, np.ndarray],
        done: Counts,
    ) -> Counts:
        if estimates is None:
            if not any(len(ids) for ids in tiles.values()):
                self.steps.append(Step(0.0, 0.0, 0.0))
                self.outcome = "reached"
            return {name: np.full((2, len(ids)), self._batch, dtype=np.int64) for name, ids in tiles.items()}
        found = {name: self._view(name, estimates[name], tiles[name], done[name]) for name in tiles}
        worst = max((view.step for view in found.values()), key=lambda step: step.relmse)
        self.steps.append(worst)
        more = {name: view.more for name, view in found.items()}
        if all(view.good for view in found.values()):
            self.outcome = "reached"
        elif self._flat():
            self.outcome = "converged-floor"
        elif not any(counts.any() for counts in more.values()):
            self.outcome = "limit"
        spent, asked = (sum(int(c.sum()) for c in counts.values()) for counts in (done, more))
        if self.outcome is None and self._referee is not None:
            if self._referee.over(len(self.steps), spent, asked):
                self.outcome = "limit"
        if self.outcome is not None:
            return {name: np.zeros_like(counts) for name, counts in more.items()}
        foreseen = sum(view.foreseen for view in found.values())
        self._share = min(0.99, max(self._share, spent / max(foreseen, spent + asked)))
        return more

    def as_dict(self) -> dict[str, Any]:
        """JSON-ready: what was asked, what came of it, and the way there."""
        return {
            "target": self.target,
            "outcome": self.outcome,
            "rounds": len(self.steps),
            "samples": self.spp,
            "steps": [[s.spp, s.relmse, s.standard_error] for s in self.steps],
        }

    def _flat(self) -> bool:
        now = self.steps[-1]
        before = [s for s in self.steps if s.spp <= now.spp / 4]
        if not before or now.relmse == 0.0:
            return False
        known = all(step.standard_error < step.relmse / 8 for step in (before[-1], now))
        return known and now.relmse > FLAT * before[-1].relmse

    def _view(
        self, name: str, sources: Mapping[str, Developed], tiles: np.ndarray, done: np.ndarray
    ) -> _View:
        judged = self._judge(name, sources)
        window = self._windows[name]
        region = changed_region(judged.picture, judged.background, judged.scatter.mean(axis=0) / 2)
        spp = float(done.sum(axis=0).mean()) if done.size else 0.0
        nothing = np.zeros_like(done)
        if not (region & judged.changed).any():
            self.noise[name] = Noise(0.0, 0.0, 0.0, 0, 0)
            return _View(Step(spp, 0.0, 0.0), nothing, True)
        # The darker half is the nearer one to the truth where a rare bright sample met the other: weighed by
        # their mean such a pixel would hide its own error. As in the error itself, m is of the whole picture.
        darker = np.minimum(*judged.halves)
        weight = 1.0 / (darker**2 + 1e-2 * np.abs(judged.picture).mean() ** 2 + 1e-30)
        between = (weight * noise_between(*judged.halves)).mean(axis=-1) * region
        own = (weight * judged.scatter).mean(axis=-1) * region / 4
        relmse = float(between.sum() / region.sum())
        ratio = float(np.clip(between.sum() / max(own.sum(), 1e-300), *RATIOS))
        # By chance alone: tiles differ in their noise, and that is no doubt about its sum.
        error = float(np.sqrt(((between - ratio * own.sum(axis=0)) ** 2).sum()) / region.sum())
        step = Step(spp, relmse, error)
        self.noise[name] = Noise(
            relmse,
            max(0.0, relmse - Z * error),
            relmse + Z * error,
            int(region.sum()),
            int(np.count_nonzero(_by_tile(region, window))),
        )
        if relmse + SURE * error <= self.target:
            return _View(step, nothing, True)
        pixels = _by_tile(region, window)[tiles]
        by_half = np.stack([_by_tile(own[half], window)[tiles] for half in (0, 1)])
        allowed = self.target * region.sum() / (1.0 + SURE * error / max(relmse, 1e-300))
        # What a half will have of the error is told by the other one's samples.
        factors = np.stack(
            [
                _over(ratio * by_half[1 - half] * done[1 - half] / done[half], pixels, allowed / 2)
                for half in (0, 1)
            ]
        )
        wanted = done * np.clip(factors, 1.0, MOST_GROWTH)
        rounds = np.ceil((wanted - done) / self._batch - 1e-9).astype(np.int64)
        more = np.clip(rounds * self._batch, 0, np.maximum(self._limit - done, 0))
        if not more.any():
            # By the tiles' own scatter all is well, by the difference of the halves it is not yet.
            busy = by_half[::-1] > np.median(by_half[::-1][:, pixels > 0], axis=1, keepdims=True)
            steps = np.maximum(done // (2 * self._batch), 1)
            more = np.where(busy, np.minimum(steps * self._batch, self._limit - done), 0)
        return _View(step, more, False, float((done * np.maximum(factors, 1.0)).sum()))


@dataclass(frozen=True)
class _View:
    step: Step
    more: np.ndarray
    good: bool
    foreseen: float = 0.0
    """Samples of all tiles, those that are done included, that the target seems to take."""


def _over(error: np.ndarray, pixels: np.ndarray, allowed: float) -> np.ndarray:
    """(tiles): by how many times each tile is over the level; 0 where nothing has to be done."""
    level = water_level(error, pixels, allowed)
    if not math.isfinite(level):
        return np.zeros(len(error))
    return np.divide(error, pixels * level, out=np.zeros(len(error)), where=pixels > 0)


def water_level(error: np.ndarray, pixels: np.ndarray, allowed: float) -> float:
    """The level t with sum(min(error, t pixels)) = allowed; infinity where the whole sum is not more.

    `error` (tiles): sums over each tile's `pixels` (tiles).
    """
    there = pixels > 0
    each = error[there] / pixels[there]
    order = np.argsort(each, kind="stable")
    e, n = error[there][order], pixels[there][order].astype(np.float64)
    if e.sum() <= allowed:
        return math.inf
    below = np.concatenate([[0.0], np.cumsum(e)[:-1]])
    above = np.cumsum(n[::-1])[::-1]
    levels = (allowed - below) / above
    # The first tile that the level does not reach: it and all after it are cut.
    return float(levels[np.flatnonzero(levels <= e / n)[0]])


def _by_tile(values: np.ndarray, window: Window) -> np.ndarray:
    """Sums by decision tile, indexed by its id in the window."""
    return tile_sums(values, (window.x, window.y)).ravel()
