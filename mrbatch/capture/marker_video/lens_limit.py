"""How far from its axis a lens model holds: where it folds back, pixels have no ray."""

from __future__ import annotations

import numpy as np


def lens_limit(matrix: np.ndarray, distortion: np.ndarray, size: tuple[int, int]) -> float:
    """Largest distance from the axis, in focal lengths on the picture, that is the image of one direction.

    Infinite where the radial model (OpenCV's, up to 8 coefficients) rises all the way to the farthest corner.
    Beyond the limit two directions fall on one place, or none does: no lens does that.
    """
    d = np.zeros(8)
    d[: len(distortion)] = distortion
    k1, k2, _, _, k3, k4, k5, k6 = d
    corner = float(_distances(matrix, *size)[[0, 0, -1, -1], [0, -1, 0, -1]].max())
    r = np.linspace(0.0, 3.0 * corner, 3000)
    s = r * r
    with np.errstate(divide="ignore", invalid="ignore"):
        shown = r * (1 + s * (k1 + s * (k2 + s * k3))) / (1 + s * (k4 + s * (k5 + s * k6)))
    falls = np.flatnonzero(~(np.diff(shown) > 0.0))
    top = float(shown[falls[0] if falls.size else -1])
    return np.inf if top >= corner else top


def rayless_share(matrix: np.ndarray, distortion: np.ndarray, size: tuple[int, int]) -> float:
    """Share of the pixels beyond the limit: nothing virtual, and no shadow, is seen there."""
    limit = lens_limit(matrix, distortion, size)
    return 0.0 if np.isinf(limit) else float(np.mean(_distances(matrix, *size) > limit))


def _distances(matrix: np.ndarray, width: int, height: int) -> np.ndarray:
    """(height, width) of pixel centres from the axis, in focal lengths."""
    x = (np.arange(width) + 0.5 - matrix[0, 2]) / matrix[0, 0]
    y = (np.arange(height) + 0.5 - matrix[1, 2]) / matrix[1, 1]
    return np.hypot(x[None, :], y[:, None])
