"""Shots that moved: the shift between neighbouring exposures, and putting them back.

The darker shot is raised to the brighter one's exposure and clipped alike; both then show the same
picture wherever the camera stood still, and phase correlation gives the shift to a tenth of a pixel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mrbatch.capture.marker_video.response_curve import ResponseCurve
from mrbatch.errors import InputError

STILL = 0.3
"""Shifts below this many pixels are the noise of the measurement."""
LARGEST = 0.1
"""Share of the picture's side beyond which a shift is a turn, which moving cannot mend."""
TURNED = 1.0
_LEAST_QUARTER = 48
_LARGE_SIDE = 2048


@dataclass(frozen=True)
class Shift:
    """How far a shot's content lies right of and below the reference's, in pixels."""

    x: float
    y: float

    @property
    def length(self) -> float:
        return float(np.hypot(self.x, self.y))


def measure_shifts(
    codes: Sequence[np.ndarray], curve: ResponseCurve, seconds: np.ndarray, reference: int
) -> list[Shift]:
    """The shift of each shot (height, width, 3) against shot `reference`, along the chain of exposures."""
    order = [int(i) for i in np.argsort(seconds)]
    at = order.index(reference)
    shifts = {reference: Shift(0.0, 0.0)}
    for chain in (order[at:], order[at::-1]):
        for known, new in zip(chain, chain[1:]):
            step = _between(codes[known], codes[new], curve, seconds[known], seconds[new])
            shifts[new] = Shift(shifts[known].x + step.x, shifts[known].y + step.y)
    return [shifts[i] if shifts[i].length >= STILL else Shift(0.0, 0.0) for i in range(len(codes))]


def turned_shots(codes: Sequence[np.ndarray], curve: ResponseCurve, seconds: np.ndarray) -> list[int]:
    """Shots whose quarters moved differently, by more than `TURNED` pixels: turned, zoomed or bent ones.

    A shot is one if it differs so from each neighbour in exposure that shows enough to tell.
    """
    order = [int(i) for i in np.argsort(seconds)]
    height, width = codes[0].shape[:2]
    if min(height, width) < 2 * _LEAST_QUARTER:
        return []
    rows = (slice(0, height // 2), slice(height // 2, height))
    columns = (slice(0, width // 2), slice(width // 2, width))
    verdicts: dict[int, list[bool]] = {i: [] for i in order}
    for i, j in zip(order, order[1:]):
        quarters = [
            _between(codes[i][r, c], codes[j][r, c], curve, seconds[i], seconds[j])
            for r in rows
            for c in columns
        ]
        moves = np.array([(q.x, q.y) for q in quarters])
        # Two quarters at least: one alone may hold something that moved.
        off = np.linalg.norm(moves - np.median(moves, axis=0), axis=1) > TURNED
        verdict = int(np.count_nonzero(off)) >= 2
        verdicts[i].append(verdict)
        verdicts[j].append(verdict)
    found = [i for i in order if all(verdicts[i])]
    # At the ends of the chain one neighbour tells; the turned one of two is the one without a good link.
    return [i for i in found if len(verdicts[i]) > 1 or not any(k in found for k in _beside(order, i))]


def _beside(order: Sequence[int], shot: int) -> list[int]:
    at = order.index(shot)
    return [order[k] for k in (at - 1, at + 1) if 0 <= k < len(order)]


def _between(a: np.ndarray, b: np.ndarray, curve: ResponseCurve, ta: float, tb: float) -> Shift:
    """Shift of b against a; none where they do not look alike."""
    import cv2

    if ta > tb:
        back = _between(b, a, curve, tb, ta)
        return Shift(-back.x, -back.y)
    dark = curve.exposure(a)[..., 1] * np.float32(tb / ta)
    bright = curve.exposure(b)[..., 1]
    # Logarithms weigh dark and bright edges alike; noise below the floor would correlate with nothing.
    floor = max(0.004, 4.0 * float(curve.table[2, 1]) * tb / ta)
    one, other = (np.log(np.clip(x, floor, 0.9)).astype(np.float32) for x in (dark, bright))
    scale = max(1, -(-max(one.shape) // _LARGE_SIDE))
    if scale > 1:
        size = (one.shape[1] // scale, one.shape[0] // scale)
        one, other = (cv2.resize(x, size, interpolation=cv2.INTER_AREA) for x in (one, other))
    if min(one.shape) < 8 or one.std() < 1e-3 or other.std() < 1e-3:
        return Shift(0.0, 0.0)
    window = cv2.createHanningWindow((one.shape[1], one.shape[0]), cv2.CV_32F)
    (x, y), response = cv2.phaseCorrelate(one - one.mean(), other - other.mean(), window)
    if np.hypot(x, y) * scale < STILL or response < 0.03:
        return Shift(0.0, 0.0)
    # A shift that is real makes the pictures more alike.
    still = float(np.mean(np.abs(one - other) > 0.25))
    moved = float(np.mean(np.abs(one - _moved(other, -x, -y)) > 0.25))
    return Shift(x * scale, y * scale) if moved < 0.8 * still else Shift(0.0, 0.0)


def _moved(values: np.ndarray, x: float, y: float) -> np.ndarray:
    import cv2

    matrix = np.array([[1.0, 0.0, x], [0.0, 1.0, y]])
    size = (values.shape[1], values.shape[0])
    whole = max(abs(x - round(x)), abs(y - round(y))) < 0.2
    if whole:
        matrix[:, 2] = np.rint(matrix[:, 2])
    flags = cv2.INTER_NEAREST if whole else cv2.INTER_LINEAR
    return cv2.warpAffine(values, matrix, size, flags=flags, borderMode=cv2.BORDER_REPLICATE)


def moved_back(codes: np.ndarray, shift: Shift, name: str) -> tuple[np.ndarray, np.ndarray]:
    """The shot's codes on the reference's pixels, and where (height, width) it has any.

    Whole pixels keep their codes; between pixels codes are interpolated linearly. Raises InputError for
    a shift so large that the camera must have turned.
    """
    height, width = codes.shape[:2]
    if abs(shift.x) > LARGEST * width or abs(shift.y) > LARGEST * height:
        raise InputError(
            f"{name} is moved by ({shift.x:.0f}, {shift.y:.0f}) pixels against the others",
            hint="leave it out, or align the pictures first; `--align off` merges them as they are",
        )
    there = np.ones((height, width), dtype=bool)
    left, up = int(np.ceil(max(0.0, -shift.x))), int(np.ceil(max(0.0, -shift.y)))
    right, down = int(np.ceil(max(0.0, shift.x))), int(np.ceil(max(0.0, shift.y)))
    there[:up], there[:, :left] = False, False
    there[height - down :], there[:, width - right :] = False, False
    return _moved(codes, -shift.x, -shift.y), there
