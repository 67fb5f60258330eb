"""Reflectance from the photo: recovered from photos that the path tracer made of known surfaces."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mrbatch.film.photo_reflectance import open_sides
from mrbatch.film.window import Window
from mrbatch.methods.delta_path_tracing import METHOD
from mrbatch.methods.estimate import estimate
from mrbatch.scene.closed_forms import (
    ball,
    ball_share,
    everything_virtual,
    lamp_sky,
    look_at,
    placed,
    real,
    scene_of,
    sky,
    virtual,
)
from mrbatch.scene.mesh import box, plane
from mrbatch.scene.scene import Material, Texture

WIDTH, HEIGHT = 48, 36


def camera(width=WIDTH, height=HEIGHT):
    return look_at((1.2, -3.0, 2.4), (0, 0, 0.2), width=width, height=height, focal=width)


def photo_of(objects, light, view, spp=256):
    """What a camera without virtual objects would take, gain 1, background black."""
    shown = everything_virtual(objects, with_virtual=False)
    return estimate(METHOD, scene_of(shown, light), view, spp=spp, seed=99).developed.P.astype(np.float32)


def from_photo(item):
    return replace(item, material=Material(from_photo=True))


def changes(objects, light, view, photo, *, seed=0, spp=256, gain=1.0, **options):
    result = estimate(
        METHOD,
        scene_of(objects, light),
        view,
        spp=spp,
        seed=seed,
        background=photo * gain,
        gain=[gain] * 3,
        **options,
    )
    return result.developed.D / gain, result


def room():
    return [
        real("table", plane(3.0, 3.0), (0.6, 0.4, 0.2)),
        real("wall", placed(plane(3.0, 3.0), at=(0, 1.0, 1.0), normal=(0, -1, 0)), (0.3, 0.5, 0.7)),
        real("cube", box((0.4, 0.4, 0.4), centre=(-0.6, 0, 0.2)), (0.7, 0.7, 0.3)),
        virtual("ball", ball(0.4, at=(0.5, 0, 0.4), subdivisions=3), 0.5, camera=False),
    ]


@pytest.mark.slow
@pytest.mark.parametrize("light", [sky(1.0), lamp_sky()], ids=["sky", "lamp"])
def test_the_change_is_that_of_the_true_reflectance(light):
    """The photo says of every surface what its reflectance is; gain and camera units cancel."""
    objects = room()
    view = camera()
    photo = photo_of(objects, light, view)
    truth, _ = changes(objects, light, view, photo, spp=256)
    guessed, result = changes(
        [from_photo(o) if not o.virtual else o for o in objects], light, view, photo, gain=0.37
    )
    assert result.plan.effects["photo-reflectance"].state == "needed"
    assert result.counters["irradiance rays"] > 0
    shadow = truth.mean(axis=-1) < -0.02
    assert shadow.sum() > 40
    for channel in range(3):
        ratio = guessed[shadow][:, channel].sum() / truth[shadow][:, channel].sum()
        assert ratio == pytest.approx(1.0, abs=0.02)
    # Nowhere does the light change by more than noise and the photo's own noise allow.
    worst = np.abs(guessed - truth).mean(axis=-1)
    assert np.percentile(worst, 95) < 0.1 * np.abs(truth).max()


@pytest.mark.slow
@pytest.mark.case("TRAP-3b")
def test_change_over_photo_is_flat_on_a_checkerboard():
    """TRAP-3b: Delta / L_b does not depend on the ink, and is the closed form F of a black ball."""
    cells = np.indices((8, 8)).sum(axis=0) % 2
    board = np.repeat(np.where(cells, 0.8, 0.04)[:, :, None], 3, axis=2).astype(np.float32)
    board = board.repeat(16, axis=0).repeat(16, axis=1)
    table = replace(real("table", plane(4.0, 4.0)), material=Material(texture=Texture(board)))
    black = virtual("ball", ball(0.5, at=(0, 0, 0.75)), 0.0, camera=False)
    view = look_at((0, 0, 3.0), (0, 0, 0), width=32, height=32, focal=40)
    # Exact photo: a lone plane under the sky shows its reflectance; ink edges off the pixels' middle.
    photo = photo_of([table], sky(), view, spp=64)
    delta, _ = changes([from_photo(table), black], sky(), view, photo, spp=512)
    ratio = (delta / photo).mean(axis=-1)
    y, x = (np.indices((32, 32)) + 0.5 - 16) * (3.0 / 40)
    expected = -ball_share(0.5, 0.75, np.hypot(x, y))
    ink = photo.mean(axis=-1) < 0.1
    paper = photo.mean(axis=-1) > 0.7
    assert ink.sum() > 100 and paper.sum() > 100
    for part in (ink, paper):
        error = (ratio - expected)[part]
        assert abs(error.mean()) < 3e-3 * abs(expected[part].mean()) + 4 * error.std() / np.sqrt(part.sum())


@pytest.mark.slow
def test_an_exact_photo_gives_the_exact_reflectance_and_surfaces_out_of_sight_count():
    """E_r behind the camera: light of a wall that no pixel shows is in the photo, so it must be in E_r."""
    rho = 0.5
    size = 200.0
    floor = real("floor", placed(plane(size, size), at=(size / 2, 0, 0)), rho)
    wall = real("wall", placed(plane(size, size), at=(0, 0, size / 2), normal=(1, 0, 0)), rho)
    hide = virtual("lid", plane(size, size, centre=(0, 0, size / 4)), 0.0, camera=False)
    view = look_at((1, 0, 0.5), (1, 0, 0), width=8, height=8, focal=64)
    photo = np.full((8, 8, 3), rho / (2 - rho), np.float32)
    objects = [from_photo(floor), wall, hide]
    delta, _ = changes(objects, sky(), view, photo, spp=64)
    # A black lid over everything takes all light: Delta = -L_b, whatever the reflectance.
    true, _ = changes([floor, wall, hide], sky(), view, photo, spp=64)
    assert (delta / true).mean() == pytest.approx(1.0, abs=0.02)


def test_objects_that_the_camera_does_not_see_are_not_in_the_photo():
    """A real object with `camera: false` hides no pixel; one that casts no shadow still shows its own."""
    table = real("table", plane(3.0, 3.0), 0.5)
    ghost = real("ghost", plane(3.0, 3.0, centre=(0, 0, 1.5)), 0.9, camera=False)
    black = virtual("ball", ball(0.4, at=(0, 0, 0.4), subdivisions=3), 0.0, camera=False)
    view = look_at((0, 0, 3.0), (0, 0, 0), width=16, height=16, focal=16)
    photo = np.full((16, 16, 3), 0.3, np.float32)
    for others in ([ghost], []):
        for casts in (True, False):
            seen = replace(from_photo(table), cast_shadow=casts)
            delta, _ = changes([seen, *others, black], sky(), view, photo, spp=64)
            assert delta[8, 8, 0] < -0.15, (len(others), casts)


def test_a_crop_is_the_crop_also_where_light_comes_from_beyond_it():
    objects = [from_photo(o) if not o.virtual else o for o in room()]
    view = camera()
    photo = np.random.default_rng(3).uniform(0.1, 0.4, (HEIGHT, WIDTH, 3)).astype(np.float32)
    whole, _ = changes(objects, sky(), view, photo, spp=4)
    window = Window(10, 7, 21, 18)
    part, _ = changes(objects, sky(), view, photo, spp=4, window=window)
    assert np.array_equal(part, whole[7:25, 10:31])
    around = Window(-5, -3, WIDTH + 9, HEIGHT + 8)
    wide, _ = changes(objects, sky(), view, photo, spp=4, window=around)
    assert np.array_equal(wide[3 : 3 + HEIGHT, 5 : 5 + WIDTH], whole)


@pytest.mark.slow
@pytest.mark.parametrize("light", [sky(1.0), lamp_sky()], ids=["sky", "lamp"])
def test_a_lone_table_needs_no_ray_for_its_irradiance(light):
    """The closed form and the traced one agree: a table that is not quite flat has no closed form."""
    table, item = real("table", plane(3.0, 3.0), (0.6, 0.4, 0.2)), room()[3]
    vertices = table.mesh.vertices.copy()
    vertices[0, 2] -= 1e-5
    bent = replace(table, mesh=replace(table.mesh, vertices=vertices, normals=None))
    view = camera()
    photo = photo_of([table], light, view, spp=1024)
    closed, alone = changes([from_photo(table), item], light, view, photo)
    traced, beside = changes([from_photo(bent), item], light, view, photo)
    centres = alone.counters["irradiance rays"]
    shown = (photo.sum(axis=-1) > 0).sum()
    assert WIDTH * HEIGHT + 0.9 * shown < centres <= WIDTH * HEIGHT + shown, "two a pixel find the surface"
    assert beside.counters["irradiance rays"] > 100 * centres
    shadow = traced.mean(axis=-1) < -0.02
    assert shadow.sum() > 50
    assert closed[shadow].mean() == pytest.approx(traced[shadow].mean(), rel=2e-3)


def test_which_sides_are_open():
    photo = Material(from_photo=True)
    table = from_photo(real("table", plane(3.0, 3.0)))
    above = real("shelf", plane(1.0, 1.0, centre=(0, 0, 1.0)))
    turned = replace(table, mesh=replace(table.mesh, faces=np.array([[0, 1, 2], [0, 3, 2]], np.int32)))
    for objects, expected in (
        ([table], [1, 1]),
        ([table, above], [2, 1]),
        ([table, replace(above, cast_shadow=False)], [1, 1]),
        ([replace(table, material=Material())], [0, 0]),
        ([from_photo(real("cube", box((1, 1, 1))))], [0, 0]),
        ([turned], [1, 1]),
    ):
        sides, normals, light = open_sides(scene_of(objects, sky(2.0)))
        assert list(sides[:2]) == expected
        if objects[0].material == photo and len(objects[0].mesh.faces) == 2:
            assert np.allclose(np.abs(normals[0]), [0, 0, 1])
        assert np.allclose(light[:2][sides[:2] > 0], 2 * np.pi, rtol=1e-6)
