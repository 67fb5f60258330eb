"""Maps made elsewhere: a lamp at a known place, seen by a map half a metre beside what it lights."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pydantic import ValidationError
from scipy import ndimage
from small_job import write_picture

from mrbatch.errors import InputError
from mrbatch.methods.delta_path_tracing import METHOD as DELTA
from mrbatch.methods.estimate import estimate
from mrbatch.scene import settings as given
from mrbatch.scene.build import build_scene
from mrbatch.scene.closed_forms import look_at
from mrbatch.scene.environment import Environment
from mrbatch.scene.map_parallax import seen_from
from mrbatch.scene.proxy_settings import Proxy

MADE = np.array([0.5, -0.3, 0.35])
LAMP = np.array([1.2, 0.4, 2.0])
BALLS = np.array([[-0.05, 0.0, 0.15], [0.0, 0.0, 0.15], [0.05, 0.0, 0.15]])
MIDDLE = BALLS.mean(axis=0)
ROOM = {
    "box": {"centre": ["0.2 m", "0.1 m", "0.9 m"], "size": ["5 m", "4 m", "2.2 m"]}
}  # the lamp in its ceiling


def texel_directions(width):
    azimuth = 2 * np.pi * (0.5 - (np.arange(width) + 0.5) / width)
    polar = np.pi * (np.arange(width // 2) + 0.5) / (width // 2)
    return np.stack(
        [
            np.sin(polar)[:, None] * np.cos(azimuth),
            np.sin(polar)[:, None] * np.sin(azimuth),
            np.repeat(np.cos(polar)[:, None], width, axis=1),
        ],
        axis=-1,
    )


def photographed(width=512, *, radius=0.06, radiance=400.0, sky=0.05):
    """(H, W, 3) what a camera at MADE sees of a round lamp of that radius in the ceiling z = 2 at LAMP."""
    fine = 4
    d = texel_directions(fine * width)
    with np.errstate(divide="ignore", invalid="ignore"):
        at = MADE + d * ((LAMP[2] - MADE[2]) / d[..., 2])[..., None]
    lit = (d[..., 2] > 0) & (np.linalg.norm(at - LAMP, axis=-1) < radius)
    value = np.where(lit, radiance, sky).reshape(width // 2, fine, width, fine).mean(axis=(1, 3))
    return np.repeat(value[..., None], 3, axis=-1).astype(np.float32)


def lamp_in(environment):
    """The direction (3,) of the lamp in a map, by power, in the world."""
    d = texel_directions(environment.width)
    weight = np.where(environment.radiance[..., 0] > 2.0, environment.radiance[..., 0], 0.0)
    weight = weight * np.sin(np.pi * (np.arange(environment.height) + 0.5) / environment.height)[:, None]
    total = environment.world_from_map @ (weight[..., None] * d).sum(axis=(0, 1))
    return total / np.linalg.norm(total)


def degrees(a, b):
    return math.degrees(math.acos(np.clip(a @ b / np.linalg.norm(a) / np.linalg.norm(b), -1, 1)))


def proxy(settings):
    return Proxy.model_validate(settings)


TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


@pytest.mark.parametrize(
    "walls",
    [
        ROOM,
        {"sphere": {"centre": ["1.2 m", "0.4 m", "0 m"], "radius": "2 m"}},
        {"dome": {"centre": ["0.7 m", "0.4 m", "0 m"], "radius": f"{math.hypot(0.5, 2.0)} m"}},
    ],
    ids=["box", "sphere", "dome"],
)
def test_a_lamp_on_the_walls_is_seen_where_it_is(walls):
    environment = Environment(photographed())
    assert degrees(lamp_in(environment), LAMP - MADE) < 0.1
    assert degrees(LAMP - MADE, LAMP - MIDDLE) > 14.0  # what is wrong without
    moved, note = seen_from(environment, MADE, proxy(walls), MIDDLE, 0.1)
    assert degrees(lamp_in(moved), LAMP - MIDDLE) < 0.15
    assert "made 0.616 m away" in note


def test_a_turned_map_is_read_in_its_own_frame():
    """A quarter turn of the map by whole texels."""
    values = photographed(256)
    turned = Environment(np.roll(values, 64, axis=1), world_from_map=TURN)
    straight, _ = seen_from(Environment(values), MADE, proxy(ROOM), MIDDLE, 0.1)
    again, _ = seen_from(turned, MADE, proxy(ROOM), MIDDLE, 0.1)
    np.testing.assert_allclose(np.roll(again.radiance, -64, axis=1), straight.radiance, rtol=1e-3, atol=1e-3)
    assert degrees(lamp_in(again), LAMP - MIDDLE) < 0.2


@pytest.mark.slow
def test_radiance_is_kept_and_solid_angle_is_not():
    """The lamp's irradiance on a surface that faces up, by its own closed form: a disc in the ceiling.

    E = pi L r^2 h^2 / d^4, to the square of r / d; d from the middle, not from where the map was made.
    """
    radius, radiance = 0.06, 400.0
    moved, _ = seen_from(Environment(photographed(1024, sky=0.0)), MADE, proxy(ROOM), MIDDLE, 0.1)
    up = np.array([[0.0, 0.0, 1.0]])
    expected = [
        math.pi * radiance * radius**2 * (LAMP[2] - at[2]) ** 2 / np.linalg.norm(LAMP - at) ** 4
        for at in (MIDDLE, MADE)
    ]
    assert moved.irradiance(up)[0, 0] == pytest.approx(expected[0], rel=0.01)
    assert abs(expected[1] / expected[0] - 1) > 0.2
    # A lamp of one texel is not lost between the directions that are drawn.
    one = np.zeros((128, 256, 3), np.float32)
    one[20, 70] = 1000.0
    here, _ = seen_from(Environment(one), MADE, proxy(ROOM), MADE, 0.1)
    assert here.fluence()[0] == pytest.approx(Environment(one).fluence()[0], rel=0.05)


def test_walls_far_away_and_even_light_change_nothing():
    even = Environment(np.full((32, 64, 3), 0.37, np.float32))
    moved, _ = seen_from(even, MADE, proxy(ROOM), MIDDLE, 0.1)
    np.testing.assert_array_equal(moved.radiance, even.radiance)
    d = texel_directions(256)
    smooth = Environment(np.exp(1.0 + 0.5 * d).astype(np.float32))
    far = {"sphere": {"centre": [0, 0, 0], "radius": "1000 km"}}
    moved, note = seen_from(smooth, MADE, proxy(far), MIDDLE, 0.1)
    np.testing.assert_allclose(moved.radiance, smooth.radiance, rtol=5e-3)
    assert "by up to 0.0 degrees" in note


def scene(folder, **environment):
    write_picture(folder / "map.exr", photographed())
    light = given.Environment.model_validate(
        {"file": str(folder / "map.exr"), "position": [f"{x} m" for x in MADE], **environment}
    )
    floor = given.RealObject.model_validate(
        {"name": "floor", "plane": {"size": ["2 m", "2 m"]}, "reflectance": 0.5}
    )
    balls = [
        given.VirtualObject.model_validate(
            {
                "name": f"ball{i}",
                "sphere": {"radius": "8 mm"},
                "transform": {"translate": [f"{x} m" for x in at]},
            }
        )
        for i, at in enumerate(BALLS)
    ]
    return build_scene(light, [floor], balls)


def shadows(made, view):
    """(n, 2) middles of the shadows in the picture, by how much darker it is, from left to right."""
    d = estimate(DELTA, made, view, spp=64, background=np.ones((160, 160, 3), np.float32)).developed
    darker = np.where(d.a > 0, 0.0, -d.D.mean(axis=2))
    number, count = ndimage.label(darker > 0.3 * darker.max())
    large = [n for n in range(1, count + 1) if (number == n).sum() > 4]
    found = ndimage.center_of_mass(darker, number, large)
    return np.array(sorted((x + 0.5, y + 0.5) for y, x in found))


@pytest.mark.slow
@pytest.mark.case("TRAP-2h")
def test_shadows_fall_where_the_lamps_place_throws_them(tmp_path):
    view = look_at((0.0, -0.12, 0.8), (-0.05, -0.05, 0.0), width=160, height=160, focal=260.0)
    truth = BALLS + (BALLS - LAMP) * (BALLS[:, 2:] / (LAMP[2] - BALLS[:, 2:]))
    truth[:, 2] = 0.0
    pixels = np.array(sorted(map(tuple, view.project(truth)[0])))
    with_walls = scene(tmp_path, proxy=ROOM)
    found = shadows(with_walls, view)
    assert found.shape == (3, 2)
    off = np.linalg.norm(found - pixels, axis=1)
    assert off[1] < 1.0
    # Beside the middle, where the map is right, what is left is atan(s / h): 1.5 degrees.
    assert off.max() < 1.6
    # As the map is printed, by direction alone, they lie many pixels off, and the report says so.
    without = scene(tmp_path)
    assert np.linalg.norm(shadows(without, view) - pixels, axis=1).min() > 8.0
    assert any("17.1 degrees for a lamp at 2 m" in note for note in without.notes)


def test_what_cannot_be():
    with pytest.raises(InputError, match="the virtual objects stand outside of the environment's proxy"):
        seen_from(Environment(photographed(64)), MADE, proxy(ROOM), np.array([0.0, 0.0, -1.0]), 0.1)
    with pytest.raises(InputError, match="the map was made outside"):
        seen_from(Environment(photographed(64)), np.array([9.0, 0.0, 1.0]), proxy(ROOM), MIDDLE, 0.1)
    with pytest.raises(ValidationError, match="one of `sphere`, `box` and `dome`"):
        Proxy.model_validate({})
    with pytest.raises(ValidationError, match="`proxy` needs `position`"):
        given.Environment.model_validate({"file": "map.exr", "proxy": ROOM})
