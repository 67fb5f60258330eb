"""Samples for as long as there is time: the whole command's limit shared out among its frames.

All frames are thinned rather than some left out. What a clock decides cannot be repeated by itself, so how
far a frame came is recorded with it, and `Recorded` decides the same once more.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from mrbatch.film.accumulator import Developed
from mrbatch.film.steering import Counts

SECONDS_PER_MEGAPIXEL = 2.0
"""Guess of what a frame takes beside its samples, until one has been seen."""
CLOSING_SECONDS, CLOSING_PER_MEGAPIXEL = 1.5, 0.45
"""Guess of what previews and report take: once, and by frame and megapixel."""


class Referee(Protocol):
    """Says when a frame has to end."""

    def over(self, rounds: int, done: int, more: int) -> bool:
        """Whether a round of `more` samples (of all tiles together) is not begun any more, after `rounds` of
        `done` samples together."""

    def grant(self, done: int, most: int, unit: int) -> int:
        """How many samples of each half come next, up to `most` and a multiple of `unit`, where all tiles get
        the same and `done` are there; 0 ends the frame."""

    @property
    def share(self) -> float:
        """How much of its time is over, 0 to 1."""


class Timed:
    """A frame that has `seconds` from now on for its samples. `asked`: when it was asked last."""

    def __init__(self, seconds: float, clock: Callable[[], float] = time.perf_counter) -> None:
        self._clock = clock
        self._began = self.asked = clock()
        self._seconds = seconds

    def _spent(self) -> float:
        self.asked = self._clock()
        return self.asked - self._began

    @property
    def share(self) -> float:
        return min(1.0, (self._clock() - self._began) / self._seconds) if self._seconds > 0 else 1.0

    def over(self, rounds: int, done: int, more: int) -> bool:
        # Half a round too long is as good as half a round too short.
        spent = self._spent()
        return done > 0 and spent + spent / done * more / 2 > self._seconds

    def grant(self, done: int, most: int, unit: int) -> int:
        spent = self._spent()
        if done == 0:
            return unit
        fit = (self._seconds - spent) * done / max(spent, 1e-6)
        # What is foreseen from few samples is looked at again.
        return min(round(min(fit, 4.0 * done) / unit) * unit, most // unit * unit) if fit > 0 else 0


@dataclass(frozen=True)
class Recorded:
    """A frame that ended after so many `rounds`, or with so many `samples` a pixel, when a clock decided."""

    rounds: int
    samples: int
    share = 0.0

    def over(self, rounds: int, done: int, more: int) -> bool:
        return rounds >= self.rounds

    def grant(self, done: int, most: int, unit: int) -> int:
        return max(0, min(most, self.samples // 2 - done))


class TimeShare:
    """Steers a frame to as many samples as fit into its time, the same for all tiles; at most `most` of each
    half."""

    looks = False
    noise = None

    def __init__(self, referee: Referee, *, most: int, unit: int = 1) -> None:
        self.unit = unit
        self._referee = referee
        self._most = max(unit, most // unit * unit)
        self._done = 0

    @property
    def share(self) -> float:
        return max(self._done / self._most, self._referee.share)

    @property
    def spp(self) -> int:
        """Samples a pixel, both halves together."""
        return 2 * self._done

    def as_dict(self) -> dict[str, Any]:
        """JSON-ready: what came of it."""
        return {"outcome": "fixed" if self._done == self._most else "limit", "rounds": 1, "samples": self.spp}

    def more(
        self,
        estimates: Mapping[str, Mapping[str, Developed]] | None,
        tiles: Mapping[str, np.ndarray],
        done: Counts,
    ) -> Counts:
        count = self._referee.grant(self._done, self._most - self._done, self.unit)
        self._done += count
        return {name: np.full((2, len(ids)), count, dtype=np.int64) for name, ids in tiles.items()}


class Allowance:
    """Shares out a command's seconds. `deadline` in the clock's time; `frames_left` tells how many frames are
    still to do, the one in work included; `megapixels` of a frame, all views."""

    def __init__(
        self,
        deadline: float,
        frames_left: Callable[[], int],
        *,
        megapixels: float,
        closing: bool,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        self._deadline = deadline
        self._frames_left = frames_left
        self._clock = clock
        self._megapixels = megapixels
        self._closing = closing
        self._overheads: list[float] = []
        self._last: Timed | None = None
        self._frames = 0

    def begin(self) -> Timed:
        """The samples of a frame begin."""
        now = self._clock()
        if self._last is not None:
            self._overheads.append(now - self._last.asked)
        left = max(1, self._frames_left())
        self._frames = max(self._frames, left)
        beside = SECONDS_PER_MEGAPIXEL * self._megapixels
        if self._overheads:
            beside = float(np.median(self._overheads))
        closing = 0.0
        if self._closing:
            closing = CLOSING_SECONDS + CLOSING_PER_MEGAPIXEL * self._megapixels * self._frames
        # This frame has been read; what follows its samples is most of what a frame takes beside them.
        seconds = (self._deadline - now - closing) / left - beside
        self._last = Timed(max(0.0, seconds), self._clock)
        return self._last
