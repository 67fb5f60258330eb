"""Corners of a marker by fitting its whole printed pattern to the picture.

Corner detectors look at four spots and at code values. Two things then go wrong: noise at those
spots, and the transfer function: a blurred black-white edge crosses the middle *code* inside the
black, so a marker seems smaller than it is and the camera farther away (0.5 to 1 % on 8-bit sRGB
pictures of 75-pixel markers). Here the known pattern itself is drawn through a homography,
blurred, lit, and compared with the picture in linear light over all of the marker's pixels:

    I(p) = min(clip, B(u, v) + (W(u, v) - B(u, v)) * (pattern * G_sigma)(u, v)),   (u, v) = H^-1 p

with black and white levels B and W linear over the marker, and G_sigma the Gaussian that stands for
lens, pixel area and defocus. Gauss-Newton with robust (Huber) weights finds the homography (as
its four corners), sigma, B and W together: the direct method of image registration (Lucas and
Kanade 1981; Baker and Matthews, "Lucas-Kanade 20 years on", 2004, eq. 10), with blur and light.
Pixels are taken through the inverse of the lens distortion, so that the marker's edges are straight.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mrbatch.capture.marker_video.calibration import Calibration

_MARGIN = 0.8
"""Cells of white around the black square that are looked at."""
_BORDER = 2
"""Cells of white around the black square in the drawn pattern, room for the blur."""
_MAX_PIXELS = 20_000
_FLOOR = 0.01
"""Standard deviation in pixels that no corner goes below: print, paper and lens are never perfect."""


@dataclass(frozen=True)
class MarkerFit:
    """A fitted marker.

    `corners` (4, 2): top left, top right, bottom right, bottom left of the printed marker in pixels,
    pixel centres at half integers, distortion included. `covariance` (8, 8) px^2 of x0 y0 x1 y1 ...
    `residual`: rms difference of picture and model over the marker's contrast. `blur`: sigma in
    pixels, the pixel's own area included. `wrong_bits`: cells whose centre has the other colour.
    """

    corners: np.ndarray
    covariance: np.ndarray
    residual: float
    blur: float
    wrong_bits: int


def undistort(points: np.ndarray, calibration: Calibration | None) -> np.ndarray:
    """(n, 2) pixels to where a lens without distortion would have put them (same camera matrix)."""
    if calibration is None or not np.any(calibration.distortion):
        return np.asarray(points, dtype=np.float64)
    import cv2

    k = calibration.opencv_matrix()
    flat = np.ascontiguousarray(points, dtype=np.float64).reshape(-1, 1, 2) - 0.5
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-10)
    return cv2.undistortPoints(flat, k, calibration.distortion, P=k, criteria=criteria).reshape(-1, 2) + 0.5


def distort(points: np.ndarray, calibration: Calibration | None) -> np.ndarray:
    """(n, 2) the inverse of `undistort`."""
    if calibration is None or not np.any(calibration.distortion):
        return np.asarray(points, dtype=np.float64)
    rays = (np.asarray(points) - calibration.matrix[:2, 2]) / np.diag(calibration.matrix)[:2]
    return calibration.camera(np.eye(4), calibration.width or 0, calibration.height or 0).project(
        np.column_stack([rays, np.ones(len(rays))])
    )[0]


def fit_marker(
    linear: np.ndarray, corners: np.ndarray, bits: np.ndarray, calibration: Calibration | None = None
) -> MarkerFit | None:
    """Fits a marker whose corners are known to about a pixel; None where the fit does not hold.

    `linear` (height, width): scene-linear brightness, any scale. `corners` (4, 2): first guess,
    pixels with centres at half integers. `bits` (n, n): the marker's inner cells, true for white, as
    seen upright.
    """
    cells = bits.shape[0] + 2
    start = undistort(corners, calibration)
    points, values = _pixels(linear, corners, start, cells, calibration)
    if len(points) < 40:
        return None
    clip = _clip_level(values)
    pattern = _Pattern(bits)
    quad, blur = start.copy(), 1.0
    side = _side(quad)
    scale = float(np.subtract(*np.percentile(values, [95, 5])))
    if scale <= 0:
        return None
    damping = 1e-4
    state = _light(pattern, points, values, quad, blur, clip)
    for _ in range(40):
        predicted, jacobian = _model(pattern, points, quad, blur, state, clip)
        residual = values - predicted
        spread = max(1.4826 * float(np.median(np.abs(residual))), 1e-6 * scale)
        weight = np.minimum(1.0, 1.5 * spread / np.maximum(np.abs(residual), 1e-12))
        normal = jacobian.T @ (jacobian * weight[:, None])
        step = np.linalg.solve(
            normal + np.diag(damping * np.diag(normal) + 1e-12 * np.trace(normal)),
            jacobian.T @ (residual * weight),
        )
        largest = np.abs(step[:8]).max()
        step *= min(1.0, 0.5 / max(largest, 1e-12), 0.3 / max(abs(step[8]), 1e-12))
        quad = quad + step[:8].reshape(4, 2)
        blur = float(np.clip(blur + step[8], 0.25, 0.3 * side))
        state = state + step[9:]
        if not np.all(np.isfinite(quad)) or np.abs(quad - start).max() > max(2.0, 0.15 * side):
            return None
        if largest < 5e-4:
            break
    else:
        return None
    predicted, jacobian = _model(pattern, points, quad, blur, state, clip)
    residual = values - predicted
    spread = max(1.4826 * float(np.median(np.abs(residual))), 1e-6 * scale)
    weight = np.minimum(1.0, 1.5 * spread / np.maximum(np.abs(residual), 1e-12))
    contrast = state[3] - state[0]
    relative = float(np.sqrt(np.average(residual**2, weights=weight))) / max(abs(contrast), 1e-12)
    if contrast <= 0 or relative > 0.2:
        return None
    normal = jacobian.T @ (jacobian * weight[:, None])
    noise = np.sum(weight * residual**2) / max(weight.sum() - jacobian.shape[1], 1.0)
    covariance = (noise * np.linalg.pinv(normal))[:8, :8] + _FLOOR**2 * np.eye(8)
    wrong = _wrong_bits(linear, quad, bits, state, calibration)
    return MarkerFit(distort(quad, calibration), covariance, relative, blur, wrong)


def _side(quad: np.ndarray) -> float:
    return float(np.linalg.norm(np.roll(quad, -1, axis=0) - quad, axis=1).mean())


def _homography(quad: np.ndarray, cells: int) -> np.ndarray:
    """(3, 3): marker coordinates (u right, v down, in cells from the top left corner) to pixels."""
    corners = np.array([[0, 0], [cells, 0], [cells, cells], [0, cells]], dtype=np.float64)
    rows = []
    for (u, v), (x, y) in zip(corners, quad, strict=True):
        rows.append([u, v, 1, 0, 0, 0, -u * x, -v * x])
        rows.append([0, 0, 0, u, v, 1, -u * y, -v * y])
    return np.append(np.linalg.solve(np.array(rows), quad.ravel()), 1.0).reshape(3, 3)


def _apply(h: np.ndarray, points: np.ndarray) -> np.ndarray:
    mapped = points @ h[:, :2].T + h[:, 2]
    return mapped[:, :2] / mapped[:, 2:]


def _pixels(
    linear: np.ndarray, corners: np.ndarray, quad: np.ndarray, cells: int, calibration: Calibration | None
) -> tuple[np.ndarray, np.ndarray]:
    """Undistorted positions (n, 2) and values (n,) of the pixels on the marker and its margin."""
    height, width = linear.shape
    pad = 2.0 + 0.25 * _side(corners)
    x0, y0 = np.maximum(np.floor(corners.min(axis=0) - pad).astype(int), 0)
    x1, y1 = np.minimum(np.ceil(corners.max(axis=0) + pad).astype(int), (width, height))
    if x1 - x0 < 4 or y1 - y0 < 4:
        return np.zeros((0, 2)), np.zeros(0)
    stride = max(1, int(np.sqrt((x1 - x0) * (y1 - y0) / _MAX_PIXELS)))
    ys, xs = np.mgrid[y0:y1:stride, x0:x1:stride]
    raw = np.column_stack([xs.ravel() + 0.5, ys.ravel() + 0.5])
    points = undistort(raw, calibration)
    uv = _apply(np.linalg.inv(_homography(quad, cells)), points)
    inside = np.all((uv > -_MARGIN) & (uv < cells + _MARGIN), axis=1)
    return points[inside], linear[ys, xs].ravel()[inside].astype(np.float64)


def _clip_level(values: np.ndarray) -> float:
    """Where the picture saturates: its largest value if many pixels have exactly that one."""
    top = values.max()
    return float(top) if np.count_nonzero(values == top) > max(5, 0.01 * values.size) else np.inf


class _Pattern:
    """The printed marker as a texture, 1 for white, that can be drawn blurred."""

    def __init__(self, bits: np.ndarray, texels: int = 12):
        cells = bits.shape[0] + 2
        grid = np.ones((cells + 2 * _BORDER,) * 2)
        grid[_BORDER:-_BORDER, _BORDER:-_BORDER] = 0.0
        inner = _BORDER + 1
        grid[inner:-inner, inner:-inner] = bits
        self.cells = cells
        self.texels = texels
        texture = np.kron(grid, np.ones((texels, texels)))
        self.size = texture.shape[0]
        self.spectrum = np.fft.rfft2(texture)
        self.fy = np.fft.fftfreq(self.size, d=1.0 / texels)[:, None]
        self.fx = np.fft.rfftfreq(self.size, d=1.0 / texels)[None, :]

    def blurred(self, covariance: np.ndarray) -> np.ndarray:
        """(size, size) texture under a Gaussian whose covariance (2, 2) is in cells^2."""
        quadratic = (
            covariance[0, 0] * self.fx**2
            + 2.0 * covariance[0, 1] * self.fx * self.fy
            + covariance[1, 1] * self.fy**2
        )
        return np.fft.irfft2(self.spectrum * np.exp(-2.0 * np.pi**2 * quadratic), s=(self.size,) * 2)

    def sample(self, textures: list[np.ndarray], uv: np.ndarray) -> list[np.ndarray]:
        """Each texture at (n, 2) marker coordinates, bilinear."""
        position = np.clip((uv + _BORDER) * self.texels - 0.5, 0.0, self.size - 1.001)
        i = position.astype(np.int64)
        f = position - i
        fx, fy, column, row = f[:, 0], f[:, 1], i[:, 0], i[:, 1]
        out = []
        for t in textures:
            top = t[row, column] * (1 - fx) + t[row, column + 1] * fx
            bottom = t[row + 1, column] * (1 - fx) + t[row + 1, column + 1] * fx
            out.append(top * (1 - fy) + bottom * fy)
        return out


def _centre_jacobian(h: np.ndarray, cells: int) -> np.ndarray:
    """(2, 2) d(pixel) / d(u, v) at the marker's centre."""
    return _jacobian(h, np.array([[0.5 * cells, 0.5 * cells]]))[0]


def _jacobian(h: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """(n, 2, 2) d(pixel) / d(u, v)."""
    mapped = uv @ h[:, :2].T + h[:, 2]
    w = mapped[:, 2, None, None]
    p = mapped[:, :2] / mapped[:, 2:]
    return (h[None, :2, :2] - p[:, :, None] * h[None, None, 2, :2]) / w


def _light_basis(uv: np.ndarray, cells: int) -> np.ndarray:
    return np.column_stack([np.ones(len(uv)), 2.0 * uv / cells - 1.0])


def _light(
    pattern: _Pattern, points: np.ndarray, values: np.ndarray, quad: np.ndarray, blur: float, clip: float
) -> np.ndarray:
    """(6,) first guess of black and white levels: constant, from clearly black and white pixels."""
    h = _homography(quad, pattern.cells)
    inverse = np.linalg.inv(_centre_jacobian(h, pattern.cells))
    shown = pattern.sample(
        [pattern.blurred(blur**2 * inverse @ inverse.T)], _apply(np.linalg.inv(h), points)
    )[0]
    a = np.column_stack([1.0 - shown, shown])
    free = values < clip
    black, white = np.linalg.lstsq(a[free], values[free], rcond=None)[0]
    if np.isfinite(clip):
        white = max(white, clip)
    return np.array([black, 0, 0, white, 0, 0], dtype=np.float64)


def _model(
    pattern: _Pattern, points: np.ndarray, quad: np.ndarray, blur: float, light: np.ndarray, clip: float
) -> tuple[np.ndarray, np.ndarray]:
    """Predicted values (n,) and their Jacobian (n, 15): 8 corner coordinates, blur, 3 black, 3 white."""
    cells = pattern.cells
    h = _homography(quad, cells)
    uv = _apply(np.linalg.inv(h), points)
    inverse = np.linalg.inv(_centre_jacobian(h, cells))
    shape = inverse @ inverse.T
    texture = pattern.blurred(blur**2 * shape)
    wider = pattern.blurred((1.05 * blur) ** 2 * shape)
    gy, gx = np.gradient(texture, 1.0 / pattern.texels)
    shown, more, du, dv = pattern.sample([texture, wider, gx, gy], uv)
    basis = _light_basis(uv, cells)
    black, white = basis @ light[:3], basis @ light[3:]
    contrast = white - black
    value = black + contrast * shown
    # moving the drawn pattern by dx changes the pixel by -grad . dx; dx comes from the corners
    # through the derivative of the homography's eight numbers
    j = _jacobian(h, uv)
    scale = contrast / (j[:, 0, 0] * j[:, 1, 1] - j[:, 0, 1] * j[:, 1, 0])
    gradient = np.column_stack(
        [scale * (du * j[:, 1, 1] - dv * j[:, 1, 0]), scale * (dv * j[:, 0, 0] - du * j[:, 0, 1])]
    )
    moved = _by_numbers(h, uv, gradient)
    corner_uv = np.array([[0, 0], [cells, 0], [cells, cells], [0, cells]], dtype=np.float64)
    at_corners = np.concatenate(
        [_by_numbers(h, np.repeat(corner_uv[i : i + 1], 2, axis=0), np.eye(2)) for i in range(4)]
    )
    jacobian = np.empty((len(points), 15))
    jacobian[:, :8] = -moved @ np.linalg.inv(at_corners)
    jacobian[:, 8] = contrast * (more - shown) / (0.05 * blur)
    jacobian[:, 9:12] = basis * (1.0 - shown)[:, None]
    jacobian[:, 12:] = basis * shown[:, None]
    jacobian[value > clip] = 0.0
    return np.minimum(value, clip), jacobian


def _by_numbers(h: np.ndarray, uv: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """(n, 8) direction . d(pixel) / d(h00 h01 h02 h10 h11 h12 h20 h21) at (n, 2) marker coordinates."""
    mapped = uv @ h[:, :2].T + h[:, 2]
    w = mapped[:, 2]
    p = mapped[:, :2] / w[:, None]
    homogeneous = np.column_stack([uv, np.ones(len(uv))]) / w[:, None]
    along = np.sum(direction * p, axis=1)
    return np.column_stack(
        [
            direction[:, :1] * homogeneous,
            direction[:, 1:] * homogeneous,
            -along[:, None] * homogeneous[:, :2],
        ]
    )


def _wrong_bits(
    linear: np.ndarray, quad: np.ndarray, bits: np.ndarray, light: np.ndarray, calibration: Calibration | None
) -> int:
    """How many inner cells show the other colour at their centres."""
    n = bits.shape[0]
    row, column = np.mgrid[0:n, 0:n]
    uv = np.column_stack([column.ravel() + 1.5, row.ravel() + 1.5])
    position = distort(_apply(_homography(quad, n + 2), uv), calibration)
    x = np.clip(position[:, 0].astype(int), 0, linear.shape[1] - 1)
    y = np.clip(position[:, 1].astype(int), 0, linear.shape[0] - 1)
    basis = _light_basis(uv, n + 2)
    middle = 0.5 * (basis @ light[:3] + basis @ light[3:])
    return int(np.count_nonzero((linear[y, x] > middle) != bits.ravel().astype(bool)))
