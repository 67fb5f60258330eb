"""Maps turned by lamps in a mirror ball: pictures of a ball traced in closed form, under known rotations."""

from __future__ import annotations

import math

import numpy as np
import OpenImageIO as oiio
import pytest
from pydantic import ValidationError
from scipy.spatial.transform import Rotation

from mrbatch.errors import InputError
from mrbatch.scene.alignment_settings import Alignment, Probe
from mrbatch.scene.camera import Camera
from mrbatch.scene.environment import Environment, load_environment
from mrbatch.scene.light_probe import align_by_ball
from mrbatch.scene.mirror_ball import (
    ball_from_circle,
    ball_from_outline,
    ball_from_world,
    ball_pixels,
    reflected,
)

WIDTH, HEIGHT = 320, 240
K = np.array([[420.0, 0.0, 158.3], [0.0, 423.0, 121.9], [0.0, 0.0, 1.0]])
POSE = np.eye(4)
POSE[:3, :3] = Rotation.from_euler("xyz", [-115, 8, 31], degrees=True).as_matrix()
POSE[:3, 3] = [0.4, -0.8, 0.6]
CAMERA = Camera.from_opencv(WIDTH, HEIGHT, K, None, POSE, pixel_centres="half")
RADIUS = 0.05
CENTRE = (POSE @ [0.085, -0.05, 0.42, 1.0])[:3]  # 13 degrees beside the axis
LAMPS = ((0.5, 0.3, 0.8), (-0.7, 0.2, 0.35), (0.1, -0.9, 0.5))


def sky(d, lamps=LAMPS, powers=(60.0, 25.0, 40.0), size=4.0):
    """Radiance (n,) of directions in the map's frame: a gradient, some large soft spots, and lamps."""
    d = d / np.linalg.norm(d, axis=-1, keepdims=True)
    value = 0.25 + 0.15 * d[..., 2]
    for k, spot in enumerate(((1, 0, 0), (-0.3, 0.8, -0.4), (0, -0.5, -0.8))):
        value = value + 0.2 * (1 + k) * np.exp(6.0 * (d @ (np.array(spot) / np.linalg.norm(spot)) - 1.0))
    for lamp, power in zip(lamps, powers):
        angle = np.arccos(np.clip(d @ (np.array(lamp) / np.linalg.norm(lamp)), -1, 1))
        value = value + power * np.clip((math.radians(size) - angle) / math.radians(0.4), 0.0, 1.0)
    return value


def even(d):
    """A sky without lamps, somewhat brighter above."""
    return 0.3 + 0.1 * d[..., 2]


def map_of(light=sky, width=512):
    height = width // 2
    azimuth = 2 * np.pi * (0.5 - (np.arange(width) + 0.5) / width)
    polar = np.pi * (np.arange(height) + 0.5) / height
    d = np.stack(
        [
            np.sin(polar)[:, None] * np.cos(azimuth),
            np.sin(polar)[:, None] * np.sin(azimuth),
            np.repeat(np.cos(polar)[:, None], width, axis=1),
        ],
        axis=-1,
    )
    return Environment(np.repeat(light(d)[..., None], 3, axis=-1).astype(np.float32))


def picture_of(turn, light=sky, *, exposure=1.0, ceiling=np.inf, side=3, centre=CENTRE):
    """(H, W, 3) a perfect mirror ball under the turned light, `side` squared rays a pixel."""
    total = np.zeros((HEIGHT, WIDTH))
    for i in range(side):
        for j in range(side):
            x, y = np.meshgrid(np.arange(WIDTH) + (i + 0.5) / side, np.arange(HEIGHT) + (j + 0.5) / side)
            d = np.stack([(x - K[0, 2]) / K[0, 0], (y - K[1, 2]) / K[1, 1], np.ones_like(x)], axis=-1)
            d = d @ POSE[:3, :3].T
            # a t^2 + b t + c = 0, all in the world, d of any length
            o = POSE[:3, 3] - centre
            a, b, c = np.sum(d * d, axis=-1), 2 * d @ o, o @ o - RADIUS**2
            under = b * b - 4 * a * c
            t = (-b - np.sqrt(np.maximum(under, 0))) / (2 * a)
            n = (o + t[..., None] * d) / RADIUS
            r = d - 2 * np.sum(d * n, axis=-1, keepdims=True) * n
            total += np.where(under > 0, 0.8 * light(r @ turn), 0.35) / side**2
    return np.repeat(np.minimum(exposure * total, ceiling)[..., None], 3, axis=-1).astype(np.float32)


def solve(picture, environment, ball=None, **more):
    ball = ball or ball_from_world(CAMERA, CENTRE, RADIUS)
    more = {"tolerance": math.radians(3.0), "upright": False, **more}
    return align_by_ball(environment, picture, ball_pixels(CAMERA, ball), **more)


def error(turn, found):
    return math.degrees(np.linalg.norm(Rotation.from_matrix(turn.T @ found.world_from_map).as_rotvec()))


@pytest.mark.parametrize("seed", range(4))
def test_a_known_turn_is_found(seed):
    turn = Rotation.random(random_state=seed).as_matrix()
    found = solve(picture_of(turn), map_of())
    assert error(turn, found) < 0.5
    assert len(found.residuals) >= 2 and np.degrees(found.residuals).max() < 1.0 and found.likeness > 0.95


@pytest.mark.parametrize(("exposure", "ceiling"), [(1.0, 1.0), (0.3, 1.0), (8.0, 100.0)])
def test_exposure_and_clipping_do_not_matter(exposure, ceiling):
    turn = Rotation.random(random_state=11).as_matrix()
    codes = np.round(picture_of(turn, exposure=exposure, ceiling=ceiling) * 255) / 255
    assert error(turn, solve(codes.astype(np.float32), map_of())) < 1.0


def rim(points=24):
    """Pixels on the ball's outline: the cone of rays that touch it, projected."""
    to = CENTRE - POSE[:3, 3]
    far = np.linalg.norm(to)
    half = math.asin(RADIUS / far)
    axis = to / far
    side = np.cross(axis, [0.3, 0.5, -0.8])
    side /= np.linalg.norm(side)
    up = np.cross(axis, side)
    turns = 2 * np.pi * np.arange(points) / points
    touch = np.array(
        [math.cos(half) * axis + math.sin(half) * (math.cos(t) * side + math.sin(t) * up) for t in turns]
    )
    return CAMERA.project(POSE[:3, 3] + touch)[0]


def test_three_ways_to_say_where_the_ball_is():
    truth = ball_from_world(CAMERA, CENTRE, RADIUS)
    outline = rim()
    for points in (outline, outline[::8]):  # three are enough
        found = ball_from_outline(CAMERA, points)
        np.testing.assert_allclose(found.axis, truth.axis, atol=1e-9)
        assert found.sine == pytest.approx(truth.sine, rel=1e-7)
    low, high = rim(256).min(axis=0), rim(256).max(axis=0)
    round_ = ball_from_circle(CAMERA, *(0.5 * (low + high)), (high - low).mean() / 2)
    np.testing.assert_allclose(round_.axis, truth.axis, atol=1e-4)
    assert round_.sine == pytest.approx(truth.sine, rel=1e-3)
    turn = Rotation.random(random_state=3).as_matrix()
    assert error(turn, solve(picture_of(turn), map_of(), round_)) < 1.0
    # To a pixel, as a hand marks them.
    assert (
        error(turn, solve(picture_of(turn), map_of(), ball_from_outline(CAMERA, np.round(outline[::4]))))
        < 2.0
    )


def test_directions_are_those_of_the_law_of_reflection():
    """Against the shortcut of a ball seen from infinitely far, which is 20 degrees off here."""
    ball = ball_from_world(CAMERA, CENTRE, RADIUS)
    outline = rim(256)
    middle = outline.mean(axis=0)
    radius = np.linalg.norm(outline - middle, axis=1).mean()
    pixels = np.array([middle, middle + [0.4 * radius, -0.3 * radius]])
    found, _ = reflected(CAMERA, ball, pixels)
    for pixel, r in zip(pixels, found):
        # Fermat: of all ways over the ball to a far point in that direction this one is stationary.
        d = POSE[:3, :3] @ [(pixel[0] - K[0, 2]) / K[0, 0], (pixel[1] - K[1, 2]) / K[1, 1], 1.0]
        o = POSE[:3, 3] - CENTRE
        t = np.roots([d @ d, 2 * d @ o, o @ o - RADIUS**2]).min()
        at = o + t * d

        def way(shift, at=at, r=r):
            on = (at + shift) / np.linalg.norm(at + shift) * RADIUS + CENTRE
            return np.linalg.norm(on - POSE[:3, 3]) - on @ r

        e1 = np.cross(at, [1.0, 2.0, 3.0])
        e1 /= np.linalg.norm(e1)
        slopes = [(way(1e-5 * e) - way(-1e-5 * e)) / 2e-5 for e in (e1, np.cross(at, e1) / RADIUS)]
        assert np.abs(slopes).max() < 1e-5
        place = (pixel - middle) / radius
        n = np.array([place[0], place[1], -math.sqrt(1 - place @ place)])
        printed = POSE[:3, :3] @ (np.array([0, 0, 1.0]) - 2 * n[2] * n)
        assert math.degrees(math.acos(printed @ r)) > 10.0


def test_pixels_of_a_ball_show_nearly_the_whole_world():
    pixels = ball_pixels(CAMERA, ball_from_world(CAMERA, CENTRE, RADIUS))
    blind = 2 * math.pi * (1 - math.cos(math.radians(17.3)))
    assert pixels.solid_angles.sum() == pytest.approx(4 * math.pi - blind, rel=0.02)


def test_one_lamp_is_enough_for_an_upright_map():
    def sun(d):
        return even(d) + sky(d, LAMPS[:1], (200.0,)) - sky(d, ())

    turn = Rotation.from_euler("z", 77.0, degrees=True).as_matrix()
    picture = picture_of(turn, sun, ceiling=1.0)
    found = solve(picture, map_of(sun), upright=True)
    assert error(turn, found) < 0.7 and np.array_equal(found.world_from_map[2], [0, 0, 1])
    with pytest.raises(InputError, match="no rotation brings") as refused:
        solve(picture, map_of(sun))
    assert "say `upright`" in refused.value.hint
    # Of a map that is not upright the lamp stands at another height.
    tilted = Rotation.from_euler("x", 25.0, degrees=True).as_matrix()
    with pytest.raises(InputError, match="no rotation brings"):
        solve(picture_of(tilted, sun), map_of(sun), upright=True)


@pytest.mark.parametrize("lamp", [(-0.9, 0.0, 0.4), (0.0, 0.02, 1.0)], ids=["seam", "pole"])
def test_a_large_lamp_over_the_maps_seam_or_pole_is_one(lamp):
    lamps = (lamp, LAMPS[0])

    def light(d):
        return sky(d, lamps, (40.0, 30.0), size=9.0)

    turn = Rotation.from_euler("zx", [160.0, 20.0], degrees=True).as_matrix()
    assert error(turn, solve(picture_of(turn, light), map_of(light))) < 0.5


def test_what_cannot_be_told_is_refused():
    turn = Rotation.random(random_state=5).as_matrix()
    with pytest.raises(InputError, match="no lamp is seen in the mirror ball"):
        solve(picture_of(turn, even), map_of())
    with pytest.raises(InputError, match="no lamp is seen in the environment map"):
        solve(picture_of(turn), map_of(even))
    with pytest.raises(InputError, match="no rotation brings"):
        other = ((0.9, 0.1, 0.1), (0.88, -0.3, 0.3), (0.8, 0.2, 0.5))
        solve(picture_of(turn), map_of(lambda d: sky(d, other)))

    def twins(d):  # two equal lamps under a sky of one radiance
        return 0.3 + sky(d, LAMPS[:2], (50.0, 50.0)) - sky(d, ())

    with pytest.raises(InputError, match="two rotations of the map fit"):
        solve(picture_of(turn, twins), map_of(twins))
    mirrored = map_of(lambda d: sky(d * [1, -1, 1]))
    with pytest.raises(InputError, match="no rotation brings|does not look like|two rotations"):
        solve(picture_of(turn), mirrored)
    far = (POSE @ [0.3, -0.1, 3.0, 1.0])[:3]
    with pytest.raises(InputError, match="fewer than 700"):
        solve(picture_of(turn), map_of(), ball_from_world(CAMERA, far, RADIUS))


def test_a_room_that_the_map_saw_from_elsewhere_is_refused(shared_data):
    """A ball 1.6 m away from where the panorama of a small room was made shows its lamps elsewhere."""
    folder = shared_data / "rgbd360" / "mitsuba_room"
    if not (folder / "view_with.exr").is_file():
        pytest.skip("the room with a mirror ball (rgbd360/mitsuba_room) is absent")
    import json

    scene = json.loads((folder / "scene.json").read_text())
    ball, view = scene["objects"]["ball_mirror"]["sphere"], scene["view"]
    picture = oiio.ImageBuf(str(folder / "view_with.exr")).get_pixels(oiio.FLOAT)[..., :3]
    focal = 256 / math.tan(math.radians(view["fov_x"] / 2))
    k = np.array([[focal, 0, 256], [0, focal, 256], [0, 0, 1]])
    camera = Camera.from_opencv(512, 512, k, None, np.array(view["world_from_camera"]), pixel_centres="half")
    pixels = ball_pixels(camera, ball_from_world(camera, np.array(ball["center"]), ball["radius"]))
    with pytest.raises(InputError):
        align_by_ball(
            load_environment(folder / "panorama.exr"),
            picture,
            pixels,
            tolerance=math.radians(3),
            upright=False,
        )


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({}, "one of `outline`, `circle` and `ball`"),
        (
            {"circle": {"centre": [1, 2], "radius": 3}, "outline": [[1, 2], [3, 4], [5, 7]]},
            "one of `outline`",
        ),
        ({"outline": [[1, 2], [3, 4]]}, "at least 3"),
    ],
)
def test_settings_that_cannot_be(more, words):
    with pytest.raises(ValidationError, match=words):
        Probe.model_validate({"frame": 0, **more})
    with pytest.raises(ValidationError, match="one of `directions` and `probe`"):
        Alignment.model_validate({})


def test_outlines_that_are_no_ball():
    for points, words in (
        ([[10, 10], [20, 20], [30, 30]], "on one line"),
        ([[100, 100], [140, 100], [140, 140], [100, 140], [120, 70]], "of the radius off"),
    ):
        with pytest.raises(ValueError, match=words):
            ball_from_outline(CAMERA, np.array(points, dtype=float))
