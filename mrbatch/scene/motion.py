"""How an object moves over the frames of a shot, and when it is there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mrbatch.scene.channel import Channel, Fixed, Placement

ALWAYS = ((-np.inf, np.inf),)


def rigid_between(a: np.ndarray, b: np.ndarray, share: float) -> np.ndarray:
    """The rigid motion (4, 4) at `share` of the way from `a` (0) to `b` (1), or beyond either: places move
    evenly along a line, rotations along the shortest arc. Exactly `a` where both are the same."""
    from scipy.spatial.transform import Rotation

    if np.array_equal(a, b):
        return a
    turn = Rotation.from_matrix(a[:3, :3].T @ b[:3, :3]).as_rotvec()
    result = np.eye(4)
    result[:3, :3] = a[:3, :3] @ Rotation.from_rotvec(share * turn).as_matrix()
    result[:3, 3] = a[:3, 3] + share * (b[:3, 3] - a[:3, 3])
    return result


@dataclass(frozen=True)
class Clock:
    """Which second a frame is shown at: `frames` (n,) rising, `seconds` (n,), and beyond them `rate` frames
    a second."""

    frames: np.ndarray
    seconds: np.ndarray
    rate: float

    def at(self, frame: float) -> float:
        """Seconds."""
        inside = float(np.clip(frame, self.frames[0], self.frames[-1]))
        return float(np.interp(inside, self.frames, self.seconds)) + (frame - inside) / self.rate


class _Timed:
    """What is there at some times only."""

    visible: Sequence[tuple[float, float]]

    def there(self, frame: float) -> bool:
        """Whether the object is there at a frame."""
        return any(first <= frame <= last for first, last in self.visible)


@dataclass(frozen=True)
class Motion(_Timed):
    """Keys in rising order of `frames` (n,): `translations` (n, 3) metres, `rotations` (n, 4) unit
    quaternions (x, y, z, w), `scales` (n, 3). Between keys places and scales change linearly and rotations
    along the shortest arc at an even speed; before the first key and after the last, nothing does.

    `visible`: first and last frame of the times at which the object is there.
    """

    frames: np.ndarray
    translations: np.ndarray
    rotations: np.ndarray
    scales: np.ndarray
    visible: Sequence[tuple[float, float]] = ALWAYS

    def world_from_object(self, frame: float) -> np.ndarray:
        """(4, 4) float64, metres, at a frame."""
        return Placement(
            Channel(self.frames, self.translations),
            Channel(self.frames, self.rotations, turns=True),
            Channel(self.frames, self.scales),
        ).matrix(frame)


@dataclass(frozen=True)
class Still(_Timed):
    """An object that stays where `matrix` (4, 4) puts it, and is there at some times only."""

    matrix: np.ndarray
    visible: Sequence[tuple[float, float]] = ALWAYS
    frames: Sequence[float] = (0.0,)

    def world_from_object(self, frame: float) -> np.ndarray:
        """(4, 4) float64, metres."""
        return self.matrix


@dataclass(frozen=True)
class Clip:
    """An animation over seconds, 0 to `length`, on the frames of a shot. `start`: frame at which it begins,
    the clock's first where None; `repeat`: whether it begins anew at its end, or stays there; before it
    begins it stays at its first key, or, where it repeats, runs as it does later. `speed`: its seconds in one
    of the shot's. `clock`: None before the shot's frames are known, when the clip stands at its start.
    """

    length: float
    start: int | None = None
    repeat: bool = False
    speed: float = 1.0
    clock: Clock | None = None

    def seconds(self, frame: float) -> float:
        """Of the animation, at a frame."""
        if self.clock is None:
            return 0.0
        start = self.clock.frames[0] if self.start is None else self.start
        at = (self.clock.at(frame) - self.clock.at(float(start))) * self.speed
        if self.repeat and self.length > 0.0:
            return at % self.length
        return min(max(at, 0.0), self.length)


@dataclass(frozen=True)
class Played(_Timed):
    """A part of an object that moves within it: `nodes`, from the object's own frame to the part's, whose
    placements change over the seconds of `clip`, while `whole` moves the object in the world."""

    whole: Motion | Still
    nodes: tuple[Placement | Fixed, ...]
    clip: Clip

    @property
    def visible(self) -> Sequence[tuple[float, float]]:  # type: ignore[override]
        return self.whole.visible

    @property
    def frames(self) -> Sequence[float] | np.ndarray:
        return self.whole.frames

    def world_from_object(self, frame: float) -> np.ndarray:
        """(4, 4) float64, metres, at a frame."""
        seconds = self.clip.seconds(frame)
        result = self.whole.world_from_object(frame)
        for node in self.nodes:
            result = result @ node.matrix(seconds)
        return result

    def by(self, clock: Clock) -> Played:
        """With the shot's clock."""
        return replace(self, clip=replace(self.clip, clock=clock))
