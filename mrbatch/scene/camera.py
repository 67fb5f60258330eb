"""Cameras: where a picture was taken from and how its pixels map to directions.

Camera frame: OpenCV (x right, y down, z forward). Pixel centres at half integers, row 0 at the top:
OpenCV's own `K` has pixel centres at integers, so a principal point from OpenCV is moved by +1/2
when it enters (`from_opencv`). Panorama frame: x to the picture's centre, z up.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from mrbatch.scene.lens import Lens

UNDONE = 1e-3
"""Pixels by which a direction may miss the pixel that it was found for."""


@dataclass(frozen=True)
class Camera:
    """A camera with its pose.

    `matrix` (3, 3) float64: focal lengths and principal point in pixels, pixel centres at half
    integers. `distortion` (8,) float64: OpenCV's k1 k2 p1 p2 k3 k4 k5 k6. `world_from_camera` (4, 4)
    float64, a rigid motion, metres. An equirectangular camera uses width, height and pose only.
    `lens`: None for a pinhole.
    """

    width: int
    height: int
    matrix: np.ndarray
    distortion: np.ndarray
    world_from_camera: np.ndarray
    model: Literal["perspective", "equirectangular"] = "perspective"
    lens: Lens | None = None

    @staticmethod
    def from_opencv(
        width: int,
        height: int,
        matrix: np.ndarray,
        distortion: np.ndarray | None,
        world_from_camera: np.ndarray,
        *,
        pixel_centres: Literal["integer", "half"] = "integer",
    ) -> Camera:
        """From OpenCV's calibration; 0, 4, 5 or 8 distortion coefficients are taken.

        Raises ValueError for another number of coefficients (thin prism and tilt are not supported).
        """
        k = np.array(matrix, dtype=np.float64).reshape(3, 3).copy()
        if pixel_centres == "integer":
            k[0, 2] += 0.5
            k[1, 2] += 0.5
        given = np.zeros(0) if distortion is None else np.asarray(distortion, dtype=np.float64).ravel()
        if given.size > 8 and np.any(given[8:] != 0.0):
            raise ValueError(f"{given.size} distortion coefficients: thin prism and tilt are not supported")
        given = given[:8]
        if given.size not in (0, 4, 5, 8):
            raise ValueError(f"{given.size} distortion coefficients: expected 0, 4, 5 or 8")
        d = np.zeros(8)
        d[: given.size] = given
        pose = np.array(world_from_camera, dtype=np.float64).reshape(4, 4)
        return Camera(width, height, k, d, pose)

    def opencv_matrix(self) -> np.ndarray:
        """`matrix` with pixel centres at integers, as OpenCV's functions want it."""
        k = self.matrix.copy()
        k[0, 2] -= 0.5
        k[1, 2] -= 0.5
        return k

    def at(self, world_from_camera: np.ndarray) -> Camera:
        return replace(self, world_from_camera=np.asarray(world_from_camera, dtype=np.float64).reshape(4, 4))

    def with_lens(self, lens: Lens | None) -> Camera:
        return replace(self, lens=lens)

    def scaled(self, width: int, height: int) -> Camera:
        """The same view in another resolution."""
        k = self.matrix.copy()
        k[0] *= width / self.width
        k[1] *= height / self.height
        return replace(self, width=width, height=height, matrix=k)

    @property
    def camera_from_world(self) -> np.ndarray:
        """(4, 4) inverse of the rigid pose."""
        inverse = np.eye(4)
        rotation = self.world_from_camera[:3, :3].T
        inverse[:3, :3] = rotation
        inverse[:3, 3] = -rotation @ self.world_from_camera[:3, 3]
        return inverse

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """World points (n, 3) to pixels (n, 2) and planar depth (n,), distortion included, in float64.

        Points behind the camera get NaN pixels.
        """
        pixels, z = self._project(points, np.zeros((1, 2)))
        return pixels[0], z

    def project_through_rim(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """As `project`, through each corner of the square that holds the lens: pixels (4, n, 2), depth (n,).

        Of a convex body the rays through one point of the lens make a perspective picture, and a point moves
        evenly over it as the point of the lens does: all that is seen of the body lies in the hull of these.
        A pinhole has one corner.
        """
        return self._project(points, np.zeros((1, 2)) if self.lens is None else self.lens.rim)

    def _project(self, points: np.ndarray, through: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        p = np.asarray(points, dtype=np.float64).reshape(-1, 3)
        c = p @ self.camera_from_world[:3, :3].T + self.camera_from_world[:3, 3]
        z = c[:, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            x = np.where(z > 0, c[:, 0] / z, np.nan)[None]
            y = np.where(z > 0, c[:, 1] / z, np.nan)[None]
            if self.lens is not None:
                off = through[:, :, None] * (1.0 / self.lens.focus - 1.0 / z)
                x, y = x + off[:, 0], y + off[:, 1]
        k1, k2, p1, p2, k3, k4, k5, k6 = self.distortion
        r2 = x * x + y * y
        radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
        xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        k = self.matrix
        return np.stack([k[0, 0] * xd + k[0, 1] * yd + k[0, 2], k[1, 1] * yd + k[1, 2]], axis=-1), z

    def directions(self, pixels: np.ndarray) -> np.ndarray:
        """Pixels (n, 2) to directions in the camera's frame (n, 3) float64 with z = 1: undoes `project`.

        NaN beyond the place where the lens folds back. Perspective cameras only.
        """
        given = np.asarray(pixels, dtype=np.float64).reshape(-1, 2)
        rays = np.ones((len(given), 3))
        k = self.matrix
        rays[:, 1] = (given[:, 1] - k[1, 2]) / k[1, 1]
        rays[:, 0] = (given[:, 0] - k[0, 2] - k[0, 1] * rays[:, 1]) / k[0, 0]
        if np.any(self.distortion) and len(given):
            import cv2

            criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-12)
            flat = np.ascontiguousarray(rays[:, None, :2])
            rays[:, :2] = cv2.undistortPoints(flat, np.eye(3), self.distortion, criteria=criteria)[:, 0]
            back = replace(self, world_from_camera=np.eye(4)).project(rays)[0]
            rays[~(np.linalg.norm(back - given, axis=1) < UNDONE)] = np.nan
        return rays
