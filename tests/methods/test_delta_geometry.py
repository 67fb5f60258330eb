"""Geometry that a light change must get right: doubled and broken surfaces, facets, mirrors, edges of the
frame; against closed forms, and against scenes that must give the same bits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mrbatch.film.window import Window
from mrbatch.methods.delta_path_tracing import METHOD as DELTA
from mrbatch.methods.delta_path_tracing.cases import delta_probe as probe
from mrbatch.methods.estimate import estimate
from mrbatch.scene.closed_forms import (
    ball,
    ball_share,
    corner,
    floor,
    lamp_sky,
    look_at,
    placed,
    real,
    scene_of,
    sky,
    virtual,
)
from mrbatch.scene.environment import Environment, rotation_from_yaw
from mrbatch.scene.mesh import Mesh, box, icosphere, plane, uv_sphere
from mrbatch.scene.mesh_file import load_mesh
from mrbatch.scene.scene import Material, SceneObject


def picture(objects, *, light=None, size=32, spp=8, eye=(2.0, -3.0, 2.5), target=(0, 0, 0.3), **options):
    view = look_at(eye, target, width=size, height=size, focal=1.2 * size)
    photo = np.full((size, size, 3), 0.3, np.float32)
    return estimate(DELTA, scene_of(objects, light), view, spp=spp, background=photo, **options)


def same(a, b):
    for name in ("P", "a", "D"):
        assert np.array_equal(getattr(a.developed, name), getattr(b.developed, name)), name


# --- meshes -----------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.case("GEO-04")
def test_broken_triangles_show_in_no_bit(tmp_path):
    """A file with triangles of no area, repeated corners and vertices that are no numbers; one without."""
    good = box((0.6, 0.6, 0.6), centre=(0, 0, 0.3))
    n = len(good.vertices)
    vertices = [*good.vertices.tolist(), [np.nan, 0, 0], [np.inf, 1, 0], [0.3, 0.3, 0.3]]
    junk = [[0, 1, n], [2, n + 1, 3], [4, 4, 5], [6, 6, 6], [0, n + 2, n + 2]]
    seen = []
    for name, faces in (("clean", good.faces.tolist()), ("broken", [*junk, *good.faces.tolist(), *junk])):
        path = tmp_path / f"{name}.ply"
        head = ["ply", "format ascii 1.0", f"element vertex {len(vertices)}"]
        head += [f"property double {c}" for c in "xyz"]
        head += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
        rows = [" ".join(repr(float(c)) for c in v) for v in vertices]
        path.write_text("\n".join([*head, *rows, *(f"3 {a} {b} {c}" for a, b, c in faces)]) + "\n")
        mesh = load_mesh(path)
        assert mesh.dropped == (0 if name == "clean" else 2 * len(junk))
        seen.append(picture([*corner(0.5, size=16.0), virtual("thing", mesh, 0.6)], light=lamp_sky()))
    assert seen[0].developed.P.any() and seen[0].developed.D.any()
    same(*seen)


@pytest.mark.slow
@pytest.mark.case("GEO-06", "TRAP-3i")
@pytest.mark.parametrize("real_things", ["plane", "corner"])
def test_a_surface_that_is_there_twice_is_there_once(real_things):
    """Real and virtual surfaces doubled in place: rays that meet both and leave either give the same bits."""
    ground = [real("floor", floor(16.0), 0.5)] if real_things == "plane" else corner(0.5, size=16.0)
    thing = virtual("thing", box((0.6, 0.6, 0.6), centre=(0.6, 0, 0.3)), (0.7, 0.4, 0.2))
    once = picture([*ground, thing], light=lamp_sky())
    twice = [replace(ground[0], name="again"), *ground, thing, replace(thing, name="thing again")]
    assert once.developed.P.any() and once.developed.D.any()
    same(once, picture(twice, light=lamp_sky()))


def lit_below(normal, height=64, width=128) -> Environment:
    """Radiance 1 in texels that lie wholly below the plane of `normal` and a little more, else 0."""
    theta = np.pi * np.arange(height + 1) / height
    phi = 2 * np.pi * (0.5 - np.arange(width + 1) / width)
    t, p = np.meshgrid(theta, phi, indexing="ij")
    d = np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], axis=-1) @ np.asarray(normal)
    most = np.maximum.reduce([d[:-1, :-1], d[1:, :-1], d[:-1, 1:], d[1:, 1:]])
    lit = np.where(most < -0.02, 1.0, 0.0).astype(np.float32)
    return Environment(np.repeat(lit[..., None], 3, axis=-1), interpolation="nearest")


@pytest.mark.case("GEO-09")
@pytest.mark.parametrize("face", [40, 100, 170])
@pytest.mark.parametrize("weights", [(0.9, 0.05, 0.05), (0.05, 0.05, 0.9)])
def test_a_coarse_smooth_ball_takes_no_light_from_below_its_facets(face, weights):
    """A ball of 16 x 8 facets with smooth normals, which does not shade itself: shading normals see beyond
    the facet's horizon, and what they see there must not count."""
    mesh = uv_sphere(1.0, segments=16, rings=8)
    a, b, c = mesh.vertices[mesh.faces[face]]
    point = weights[0] * a + weights[1] * b + weights[2] * c
    normal = mesh.face_normals()[face]
    light = lit_below(normal)
    shading = np.asarray(weights) @ mesh.normals[mesh.faces[face]].astype(np.float64)
    assert light.irradiance(shading[None] / np.linalg.norm(shading))[0, 0] > 0.01, "printed form: a leak"
    item = virtual("ball", mesh, 1.0, cast_shadow=False)
    found = probe(scene_of([item], light), point, normal=normal, distance=1.0, spp=64)
    assert not found.virtual.any()


@pytest.mark.case("GEO-09")
def test_a_coarse_smooth_ball_gains_nothing():
    white = virtual("ball", uv_sphere(1.0, segments=16, rings=8), 1.0)
    found = picture([white], spp=256, eye=(0, -4, 1), target=(0, 0, 0)).developed
    inside = found.P[found.a == 1][:, 0]
    error = np.sqrt(found.variance[found.a == 1][:, 0])
    assert len(inside) > 100
    assert np.all(inside <= 1.0 + 5 * error + 1e-5)
    assert inside.mean() <= 1.0 + 4 * inside.std() / np.sqrt(len(inside))


# --- closed forms -----------------------------------------------------------------------------------


@pytest.mark.case("DPT-02")
@pytest.mark.parametrize("s", [0.25, 0.5, 1.0, 2.0, 4.0])
def test_black_ball_on_a_plane_to_a_thousandth(s):
    """-rr F with F = (1 + s^2)^-1.5: .913, .716, .354, .0894, .0143 at a quarter to four radii."""
    table = {0.25: 0.913, 0.5: 0.716, 1.0: 0.354, 2.0: 0.0894, 4.0: 0.0143}
    share = float(ball_share(1.0, 1.0, s))
    assert share == pytest.approx(table[s], abs=6e-4)
    scene = scene_of([real("floor", floor(), 0.5), virtual("ball", ball(), 0.0, camera=False)])
    found = probe(scene, (s, 0, 0), spp=2048)
    assert np.all(np.abs(found.delta + 0.5 * share) < 1e-3 * 0.5 * share + 4 * found.delta_error)
    assert np.all(found.delta_error < 1e-2 * 0.5 * share)


def hollow(radius: float, at) -> Mesh:
    mesh = icosphere(1.0, subdivisions=4)
    depth = sum(np.exp(10.0 * (mesh.vertices @ axis - 1.0)) for axis in np.eye(3))
    return replace(
        mesh, vertices=mesh.vertices * (radius * (1 - 0.6 * depth))[:, None] + np.asarray(at), normals=None
    )


MESHES = {
    "box": box((1.0, 0.6, 0.8), centre=(0, 0, 0.4)),
    "half in the floor": box((0.8, 0.8, 0.8), centre=(0, 0, 0.1)),
    "hollow": hollow(0.6, (0, 0, 0.7)),
    "card": placed(plane(1.0, 1.0), at=(-0.2, 0, 0.5), normal=(1, 0, 0)),
}


@pytest.mark.case("DPT-04", "TRAP-1e")
@pytest.mark.parametrize("name", MESHES)
def test_any_white_thing_on_a_white_floor_changes_nothing(name):
    scene = scene_of([real("floor", floor(), 1.0), virtual("thing", MESHES[name], 1.0, camera=False)])
    for at in ((0.8, 0.1, 0), (0.2, 0.9, 0)):
        found = probe(scene, at, spp=256)
        assert np.all(np.abs(found.delta) < 1e-3 + 4 * found.delta_error)


def upright_share(a: float, b: float, c: float) -> float:
    """Form factor of a rectangle a high and b wide that stands on the plane, one lower corner c off."""
    y, q = c / b, np.hypot(a, c) / b
    return float((np.arctan(1 / y) - y / q * np.arctan(1 / q)) / (2 * np.pi))


@pytest.mark.slow
@pytest.mark.case("DPT-06")
@pytest.mark.parametrize("reflectance", [0.0, 0.4, 1.0])
def test_upright_mirror_takes_what_it_does_not_mirror(reflectance):
    """Delta = -rr F (1 - R): whatever leaves the floor for the mirror ends in the sky above it."""
    a, b, c = 1.0, 1.0, 0.5
    assert upright_share(a, b, c) == pytest.approx(0.12427, abs=1e-5)
    card = placed(plane(b, a), at=(0, b / 2, a / 2), normal=(1, 0, 0))
    look = Material("conductor", (reflectance,) * 3, 0.0)
    item = SceneObject("mirror", card, look, True, camera=False)
    scene = scene_of([real("floor", floor(), 0.5), item])
    found = probe(scene, (c, 0, 0), spp=2048)
    oracle = -0.5 * upright_share(a, b, c) * (1 - reflectance)
    assert np.all(np.abs(found.delta - oracle) < 4 * found.delta_error + 1e-6)
    assert np.all(found.delta_error < 1e-3)
    if reflectance == 1.0:
        # What is taken off a ray and what is put on it are one number.
        exact = probe(scene, (c, 0, 0), spp=256, settings={"strategy": "bsdf"})
        assert np.abs(exact.pixels).max() < 1e-6


# --- in front and behind ----------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.case("DPT-07")
def test_what_stands_in_a_closed_real_box_changes_nothing_outside():
    """Six walls with a glowing white ball inside: not a bit, and the map is never asked."""
    inside = virtual("ball", ball(0.3, at=(0, 0, 0.5)), 0.9)
    glowing = replace(inside, material=replace(inside.material, emission=(5.0, 5.0, 5.0)))
    objects = [real("floor", floor(), 0.5), real("box", box((0.8, 0.8, 0.8), centre=(0, 0, 0.5))), glowing]
    for at, normal in (((0.6, 0.1, 0), (0, 0, 1)), ((0.4, 0.1, 0.5), (1, 0, 0))):
        found = probe(scene_of(objects, lamp_sky()), at, normal=normal, spp=256)
        assert found.counters["scatter rays"] > 0
        assert not found.pixels.any() and found.counters["lookups"] == 0


@pytest.mark.case("DPT-10")
def test_a_shadow_in_the_frame_of_a_thing_outside_is_that_of_a_wider_frame():
    objects = [
        real("floor", floor(16.0), 0.5),
        virtual("ball", ball(0.4, at=(-1.1, 0, 0.4), subdivisions=4), 0.3),
    ]
    options = dict(light=lamp_sky(), size=64, eye=(0, -3.0, 3.0), target=(0, 0, 0), half_code=1e-4)
    whole = picture(objects, **options)
    first = int(np.nonzero(whole.developed.a.any(axis=0))[0].max()) + 2
    assert first < 40
    part = picture(objects, window=Window(first, 0, 64 - first, 64), **options)
    assert not part.developed.a.any() and np.abs(part.developed.D).max() > 0.02
    for name in ("P", "a", "D"):
        assert np.array_equal(getattr(part.developed, name), getattr(whole.developed, name)[:, first:]), name


@pytest.mark.case("DPT-14")
def test_a_real_pole_hides_what_stands_behind_it():
    """M is 0 where the pole is: exactly, pixel by pixel, and the pole has its own light change."""
    pole = real("pole", box((0.2, 0.2, 2.0), centre=(0.4, -1.0, 1.0)), 0.5)
    thing = virtual("thing", box((1.5, 0.3, 1.0), centre=(0, 0, 0.5)), 0.5)
    options = dict(size=48, eye=(0.4, -4.0, 1.2), target=(0.4, 0, 0.7), spp=16)
    held = picture([real("floor", floor()), pole, thing], **options).developed
    alone = picture([real("floor", floor()), thing], **options).developed
    shown = picture([replace(pole, virtual=True)], **options).developed
    assert (shown.a == 1).sum() > 40
    assert not held.a[shown.a == 1].any() and not held.P[shown.a == 1].any()
    assert alone.a[shown.a == 1].any()
    assert np.array_equal(held.a[shown.a == 0], alone.a[shown.a == 0])
    assert held.D[shown.a == 1].any()


@pytest.mark.case("ENV-08")
@pytest.mark.parametrize(("row", "column", "yaw"), [(40, 300, 0.0), (44, 37, 0.0), (36, 300, 0.37)])
def test_the_tip_of_a_shadow_is_where_the_lamps_texel_throws_it(row, column, yaw):
    """A map black but for one texel; a card that stands on the floor; the house's formula in float64."""
    height, width = 128, 384
    image = np.full((height, width, 3), 1e-4, np.float32)
    image[row, column] = 1e3
    light = Environment(image, world_from_map=rotation_from_yaw(yaw), interpolation="nearest")
    phi = 2 * np.pi * (0.5 - (column + 0.5) / width)
    theta = np.pi * (row + 0.5) / height
    d = np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
    d = rotation_from_yaw(yaw) @ d
    # The card faces the lamp, a metre high and half a metre wide.
    across = np.array([-d[1], d[0], 0]) / np.hypot(d[0], d[1])
    corners = np.array([-across * 0.25, across * 0.25, across * 0.25 + [0, 0, 1], -across * 0.25 + [0, 0, 1]])
    card = virtual("card", Mesh(corners, np.array([[0, 1, 2], [0, 2, 3]], np.int32)), 0.0, camera=False)
    size = 96
    view = look_at((0, 0, 6), (0, 0, 0), width=size, height=size, focal=1.2 * size)
    D = estimate(DELTA, scene_of([real("floor", floor(8.0), 0.5), card], light), view, spp=64).developed.D
    depth = -D[..., 0] / -D[..., 0].min()
    tip = np.array([0, 0, 1.0]) - d / d[2]
    # Along the shadow's middle line: it ends where half of the lamp is seen.
    steps = np.linspace(0.2, 1.4, 1201)
    pixels, _ = view.project(steps[:, None] * tip)
    i = np.floor(pixels - 0.5).astype(int)
    f = pixels - 0.5 - i
    x, y = i.T
    along = (depth[y, x] * (1 - f[:, 0]) + depth[y, x + 1] * f[:, 0]) * (1 - f[:, 1]) + (
        depth[y + 1, x] * (1 - f[:, 0]) + depth[y + 1, x + 1] * f[:, 0]
    ) * f[:, 1]
    plateau = np.median(along[(steps > 0.4) & (steps < 0.8)])
    end = steps[np.nonzero(along > 0.5 * plateau)[0].max()]
    found, truth = view.project(np.array([end * tip, tip]))[0]
    assert plateau > 0.8
    assert np.linalg.norm(found - truth) < 0.5
    # Nor is the shadow anywhere else: the middle of its mass is the middle of what the card hides.
    y, x = np.indices(depth.shape) + 0.5
    strong = np.where(depth > 0.1, depth, 0.0)
    middle = np.array([(strong * x).sum(), (strong * y).sum()]) / strong.sum()
    assert np.linalg.norm(middle - view.project(0.5 * tip[None])[0][0]) < 1.0


@pytest.mark.case("IO-07")
@pytest.mark.parametrize(("width", "height"), [(1, 1), (1279, 719), (1, 4096)])
def test_odd_sizes_are_crops_of_larger_pictures(width, height):
    """Pixel (x, y) is the same whatever the frame's size: one that no tile fits is a crop of a larger one."""
    objects = [
        real("floor", floor(16.0), 0.5),
        virtual("ball", ball(0.4, at=(0, 0, 0.4), subdivisions=3), 0.6),
    ]
    larger = look_at(
        (0, -0.4, 3), (0, 0, 0.2), width=width + 3, height=height + 5, focal=max(width, height, 40)
    )
    smaller = replace(larger, width=width, height=height)
    options = dict(spp=2, half_code=1e-3)
    window = Window(0, 0, width, height)
    part = estimate(DELTA, scene_of(objects, sky()), smaller, **options).developed
    whole = estimate(DELTA, scene_of(objects, sky()), larger, window=window, **options).developed
    assert part.P.shape == (height, width, 3) and (part.D.any() or part.P.any())
    for name in ("P", "a", "D", "variance", "samples"):
        assert np.array_equal(getattr(part, name), getattr(whole, name)), name


@pytest.mark.case("DPT-18")
@pytest.mark.parametrize(
    ("lamp", "blocker", "hidden"),
    [((0, 0, 6), (0, 0, 2), True), ((0, 3, 4), (2, 0, 2), False), ((0, 0, 2), (0, 0, 8), None)],
    ids=["lamp behind", "apart", "lamp in front"],
)
def test_a_virtual_lamp_behind_a_virtual_blocker_lights_nothing(lamp, blocker, hidden):
    """What is behind takes no part: rr (F_lamp (L_e - 1) - F_black) over what the floor sees of each."""
    e, rr = 5.0, 0.5
    glow = Material(reflectance=(0.0,) * 3, emission=(e,) * 3)
    objects = [
        real("floor", floor(), rr),
        SceneObject("lamp", ball(0.6, at=lamp), glow, True, camera=False),
        virtual("black", ball(0.5, at=blocker), 0.0, camera=False),
    ]
    f_lamp, f_black = (
        float(ball_share(r, at[2], np.hypot(at[0], at[1]))) for r, at in ((0.6, lamp), (0.5, blocker))
    )
    oracle = {
        True: -rr * f_black,
        False: rr * (f_lamp * (e - 1) - f_black),
        None: rr * f_lamp * (e - 1),
    }[hidden]
    found = probe(scene_of(objects), (0, 0, 0), spp=1024)
    assert np.all(np.abs(found.delta - oracle) < 1e-3 * abs(oracle) + 4 * found.delta_error)
    assert np.all(found.delta_error < 0.05 * abs(oracle))
