"""Depth of field against the thin lens worked out by hand: how far a point spreads, what stays as it was."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mrbatch.methods.delta_path_tracing import METHOD as DELTA
from mrbatch.methods.estimate import estimate
from mrbatch.methods.image_based_lighting import METHOD as IBL
from mrbatch.methods.one_pass import METHOD as ONE_PASS
from mrbatch.methods.two_pass import METHOD as TWO_PASS
from mrbatch.scene.camera import Camera
from mrbatch.scene.closed_forms import real, scene_of, virtual
from mrbatch.scene.environment import Environment
from mrbatch.scene.lens import Lens
from mrbatch.scene.mesh import Mesh, plane
from mrbatch.scene.scene import Material, SceneObject

WIDTH, HEIGHT, FOCAL = 48, 40, 300.0
LIGHT = 7.0
BLACK = Environment(np.zeros((2, 4, 3), np.float32))


def disc(radius: float, at, sides: int = 48) -> Mesh:
    """A regular polygon, facing down the camera's axis."""
    angle = np.arange(sides) * 2 * np.pi / sides
    rim = np.stack([np.cos(angle), np.sin(angle), np.zeros(sides)], axis=1) * radius
    faces = [[0, k + 1, (k + 1) % sides + 1] for k in range(sides)]
    return Mesh(np.vstack([[0, 0, 0], rim]) + at, np.array(faces, np.int32))


def lamp(radius, at) -> SceneObject:
    return SceneObject("lamp", disc(radius, at), Material(reflectance=(0, 0, 0), emission=(LIGHT,) * 3), True)


def camera(lens: Lens | None, distortion=None, centre=(WIDTH / 2, HEIGHT / 2)) -> Camera:
    """At the origin, looking along +z."""
    k = np.array([[FOCAL, 0, centre[0]], [0, FOCAL, centre[1]], [0, 0, 1]])
    d = np.zeros(8) if distortion is None else np.asarray(distortion, np.float64)
    return Camera(WIDTH, HEIGHT, k, d, np.eye(4), lens=lens)


def moments(picture: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Sum, centre (x, y) and covariance (2, 2), pixels."""
    y, x = np.mgrid[: picture.shape[0], : picture.shape[1]] + 0.5
    total = picture.sum()
    points = np.stack([x.ravel(), y.ravel()])
    weights = picture.ravel() / total
    centre = points @ weights
    off = points - centre[:, None]
    return total, centre, (off * weights) @ off.T


def polygon_variance(radius: float, sides: int = 48) -> float:
    """Along x, of an even spread over a regular polygon."""
    inner = radius * np.cos(np.pi / sides)
    return (inner**2 * 2 + radius**2) / 3 / 4


SPREAD = polygon_variance(1.0)


@pytest.mark.slow
@pytest.mark.parametrize("method", [DELTA, IBL, ONE_PASS, TWO_PASS], ids=lambda m: m.name)
@pytest.mark.parametrize(("depth", "focus"), [(2.0, 3.0), (3.0, 1.5)])
def test_a_point_spreads_over_the_circle_of_confusion(method, depth, focus):
    """A small disc at z becomes a disc of A f |z - zf| / (z (zf - f)) / pitch, as bright in all."""
    lens = Lens(radius=0.12, focus=focus)
    small = 1.0 * depth / FOCAL
    found = estimate(method, scene_of([lamp(small, (0, 0, depth))], BLACK), camera(lens), spp=8192).developed
    # Of a lens whose picture lies v = f zf / (zf - f) behind it, in pixels of this pitch: v / pitch = FOCAL.
    pitch = 5e-6
    v = FOCAL * pitch
    f = v * focus / (v + focus)
    confusion = 2 * lens.radius * f * abs(depth - focus) / (depth * (focus - f)) / pitch
    assert 10 < confusion < 40
    total, centre, covariance = moments(found.a)
    # An even disc of diameter c has the variance c^2 / 16 along each axis, a pixel 1 / 12.
    expected = (confusion / 2) ** 2 / 4 + SPREAD + 1 / 12
    np.testing.assert_allclose(np.diag(covariance), expected, rtol=0.03)
    assert abs(covariance[0, 1]) < 0.02 * expected
    np.testing.assert_allclose(centre, [WIDTH / 2, HEIGHT / 2], atol=0.05 * confusion / 2)
    # Diameter and radius taken for each other would be a factor of 4.
    assert not np.isclose(covariance[0, 0], confusion**2 / 4, rtol=0.5)
    area = 48 / 2 * np.sin(2 * np.pi / 48)
    assert total == pytest.approx(area, rel=0.05)
    np.testing.assert_allclose(found.P[..., 0], LIGHT * found.a, rtol=1e-6)
    # Even inside, nothing outside.
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5 - np.array([HEIGHT / 2, WIDTH / 2])[:, None, None]
    r = np.hypot(x, y)
    assert not found.a[r > confusion / 2 + 1.8].any()
    inside = found.a[r < confusion / 2 - 1.8]
    assert inside.mean() == pytest.approx(area / (np.pi * confusion**2 / 4), rel=0.05)


def test_the_plane_in_focus_is_flat():
    """Off the axis too what lies at the planar depth of the focus is sharp: distance along the ray, the wrong
    reading of it, would blur it."""
    lens = Lens(radius=0.3, focus=2.0)
    here = camera(lens, centre=(-200.0, HEIGHT / 2))
    at = np.array([(24 + 200.0) / FOCAL * 2.0, 0.0, 2.0])
    scene = scene_of([lamp(6 * 2.0 / FOCAL, at)], BLACK)
    blurred, sharp = (
        estimate(DELTA, scene, replace(here, lens=each), spp=256, forced={"depth-of-field": word}).developed
        for each, word in ((lens, "on"), (None, "auto"))
    )
    assert moments(blurred.a)[2][0, 0] == pytest.approx(moments(sharp.a)[2][0, 0], rel=1e-3)
    wrong = 2 * lens.radius * FOCAL * abs(1 / 2.0 - 1 / (2.0 * 2.0 / np.linalg.norm(at)))
    assert wrong > 10


@pytest.mark.slow
def test_distortion_bends_the_blurred_picture():
    """The thin lens lies in front of the distortion: a point spreads over the image of its disc."""
    distortion = [-0.3, 0.1, 2e-3, -1e-3, 0, 0, 0, 0]
    lens = Lens(radius=0.08, focus=1.5)
    here = camera(lens, distortion, centre=(-100.0, -60.0))
    depth = 2.5
    confusion = 2 * lens.radius * FOCAL * abs(1 / depth - 1 / lens.focus)
    # The point whose picture is the middle of ours.
    target, q = np.array([WIDTH / 2, HEIGHT / 2]), np.array([0.4, 0.3])
    for _ in range(50):
        q = q + (target - here.project(np.array([[*q, 1.0]]))[0][0]) / FOCAL
    h = 1e-5
    jacobian = np.stack(
        [
            (here.project([[*(q + d), 1.0]])[0][0] - here.project([[*(q - d), 1.0]])[0][0]) / (2 * h)
            for d in (np.array([h, 0]), np.array([0, h]))
        ],
        axis=1,
    )
    small = 1.0 * depth / FOCAL
    scene = scene_of([lamp(small, np.array([*q, 1.0]) * depth)], BLACK)
    found = estimate(DELTA, scene, here, spp=8192).developed
    _, centre, covariance = moments(found.a)
    even = (confusion / 2 / FOCAL) ** 2 / 4 + (1.0 / FOCAL) ** 2 * SPREAD
    expected = jacobian @ jacobian.T * even + np.eye(2) / 12
    np.testing.assert_allclose(covariance, expected, atol=0.03 * expected[0, 0])
    # A round spot, as without distortion, is not what is found.
    assert np.abs(covariance - (np.eye(2) * (even * FOCAL**2 + 1 / 12))).max() > 0.1 * expected[0, 0]
    np.testing.assert_allclose(centre, target, atol=0.3)


def desk(height=0.03):
    floor = real("floor", plane(20, 20, centre=(0, 0, 0)), 0.6)
    card = virtual("card", plane(0.4, 0.4, centre=(0, 0, height)), 0.2, camera=False)
    return scene_of([floor, card])


def above(lens, focal=60.0, tall=2.0):
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[2, 3] = tall
    k = np.array([[focal, 0, WIDTH / 2], [0, focal, HEIGHT / 2], [0, 0, 1]])
    return Camera(WIDTH, HEIGHT, k, np.zeros(8), pose, lens=lens)


@pytest.mark.slow
def test_shadows_out_of_focus_are_blurred():
    """The change on a floor at one depth is the sharp one, averaged over the circle of confusion."""
    lens = Lens(radius=0.15, focus=1.0)
    photo = np.ones((HEIGHT, WIDTH, 3), np.float32)
    sharp = estimate(DELTA, desk(), above(None), spp=1024, background=photo).developed.D[..., 0]
    out_of_focus = estimate(DELTA, desk(), above(lens), spp=1024, background=photo).developed
    soft, noise = out_of_focus.D[..., 0], np.sqrt(out_of_focus.variance[..., 0])
    radius = lens.radius * 60.0 * abs(1 / 2.0 - 1 / 1.0)
    assert radius > 4
    # Convolved with the even disc: exact in the middle, where the disc stays in the picture.
    grid = (np.arange(-60, 61)) / 10
    y, x = np.meshgrid(grid, grid, indexing="ij")
    offsets = np.stack([x, y], -1)[np.hypot(x, y) <= radius]
    from scipy.ndimage import map_coordinates

    for row, column in ((20, 24), (20, 30), (14, 24), (26, 18)):
        points = [row + offsets[:, 1], column + offsets[:, 0]]
        expected = map_coordinates(sharp, points, order=1).mean()
        assert soft[row, column] == pytest.approx(expected, abs=4 * noise[row, column])
    assert np.abs(soft - sharp).max() > 8 * noise.max()


def test_edges_out_of_focus_cover_their_share():
    """Half a plane before the focus: its coverage is the share of the lens that sees it, and the light on the
    floor beside it counts for the rest."""
    lens = Lens(radius=0.1, focus=2.0)
    card = virtual("card", plane(4.0, 4.0, centre=(2.0, 0, 1.0)), 0.3)
    floor = real("floor", plane(20, 20), 0.5)
    photo = np.full((HEIGHT, WIDTH, 3), 0.5, np.float32)
    scene = scene_of([card, floor])
    found = estimate(DELTA, scene, above(lens, focal=120.0), spp=2048, background=photo).developed
    c = lens.radius * 120.0 * abs(1 / 1.0 - 1 / 2.0)
    # Edge at x = 0, seen in the middle: circular segment beyond s, averaged over the pixel.
    s = (np.arange(WIDTH)[:, None] + (np.arange(16) + 0.5) / 16 - WIDTH / 2) / c
    t = np.clip(s, -1, 1)
    share = (0.5 + (t * np.sqrt(1 - t * t) + np.arcsin(t)) / np.pi).mean(axis=1)
    np.testing.assert_allclose(found.a[20], share, atol=0.02)
    assert 0.2 < share[24] < 0.8 and c > 5
    uncovered = found.a == 0
    assert uncovered.any() and (found.a[~uncovered] < 0.999).any()
    # What is uncovered keeps its photo: the change there is no larger than the floor's own, share by share.
    assert np.all(np.abs(found.D[..., 0]) <= 0.5 * (1 - found.a) + 1e-6)


@pytest.mark.parametrize("method", [DELTA, IBL, ONE_PASS, TWO_PASS], ids=lambda m: m.name)
def test_a_closed_aperture_is_a_pinhole(method):
    """The same bits, tiles and verdict as with no lens at all."""
    scene = scene_of([virtual("card", plane(0.4, 0.4, centre=(0, 0, 0.3))), real("floor", plane(20, 20))])
    none = estimate(method, scene, above(None), spp=8)
    closed = estimate(method, scene, above(Lens(0.0, 1.0)), spp=8)
    assert closed.plan.effects["depth-of-field"].state == "absent"
    for part in ("P", "a", "D", "variance"):
        assert np.array_equal(getattr(none.developed, part), getattr(closed.developed, part))
    assert closed.counters == none.counters


def test_what_blurs_under_half_a_pixel_is_left_out():
    scene = desk()
    limit = 0.5 / (2 * 60.0 * abs(1 / 2.0 - 1 / 1.0))
    for radius, state in ((0.98 * limit, "negligible"), (1.02 * limit, "needed")):
        plan = estimate(DELTA, scene, above(Lens(radius, 1.0)), spp=2).plan
        assert plan.effects["depth-of-field"].state == state
    sharp = estimate(DELTA, scene, above(None), spp=4)
    off = estimate(DELTA, scene, above(Lens(0.2, 1.0)), spp=4, forced={"depth-of-field": "off"})
    assert np.array_equal(sharp.developed.D, off.developed.D)


def test_tiles_reach_as_far_as_the_blur():
    """All that changes lies in tiles that are done: the same bits as with every tile."""
    scene = scene_of([lamp(0.01, (0.0, 0.0, 0.5))], BLACK)
    pose = np.eye(4)
    k = np.array([[FOCAL, 0, 100.0], [0, FOCAL, 80.0], [0, 0, 1]])
    lens = Lens(0.02, 1.0)
    here = Camera(200, 160, k, np.zeros(8), pose, lens=lens)
    found = estimate(DELTA, scene, here, spp=256)
    y, x = np.nonzero(found.developed.a)
    radius = lens.radius * FOCAL * abs(1 / 0.5 - 1)
    assert np.hypot(x + 0.5 - 100, y + 0.5 - 80).max() == pytest.approx(radius + 0.01 / 0.5 * FOCAL, abs=1.5)
    tiles = found.plan.tiles[0, ""]
    assert 0 < len(tiles) < 130
