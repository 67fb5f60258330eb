"""A lens of finite width: what is sharp through it, and how far the rest spreads."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Lens:
    """A thin lens. `radius` of its aperture, metres; `focus`: planar z of what is sharp, metres."""

    radius: float
    focus: float

    def spread(self, focal: float, depth: Any) -> Any:
        """Diameter in pixels of the circle of confusion of points at planar `depth` (metres).

        A f |z - zf| / (z (zf - f)) / pitch, with the picture's distance v = f zf / (zf - f) behind the lens
        in pixels, `focal` = v / pitch, as a calibration measures it: A focal |1 / z - 1 / zf|. Infinite where
        a point is not in front of the lens.
        """
        z = np.asarray(depth, dtype=np.float64)
        if self.radius == 0.0:
            return np.zeros(z.shape)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(z > 0.0, 2.0 * self.radius * focal * np.abs(1.0 / z - 1.0 / self.focus), np.inf)

    @property
    def rim(self) -> np.ndarray:
        """(4, 2): corners of the square that holds the aperture, metres, in the camera's x and y."""
        return self.radius * np.array([(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)])
