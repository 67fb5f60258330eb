"""Frames whose every number is known: a plane seen from above, with a light change, noise and guides."""

from __future__ import annotations

import numpy as np
import pytest

from mrbatch.film.accumulator import Developed
from mrbatch.film.filter.apply import filtered, smoother
from mrbatch.film.filter.settings import Filter
from mrbatch.film.guides import Guide, Guides
from mrbatch.film.window import Window

METRES = 0.001
"""Side of a pixel on the plane."""


def flat_guide(h: int, w: int, owner=1, reflectance=0.8) -> Guide:
    """A plane z = 0, seen from above. `owner` and `reflectance` broadcast to (h, w) and (h, w, 3)."""
    y, x = np.mgrid[:h, :w] * METRES
    normal = np.broadcast_to(np.float32([0, 0, 1]), (h, w, 3)).copy()
    position = np.stack([x, y, 0 * x], axis=-1).astype(np.float32)
    shade = np.broadcast_to(np.float32(reflectance), (h, w, 3)).copy()
    return Guide(np.broadcast_to(np.int32(owner), (h, w)).copy(), normal, position, shade)


def nothing(h: int, w: int) -> Guide:
    zero = np.zeros((h, w, 3), np.float32)
    return Guide(np.zeros((h, w), np.int32), zero, zero, zero)


def real_frame(light, noise=0.0, seed=0, reflectance=0.8, owner=1, skew=False) -> tuple[Developed, Guides]:
    """Change of light (h, w) on a plane, seen whole: D = reflectance * light, plus noise.

    `noise`: standard error of the light's mean, the halves' is sqrt(2) as large; `skew`: exponential (few
    large values, as of lamps) in place of normal.
    """
    light = np.asarray(light, dtype=np.float64)
    h, w = light.shape
    guide = flat_guide(h, w, owner, reflectance)
    random = np.random.default_rng(seed)
    drawn = random.exponential(1, (2, h, w)) - 1 if skew else random.normal(0, 1, (2, h, w))
    halves = light[None, :, :, None] + np.sqrt(2.0) * noise * drawn[..., None]
    D = halves * guide.reflectance
    film = np.concatenate([np.zeros((2, h, w, 4)), D], axis=-1)
    return developed(film), Guides(nothing(h, w), guide)


def developed(halves: np.ndarray, **parts: np.ndarray) -> Developed:
    """From the halves' means (2, h, w, 7)."""
    mean = halves.mean(axis=0)
    h, w = mean.shape[:2]
    return Developed(
        Window(0, 0, w, h),
        P=mean[..., :3],
        a=mean[..., 3],
        D=mean[..., 4:],
        variance=0.25 * (halves[0, ..., 4:] - halves[1, ..., 4:]) ** 2,
        samples=np.full((h, w), 32),
        halves=halves,
        **parts,
    )


def strip(h: int, w: int, first: int, last: int, depth: float) -> np.ndarray:
    """0, and `depth` in columns first to last - 1."""
    light = np.zeros((h, w))
    light[:, first:last] = depth
    return light


def apply(kind: str, frame: tuple[Developed, Guides], *, threads: int = 1, **settings: int) -> Developed:
    """The frame filtered as a job with these settings does it; skips the test where OIDN is missing."""
    if kind == "oidn":
        pytest.importorskip("pyoidn")
    return filtered(*frame, smoother(Filter(kind=kind, **settings), threads))
