"""Values that change with time: key frames and what lies between them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

Interpolation = Literal["linear", "step", "cubic-spline"]


@dataclass(frozen=True)
class Channel:
    """Keys in rising order of `times` (n,). `values` (n, c); of a cubic spline (n, 3, c): tangent into the
    key, value, tangent out of it, per unit of time. Before the first key and after the last nothing changes.

    `turns`: values are unit quaternions (x, y, z, w), which change along the shortest arc at an even speed
    (Shoemake, SIGGRAPH 1985), or on a spline of their four numbers, made unit again. glTF 2.0, appendix C.
    """

    times: np.ndarray
    values: np.ndarray
    interpolation: Interpolation = "linear"
    turns: bool = False

    def at(self, time: float) -> np.ndarray:
        """(c,) float64."""
        t = float(np.clip(time, self.times[0], self.times[-1]))
        keys = self.values[:, 1] if self.interpolation == "cubic-spline" else self.values
        before = min(int(np.searchsorted(self.times, t, side="right")) - 1, len(self.times) - 2)
        if before < 0:
            return np.asarray(keys[0], dtype=np.float64)
        width = float(self.times[before + 1] - self.times[before])
        s = (t - float(self.times[before])) / width
        a, b = (np.asarray(keys[k], dtype=np.float64) for k in (before, before + 1))
        if s == 0.0 or s == 1.0:
            return b if s else a
        if self.interpolation == "step":
            return a
        if self.interpolation == "cubic-spline":
            out, into = self.values[before, 2] * width, self.values[before + 1, 0] * width
            found = (
                (2 * s**3 - 3 * s**2 + 1) * a
                + (s**3 - 2 * s**2 + s) * out
                + (3 * s**2 - 2 * s**3) * b
                + (s**3 - s**2) * into
            )
            return found / np.linalg.norm(found) if self.turns else found
        return _arc(a, b, s) if self.turns else a + s * (b - a)


def _arc(a: np.ndarray, b: np.ndarray, s: float) -> np.ndarray:
    """Between two unit quaternions."""
    if a @ b < 0.0:
        b = -b
    # The angle from the chord keeps its digits where both nearly agree.
    angle = 2.0 * np.arctan2(np.linalg.norm(b - a), np.linalg.norm(b + a))
    if angle == 0.0:
        return a
    found = (np.sin((1 - s) * angle) * a + np.sin(s * angle) * b) / np.sin(angle)
    return found / np.linalg.norm(found)


def constant(value: object, *, turns: bool = False) -> Channel:
    """A channel of one key."""
    return Channel(np.zeros(1), np.asarray(value, dtype=np.float64)[None], turns=turns)


@dataclass(frozen=True)
class Placement:
    """Channels of a place (metres), a rotation and a scale."""

    translation: Channel
    rotation: Channel
    scale: Channel

    def matrix(self, time: float) -> np.ndarray:
        """(4, 4) float64: translate * rotate * scale."""
        from scipy.spatial.transform import Rotation

        result = np.eye(4)
        turn = Rotation.from_quat(self.rotation.at(time)).as_matrix()
        result[:3, :3] = turn @ np.diag(self.scale.at(time))
        result[:3, 3] = self.translation.at(time)
        return result


@dataclass(frozen=True)
class Fixed:
    """What stays where `value` (4, 4) puts it."""

    value: np.ndarray

    def matrix(self, time: float) -> np.ndarray:
        """(4, 4) float64."""
        return self.value
