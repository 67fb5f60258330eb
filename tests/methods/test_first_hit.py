"""Data layers at first hits, against geometry worked out by hand in float64."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from mrbatch.contracts import Pipeline
from mrbatch.device.rays import resolve_engine
from mrbatch.device.runner import Runner
from mrbatch.device.timing import TimingNode
from mrbatch.film.binding import bind_view
from mrbatch.film.first_hit import first_hit_buffers, first_hit_estimates, first_hit_pass
from mrbatch.film.layers import NOTHING
from mrbatch.film.outputs import Outputs, ViewInput, ViewOutput
from mrbatch.film.rendering import FrameRenderer, Look, Source
from mrbatch.film.window import Window
from mrbatch.scene.closed_forms import ball, look_at, real, scene_of, virtual
from mrbatch.scene.mesh import plane
from mrbatch.scene.motion import Motion
from mrbatch.scene.scene import Material, Texture
from mrbatch.scene.scene_data import upload
from mrbatch.scene.shading import ShadingFlags

PARTS = frozenset({"depth", "normal", "albedo", "motion", "object_ids"})
WIDTH, HEIGHT = 24, 20


def layers(
    objects, camera, *, next_camera=None, needs=PARTS, tiles=None, window=None, times=(), cutouts=False
):
    """`times`: moments at which the exposure of frame 0 is looked at."""
    engine = resolve_engine("auto")
    window = window or Window(0, 0, camera.width, camera.height)
    view = ViewOutput("", 0, window)
    outputs = Outputs((view,), needs, 0, engine, shutter=len(times) > 0)
    there = scene_of(objects)
    scene = upload(there, engine)
    shading = ShadingFlags(textures=True, normal_maps=True, cutouts=cutouts)
    step = first_hit_pass(scene, view, outputs, shading, False, "box")
    pipeline = Pipeline(
        finish=(step,),
        buffers=first_hit_buffers(view, outputs),
        bind=lambda frame: {"": bind_view(scene, outputs, view, frame, photo=False)},
    )
    black = np.zeros((window.height, window.width, 3), np.float32)
    with Runner(1) as runner:
        renderer = FrameRenderer(runner, [Source("method", pipeline)], outputs, TimingNode("test"))
        shifts = there.shifts(0, 1) if there.moves else None
        given = {"": ViewInput(camera, black, np.ones(3), next_camera, shifts=shifts)}
        looks = [
            Look(
                partial(scene.show, time, 0),
                {"": replace(given[""], frame_camera=camera, home=there.shifts(time, 0))},
            )
            for time in times
        ]
        samples = 2 * max(1, len(times))
        chosen = None if tiles is None else {"": tiles}
        rendered = renderer.render(0, given, samples, tiles=chosen, looks=looks)
        ids = {
            "object": np.arange(1, len(objects) + 1, dtype=np.uint32) * 100,
            "material": np.array([7 if o.material.name == "shared" else 8 for o in objects], np.uint32),
        }
        return first_hit_estimates(view, outputs, rendered.buffers, ids)


def camera():
    return look_at((0, 0, 5.0), (0, 0, 0), width=WIDTH, height=HEIGHT, focal=20.0)


def card(height, size=2.0, **switches):
    return virtual("card", plane(size, size, centre=(0, 0, height)), (0.1, 0.5, 0.9), **switches)


def test_depth_normal_albedo_of_a_card():
    """A card 3 m below the camera covers (2 / 3) 20 = 13.33 pixels each way."""
    found = layers([real("floor", plane(20, 20)), card(2.0)], camera())
    inside = np.s_[5:15, 7:17]
    assert np.allclose(found["depth"][inside], 3.0, rtol=1e-6)
    assert np.allclose(found["normal"][inside], [0, 0, 1], atol=1e-6)
    assert np.allclose(found["albedo"][inside], [0.1, 0.5, 0.9], atol=1e-6)
    # Real things are in no layer; nothing is 1e10 away.
    assert np.all(found["depth"][0] == NOTHING) and not found["normal"][0].any()
    share = found["object_coverage"].sum(axis=-1)
    assert share.sum() == pytest.approx((20 * 2 / 3) ** 2, rel=0.01)
    # Premultiplied: at the edge a normal is as long as the coverage.
    assert np.allclose(found["normal"][..., 2], share, atol=1e-5)
    assert set(np.unique(found["object_ids"])) == {0, 200}


def test_veils_and_cut_outs_cover_their_share():
    """Opacity is coverage; behind a veil the next object has the rest; depth is the nearest that is there."""
    veil = card(2.0)
    veil = replace(veil, material=replace(veil.material, opacity=0.5))
    solid = virtual("solid", plane(8, 8, centre=(0, 0, 1.0)), 0.3)
    found = layers([real("floor", plane(20, 20)), veil, solid], camera(), cutouts=True)
    inside = np.s_[6:14, 8:16]
    by_id = {
        k: (found["object_coverage"] * (found["object_ids"] == k)).sum(axis=-1)[inside] for k in (200, 300)
    }
    assert np.all(by_id[200] == 0.5) and np.all(by_id[300] == 0.5)
    assert np.allclose(found["depth"][inside], 3.0, rtol=1e-6)
    assert np.allclose(found["albedo"][inside], np.array([0.2, 0.4, 0.6]), atol=1e-6)
    # Cut out, half a card: nothing where it is not, all where it is.
    picture = np.zeros((1, 64, 3), np.float32)
    picture[:, 32:] = 1.0
    cut = card(2.0)
    cut = replace(cut, material=replace(cut.material, opacity_texture=Texture(picture), opacity_cutoff=0.5))
    found = layers([cut], camera(), cutouts=True)
    share = found["object_coverage"].sum(axis=-1)
    left, right = share[6:14, 7:11], share[6:14, 13:17]
    assert camera().world_from_camera[0, 0] == 1.0
    assert not left.any() and np.all(right == 1.0)
    assert np.all(found["depth"][6:14, 7:11] == NOTHING)


def test_depth_is_planar_and_the_nearest():
    """A tilted plane: planar z along the optical axis, the least within the pixel."""
    slope = 0.5
    mesh = plane(30, 30)
    mesh = replace(mesh, vertices=mesh.vertices + mesh.vertices[:, :1] * [0, 0, slope], normals=None)
    found = layers([virtual("ramp", mesh)], camera())
    # Camera at z = 5 looking down, picture x along world x or against it: z = 5 - slope x, x = +-t u.
    u = (np.arange(WIDTH) + 0.5 - WIDTH / 2) / 20.0
    half = 0.5 / 20.0
    across = camera().world_from_camera[0, 0]
    nearest = np.minimum(5 / (1 + slope * across * (u - half)), 5 / (1 + slope * across * (u + half)))
    middle = 5 / (1 + slope * across * u)
    row = found["depth"][HEIGHT // 2]
    assert np.all(row >= nearest - 1e-5) and np.all(row < middle)


def test_motion_of_a_moving_camera():
    """Pixels to the next frame, y down: a camera that goes right moves the picture left."""
    here = camera()
    pose = here.world_from_camera.copy()
    pose[:3, 3] += pose[:3, 0] * 0.03 + pose[:3, 1] * 0.06
    found = layers([card(2.0)], here, next_camera=here.at(pose))
    assert np.allclose(found["motion"][10, 12], [-0.03 / 3 * 20, -0.06 / 3 * 20], atol=1e-4)
    still = layers([card(2.0)], here)
    assert np.abs(still["motion"]).max() < 1e-4
    # A mean over hits, not premultiplied: as large at the card's edge as in its middle.
    edge = (found["object_coverage"].sum(axis=-1) > 0) & (found["object_coverage"].sum(axis=-1) < 0.5)
    assert edge.any()
    assert np.allclose(found["motion"][edge], [-0.2, -0.4], atol=1e-3)


def turning(degrees: float, size: float = 3.0):
    """A card that turns about the optical axis, by so much a frame."""
    card_mesh = plane(size, size, centre=(0, 0, 2.0))
    turns = [[0, 0, np.sin(a), np.cos(a)] for a in np.radians([-degrees / 2, 0, degrees / 2])]
    motion = Motion(np.array([-1.0, 0, 1]), np.zeros((3, 3)), np.array(turns), np.ones((3, 3)))
    return replace(virtual("card", card_mesh), motion=motion, still=card_mesh)


def test_motion_of_what_is_blurred_is_that_of_the_points_that_are_seen():
    """Over a shutter that is open from 0 to 0.5 a pixel shows points that were elsewhere at the frame's own
    time: each goes on from there."""
    degrees, times = 30.0, (0.0625, 0.1875, 0.3125, 0.4375)
    found = layers([turning(degrees)], camera(), times=times)
    # Down on the picture is -y in the world: turns are the other way round.
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5 - np.array([HEIGHT / 2, WIDTH / 2])[:, None, None]
    at = x - 1j * y

    def turn(share):
        return np.exp(1j * np.radians(degrees) * share)

    expected = np.mean([(turn(1) - 1) * turn(-t) * at for t in times], axis=0)
    wrong = (turn(1) - 1) * at
    middle = np.hypot(x, y) < 6
    moved = found["motion"][..., 0] - 1j * found["motion"][..., 1]
    # The camera's x axis in the world may go either way.
    across = camera().world_from_camera[0, 0]
    if across < 0:
        moved = -moved
        expected, wrong = -expected, -wrong
    assert np.abs(moved - expected)[middle].max() < 0.05
    assert np.abs(moved - wrong)[middle].max() > 0.3


def test_moments_at_which_nothing_has_moved_change_no_layer():
    """Four looks share the samples of one, and add up to the same."""
    objects = [real("floor", plane(20, 20)), card(2.0), card(1.0, 3.0)]
    once, often = layers(objects, camera()), layers(objects, camera(), times=(-0.3, -0.1, 0.1, 0.3))
    for part in ("depth", "object_ids"):
        assert np.array_equal(once[part], often[part])
    for part in ("normal", "albedo", "motion", "object_coverage"):
        np.testing.assert_allclose(once[part], often[part], atol=1e-5)


def test_overlapping_objects_share_a_pixel():
    """Coverage by object; the nearer hides the farther; holdouts and unseen objects are in no layer."""
    left = virtual("left", plane(2, 2, centre=(-1.0 - 0.05, 0, 1)))
    right = virtual("right", plane(2, 2, centre=(1.0 - 0.05, 0, 1)))
    below = virtual("below", ball(0.5, at=(0, 0, 0)))
    found = layers([left, right, below], camera())
    total = {k: found["object_coverage"][found["object_ids"] == k].sum() for k in (100, 200, 300)}
    # x runs against the world's or with it: the two cards meet 0.05 m beside the middle.
    assert total[100] == pytest.approx(total[200], rel=0.02) and total[300] == 0
    middle = found["object_coverage"][10, 11:13].sum(axis=-1)
    assert np.allclose(middle, 1.0)
    shared = (found["object_coverage"] > 0).sum(axis=-1) == 2
    assert shared[8:12].any()
    for switch in ({"holdout": True}, {"camera": False}):
        found = layers([card(2.0, **switch)], camera())
        assert np.all(found["depth"] == NOTHING) and not found["object_coverage"].any()


def test_objects_of_one_material_share_its_mask():
    shared = Material(name="shared")
    cards = [
        replace(virtual(name, plane(2, 2, centre=(x, 0, 1))), material=look)
        for name, x, look in (("left", -2.0, shared), ("middle", 0.0, Material()), ("right", 2.0, shared))
    ]
    found = layers(cards, camera(), needs=frozenset({"material_ids", "material_coverage"}))
    assert set(found) == {"material_ids", "material_coverage"}
    total = {k: found["material_coverage"][found["material_ids"] == k].sum() for k in (7, 8)}
    assert total[8] == pytest.approx(100, rel=0.01), "2 m seen from 4 m: 10 x 10 pixels"
    assert total[7] == pytest.approx(2 * 70, rel=0.01), "7 of 10 columns of each are in the picture"


def test_the_largest_of_many_objects_is_kept():
    """Eight slivers cover the left of a pixel, one card the rest: the card must not be the one left out."""
    edges = np.linspace(-0.05, 0.0, 9)
    slivers = [
        virtual(f"sliver{i}", plane(float(b - a), 0.2, centre=(float(a + b) / 2, -0.05, 0.0)))
        for i, (a, b) in enumerate(zip(edges[:-1], edges[1:], strict=True))
    ]
    view = look_at((0, 0, 5.0), (0, 0, 0), width=1, height=1, focal=50.0)
    found = layers([*slivers, virtual("card", plane(0.2, 0.4, centre=(0.1, 0, 0.0)))], view)
    share = found["object_coverage"][0, 0][found["object_ids"][0, 0] == 900]
    assert share.sum() == pytest.approx(0.5, abs=0.02)


def test_albedo_is_the_texture():
    texels = np.zeros((2, 2, 3), np.float32)
    texels[:, 1] = 1.0
    item = replace(card(2.0), material=Material(texture=Texture(texels)))
    found = layers([item], camera())
    # Pixel 7 sees x = -.675 m: u = .1625, .175 of a texel before the first one's centre, where texels repeat.
    assert camera().world_from_camera[0, 0] == 1.0
    assert found["albedo"][10, 7, 0] == pytest.approx(0.175, abs=0.005)
    assert found["albedo"][10, 16, 0] == pytest.approx(0.825, abs=0.005)


def test_the_normal_layer_shows_the_map():
    tilt = np.array([0.6, 0.0, 0.8], np.float32)
    item = replace(card(2.0), material=Material(normal_texture=Texture(tilt[None, None])))
    found = layers([item], camera())
    np.testing.assert_allclose(found["normal"][10, 12], tilt, atol=1e-6)


def test_tiles_that_are_left_out_hold_nothing():
    found = layers([card(2.0)], camera(), tiles=np.array([0], np.int32))
    assert np.all(found["depth"][16:] == NOTHING) and np.all(found["depth"][:, 16:] == NOTHING)
    assert (found["depth"][:16, :16] < NOTHING).any()


def test_only_what_is_asked_for_is_made():
    found = layers([card(2.0)], camera(), needs=frozenset({"depth"}))
    assert set(found) == {"depth"}


def test_a_crop_is_the_crop():
    whole = layers([card(2.0)], camera())
    part = layers([card(2.0)], camera(), window=Window(-3, 4, 20, 9))
    for name in ("depth", "normal", "albedo", "motion", "object_ids", "object_coverage"):
        assert np.array_equal(part[name][:, 3:], whole[name][4:13, :17]), name
