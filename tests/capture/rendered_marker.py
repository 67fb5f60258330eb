"""Pictures of printed targets made by tracing pixels back to the page: the truth for pose tests.

Nothing here uses the code under test: patterns come from OpenCV, the lens from `cv2.undistortPoints`, and
each pixel is the mean of `samples` x `samples` point samples in linear light, encoded as sRGB.
"""

from __future__ import annotations

import cv2
import numpy as np


def look_at(eye, target=(0.0, 0.0, 0.0), roll: float = 0.0) -> np.ndarray:
    """(4, 4) world_from_camera of a camera at `eye` that looks at `target`, x right, y down, z forward."""
    eye = np.asarray(eye, dtype=np.float64)
    z = np.asarray(target) - eye
    z /= np.linalg.norm(z)
    up = np.array([0.0, 1.0, 0.0]) if abs(z[1]) < 0.99 else np.array([0.0, 0.0, 1.0])
    x = np.cross(z, up)
    x /= np.linalg.norm(x)
    pose = np.eye(4)
    pose[:3, :3] = np.column_stack([x, np.cross(z, x), z])
    c, s = np.cos(roll), np.sin(roll)
    pose[:3, :3] = pose[:3, :3] @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    pose[:3, 3] = eye
    return pose


def marker_page(dictionary: str, marker: int, side: float, page: float = 2.0) -> tuple[np.ndarray, float]:
    """A marker in the middle of a white page `page` times its side: picture of 0 and 1, metres a pixel."""
    entry = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    cells = entry.markerSize + 2
    size = 16 * cells
    pattern = cv2.aruco.generateImageMarker(entry, marker, size) > 127
    if dictionary.startswith("DICT_APRILTAG") and tags_are_turned():
        pattern = pattern[::-1, ::-1]
    border = int(round(0.5 * (page - 1.0) * size))
    return np.pad(pattern, border, constant_values=True).astype(float), side / size


def tags_are_turned() -> bool:
    """Whether OpenCV draws AprilTags upside down, against the print of tag 0 of family 36h11."""
    entry = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    drawn = cv2.aruco.generateImageMarker(entry, 0, 8) > 127
    upright = np.array([list(row) for row in ("110101", "011101", "011000", "101000", "010110", "000100")])
    cells = drawn[1:-1, 1:-1]
    assert (cells == (upright == "1")).all() or (cells[::-1, ::-1] == (upright == "1")).all()
    return not (cells == (upright == "1")).all()


def board_page(board, square: float, pixels: int = 80) -> tuple[np.ndarray, float]:
    """A ChArUco board with a white rim one square wide: picture of 0 and 1, metres a pixel."""
    columns, rows = board.getChessboardSize()
    drawn = board.generateImage((columns * pixels, rows * pixels)) > 127
    return np.pad(drawn, pixels, constant_values=True).astype(float), square / pixels


def render(
    page: np.ndarray,
    metres: float,
    matrix: np.ndarray,
    world_from_camera: np.ndarray,
    size: tuple[int, int],
    *,
    distortion=None,
    world_from_page: np.ndarray | None = None,
    onto: np.ndarray | None = None,
    samples: int = 4,
) -> np.ndarray:
    """Linear picture (height, width) of a page that lies in z = 0 of `world_from_page`, its centre at 0.

    `matrix` (3, 3) with pixel centres at half integers. White is 0.8, ink 0.04, the table 0.3.
    """
    width, height = size
    step = 1.0 / samples
    x = (np.arange(width * samples) + 0.5) * step
    y = (np.arange(height * samples) + 0.5) * step
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 1, 2)
    if distortion is None:
        rays = (points[:, 0] - matrix[:2, 2]) / np.diag(matrix)[:2]
    else:
        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-12)
        rays = cv2.undistortPoints(points, matrix, np.asarray(distortion), criteria=criteria)[:, 0]
    page_from_camera = world_from_camera
    if world_from_page is not None:
        page_from_camera = np.linalg.inv(world_from_page) @ world_from_camera
    d = np.column_stack([rays, np.ones(len(rays))]) @ page_from_camera[:3, :3].T
    eye = page_from_camera[:3, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        t = -eye[2] / d[:, 2]
        u = (eye[0] + t * d[:, 0]) / metres + 0.5 * page.shape[1]
        v = 0.5 * page.shape[0] - (eye[1] + t * d[:, 1]) / metres
        on = (t > 0) & (u >= 0) & (u < page.shape[1]) & (v >= 0) & (v < page.shape[0])
    background = np.full((height, width), 0.3) if onto is None else onto
    value = np.repeat(np.repeat(background, samples, axis=0), samples, axis=1).ravel()
    value[on] = 0.04 + 0.76 * page[v[on].astype(int), u[on].astype(int)]
    return value.reshape(height, samples, width, samples).mean(axis=(1, 3))


def photograph(linear: np.ndarray, noise: float = 0.01, seed: int = 1, blur: float = 0.0) -> np.ndarray:
    """8-bit sRGB codes of a linear picture, with lens blur (sigma in pixels) and Gaussian noise."""
    if blur:
        linear = cv2.GaussianBlur(linear, (0, 0), blur)
    noisy = linear + np.random.default_rng(seed).normal(0.0, noise, linear.shape) * np.sqrt(linear)
    x = np.clip(noisy, 0.0, 1.0)
    return np.round(255 * np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)).astype(
        np.uint8
    )


def errors(found: np.ndarray, truth: np.ndarray) -> tuple[float, float]:
    """Angle in degrees and distance in metres between two poses (4, 4)."""
    cosine = 0.5 * (np.trace(found[:3, :3].T @ truth[:3, :3]) - 1.0)
    # the chord is accurate where the arc cosine is not
    chord = np.linalg.norm(found[:3, :3] - truth[:3, :3]) / np.sqrt(8.0)
    angle = 2.0 * np.arcsin(min(chord, 1.0)) if cosine > 0 else np.arccos(max(cosine, -1.0))
    return float(np.degrees(angle)), float(np.linalg.norm(found[:3, 3] - truth[:3, 3]))
