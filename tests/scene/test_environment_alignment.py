"""Maps laid over the world by marked directions: known rotations, noise, and marks that cannot be."""

from __future__ import annotations

import math

import numpy as np
import OpenImageIO as oiio
import pytest
from pydantic import ValidationError
from scipy.spatial.transform import Rotation

from mrbatch.scene import settings as given
from mrbatch.scene.build import build_scene
from mrbatch.scene.environment import rotation_from_yaw
from mrbatch.scene.environment_alignment import align, map_direction, pixel_direction


def place_in_map(direction):
    """(u, v) by the program's convention, written out again."""
    x, y, z = direction / np.linalg.norm(direction)
    return [0.5 - math.atan2(y, x) / (2 * math.pi), math.acos(z) / math.pi]


def directions(count, seed):
    d = np.random.default_rng(seed).normal(size=(count, 3))
    return d / np.linalg.norm(d, axis=1, keepdims=True)


def angle(a, b):
    return np.degrees(np.linalg.norm(Rotation.from_matrix(a.T @ b).as_rotvec()))


def environment(marks, **more):
    return given.Environment.model_validate(
        {"file": "sky.exr", "align": {"directions": marks, **more.pop("align", {})}, **more}
    )


def test_places_in_the_map():
    np.testing.assert_allclose(map_direction(0.5, 0.5), [1, 0, 0], atol=1e-15)  # the centre is +x
    np.testing.assert_allclose(map_direction(0.25, 0.5), [0, 1, 0], atol=1e-15)  # +y is left of it
    np.testing.assert_allclose(map_direction(0.1, 0.0), [0, 0, 1], atol=1e-15)
    for d in directions(20, 0):
        np.testing.assert_allclose(map_direction(*place_in_map(d)), d, atol=1e-14)
    # the same place in pixels, for both conventions of rows
    u, v = 0.3, 0.2
    np.testing.assert_allclose(pixel_direction(u * 64, v * 32, 64, 32), map_direction(u, v), atol=1e-15)
    at = pixel_direction(u * 64, v * 31 + 0.5, 64, 32, "endpoints")
    np.testing.assert_allclose(at, map_direction(u, v), atol=1e-15)


@pytest.mark.parametrize("count", [2, 3, 7])
@pytest.mark.parametrize("seed", range(5))
def test_exact_directions_give_the_exact_rotation(count, seed):
    turn = Rotation.random(random_state=seed).as_matrix()
    seen = directions(count, seed)
    marks = [
        {"map": place_in_map(d), "world": [float(x) for x in 2.5 * turn @ d]} for d in seen
    ]  # lengths do not count
    found = environment(marks).align.solved("centres")
    assert np.abs(found.world_from_map - turn).max() < 1e-9
    assert np.degrees(found.residuals).max() < 1e-6 and not found.mirrored
    assert np.linalg.det(found.world_from_map) == pytest.approx(1.0)


def test_noise_averages_out_as_expected():
    """Of n directions all round, each off by sigma across: the turn errs by sigma sqrt(9 / (2 n)) in all."""
    sigma, count, errors, residuals = np.radians(1.0), 12, [], []
    random = np.random.default_rng(0)
    for seed in range(200):
        turn = Rotation.random(random_state=seed).as_matrix()
        d = directions(count, seed)
        noisy = d @ turn.T + random.normal(0.0, sigma, d.shape)
        found = align(d, noisy)
        errors.append(angle(turn, found.world_from_map))
        residuals.append(np.degrees(found.residuals))
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(math.sqrt(9 / (2 * count)), rel=0.15)
    # 2 n numbers are seen, 3 are fitted
    assert np.sqrt(np.mean(np.square(residuals))) == pytest.approx(math.sqrt(2 - 3 / count), rel=0.1)


def test_two_directions_share_their_disagreement():
    found = align(
        np.array([[1.0, 0, 0], [0, 1, 0]]), np.array([[1.0, 0, 0], [math.sin(0.02), math.cos(0.02), 0]])
    )
    np.testing.assert_allclose(found.residuals, 0.01, atol=1e-12)


def test_the_scene_gets_the_rotation_and_says_how_well_it_fits(tmp_path):
    path = tmp_path / "sky.exr"
    out = oiio.ImageOutput.create(str(path))
    out.open(str(path), oiio.ImageSpec(8, 4, 3, "float"))
    out.write_image(np.ones((4, 8, 3), np.float32))
    out.close()
    # What is straight ahead in the map stands at +y: a yaw of 90 degrees.
    marks = [{"map": [4, 2], "world": [0, 1, 0]}, {"map": [4, 0], "world": [0, 0, 1]}]
    light = environment(marks, file=str(path), align={"size": [8, 4]})
    scene = build_scene(light, [], [])
    np.testing.assert_allclose(
        scene.environment.world_from_map, rotation_from_yaw(math.radians(90)), atol=1e-12
    )
    assert any("turned to meet 2 marked directions" in note and "0.00" in note for note in scene.notes)
    again = given.Environment.model_validate(light.model_dump(mode="json"))
    assert again == light


@pytest.mark.parametrize(
    ("marks", "more", "words"),
    [
        ([], {}, "at least 2"),
        ([([0.5, 0.51], [0, 0, 1])], {}, "in the map lie within 1.8 degrees of one line"),
        ([([0.0, 0.5], [0, 0, 1])], {}, "in the map lie within .* degrees of one line"),
        ([([0.5, 0.0], [-2, 0, 0])], {}, "in the world lie within 0 degrees of one line"),
        ([([0.5, 0.0], [0.3, 0, 1])], {}, "contradict each other: `directions"),
        ([([0.5, 0.0], [0, 0, 0])], {}, "must not have the length 0"),
        ([([512, 0], [0, 0, 1])], {}, "`directions.1.map` lies outside.* need the picture"),
        ([([9, 0], [0, 0, 1])], {"size": [8, 4]}, "outside of the map, 0..8"),
        ([([0.5, 0.0], [0, 0, 1]), ([0.25, 0.5], [0, -1, 0])], {}, "mirror image"),
    ],
)
def test_marks_that_cannot_be(marks, more, words):
    marks = [{"map": m, "world": w} for m, w in [([0.5, 0.5], [1, 0, 0]), *marks]]
    with pytest.raises(ValidationError, match=words):
        environment(marks, align=more)


def test_tolerance_is_the_jobs():
    marks = [{"map": [0.5, 0.5], "world": [1, 0, 0]}, {"map": [0.5, 0.0], "world": [0.1, 0, 1]}]
    assert environment(marks).align is not None  # 2.9 degrees each
    with pytest.raises(ValidationError, match="are 2.86 degrees off|is 2.86 degrees off"):
        environment(marks, align={"tolerance": "1 deg"})


def test_one_rotation_only():
    marks = [{"map": [0.5, 0.5], "world": [1, 0, 0]}, {"map": [0.5, 0.0], "world": [0, 0, 1]}]
    with pytest.raises(ValidationError, match="`yaw` and `align` are both given"):
        environment(marks, yaw="30 deg")
