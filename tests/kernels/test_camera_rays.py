"""Camera rays against float64 references: OpenCV's projection, and inversion by bisection."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import warp as wp

from mrbatch.kernels.camera import (
    CameraData,
    CameraRay,
    camera_data,
    has_distortion,
    make_camera,
    radial_limit,
)
from mrbatch.scene.camera import Camera

WIDTH, HEIGHT = 640, 480
MILD = [-0.28, 0.09, 1e-3, -5e-4, -0.012, 0.0, 0.0, 0.0]
RATIONAL = [0.8, -0.3, 4e-4, -3e-4, 0.02, 1.1, -0.2, -0.05]
CASES = {"k1 -.4": [-0.4] + [0.0] * 7, "k1 +.4": [0.4] + [0.0] * 7, "mild": MILD, "rational": RATIONAL}


@wp.struct
class Points:
    x: wp.array(dtype=float)
    y: wp.array(dtype=float)
    p: wp.array(dtype=wp.vec3)


def _kernels(model, distortion):
    funcs = make_camera(model, distortion)
    ray, project = funcs.ray, funcs.project

    @wp.kernel(enable_backward=False, module="unique")
    def rays(cam: CameraData, points: Points, out: wp.array(dtype=CameraRay)):
        i = wp.tid()
        out[i] = ray(cam, points.x[i], points.y[i])

    @wp.kernel(enable_backward=False, module="unique")
    def projections(cam: CameraData, points: Points, out: wp.array(dtype=wp.vec3)):
        i = wp.tid()
        out[i] = project(cam, points.p[i])

    return rays, projections


_made = {}


def _kernel(camera, which):
    key = (camera.model, has_distortion(camera))
    if key not in _made:
        _made[key] = _kernels(*key)
    return _made[key][which]


def rays(camera, pixels, origin=(0.0, 0.0, 0.0)):
    """(directions (n, 3), ok (n,), origins (n, 3)) of float32 pixels."""
    xy = np.asarray(pixels, dtype=np.float32)
    points = Points()
    points.x = wp.array(xy[:, 0].copy(), dtype=float, device="cpu")
    points.y = wp.array(xy[:, 1].copy(), dtype=float, device="cpu")
    out = wp.zeros(len(xy), dtype=CameraRay, device="cpu")
    data = camera_data(camera, np.asarray(origin))
    wp.launch(_kernel(camera, 0), len(xy), [data, points], [out], device="cpu")
    a = out.numpy()
    return a["direction"].astype(np.float64), a["ok"].astype(bool), a["origin"].astype(np.float64)


def project(camera, points, origin=(0.0, 0.0, 0.0)):
    given = Points()
    given.p = wp.array(np.asarray(points, dtype=np.float32), dtype=wp.vec3, device="cpu")
    out = wp.zeros(len(points), dtype=wp.vec3, device="cpu")
    data = camera_data(camera, np.asarray(origin))
    wp.launch(_kernel(camera, 1), len(points), [data, given], [out], device="cpu")
    return out.numpy().astype(np.float64)


def looking(rvec=(2.6, 0.3, -0.2), position=(0.2, -0.5, 0.9)) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3] = cv2.Rodrigues(np.asarray(rvec, dtype=np.float64))[0]
    pose[:3, 3] = position
    return pose


def camera(distortion=None, pose=None, *, focal=520.0, skew=0.0) -> Camera:
    k = np.array([[focal, skew, 321.3], [0.0, focal + 3.0, 238.8], [0.0, 0.0, 1.0]])
    d = np.zeros(8) if distortion is None else np.asarray(distortion)
    return Camera.from_opencv(WIDTH, HEIGHT, k, d, np.eye(4) if pose is None else pose)


def grid() -> np.ndarray:
    """Pixel centres with the picture's rim."""
    x = np.concatenate([[0.0], np.arange(0.5, WIDTH, 31.0), [WIDTH]])
    y = np.concatenate([[0.0], np.arange(0.5, HEIGHT, 23.0), [HEIGHT]])
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2).astype(np.float32)


def opencv_pixels(cam, points) -> np.ndarray:
    """cv2.projectPoints in our pixel coordinates: OpenCV's pixel centres are integers, ours halves."""
    pose = cam.camera_from_world
    rvec = cv2.Rodrigues(pose[:3, :3])[0]
    xy, _ = cv2.projectPoints(
        np.asarray(points, np.float64), rvec, pose[:3, 3], cam.opencv_matrix(), cam.distortion
    )
    return xy.reshape(-1, 2) + 0.5


@pytest.mark.case("MRK-07", "TRAP-3h")
@pytest.mark.parametrize("name", list(CASES))
def test_mrk_07_rays_meet_what_opencv_projects(name):
    """MRK-07: k1 = +-.4 with points up to the picture's rim, against OpenCV in float64, .1 px allowed.

    The ray of each pixel, followed and projected by OpenCV, returns to its pixel within float noise.
    """
    cam = camera(CASES[name], looking(), focal=700.0)
    pixels = grid()
    direction, ok, origin = rays(cam, pixels)
    assert ok.all()
    np.testing.assert_allclose(np.linalg.norm(direction, axis=1), 1.0, atol=3e-7)
    back = opencv_pixels(cam, cam.world_from_camera[:3, 3] + 3.0 * direction)
    np.testing.assert_allclose(back, pixels, atol=2e-3)
    np.testing.assert_allclose(origin, np.tile(cam.world_from_camera[:3, 3], (len(pixels), 1)), rtol=1e-7)


@pytest.mark.parametrize("name", list(CASES))
def test_projection_agrees_with_opencv_and_the_host(name):
    cam = camera(CASES[name], looking(), focal=700.0)
    direction, _, origin = rays(cam, grid())
    points = (origin + direction * np.linspace(0.3, 9.0, len(direction))[:, None]).astype(np.float32)
    got = project(cam, points)
    np.testing.assert_allclose(got[:, :2], opencv_pixels(cam, points), atol=2e-3)
    host, z = cam.project(points)
    np.testing.assert_allclose(got[:, :2], host, atol=2e-3)
    np.testing.assert_allclose(got[:, 2], z, rtol=1e-6)


@pytest.mark.parametrize("distortion", [None, *CASES.values()])
def test_ray_of_projection_returns(distortion):
    cam = camera(distortion, focal=700.0, skew=0.7)
    direction, ok, _ = rays(cam, grid())
    got = project(cam, direction * 2.0)
    again, ok2, _ = rays(cam, got[:, :2])
    assert ok.all() and ok2.all()
    # Pixels near 640 are rounded to 6e-5 / 700 = 9e-8 rad; some roundings of that.
    np.testing.assert_allclose(again, direction, atol=6e-7)


def test_pixel_centres_are_half_integers():
    k = np.array([[500.0, 0.0, 320.0], [0.0, 500.0, 240.0], [0.0, 0.0, 1.0]])
    cam = Camera(WIDTH, HEIGHT, k, np.zeros(8), np.eye(4))
    direction, ok, _ = rays(cam, [[320.0, 240.0], [320.5, 240.0]])
    assert ok.all()
    np.testing.assert_array_equal(direction[0], [0.0, 0.0, 1.0])
    np.testing.assert_allclose(direction[1] / direction[1, 2], [0.5 / 500.0, 0.0, 1.0], atol=1e-9)


def _inverse_radius(k1: float, rd: float) -> float:
    """Root of r (1 + k1 r^2) = rd on the branch from 0, by bisection in float64."""
    low, high = 0.0, np.sqrt(-1.0 / (3.0 * k1)) if k1 < 0.0 else rd
    for _ in range(200):
        middle = 0.5 * (low + high)
        if middle * (1.0 + k1 * middle**2) < rd:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


@pytest.mark.parametrize("k1", [-0.4, 0.4])
def test_undistortion_up_to_the_fold(k1):
    """A barrel r (1 - .4 r^2) grows up to r = .913, rd = .6086: beyond there is no ray."""
    cam = camera([k1] + [0.0] * 7, focal=300.0)
    rd = np.concatenate([np.linspace(0.0, 0.6, 61), [0.607, 0.6084]])
    pixels = np.stack([cam.matrix[0, 0] * rd + cam.matrix[0, 2], np.full(len(rd), cam.matrix[1, 2])], axis=1)
    direction, ok, _ = rays(cam, pixels)
    assert ok.all()
    got = direction[:, 0] / direction[:, 2]
    wanted = np.array([_inverse_radius(k1, r) for r in rd])
    # What the pixel's rounding (about 2^-15 px) moves the root by, with the model's slope.
    slope = 1.0 + 3.0 * k1 * wanted**2
    assert (np.abs(got - wanted) <= 4e-7 / slope + 4e-7).all()


def test_outside_the_invertible_region_there_is_no_ray():
    cam = camera([-0.4] + [0.0] * 7, focal=300.0)
    for rd in (0.6095, 0.65, 0.9, 1.5, 5.0, 100.0):
        pixels = [[cam.matrix[0, 0] * rd + cam.matrix[0, 2], cam.matrix[1, 2]]]
        direction, ok, _ = rays(cam, pixels)
        assert not ok[0]
        assert np.isfinite(direction).all()


def test_points_past_the_fold_are_not_projected_into_the_picture():
    cam = camera([-0.4] + [0.0] * 7, focal=300.0)
    x = np.array([0.5, 0.9, 0.95, 1.3, 1.58, 3.0])
    got = project(cam, np.stack([2.0 * x, 0.0 * x, 2.0 + 0.0 * x], axis=1))
    assert (got[:2, 2] == 2.0).all()
    assert (got[2:, 2] <= 0.0).all()


@pytest.mark.parametrize("distortion", [None, MILD])
def test_points_behind_have_no_depth(distortion):
    got = project(camera(distortion), [[0.1, 0.2, -1.0], [0.3, 0.1, 0.0], [0.0, 0.0, 1.0]])
    assert got[0, 2] <= 0.0 and got[1, 2] <= 0.0 and got[2, 2] == 1.0
    assert np.isfinite(got).all()


@pytest.mark.parametrize(
    ("distortion", "limit"),
    [
        ([0.0] * 8, np.inf),
        ([0.4] + [0.0] * 7, np.inf),
        ([-0.4] + [0.0] * 7, 1.0 / 1.2),
        ([0.0, 0.0, 0.0, 0.0, 0.0, -0.5, 0.0, 0.0], 2.0),
    ],
)
def test_radial_limit(distortion, limit):
    assert radial_limit(np.array(distortion)) == pytest.approx(limit, rel=1e-12)


def test_far_origin_is_subtracted_in_float64():
    shift = np.array([4.0e6, -1.0e6, 2.0e5])
    near, far = camera(None, looking()), camera(None, looking())
    moved = far.world_from_camera.copy()
    moved[:3, 3] += shift
    a = rays(near, grid())
    b = rays(far.at(moved), grid(), shift)
    np.testing.assert_array_equal(a[0], b[0])
    np.testing.assert_allclose(a[2], b[2], atol=1e-9 * 4e6)


def panorama(pose=None) -> Camera:
    return Camera(64, 32, np.eye(3), np.zeros(8), np.eye(4) if pose is None else pose, "equirectangular")


def test_equirectangular_convention():
    """u = 1/2 - atan2(y, x) / (2 pi), v = acos(z) / pi: +x at the centre, +y to the left, +z on top."""
    direction, ok, _ = rays(panorama(), [[32, 16], [16, 16], [48, 16], [32, 0], [32, 32]])
    assert ok.all()
    wanted = [[1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]]
    np.testing.assert_allclose(direction, wanted, atol=3e-7)


def test_equirectangular_against_its_formula_and_back():
    cam = panorama(looking())
    x, y = np.meshgrid(np.arange(0.5, 64), np.arange(0.5, 32))
    pixels = np.stack([x.ravel(), y.ravel()], axis=1)
    direction, ok, _ = rays(cam, pixels)
    local = direction @ cam.world_from_camera[:3, :3]
    u = 0.5 - np.arctan2(local[:, 1], local[:, 0]) / (2.0 * np.pi)
    v = np.arccos(np.clip(local[:, 2], -1, 1)) / np.pi
    assert ok.all()
    np.testing.assert_allclose(np.stack([64 * u, 32 * v], axis=1), pixels, atol=2e-4)
    got = project(cam, cam.world_from_camera[:3, 3] + 2.5 * direction)
    np.testing.assert_allclose(got[:, :2], pixels, atol=2e-4)
    np.testing.assert_allclose(got[:, 2], 2.5, rtol=1e-6)


def test_equirectangular_has_no_ray_above_or_below():
    _, ok, _ = rays(panorama(), [[3, -0.5], [3, 32.5], [-1.0, 3.0]])
    np.testing.assert_array_equal(ok, [False, False, True])


def test_make_camera():
    assert make_camera("perspective", True) is make_camera("perspective", True)
    with pytest.raises(ValueError, match="fisheye"):
        make_camera("fisheye")
    with pytest.raises(ValueError, match="distortion"):
        make_camera("equirectangular", True)
    assert has_distortion(camera(MILD)) and not has_distortion(camera())
    with pytest.raises(ValueError, match="focal"):
        camera_data(camera(None, focal=0.0), np.zeros(3))
