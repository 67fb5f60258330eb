"""Intrinsics and distortion from views of a board, with what they are uncertain by and what the views lack.

OpenCV's `calibrateCameraExtended` does the least squares. The number of distortion coefficients is the one
with the smallest Bayesian information criterion, n log(RSS / n) + k log n, among those whose lens does not
fold back within the picture: high powers fitted to corners near the middle do so further out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mrbatch.capture.marker_video.calibration_views import View
from mrbatch.capture.marker_video.lens_limit import lens_limit
from mrbatch.errors import InputError

MODELS = (0, 2, 4, 5, 8)
"""Numbers of distortion coefficients: none; k1 k2; and p1 p2; and k3; and k4 k5 k6."""
AUTOMATIC = (0, 2, 4, 5)
"""The rational model (8) is taken only when asked for: beyond the corners seen it may have poles."""
MIN_VIEWS = 3
FEW_VIEWS = 10
REACH = 0.75
"""Share of the way to the picture's corners that board corners should have been seen at."""
TILT = 20.0
"""Degrees between board and picture from which the focal length shows."""
_CELLS = (8, 6)
_GROUPS = 20
OWN_ERRORS = 2.0
"""How much larger than the least squares' the views' standard deviation is where views err as a whole."""


@dataclass(frozen=True)
class CalibrationFit:
    """`matrix` (3, 3), pixel centres at integers as OpenCV counts; `distortion` (0, 4, 5 or 8,).

    `sigma` (4,): standard deviations of fx fy cx cy in pixels, `sigma_distortion` those of the coefficients,
    as the least squares state them: true where corners err one by one. `sigma_views`,
    `sigma_views_distortion`: the same from how the fit changes without some of the views; larger where each
    view has an error of its own, as from a bent board, a rolling shutter or a focus that moves.
    `rms`: reprojection error in pixels. `views`: those used, with `residuals` (n, 2) pixels each, seen less
    predicted, and `tilts` in degrees. `dropped`: views that did not fit, by name with their error;
    `dropped_corners`: how many corners did not.
    """

    size: tuple[int, int]
    matrix: np.ndarray
    distortion: np.ndarray
    sigma: np.ndarray
    sigma_distortion: np.ndarray
    rms: float
    views: tuple[View, ...]
    residuals: tuple[np.ndarray, ...]
    tilts: tuple[float, ...]
    sigma_views: np.ndarray
    sigma_views_distortion: np.ndarray
    dropped: tuple[tuple[str, float], ...] = ()
    dropped_corners: int = 0

    @property
    def view_rms(self) -> list[float]:
        return [float(np.sqrt(np.mean(np.sum(r**2, axis=1)))) for r in self.residuals]


def fit_calibration(
    views: Sequence[View], size: tuple[int, int], coefficients: int | None = None
) -> CalibrationFit:
    """Fits the camera; `coefficients` of `MODELS`, None to choose.

    Views that do not fit, then corners that do not, are left out once, by robust thresholds. Raises
    InputError for fewer than `MIN_VIEWS` views, or views that give no camera.
    """
    if len(views) < MIN_VIEWS:
        raise InputError(
            f"the board is seen in {len(views)} pictures; at least {MIN_VIEWS} are needed",
            hint="check --board against the print; film the whole board, near, tilted to all sides",
        )
    first = _fit(views, size, 5)
    kept, dropped = _fitting_views(first)
    second = _fit(kept, size, 5) if dropped else first
    kept, lost = _fitting_corners(second)
    tried = [_fit(kept, size, n) for n in (AUTOMATIC if coefficients is None else (coefficients,))]
    best = min([t for t in tried if not folds(t)] or tried[:1], key=_information)
    spread = _jackknife(best, kept, coefficients=_coefficients(best))
    return replace(
        best,
        dropped=dropped,
        dropped_corners=lost,
        sigma_views=spread[:4],
        sigma_views_distortion=spread[4:],
    )


def _coefficients(fit: CalibrationFit) -> int:
    """Which of `MODELS` a fit has."""
    if len(fit.distortion) == 4:
        return 4 if np.any(fit.distortion[2:]) else 2
    return len(fit.distortion)


def _jackknife(fit: CalibrationFit, views: Sequence[View], coefficients: int) -> np.ndarray:
    """(4 + coefficients,) standard deviations from fits that leave out a group of views each.

    Delete-a-group jackknife: sigma^2 = (g - 1) / g sum (x_i - mean x)^2. NaN where too few views are left.
    """
    groups = min(len(views), _GROUPS)
    found = []
    for group in range(groups):
        rest = [v for i, v in enumerate(views) if i % groups != group]
        if len(rest) < MIN_VIEWS:
            return np.full(4 + len(fit.distortion), np.nan)
        k = (part := _fit(rest, fit.size, coefficients)).matrix
        found.append([k[0, 0], k[1, 1], k[0, 2], k[1, 2], *part.distortion])
    values = np.array(found)
    squares = np.sum((values - values.mean(axis=0)) ** 2, axis=0)
    return np.sqrt((groups - 1) / groups * squares)


def _flags(coefficients: int) -> int:
    import cv2

    flags = cv2.CALIB_RATIONAL_MODEL if coefficients == 8 else 0
    if coefficients < 5:
        flags |= cv2.CALIB_FIX_K3
    if coefficients < 4:
        flags |= cv2.CALIB_ZERO_TANGENT_DIST
    if coefficients < 2:
        flags |= cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2
    return flags


def _fit(views: Sequence[View], size: tuple[int, int], coefficients: int) -> CalibrationFit:
    import cv2

    # OpenCV counts pixel centres at integers and takes single precision.
    boards = [v.board.astype(np.float32) for v in views]
    points = [(v.points - 0.5).astype(np.float32) for v in views]
    try:
        rms, matrix, distortion, turns, moves, sigma, _, _ = cv2.calibrateCameraExtended(  # type: ignore[call-overload]
            boards, points, size, None, None, flags=_flags(coefficients)
        )
    except cv2.error as error:
        reason = str(error).strip().splitlines()[-1]
        raise InputError(f"these views give no camera ({reason})", hint="film more, tilted views") from None
    distortion, sigma = np.ravel(distortion)[:8], np.ravel(sigma)
    if not (np.isfinite(rms) and np.all(np.isfinite(matrix)) and min(matrix[0, 0], matrix[1, 1]) > 0):
        raise InputError("these views give no camera", hint="film the board tilted to all sides")
    residuals, tilts = [], []
    for view, turn, move in zip(views, turns, moves):
        shown = cv2.projectPoints(view.board, turn, move, matrix, distortion)[0].reshape(-1, 2)
        residuals.append(view.points - 0.5 - shown)
        tilts.append(float(np.degrees(np.arccos(min(1.0, abs(cv2.Rodrigues(turn)[0][2, 2]))))))
    length = {0: 0, 2: 4}.get(coefficients, coefficients)
    return CalibrationFit(
        size,
        matrix,
        distortion[:length],
        sigma[:4],
        sigma[4 : 4 + length],
        float(rms),
        tuple(views),
        tuple(residuals),
        tuple(tilts),
        np.full(4, np.nan),
        np.full(length, np.nan),
    )


def _information(fit: CalibrationFit) -> float:
    squares = float(sum(np.sum(r**2) for r in fit.residuals))
    count = 2 * sum(len(r) for r in fit.residuals)
    used = int(np.count_nonzero(fit.distortion))
    return count * np.log(squares / count) + (4 + used + 6 * len(fit.views)) * np.log(count)


def folds(fit: CalibrationFit) -> bool:
    """Whether two directions fall on one place within the picture: no lens does that."""
    return bool(np.isfinite(lens_limit(fit.matrix, fit.distortion, fit.size)))


def _fitting_views(fit: CalibrationFit) -> tuple[list[View], tuple[tuple[str, float], ...]]:
    # Medians: one wrong corner is no reason to lose a view.
    errors = np.array([float(np.median(np.linalg.norm(r, axis=1))) for r in fit.residuals])
    most = max(3.0 * float(np.median(errors)), 0.5)
    dropped = tuple((v.name, float(e)) for v, e in zip(fit.views, errors) if e > most)
    kept = [v for v, e in zip(fit.views, errors) if e <= most]
    return (kept, dropped) if len(kept) >= MIN_VIEWS else (list(fit.views), ())


def _fitting_corners(fit: CalibrationFit) -> tuple[list[View], int]:
    lengths = np.linalg.norm(np.concatenate(fit.residuals), axis=1)
    # The median length of a two-dimensional Gaussian is 1.18 sigma.
    most = max(6.0 * float(np.median(lengths)) / 1.1774, 0.2)
    kept, lost = [], 0
    for view, residual in zip(fit.views, fit.residuals):
        length = np.linalg.norm(residual, axis=1)
        # A wrong corner bends its view's pose, and makes good ones look a little wrong.
        good = length <= max(most, 0.5 * float(length.max()))
        if np.count_nonzero(good) < 6:
            good[:] = True
        lost += int(np.count_nonzero(~good))
        kept.append(replace(view, points=view.points[good], board=view.board[good]))
    return kept, lost


@dataclass(frozen=True)
class Coverage:
    """What the views cover: `cells` share of the picture's 8 x 6 cells with a corner; `reach` of the corners
    from the middle, as a share of the way to the picture's corners; `tilt` degrees of the 75th percentile."""

    cells: float
    reach: float
    tilt: float


def coverage(fit: CalibrationFit) -> Coverage:
    """How much of picture and tilts the corners cover."""
    width, height = fit.size
    points = np.concatenate([v.points for v in fit.views])
    column = np.clip((points[:, 0] / width * _CELLS[0]).astype(int), 0, _CELLS[0] - 1)
    row = np.clip((points[:, 1] / height * _CELLS[1]).astype(int), 0, _CELLS[1] - 1)
    cells = len(set(zip(column.tolist(), row.tolist()))) / (_CELLS[0] * _CELLS[1])
    radius = np.linalg.norm(points - [0.5 * width, 0.5 * height], axis=1) / (0.5 * np.hypot(width, height))
    return Coverage(cells, float(np.percentile(radius, 99)), float(np.percentile(fit.tilts, 75)))


def weaknesses(fit: CalibrationFit, seen: Coverage) -> list[str]:
    """What a person should film better, one sentence each."""
    told = []
    if len(fit.views) < FEW_VIEWS:
        told.append(f"only {len(fit.views)} views: 20 to 40 that differ are better")
    if seen.cells < 0.75:
        told.append(f"corners are seen in {100 * seen.cells:.0f} % of the picture only: move the board about")
    if seen.reach < REACH and np.any(fit.distortion):
        told.append(
            f"no corners beyond {100 * seen.reach:.0f} % of the way to the picture's corners: the distortion "
            "there is a guess; bring the board into the corners"
        )
    if seen.tilt < TILT:
        told.append(
            f"three of four views are tilted by less than {seen.tilt:.0f} degrees: the focal length hardly "
            "shows; tilt the board by 30 to 45"
        )
    if folds(fit):
        told.append("the lens folds back within the picture: give fewer coefficients, --distortion 2")
    ratio = float(np.nanmedian(fit.sigma_views / fit.sigma)) if np.isfinite(fit.sigma_views).any() else 1.0
    if ratio > OWN_ERRORS:
        told.append(
            f"the views disagree {ratio:.1f} times more than their corners' noise explains: count on the "
            "larger +-; is the board flat, the focus fixed, the picture unstabilised, the motion slow?"
        )
    sigma = np.fmax(fit.sigma, fit.sigma_views)
    relative = float(max(sigma[0] / fit.matrix[0, 0], sigma[1] / fit.matrix[1, 1]))
    if relative > 0.005:
        told.append(f"the focal length is known to {100 * relative:.1f} % only")
    if fit.rms > 1.0:
        told.append(
            f"corners are off by {fit.rms:.1f} pixels: is the board flat, are --board's sizes the print's, "
            "did the focus change?"
        )
    return told
