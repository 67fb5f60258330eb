"""Directions drawn to what emits, against Lambert's formula for polygons and other closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mrbatch.methods.image_based_lighting import METHOD as IMAGE_BASED
from mrbatch.methods.probe import probe
from mrbatch.methods.registry import method as get_method
from mrbatch.scene import settings as given
from mrbatch.scene.build import build_scene
from mrbatch.scene.closed_forms import (
    ball,
    ball_share,
    everything_virtual,
    floor,
    placed,
    real,
    scene_of,
    sky,
    sunk_ball_share,
    virtual,
)
from mrbatch.scene.mesh import Mesh, box, icosphere, plane
from mrbatch.scene.scene import Material, SceneObject, Texture

TRACERS = ["delta-path-tracing", "one-pass", "two-pass"]
EVERY = pytest.mark.parametrize("name", TRACERS)
RHO = 0.5
DARK = sky(0.0)
FLOOR = floor(64.0)
"""Not larger: a place on a triangle is known to 6e-8 of its size, and light of a near lamp changes over
less."""


def agrees(found, error, oracle, tolerance=0.0):
    room = tolerance + 4 * np.asarray(error)
    assert np.all(np.isfinite(found))
    assert np.all(np.abs(np.asarray(found) - oracle) <= room), (found, oracle, room)


def glowing(emission, reflectance=0.0, **more):
    return Material(
        reflectance=(reflectance,) * 3, emission=tuple(np.broadcast_to(emission, 3).tolist()), **more
    )


def lamp(mesh, emission, *, is_virtual=True, camera=False, **more):
    return SceneObject("lamp", mesh, glowing(emission, **more), is_virtual, camera=camera)


def polygon_share(corners, point, normal=(0, 0, 1)):
    """Form factor of a polygon wholly above the horizon: sum of angle_i (n . m_i) / 2 pi, m_i the unit normal
    of the plane through the point and edge i (Lambert, Photometria, 1760)."""
    v = np.asarray(corners, float) - np.asarray(point, float)
    assert np.all(v @ np.asarray(normal, float) >= -1e-12)
    v = v / np.linalg.norm(v, axis=1, keepdims=True)
    w = np.roll(v, -1, axis=0)
    cross = np.cross(v, w)
    size = np.linalg.norm(cross, axis=1)
    angle = np.arctan2(size, (v * w).sum(axis=1))
    return abs(float(np.sum(angle / size * (cross @ np.asarray(normal, float))))) / (2 * np.pi)


def rectangle(x0, x1, y0, y1, z):
    return np.array([[x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z]], float)


def quad(x0, x1, y0, y1, z):
    return plane(x1 - x0, y1 - y0, centre=((x0 + x1) / 2, (y0 + y1) / 2, z))


def disc(radius, at, sides=48):
    turn = 2 * np.pi * np.arange(sides) / sides
    ring = np.stack([radius * np.cos(turn), radius * np.sin(turn), np.zeros(sides)], axis=1)
    here = np.arange(1, sides + 1)
    faces = np.stack([np.zeros_like(here), np.roll(here, -1), here], axis=1).astype(np.int32)
    return Mesh(np.concatenate([np.zeros((1, 3)), ring]) + np.asarray(at, float), faces)


def test_the_oracle():
    """The formula by itself: a disc seen from its axis has the share r^2 / (r^2 + h^2)."""
    ring = disc(0.4, (0, 0, 1.0), 4000).vertices[1:]
    assert polygon_share(ring, (0, 0, 0)) == pytest.approx(0.16 / 1.16, rel=1e-5)


@EVERY
@pytest.mark.parametrize("point", [(0.0, 0.0, 0.0), (1.5, 0.7, 0.0)])
def test_a_small_quad_over_a_real_plane(name, point):
    """0.1 % of the hemisphere: found by chance, 64 x 64 samples would err by a tenth."""
    sides = (-0.03, 0.05, -0.02, 0.06, 0.8)
    scene = scene_of([real("floor", FLOOR, RHO), lamp(quad(*sides), (200.0, 100.0, 50.0))], DARK)
    found = probe(get_method(name), scene, point, spp=64)
    truth = RHO * polygon_share(rectangle(*sides), point) * np.array([200.0, 100.0, 50.0])
    agrees(found.delta, found.delta_error, truth)
    # Both of a two-pass difference's pictures are lit by the map alone otherwise, which is dark here.
    assert np.all(found.delta_error < 4e-3 * truth)


@EVERY
def test_a_disc_and_a_ball(name):
    for mesh, share in (
        (disc(0.05, (0.1, 0, 0.5)), polygon_share(disc(0.05, (0.1, 0, 0.5)).vertices[1:], (0, 0.2, 0))),
        (ball(0.05, at=(0.1, 0, 0.5), subdivisions=4), ball_share(0.05, 0.5, np.hypot(0.1, 0.2))),
    ):
        scene = scene_of([real("floor", FLOOR, RHO), lamp(mesh, 100.0)], DARK)
        found = probe(get_method(name), scene, (0, 0.2, 0), spp=256)
        # The ball's outline is that of 5120 facets.
        agrees(found.delta, found.delta_error, RHO * 100.0 * share, 1e-3 * share * RHO * 100.0)
        assert np.all(found.delta_error < 0.02 * found.delta)


@pytest.mark.slow
def test_noise_of_a_small_bright_lamp_falls_by_more_than_an_order_of_magnitude():
    scene = scene_of([real("floor", FLOOR, RHO), lamp(ball(0.05, at=(0, 0, 0.5), subdivisions=3), 100.0)])
    method = get_method("delta-path-tracing")
    drawn, met = (
        probe(method, scene, (0.2, 0, 0), spp=64, settings={"strategy": s}) for s in ("mis", "bsdf")
    )
    assert np.all(drawn.delta_error**2 < met.delta_error**2 / 10)


@pytest.mark.slow
@EVERY
@pytest.mark.parametrize("point", [(0.3, 0.1, 0.0), (0.0, 0.9, 0.0)])
def test_three_strategies_have_one_mean(name, point):
    """Large lamp under a sky, beside a wall, with things in between; a metal floor too."""
    wall = real("wall", placed(plane(2, 2), at=(-1, 0, 1.0), normal=(1, 0, 0)), 0.7)
    lid = virtual("lid", box((0.3, 0.3, 0.1), centre=(0.2, 0.3, 0.6)), 0.4, camera=False)
    bright = lamp(placed(plane(1.2, 0.8), at=(0.2, 0.1, 1.0), normal=(0, 0, -1)), 3.0, reflectance=0.3)
    for rough in (None, 0.4):
        ground = real("floor", floor(4.0), 0.6)
        if rough:
            ground = replace(ground, material=Material("conductor", (0.6,) * 3, rough))
        scene = scene_of([ground, wall, lid, bright])
        results = [
            probe(get_method(name), scene, point, spp=512, seed=k, settings={"strategy": s})
            for k, s in enumerate(("mis", "bsdf", "environment"))
        ]
        for a in results[1:]:
            # Three channels and two comparisons; grey things have equal channels but for the noise.
            error = np.hypot(a.delta_error, results[0].delta_error)
            assert np.all(np.abs(a.delta - results[0].delta) < 4 * error), rough


# --- shadows ------------------------------------------------------------------------------------


def lit_part(lamp_sides, lid_sides, point):
    """Share of a horizontal lamp, and of the part of it that a horizontal lid hides from `point`."""
    x0, x1, y0, y1, z = lamp_sides
    grow = (z - point[2]) / (lid_sides[4] - point[2])
    a0, a1 = (point[0] + grow * (x - point[0]) for x in lid_sides[:2])
    b0, b1 = (point[1] + grow * (y - point[1]) for y in lid_sides[2:4])
    a0, a1, b0, b1 = max(a0, x0), min(a1, x1), max(b0, y0), min(b1, y1)
    hidden = polygon_share(rectangle(a0, a1, b0, b1, z), point) if a0 < a1 and b0 < b1 else 0.0
    return polygon_share(rectangle(*lamp_sides), point), hidden


LAMP, LID = (-0.3, 0.3, -0.2, 0.2, 1.0), (0.0, 0.5, -0.1, 0.4, 0.5)


@pytest.mark.slow
@EVERY
@pytest.mark.parametrize("blocker", ["virtual", "real"])
def test_dpt_18_virtual_lamp_with_something_in_between(name, blocker):
    """The lamp's light comes where neither real nor virtual things hide it."""
    point = (0.1, 0.05, 0.0)
    lid = SceneObject("lid", quad(*LID), Material(reflectance=(0.0,) * 3), blocker == "virtual", camera=False)
    scene = scene_of([real("floor", FLOOR, RHO), lid, lamp(quad(*LAMP), 5.0)], DARK)
    found = probe(get_method(name), scene, point, spp=1024)
    whole, hidden = lit_part(LAMP, LID, point)
    assert 0.2 * whole < hidden < 0.8 * whole
    agrees(found.delta, found.delta_error, RHO * 5.0 * (whole - hidden), 1e-4)


@pytest.mark.slow
@EVERY
def test_dpt_18_union_of_lamp_and_blocker_under_a_sky(name):
    """- sky over the union of both, + the lamp where the blocker does not hide it."""
    point = (0.1, 0.05, 0.0)
    lid = virtual("lid", quad(*LID), 0.0, camera=False)
    scene = scene_of([real("floor", FLOOR, RHO), lid, lamp(quad(*LAMP), 5.0)])
    found = probe(get_method(name), scene, point, spp=1024)
    whole, hidden = lit_part(LAMP, LID, point)
    of_lid = polygon_share(rectangle(*LID), point)
    truth = RHO * (5.0 * (whole - hidden) - (whole - hidden) - of_lid)
    agrees(found.delta, found.delta_error, truth, 1e-4)


@EVERY
def test_a_real_lamp_is_in_the_photo_and_only_its_shadow_is_new(name):
    point = (0.1, 0.05, 0.0)
    lid = virtual("lid", quad(*LID), 0.0, camera=False)
    there = lamp(quad(*LAMP), 5.0, is_virtual=False)
    ground = real("floor", FLOOR, RHO)
    whole, hidden = lit_part(LAMP, LID, point)
    found = probe(get_method(name), scene_of([ground, lid, there], DARK), point, spp=1024)
    agrees(found.delta, found.delta_error, -RHO * 5.0 * hidden, 1e-4)
    far = virtual("far", quad(5.0, 5.1, 0.0, 0.1, 0.5), 0.0, camera=False)
    found = probe(get_method(name), scene_of([ground, far, there], DARK), point, spp=64)
    agrees(found.delta, found.delta_error, 0.0, 1e-5)
    # A real lid hid it before: nothing is lost behind it.
    scene = scene_of([ground, replace(lid, name="own", virtual=False), lid, there], DARK)
    found = probe(get_method(name), scene, point, spp=64)
    agrees(found.delta, found.delta_error, 0.0, 1e-5)


@EVERY
def test_a_real_and_a_virtual_lamp_together(name):
    """The virtual one hides the real one behind it: its own light less what it takes away."""
    point = (0.1, 0.05, 0.0)
    scene = scene_of(
        [real("floor", FLOOR, RHO), lamp(quad(*LID), 2.0), lamp(quad(*LAMP), 5.0, is_virtual=False)], DARK
    )
    found = probe(get_method(name), scene, point, spp=1024)
    _, hidden = lit_part(LAMP, LID, point)
    truth = RHO * (2.0 * polygon_share(rectangle(*LID), point) - 5.0 * hidden)
    agrees(found.delta, found.delta_error, truth, 1e-4)


@pytest.mark.slow
@EVERY
def test_light_of_a_lamp_over_a_real_wall_is_the_difference_of_two_whole_pictures(name):
    """More than one bounce among real surfaces: against everything as virtual things, with and without."""
    point = (0.4, 0.1, 0.0)
    items = [
        real("floor", floor(6.0), 0.6),
        real("wall", placed(plane(6, 6), at=(-0.5, 0, 1.0), normal=(1, 0, 0)), 0.8),
        lamp(box((0.1, 0.1, 0.1), centre=(0.1, -0.3, 0.5)), 20.0, reflectance=0.5),
        lamp(quad(0.5, 0.9, 0.3, 0.5, 1.2), 4.0, is_virtual=False),
    ]
    found = probe(get_method(name), scene_of(items), point, spp=1024)
    method = get_method("two-pass")
    whole, without = (
        probe(method, scene_of(everything_virtual(items, with_virtual=w)), point, spp=1024, seed=9 + w)
        for w in (True, False)
    )
    truth = whole.virtual - without.virtual
    error = np.sqrt(found.delta_error**2 + whole.virtual_error**2 + without.virtual_error**2)
    agrees(found.delta, error, truth)
    assert np.all(error < 0.02 * np.abs(truth))


# --- shape and place ----------------------------------------------------------------------------


@pytest.mark.parametrize("motion", [False, True])
def test_mirrored_uneven_and_moving_lamps(motion):
    """Areas are those of the world: scale (-0.1, 0.4, 1) at one place, another size at another frame."""
    sides = (0.2 - 0.05, 0.2 + 0.05, -0.1 - 0.2, -0.1 + 0.2, 0.7)
    shape = {"name": "lamp", "plane": {"size": ["1 m", "1 m"]}, "emission": 30.0, "camera": False}
    look = {"material": {"type": "diffuse", "reflectance": 0.0}}
    place = {"translate": ["0.2 m", "-0.1 m", "0.7 m"]}
    if motion:
        keys = [
            {"frame": 0, "translate": ["1 m", "1 m", "2 m"], "scale": [3.0, 2.0, 1.0]},
            {"frame": 4, **place, "scale": [0.1, 0.4, 1.0]},
        ]
        item = shape | look | {"animation": keys}
    else:
        item = shape | look | {"transform": {**place, "scale": [-0.1, 0.4, 1.0]}}
    table = {"name": "table", "plane": {"size": ["40 m", "40 m"]}, "reflectance": RHO}
    scene = build_scene(
        None, [given.RealObject.model_validate(table)], [given.VirtualObject.model_validate(item)]
    )
    found = probe(get_method("delta-path-tracing"), scene, (0, 0, 0), spp=256, frame=4)
    agrees(found.delta, found.delta_error, RHO * 30.0 * polygon_share(rectangle(*sides), (0, 0, 0)))
    assert np.all(found.delta_error < 0.02 * found.delta)


@pytest.mark.slow
def test_a_lamp_that_is_not_there_at_a_frame_lights_nothing():
    item = {
        "name": "lamp",
        "sphere": {"radius": "0.1 m"},
        "transform": {"translate": ["0 m", "0 m", "0.5 m"]},
        "emission": 30.0,
        "visible": [[3, 5]],
    }
    table = {"name": "table", "plane": {"size": ["40 m", "40 m"]}, "reflectance": RHO}
    scene = build_scene(
        None, [given.RealObject.model_validate(table)], [given.VirtualObject.model_validate(item)]
    )
    for name in TRACERS:
        at = [
            probe(get_method(name), scene, (1, 0, 0), distance=0.2, spp=16, frame=frame) for frame in (2, 4)
        ]
        assert not at[0].delta.any() and np.all(at[1].delta > 0.0)


@pytest.mark.slow
def test_texture_is_exact_where_light_comes_from():
    """A lamp whose one half glows, in three colours, twice as long in the texture as in the world."""
    half = np.zeros((2, 8, 3), np.float32)
    half[:, :4] = (3.0, 6.0, 1.5)
    look = glowing(1.0, emission_texture=Texture(half))
    there = SceneObject("lamp", quad(-0.4, 0.4, -0.1, 0.1, 0.6), look, True, camera=False)
    scene = scene_of([real("floor", FLOOR, RHO), there], DARK)
    found = probe(get_method("delta-path-tracing"), scene, (0.1, 0.1, 0), spp=1024)
    # Between texels it is bilinear, and the texture repeats: strips with the weights 0, 1/2 and 1 on average.
    edges = np.linspace(-0.4, 0.4, 8 * 32 + 1)
    middles = (edges[1:] + edges[:-1]) / 2
    x = (middles + 0.4) / 0.8 * 8 - 0.5
    low, part = np.floor(x).astype(int), x - np.floor(x)
    column = half[0, :, 0] / 3.0
    weight = column[low % 8] * (1 - part) + column[(low + 1) % 8] * part
    shares = [
        polygon_share(rectangle(a, b, -0.1, 0.1, 0.6), (0.1, 0.1, 0)) for a, b in zip(edges[:-1], edges[1:])
    ]
    truth = RHO * float(weight @ shares) * np.array([3.0, 6.0, 1.5])
    agrees(found.delta, found.delta_error, truth, 1e-3 * truth)


def test_lamp_that_touches_the_floor():
    """Half sunk, standing upright on it, lying on it: right next to the contact, and finite everywhere."""
    method = get_method("delta-path-tracing")
    ground = real("floor", FLOOR, RHO)
    sunk = lamp(ball(1.0, at=(0, 0, 0)), 2.0)
    for q in (1.2, 2.0):
        found = probe(method, scene_of([ground, sunk], DARK), (q, 0, 0), spp=1024)
        agrees(found.delta, found.delta_error, RHO * 2.0 * sunk_ball_share(q), 1e-3)
    upright = lamp(placed(plane(2.0, 1.0), at=(0, 0, 0.5), normal=(1, 0, 0)), 2.0)
    corners = np.array([[0, -1, 0], [0, 1, 0], [0, 1, 1], [0, -1, 1]], float)
    for c in (1e-3, 0.05, 0.5):
        found = probe(method, scene_of([ground, upright], DARK), (c, 0, 0), distance=c, spp=1024)
        agrees(found.delta, found.delta_error, RHO * 2.0 * polygon_share(corners, (c, 0, 0)), 1e-3)
    lying = lamp(box((1.0, 1.0, 0.2), centre=(0, 0, 0.1)), 2.0)
    for x in (0.5, 0.5 + 1e-6, 0.5001, 0.6):
        found = probe(method, scene_of([ground, lying], DARK), (x, 0, 0), distance=0.1, spp=64)
        assert np.all(np.isfinite(found.pixels)) and np.all(found.pixels >= 0.0)
        # Of the picture's width part lies under the box, where all that is seen glows.
        share = 1.0 if x < 0.5001 else 0.5
        assert np.all(found.delta <= RHO * 2.0 * share + 4 * found.delta_error + 1e-3)


def test_coplanar_and_grazing_lamps_add_nothing_and_stay_finite():
    method = get_method("delta-path-tracing")
    ground = real("floor", FLOOR, RHO)
    flat = lamp(quad(1.0, 2.0, -0.5, 0.5, 0.0), 100.0)
    found = probe(method, scene_of([ground, flat], DARK), (0, 0, 0), spp=256)
    assert np.all(np.abs(found.delta) < 1e-4)
    low = lamp(quad(1.0, 2.0, -0.5, 0.5, 1e-4), 100.0)
    found = probe(method, scene_of([ground, low], DARK), (0, 0, 0), spp=256)
    truth = RHO * 100.0 * polygon_share(rectangle(1.0, 2.0, -0.5, 0.5, 1e-4), (0, 0, 0))
    agrees(found.delta, found.delta_error, truth, 1e-6)
    # A lamp without area, and one seen edge on.
    sliver = Mesh(np.array([[0, 0, 1.0], [1, 0, 1.0], [2, 0, 1.0]]), np.array([[0, 1, 2]], np.int32))
    edge = placed(plane(1, 1), at=(0, 0, 1.0), normal=(1, 0, 0))
    for mesh in (sliver, edge):
        found = probe(method, scene_of([ground, lamp(mesh, 5.0)], DARK), (0, 0, 0), spp=64)
        # The picture is 2e-4 wide, so that it is not edge on all over.
        agrees(found.delta, found.delta_error, 0.0, 3e-4)


@pytest.mark.parametrize("factor", [2.0**-13, 2.0**13])
def test_scale_by_a_power_of_two_keeps_every_bit(factor):
    from mrbatch.scene.closed_forms import scaled

    scene = scene_of([real("floor", FLOOR, RHO), lamp(ball(0.25, at=(0.5, 0, 1.0), subdivisions=3), 4.0)])
    method = get_method("delta-path-tracing")
    one = probe(method, scene, (0, 0, 0), spp=32)
    other = probe(method, scaled(scene, factor), (0, 0, 0), distance=factor, spp=32)
    assert np.array_equal(one.pixels, other.pixels)


# --- glass --------------------------------------------------------------------------------------

GLASS = Material("dielectric", (1.0,) * 3, 0.0, ior=1.5)


@pytest.mark.slow
@EVERY
@pytest.mark.parametrize("alpha", [0.0, 0.3])
def test_lamp_inside_clear_glass_as_bright_as_the_sky_cannot_be_told_from_it(name, alpha):
    """White floor, white sky, and a lamp of radiance n^2 in smooth glass, where the sky's is n^2 too: nothing
    changes. Of rough glass: one mean by two strategies."""
    bulb = SceneObject(
        "bulb",
        icosphere(0.3, subdivisions=4, centre=(0, 0, 0.5)),
        replace(GLASS, alpha=alpha),
        True,
        camera=False,
    )
    wire = lamp(ball(0.1, at=(0, 0, 0.5), subdivisions=3), GLASS.ior**2)
    scene = scene_of([real("floor", FLOOR, 1.0), bulb, wire])
    found = probe(get_method(name), scene, (0.4, 0, 0), spp=512)
    if alpha == 0.0:
        agrees(found.delta, found.delta_error, 0.0, 1e-3)
    else:
        other = probe(get_method(name), scene, (0.4, 0, 0), spp=512, seed=3, settings={"strategy": "bsdf"})
        agrees(found.delta, np.hypot(found.delta_error, other.delta_error), other.delta)


@pytest.mark.slow
def test_what_is_in_a_coloured_medium_with_the_lamp_gets_its_light_by_that_medium():
    """A card and a lamp in one block of coloured glass: a direction drawn to the lamp loses what a ray
    loses."""
    block = SceneObject(
        "block",
        box((2.0, 2.0, 2.0), centre=(0, 0, 0)),
        replace(GLASS, absorption=(0.2, 1.0, 3.0)),
        True,
    )
    card = virtual("card", plane(0.4, 0.4, centre=(0, 0, -0.5)), 0.8)
    inside = SceneObject("lamp", quad(-0.2, 0.2, -0.2, 0.2, 0.2), glowing(10.0), True, camera=False)
    scene = scene_of([block, card, inside], DARK)
    method = get_method("delta-path-tracing")
    drawn, met = (
        probe(method, scene, (0.05, 0, 1.0), distance=0.5, spp=4096, seed=k, settings={"strategy": s})
        for k, s in enumerate(("mis", "bsdf"))
    )
    assert drawn.virtual[0] > 2 * drawn.virtual[2] > 0.0
    agrees(drawn.virtual, np.hypot(drawn.virtual_error, met.virtual_error), met.virtual)
    assert np.all(drawn.virtual_error < 0.02 * drawn.virtual)


# --- image-based lighting -----------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("occlusion", [False, True])
def test_image_based_lighting_lights_virtual_things_by_lamps(occlusion):
    point = (0.1, 0.05, 0.0)
    card = virtual("card", plane(1.0, 1.0), RHO)
    lid = virtual("lid", quad(*LID), 0.0, camera=False)
    whole, hidden = lit_part(LAMP, LID, point)
    for is_virtual in (True, False):
        there = lamp(quad(*LAMP), 5.0, is_virtual=is_virtual)
        scene = scene_of([card, lid, there], DARK)
        for strategy in ("mis", "bsdf", "environment"):
            settings = {"occlusion": occlusion, "strategy": strategy}
            found = probe(IMAGE_BASED, scene, point, distance=0.2, spp=1024, settings=settings)
            truth = RHO * 5.0 * (whole - hidden if occlusion else whole)
            agrees(found.virtual, found.virtual_error, truth, 1e-4)


def test_image_based_lighting_does_not_see_through_a_closed_lamp():
    """Of a ball only the near side sends light here, whatever else may stand in the way."""
    card = virtual("card", plane(1.0, 1.0), RHO)
    scene = scene_of([card, lamp(ball(0.1, at=(0, 0, 0.5), subdivisions=4), 20.0)])
    found = probe(IMAGE_BASED, scene, (0.1, 0, 0), distance=0.1, spp=1024)
    truth = RHO * (1.0 + 20.0 * ball_share(0.1, 0.5, 0.1))
    agrees(found.virtual, found.virtual_error, truth, 2e-3)


# --- what others need not pay -------------------------------------------------------------------


@pytest.mark.slow
def test_several_directions_from_the_first_vertex():
    scene = scene_of([real("floor", FLOOR, RHO), lamp(quad(*LAMP), 5.0)])
    point = (0.1, 0.05, 0.0)
    truth = RHO * 4.0 * polygon_share(rectangle(*LAMP), point)
    for name in TRACERS:
        found = probe(get_method(name), scene, point, spp=256, settings={"light_samples": 4})
        agrees(found.delta, found.delta_error, truth, 1e-4)


@pytest.mark.slow
def test_photo_reflectance_knows_the_light_of_a_real_lamp():
    """E_r holds what a declared lamp sends, also over a wall, also where the photo clips the lamp."""
    from test_photo_reflectance import changes, from_photo, photo_of

    from mrbatch.scene.closed_forms import look_at

    table = real("table", plane(3.0, 3.0), (0.6, 0.4, 0.2))
    wall = real("wall", placed(plane(3.0, 3.0), at=(0, 1.0, 1.0), normal=(0, -1, 0)), (0.3, 0.5, 0.7))
    there = lamp(quad(-0.6, -0.4, 0.1, 0.3, 0.8), 30.0, is_virtual=False, camera=True, reflectance=0.5)
    lid = virtual("lid", ball(0.3, at=(0.3, 0, 0.5), subdivisions=3), 0.5, camera=False)
    view = look_at((1.2, -3.0, 2.4), (0, 0, 0.2), width=48, height=36, focal=48)
    light = sky(0.3)
    photo = np.minimum(photo_of([table, wall, there], light, view), 4.0)
    truth, _ = changes([table, wall, there, lid], light, view, photo)
    guessed, _ = changes([from_photo(table), from_photo(wall), there, lid], light, view, photo)
    shadow = truth.mean(axis=-1) < -0.02
    assert shadow.sum() > 40
    for channel in range(3):
        ratio = guessed[shadow][:, channel].sum() / truth[shadow][:, channel].sum()
        assert ratio == pytest.approx(1.0, abs=0.02)


def test_scenes_without_lamps_have_no_code_of_them():
    from test_switches import source

    from mrbatch.device.rays import resolve_engine
    from mrbatch.methods.delta_path_tracing.kernels import Flags
    from mrbatch.scene.shading import ShadingFlags

    engine = resolve_engine("auto")
    without = source(Flags(engine=engine))
    glows = replace(Flags(engine=engine), shading=ShadingFlags(emission=True))
    met, drawn = source(glows), source(replace(glows, lamps="mis"))
    for name in ("draw_lamp", "lamp_pdf", "over_pdf"):
        assert name in drawn and name not in met and name not in without, name
    assert "emission_at" in met and "emission_at" not in without
    assert len(without) < len(met) < len(drawn)


@pytest.mark.slow
def test_numbers_of_lamps_are_apart_from_all_others():
    """Light of the map has the same bits whether directions to lamps are drawn or not."""
    from mrbatch.methods.delta_path_tracing import passes

    dark = lamp(quad(-0.3, 0.3, -0.2, 0.2, 1.0), 0.0)
    scene = scene_of([real("floor", FLOOR, RHO), dark, virtual("card", quad(*LID), 0.6, camera=False)])
    method = get_method("delta-path-tracing")
    plain = probe(method, scene, (0.1, 0.05, 0), spp=32)
    make = passes.make_flags
    passes.make_flags = lambda *arguments: replace(make(*arguments), lamps="mis")
    try:
        full = probe(method, scene, (0.1, 0.05, 0), spp=32)
    finally:
        passes.make_flags = make
    assert np.array_equal(plain.pixels, full.pixels) and plain.counters == full.counters


def verdict(objects, half_code=0.0):
    from mrbatch.effects.facts import FrameFacts, ShotFacts
    from mrbatch.effects.surface_rules import EMISSION
    from mrbatch.film.window import Window
    from mrbatch.scene.closed_forms import look_at

    view = look_at((0, -4, 4), (0, 0, 0), width=16, height=16, focal=16)
    method = get_method("delta-path-tracing")
    return EMISSION.decide(
        ShotFacts(
            scene=scene_of(objects),
            frames=(FrameFacts(0, {"": view}, {"": np.full(3, 2.0)}),),
            windows={"": Window(0, 0, 16, 16)},
            settings=method.settings(),
            layers=frozenset(),
            half_code=half_code,
        )
    )


def test_rule_of_emission():
    """Absent, needed, and negligible where F L_e is below half a code value on whatever there is."""
    ground = real("floor", plane(4, 4), RHO)
    far = ball(0.1, at=(0, 0, 3.0), subdivisions=2)
    assert verdict([ground, virtual("ball", far)]).state == "absent"
    assert verdict([ground, lamp(far, 1.0)]).state == "needed"
    assert verdict([ground, lamp(far, 1.0)], half_code=0.05).state == "negligible"
    assert verdict([ground, lamp(far, 1.0, camera=True)], half_code=0.05).state == "needed"
    assert verdict([ground, lamp(far, 100.0)], half_code=0.05).state == "needed"
    assert (
        verdict([ground, lamp(far, 1.0, is_virtual=False, camera=True)], half_code=0.05).state == "negligible"
    )
    mirror = replace(virtual("mirror", plane(1, 1)), material=Material("conductor", (0.9,) * 3, 0.0))
    assert verdict([ground, mirror, lamp(far, 1.0)], half_code=0.05).state == "needed"
    # The bound holds: what the rule would leave out is less. Gain 2, F at the foot 0.1^2 / 3^2; the bound's
    # ball is round the lamp's box (3 F at most), and light may come back from a floor of 0.5 (2 times).
    bound = verdict([ground, lamp(far, 1.0)], half_code=0.05).bound
    truth = 2.0 * RHO * ball_share(0.1, 3.0, 0.0)
    assert truth <= bound < 6.1 * truth


def test_what_a_lamp_reflects_is_not_taken_from_the_photo():
    item = {"name": "lamp", "plane": {"size": ["1 m", "1 m"]}, "emission": 2.0}
    assert build_scene(None, [given.RealObject.model_validate(item | {"reflectance": 0.3})], []).real[
        0
    ].material.emission == (2.0, 2.0, 2.0)
    with pytest.raises(ValueError, match="lamp"):
        given.RealObject.model_validate(item | {"reflectance": "photo"})


def test_the_bound_on_the_change_holds_the_long_shadow_of_a_real_lamp():
    """A small ball near a low lamp darkens the table far behind it by more than the map could."""
    from mrbatch.effects.light_bounds import Boxes, LightBounds

    low = lamp(ball(0.05, at=(-1.0, 0, 0.42), subdivisions=2), 6000.0, is_virtual=False)
    small = virtual("ball", ball(0.1, at=(0, 0, 0.3), subdivisions=2), 0.2, camera=False)
    scene = scene_of([real("floor", FLOOR, RHO), low, small], sky(0.2))
    there = np.array([[2.4, 0.0, 0.0]])
    found = probe(get_method("delta-path-tracing"), scene, there[0], spp=64)
    truth = RHO * 6000.0 * ball_share(0.05, 0.42, 3.4)
    agrees(found.delta, found.delta_error, -truth, 0.05 * truth)
    bounds = LightBounds(scene, exact=False)
    surface = next(body for body in bounds.real if body.item.name == "floor")
    most = bounds.change(surface, Boxes(there, there), (np.array([0.0, 0.0, 1.0]), 0.0))
    assert np.all(most >= truth)
