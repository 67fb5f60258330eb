"""The camera's pose from points of known place: all roots, each at its own least squares minimum.

A flat target seen from afar has two poses that explain it almost equally well, mirror images of each
other about the line of sight (Schweighofer and Pinz 2006). IPPE (Collins and Bartoli 2014) gives both;
each is refined here by Levenberg-Marquardt with the lens distortion and the points' covariance in the
model.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mrbatch.capture.marker_video.calibration import Calibration
from mrbatch.capture.marker_video.markers import Detection

SAME_ROOT = 1e-3
"""Roots whose rotations differ by less (radians) are one and the same minimum."""


@dataclass(frozen=True)
class Root:
    """One pose that explains a picture, at its minimum.

    `world_from_camera` (4, 4) float64, metres. `rms`: root mean square distance of projected and
    detected points, pixels. `chi2`: squared residuals weighted by the points' covariance.
    """

    world_from_camera: np.ndarray
    rms: float
    chi2: float


def exponential(w: np.ndarray) -> np.ndarray:
    """(3, 3) rotation by the vector `w` (radians)."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_rotvec(w).as_matrix()


def angle_between(a: np.ndarray, b: np.ndarray) -> float:
    """Angle in radians between two rotations (3, 3) or poses (4, 4)."""
    from scipy.spatial.transform import Rotation

    return float(np.linalg.norm(Rotation.from_matrix(a[:3, :3].T @ b[:3, :3]).as_rotvec()))


def invert(pose: np.ndarray) -> np.ndarray:
    """(4, 4) inverse of a rigid motion."""
    result = np.eye(4)
    result[:3, :3] = pose[:3, :3].T
    result[:3, 3] = -pose[:3, :3].T @ pose[:3, 3]
    return result


def rigid_from_rvec(rvec: np.ndarray, tvec: np.ndarray) -> np.ndarray:
    """(4, 4) from OpenCV's rotation vector and translation."""
    pose = np.eye(4)
    pose[:3, :3] = exponential(np.asarray(rvec, dtype=np.float64).ravel())
    pose[:3, 3] = np.asarray(tvec, dtype=np.float64).ravel()
    return pose


def project(
    points_3d: np.ndarray, camera_from_world: np.ndarray, calibration: Calibration
) -> tuple[np.ndarray, np.ndarray]:
    """Pixels (n, 2), centres at half integers, and their Jacobian (2n, 6).

    The Jacobian's parameters are a small rotation of the scene about the camera's axes, then a
    small shift of it along them: X' = exp(w) X + t.
    """
    import cv2

    seen = points_3d @ camera_from_world[:3, :3].T + camera_from_world[:3, 3]
    pixels, jacobian = cv2.projectPoints(
        seen, np.zeros(3), np.zeros(3), calibration.opencv_matrix(), calibration.distortion
    )[:2]
    return pixels.reshape(-1, 2) + 0.5, jacobian[:, :6]


def whitening(covariance: np.ndarray) -> np.ndarray:
    """W with W' W = covariance^-1."""
    return np.linalg.inv(np.linalg.cholesky(covariance))


def refine(
    points_3d: np.ndarray,
    points_2d: np.ndarray,
    white: np.ndarray,
    calibration: Calibration,
    camera_from_world: np.ndarray,
) -> Root | None:
    """The least squares minimum next to a first guess; None where the target falls behind the camera."""
    pose = camera_from_world.copy()
    damping = 1e-3
    residual, jacobian = _residual(points_3d, points_2d, white, calibration, pose)
    cost = residual @ residual
    for _ in range(100):
        normal, gradient = jacobian.T @ jacobian, jacobian.T @ residual
        step = np.linalg.lstsq(normal + damping * np.diag(np.diag(normal)), gradient, rcond=None)[0]
        turn, trial = exponential(step[:3]), np.eye(4)
        trial[:3, :3] = turn @ pose[:3, :3]
        trial[:3, 3] = turn @ pose[:3, 3] + step[3:]
        if _behind(points_3d, trial):
            damping *= 10.0
            if damping > 1e9:
                return None
            continue
        new_residual, new_jacobian = _residual(points_3d, points_2d, white, calibration, trial)
        new_cost = new_residual @ new_residual
        if not np.isfinite(new_cost) or new_cost > cost:
            damping *= 10.0
            if damping > 1e9:
                break
            continue
        small = np.linalg.norm(step[:3]) < 1e-10 and np.linalg.norm(step[3:]) < 1e-10 * np.linalg.norm(
            pose[:3, 3]
        )
        done = small or cost - new_cost <= 1e-12 * cost
        pose, residual, jacobian, cost = trial, new_residual, new_jacobian, new_cost
        damping = max(damping / 10.0, 1e-12)
        if done:
            break
    if _behind(points_3d, pose):
        return None
    pixels = project(points_3d, pose, calibration)[0]
    rms = float(np.sqrt(np.mean(np.sum((pixels - points_2d) ** 2, axis=1))))
    # products of rotations drift from orthonormality by rounding
    u, _, vt = np.linalg.svd(pose[:3, :3])
    pose[:3, :3] = u @ vt
    return Root(invert(pose), rms, float(cost))


def _residual(points_3d, points_2d, white, calibration, pose) -> tuple[np.ndarray, np.ndarray]:
    pixels, jacobian = project(points_3d, pose, calibration)
    return white @ (points_2d - pixels).ravel(), white @ jacobian


def _behind(points_3d: np.ndarray, camera_from_world: np.ndarray) -> bool:
    return bool(np.any(points_3d @ camera_from_world[2, :3] + camera_from_world[2, 3] <= 0))


def solve(detection: Detection, calibration: Calibration) -> list[Root]:
    """All roots of one picture, best first: none, one (or one twice over), or two and rarely more.

    Poses that see a marker's back are left out.
    """
    points_3d, points_2d = detection.points_3d, detection.points_2d
    if len(points_3d) < 4:
        return []
    white = whitening(detection.covariance)
    roots: list[Root] = []
    for guess in _guesses(detection, calibration):
        if _behind(points_3d, guess):
            continue
        root = refine(points_3d, points_2d, white, calibration, guess)
        if root is None or _sees_back(points_3d, root):
            continue
        same = [i for i, r in enumerate(roots) if _same(r, root)]
        if not same:
            roots.append(root)
        elif root.chi2 < roots[same[0]].chi2:
            roots[same[0]] = root
    return sorted(roots, key=lambda r: r.chi2)


def _same(a: Root, b: Root) -> bool:
    return angle_between(a.world_from_camera, b.world_from_camera) < SAME_ROOT


def _sees_back(points_3d: np.ndarray, root: Root) -> bool:
    """Whether print is seen from behind."""
    eye = root.world_from_camera[:3, 3]
    if np.ptp(points_3d[:, 2]) == 0.0:
        return bool(eye[2] <= points_3d[0, 2])
    # of a marker (bottom right - top left) x (top right - top left) points out of the page
    quads = points_3d.reshape(-1, 4, 3)
    normals = np.cross(quads[:, 2] - quads[:, 0], quads[:, 1] - quads[:, 0])
    return bool(np.any(np.sum(normals * (eye - quads[:, 0]), axis=1) <= 0))


def _guesses(detection: Detection, calibration: Calibration) -> list[np.ndarray]:
    """First guesses of camera_from_world (4, 4)."""
    import cv2

    points_3d, points_2d = detection.points_3d, detection.points_2d
    centred = points_3d - points_3d.mean(axis=0)
    spread = np.linalg.svd(centred, compute_uv=False)
    if spread[1] <= 1e-9 * spread[0]:
        return []
    guesses: list[np.ndarray] = []
    if spread[2] <= 1e-7 * spread[0]:
        return _opencv(points_3d, points_2d, calibration, cv2.SOLVEPNP_IPPE)
    guesses += _opencv(points_3d, points_2d, calibration, cv2.SOLVEPNP_SQPNP)
    for i in np.unique(detection.ids):
        chosen = detection.ids == i
        if chosen.sum() == 4:
            guesses += _opencv(points_3d[chosen], points_2d[chosen], calibration, cv2.SOLVEPNP_IPPE)
    return guesses


def _opencv(points_3d, points_2d, calibration: Calibration, method: int) -> list[np.ndarray]:
    import cv2

    try:
        _, rvecs, tvecs, _ = cv2.solvePnPGeneric(
            np.ascontiguousarray(points_3d),
            np.ascontiguousarray(points_2d - 0.5),
            calibration.opencv_matrix(),
            calibration.distortion,
            flags=method,
        )
    except cv2.error:
        return []
    poses = [rigid_from_rvec(r, t) for r, t in zip(rvecs, tvecs, strict=True)]
    return [pose for pose in poses if np.all(np.isfinite(pose))]


def reprojection_rms(world_from_camera: np.ndarray, detection: Detection, calibration: Calibration) -> float:
    """Root mean square distance in pixels of detected points from where a pose (4, 4) puts them."""
    pixels = project(detection.points_3d, invert(world_from_camera), calibration)[0]
    return float(np.sqrt(np.mean(np.sum((pixels - detection.points_2d) ** 2, axis=1))))


def pose_covariance(root: Root, detection: Detection, calibration: Calibration) -> np.ndarray:
    """(6, 6) covariance: rotation about the camera's axes (radians), then its place in the world (metres).

    First order, from the points' covariance: (J' C^-1 J)^-1. With X' = exp(w) X + t the camera's
    place moves by -R' t, R the rotation of camera_from_world.
    """
    pose = invert(root.world_from_camera)
    jacobian = whitening(detection.covariance) @ project(detection.points_3d, pose, calibration)[1]
    covariance = np.linalg.pinv(jacobian.T @ jacobian, hermitian=True)
    change = np.eye(6)
    change[3:, 3:] = -pose[:3, :3].T
    return change @ covariance @ change.T
