"""Who decides how many samples a frame gets, and where: a word between every two rounds of `refine`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

import numpy as np

from mrbatch.film.accumulator import Developed

Counts = Mapping[str, np.ndarray]
"""By view (2, tiles) int: samples a pixel of each half, for the decision tiles that are done."""


class Steering(Protocol):
    """Asked before the first round and after each; what it answers is rendered, until it asks for nothing.

    Counts are multiples of `unit`, for where the shutter is open all moments get the same number. What one
    half is given may depend on the other half's samples alone, or its mean is biased.
    """

    unit: int
    looks: bool
    """Whether it looks at what was rendered so far."""

    def more(
        self,
        estimates: Mapping[str, Mapping[str, Developed]] | None,
        tiles: Mapping[str, np.ndarray],
        done: Counts,
    ) -> Counts:
        """How many samples come on top of `done`. `estimates` by view and source of what was rendered so
        far, with the halves' scatter (None before the first round, or where it does not look); `tiles` by
        view the ids of the decision tiles."""

    @property
    def share(self) -> float:
        """How much of the work seems done, above 0 to 1: for progress alone."""


def groups(done: np.ndarray, more: np.ndarray) -> list[tuple[int, int, np.ndarray]]:
    """(first sample, samples, indices of tiles) of those of one half that go on, in a fixed order."""
    going = np.flatnonzero(more > 0)
    pairs = np.stack([done[going], more[going]], axis=1)
    found = []
    for first, count in np.unique(pairs, axis=0):
        found.append((int(first), int(count), going[(pairs == (first, count)).all(axis=1)]))
    return found
