"""How an object moves over the frames of a shot, and when it is there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

ALWAYS = ((-np.inf, np.inf),)


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
    along the shortest arc at an even speed (Shoemake, SIGGRAPH 1985); before the first key and after the
    last, nothing does.

    `visible`: first and last frame of the times at which the object is there.
    """

    frames: np.ndarray
    translations: np.ndarray
    rotations: np.ndarray
    scales: np.ndarray
    visible: Sequence[tuple[float, float]] = ALWAYS

    def world_from_object(self, frame: float) -> np.ndarray:
        """(4, 4) float64, metres, at a frame."""
        from scipy.spatial.transform import Rotation, Slerp

        at = float(np.clip(frame, self.frames[0], self.frames[-1]))
        rotation = Rotation.from_quat(self.rotations[0])
        if len(self.frames) > 1:
            rotation = Slerp(self.frames, Rotation.from_quat(self.rotations))(at)
        scale = [np.interp(at, self.frames, self.scales[:, c]) for c in range(3)]
        result = np.eye(4)
        result[:3, :3] = rotation.as_matrix() @ np.diag(scale)
        result[:3, 3] = [np.interp(at, self.frames, self.translations[:, c]) for c in range(3)]
        return result


@dataclass(frozen=True)
class Still(_Timed):
    """An object that stays where `matrix` (4, 4) puts it, and is there at some times only."""

    matrix: np.ndarray
    visible: Sequence[tuple[float, float]] = ALWAYS
    frames: Sequence[float] = (0.0,)

    def world_from_object(self, frame: float) -> np.ndarray:
        """(4, 4) float64, metres."""
        return self.matrix
