"""Surfaces that are there in part, by a number or cut out by a picture: light, coverage and shadow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import warp as wp

from mrbatch.device.rays import rays
from mrbatch.film.composite import composite
from mrbatch.methods.delta_path_tracing import METHOD as DELTA
from mrbatch.methods.estimate import estimate
from mrbatch.methods.image_based_lighting import METHOD as IMAGE_BASED
from mrbatch.methods.one_pass import METHOD as ONE_PASS
from mrbatch.methods.probe import probe
from mrbatch.methods.two_pass import METHOD as TWO_PASS
from mrbatch.scene.closed_forms import corner, floor, look_at, placed, real, scene_of, sky, virtual
from mrbatch.scene.mesh import box, plane
from mrbatch.scene.scene import Material, Texture
from mrbatch.scene.scene_data import SceneData, upload

EVERY = pytest.mark.parametrize("method", [DELTA, IMAGE_BASED, TWO_PASS, ONE_PASS], ids=lambda m: m.name)
DIFFERENTIAL = pytest.mark.parametrize("method", [DELTA, TWO_PASS, ONE_PASS], ids=lambda m: m.name)
BIG = 2.0**12


def agrees(found, error, oracle, tolerance):
    room = tolerance + 4 * np.asarray(error)
    assert np.all(np.abs(np.asarray(found) - oracle) <= room), (found, oracle, room)


def of(opacity, item, **more):
    """The object with an opacity: a number, or a picture (h, w) of it."""
    if np.ndim(opacity) == 0:
        return replace(item, material=replace(item.material, opacity=float(opacity), **more))
    pixels = np.repeat(np.asarray(opacity, np.float32)[..., None], 3, axis=2)
    return replace(item, material=replace(item.material, opacity_texture=Texture(pixels), **more))


def card(height=1.0, size=2.0, reflectance=0.0, **switches):
    return virtual("card", plane(size, size, centre=(0, 0, height)), reflectance, **switches)


def rectangle_share(x0, x1, y0, y1, height):
    """Form factor of a rectangle parallel to the surface of a point under (0, 0): of each of its corners that
    of the rectangle to there (a textbook form, Howell's catalogue B-3)."""

    def to_corner(a, b):
        x, y = a / height, b / height
        p, q = np.sqrt(1 + x * x), np.sqrt(1 + y * y)
        return (x / p * np.arctan(y / p) + y / q * np.arctan(x / q)) / (2 * np.pi)

    return to_corner(x1, y1) - to_corner(x0, y1) - to_corner(x1, y0) + to_corner(x0, y0)


@pytest.mark.slow
@DIFFERENTIAL
@pytest.mark.parametrize("opacity", [1.0, 0.5, 0.25])
def test_black_card_takes_its_opacity_of_what_it_hides(method, opacity):
    """DPT-02 for a card: -rr F alpha, under the even sky."""
    share = rectangle_share(-1.2, 0.8, -1.0, 1.0, 1.0)
    scene = scene_of([real("floor", floor()), of(opacity, card(camera=False))])
    found = probe(method, scene, (0.2, 0, 0), spp=1024)
    agrees(found.delta, found.delta_error, -0.5 * share * opacity, 1e-4)


@pytest.mark.slow
def test_shadow_rays_know_opacity_without_noise():
    """Where light is drawn alone, a card that hides all of the light takes exactly its opacity of each
    sample: a shadow ray that stopped at random would not."""
    light = {"strategy": "environment"}
    for opacity in (0.25, 0.5):
        lids = [of(opacity, card(size=BIG, camera=False)), of(1.0, card(size=BIG, camera=False))]
        part, whole = (
            probe(DELTA, scene_of([real("floor", floor()), lid]), (0, 0, 0), spp=16, settings=light)
            for lid in lids
        )
        np.testing.assert_allclose(part.pixels, whole.pixels * opacity, rtol=1e-6)


@pytest.mark.slow
@DIFFERENTIAL
def test_grey_card_sends_what_it_keeps_times_its_reflectance(method):
    """DPT-05 with opacity: two endless plates, L = rr (1 - a) / (1 - rr a rv)."""
    for opacity, rv in ((0.5, 0.8), (0.25, 0.5)):
        scene = scene_of([real("floor", floor(), 0.5), of(opacity, card(0.5, BIG, rv, camera=False))])
        found = probe(method, scene, (0, 0, 0), spp=512)
        oracle = 0.5 * (1 - opacity) / (1 - 0.5 * opacity * rv) - 0.5
        agrees(found.delta, found.delta_error, oracle, 1e-3)


@pytest.mark.slow
def test_dpt_06_mirror_card_with_opacity():
    """Upright mirror card: -rr F a (1 - R); a full mirror changes nothing at any opacity."""
    upright = placed(plane(2, 1), at=(0, 0, 0.5), normal=(1, 0, 0))
    item = virtual("mirror", upright, camera=False)
    for opacity, r in ((0.5, 0.4), (0.5, 1.0)):
        look = replace(item, material=Material("conductor", (r,) * 3, 0.0))
        found = probe(
            DELTA, scene_of([real("floor", floor()), of(opacity, look)]), (0.5, 0, 0), spp=1024, distance=0.1
        )
        share = 2 * 0.12427 / 2
        c, a, b = 0.5, 1.0, 1.0
        q, y = np.hypot(a, c) / b, c / b
        share = 2 * (np.arctan(1 / y) - y / q * np.arctan(1 / q)) / (2 * np.pi)
        assert share == pytest.approx(2 * 0.12427, abs=1e-5)
        agrees(found.delta, found.delta_error, -0.5 * share * opacity * (1 - r), 1e-4)


@pytest.mark.slow
@EVERY
def test_card_of_opacity_0_is_no_card(method):
    """No bit changes, and nothing is read from the map on its account."""
    view = look_at((0, -4, 4), (0, 0, 0), width=16, height=16, focal=16)
    ghost = of(0.0, card(reflectance=0.8))
    found = estimate(method, scene_of([real("floor", floor()), ghost]), view, spp=8)
    d = found.developed
    assert found.plan.effects["alpha"].state == "needed"
    assert not d.P.any() and not d.a.any()
    if method is TWO_PASS:
        # Its two pictures are independent of each other, and differ by their noise alone.
        without = estimate(
            method, scene_of([real("floor", floor()), of(0.0, card(height=-5.0))]), view, spp=8
        )
        assert np.array_equal(d.D, without.developed.D)
        return
    assert not d.D.any()
    if method is DELTA:
        assert found.counters["lookups"] == 0
        assert found.counters["camera rays"] > 16 * 16 * 8, "rays that go on are counted"


@DIFFERENTIAL
def test_checkerboard_throws_half_a_shadow_far_away(method):
    """Cut out along the picture's edge, or grey between texels: half of the card is there."""
    board = np.indices((16, 16)).sum(axis=0) % 2
    for cutoff in (0.5, 0.0):
        item = of(board, card(height=4.0, camera=False), opacity_cutoff=cutoff)
        found = probe(method, scene_of([real("floor", floor()), item]), (0.3, 0.1, 0), spp=2048)
        share = rectangle_share(-1.3, 0.7, -1.1, 0.9, 4.0)
        agrees(found.delta, found.delta_error, -0.5 * share / 2, 0.01 * share)


@pytest.mark.slow
def test_cut_out_is_where_its_picture_says():
    """u runs right, v up; from the cutoff on it is there."""
    picture = np.array([[0.0, 0.0], [0.0, 1.0]])  # the lower right quarter
    item = of(picture, card(0.0, 2.0, 0.5), opacity_cutoff=0.5)
    view = look_at((0, 0, 2.0), (0, 0, 0), width=16, height=16, focal=16)
    assert view.world_from_camera[0, 0] == 1.0
    a = estimate(DELTA, scene_of([item]), view, spp=16).developed.a
    ys, xs = np.nonzero(a > 0.5)
    # Weights x y >= 1/2 of the two axes: 4 (1/2 - ln(2) / 2) of a texel of 8 x 8 pixels, about its middle.
    assert a.sum() == pytest.approx(64 * 2 * (1 - np.log(2)), rel=0.05)
    assert abs(xs.mean() - 11.5) < 0.3 and abs(ys.mean() - 11.5) < 0.3


@pytest.mark.slow
@EVERY
def test_coverage_is_the_opacity(method):
    """A card across the view: every second ray of a pixel stops at it, neither more nor less."""
    view = look_at((0, 0, 4), (0, 0, 0), width=8, height=8, focal=64)
    photo = np.full((8, 8, 3), 0.3, np.float32)
    item = of(0.5, card(1.0, 4.0, 0.4))
    found = estimate(method, scene_of([item]), view, spp=64, background=photo).developed
    assert np.all(found.a == 0.5)
    agrees(found.P.mean(), found.P[..., 0].std(ddof=1) / 8, 0.5 * 0.4, 1e-5)
    odd = estimate(method, scene_of([of(0.3, card(1.0, 4.0, 0.4))]), view, spp=64, background=photo).developed
    # Each half of the film is stratified by itself: 9 or 10 of its 32 samples stop.
    assert np.all(np.abs(odd.a - 0.3) < 1 / 32)
    assert odd.a.mean() == pytest.approx(0.3, abs=4 / 64 / 8 / 2)


@DIFFERENTIAL
def test_white_furnace_with_a_veil_before_everything(method):
    """DPT-04: veils of every opacity among white surfaces, seen and unseen: the composite stays 1."""
    objects = [
        real("floor", floor(), 1.0),
        of(0.5, virtual("veil", plane(1, 1, centre=(0, 0, 0.5)), 1.0)),
        of(0.3, virtual("more", plane(1.5, 1, centre=(0.4, 0, 0.8)), 1.0)),
    ]
    view = look_at((0, -2, 2), (0, 0, 0.3), width=8, height=8, focal=16)
    photo = np.ones((8, 8, 3), np.float32)
    found = estimate(method, scene_of(objects), view, spp=512, background=photo).developed
    assert 0.1 < found.a.mean() < 0.9
    c = composite(found.P, found.a, photo, found.D).reshape(-1, 3).mean(axis=1)
    assert abs(c.mean() - 1.0) < 4 * c.std(ddof=1) / 8 + 1e-3


@pytest.mark.slow
@DIFFERENTIAL
def test_veil_over_a_shadowed_floor_weighs_the_change(method):
    """D = mean of (1 - M) Delta: what stays visible of the change, behind a veil that casts none itself."""
    view = look_at((0, 0, 3), (0, 0, 0), width=8, height=8, focal=8 * 2**12)
    lid = card(1.0, 2.0, 0.0, camera=False)
    veil = of(0.25, virtual("veil", plane(8, 8, centre=(0, 0, 2.0)), 0.0, cast_shadow=False))
    whole = estimate(method, scene_of([real("floor", floor()), lid]), view, spp=1024).developed
    part = estimate(method, scene_of([real("floor", floor()), lid, veil]), view, spp=1024).developed
    one, other = (d.D.reshape(-1, 3)[:, 0] for d in (whole, part))
    error = np.hypot(0.75 * one.std(ddof=1), other.std(ddof=1)) / 8
    assert abs(other.mean() - 0.75 * one.mean()) < 4 * error + 1e-5
    assert error < 0.05 * abs(one.mean())


@pytest.mark.slow
@DIFFERENTIAL
def test_light_between_real_walls_through_a_veil(method):
    """In a corner: a black veil whole before the wall takes its opacity of what the wall sends, DPT-21."""
    rho, opacity, size = 0.5, 0.5, 2.0**8
    veil = of(
        opacity,
        virtual(
            "veil", placed(plane(size, size), at=(2.0**-10, 0, size / 2), normal=(1, 0, 0)), 0.0, camera=False
        ),
    )
    found = probe(method, scene_of([*corner(rho, size=size), veil]), (1, 0, 0), spp=512)
    # Wall and floor each lit by half a sky and the other; the veil is passed to the wall and back.
    through = 1 - opacity
    lit = rho * np.linalg.solve(
        np.array([[1, -rho * through / 2], [-rho * through / 2, 1]]), np.array([0.5, through * 0.5])
    )
    agrees(found.delta, found.delta_error, lit[0] - rho / (2 - rho), 1e-3)


@pytest.mark.slow
def test_engines_agree():
    """Embree and Warp's own hierarchy, as nearly as they do without cut-outs."""
    veil = virtual("veil", plane(2, 2, centre=(1.5, 0, 0.7)), 0.7)
    view = look_at((3, -2, 3), (0.7, 0, 0.4), width=16, height=16, focal=20)
    apart = []
    for opacity in (1.0, np.eye(4)):
        scene = scene_of([real("floor", floor(64.0)), of(opacity, veil)])
        one, other = (estimate(DELTA, scene, view, spp=16, engine=e).developed for e in ("embree", "warp"))
        for name in ("P", "a"):
            a, b = getattr(one, name), getattr(other, name)
            assert np.mean(np.abs(a - b) > 1e-4) < 0.02 and abs(a.mean() - b.mean()) < 1e-4, name
        apart.append(np.mean(np.abs(one.D - other.D) > 1e-4))
        assert abs(one.D.mean() - other.D.mean()) < 1e-3
    assert apart[1] < apart[0] + 0.02


@pytest.mark.slow
def test_pictures_do_not_depend_on_launches():
    scene = scene_of([*corner(0.5, size=64.0), of(0.4, virtual("v", plane(2, 2, centre=(1.5, 0, 0.7)), 0.7))])
    view = look_at((3, -2, 3), (0.7, 0, 0.4), width=40, height=24, focal=30)
    one = estimate(DELTA, scene, view, spp=4, threads=1).developed
    other = estimate(DELTA, scene, view, spp=4, threads=2, units_per_launch=1).developed
    for name in ("P", "a", "D"):
        assert np.array_equal(getattr(one, name), getattr(other, name)), name


@EVERY
def test_texture_of_ones_leaves_no_branch_and_no_bit(method):
    view = look_at((0, -4, 4), (0, 0, 0), width=16, height=16, focal=16)
    plain = card(reflectance=0.6)
    full = of(np.ones((4, 4)), plain)
    cut = of(np.full((4, 4), 0.7), plain, opacity_cutoff=0.5)
    with_plain, with_full, with_cut = (
        estimate(method, scene_of([real("floor", floor()), item]), view, spp=8) for item in (plain, full, cut)
    )
    for other in (with_full, with_cut):
        assert other.plan.effects["alpha"].state == "absent"
        for name in ("P", "a", "D"):
            assert np.array_equal(getattr(with_plain.developed, name), getattr(other.developed, name)), name
        assert other.counters == with_plain.counters


@pytest.mark.slow
def test_a_veil_inside_a_medium_does_not_shorten_the_way():
    """What is left of light after a slab is its whole thickness', however many cut-out cards lie in it."""
    dark = Material("dielectric", (1.0,) * 3, 0.0, ior=1.5, absorption=(2.0, 1.0, 0.5))
    slab = replace(virtual("slab", box((8.0, 8.0, 0.5))), material=dark)
    inside = [of(0.0, card(h, 6.0, 0.5)) for h in (-0.2, 0.05)]
    view = look_at((0, 0, 4), (0, 0, 0), width=8, height=8, focal=8 * 2**12)
    clear = estimate(DELTA, scene_of([slab], sky()), view, spp=64).developed.P
    veiled = estimate(DELTA, scene_of([slab, *inside], sky()), view, spp=64).developed.P
    np.testing.assert_allclose(veiled, clear, rtol=1e-5)


def test_image_based_light_comes_through_a_veil():
    """With occlusion, a white card under an endless black veil has what passes it."""
    lit = card(0.0, 1.0, 1.0)
    veil = of(0.25, card(0.5, BIG, 0.0, camera=False))
    view = look_at((0, 0, 0.3), (0, 0, 0), width=8, height=8, focal=64)
    found = estimate(IMAGE_BASED, scene_of([lit, veil]), view, spp=64, settings={"occlusion": True}).developed
    p = found.P[..., 0]
    agrees(p.mean(), p.std(ddof=1) / 8, 0.75, 1e-3)
    assert p.std() < 0.01


def test_transmittance_ends_where_the_ray_does():
    """Of rays of any length: what stands before the end counts, what stands behind does not."""
    from mrbatch.device.rays import FAR, resolve_engine
    from mrbatch.kernels.rng import make_sampler
    from mrbatch.scene.ray_start import make_ray_start
    from mrbatch.scene.see_through import make_see_through
    from mrbatch.scene.shading import ShadingFlags

    engine = resolve_engine("auto")
    trace = rays(engine).trace
    flags = ShadingFlags(cutouts=True, panes=True)
    transmittance = make_see_through(
        flags, trace, make_ray_start(), make_sampler("owen").sample_1d
    ).transmittance

    @wp.kernel(enable_backward=False, module="unique")
    def ask(
        scene: SceneData,
        origin: wp.array(dtype=wp.vec3),
        direction: wp.array(dtype=wp.vec3),
        tfar: wp.array(dtype=wp.float32),
        share: wp.array(dtype=wp.vec3),
    ):
        i = wp.tid()
        share[i] = transmittance(scene, scene.all_set, origin[i], direction[i], tfar[i]).share

    pane = replace(card(3.0, 40.0), material=Material("thin_dielectric", (0.5, 1.0, 1.0), 0.0, ior=1.5))
    solid = card(4.0, 40.0)
    scene = upload(
        scene_of([of(0.5, card(1.0, 40.0)), of(0.25, card(2.0, 40.0)), pane, solid], origin=np.zeros(3)),
        engine,
    )
    up, slanted = np.array([0, 0, 1.0]), np.array([np.sqrt(3.0), 0, 1.0])
    rows = [
        (up, 0.5, 1.0),
        (up, 1.5, 0.5),
        (up * 0.1, 15.0, 0.5),
        (up * 7, 2.5 / 7, 0.5 * 0.75),
        # Up to a surface, and no farther: a light on it is not hidden by itself.
        (up * 2.0, 1.0 - 2.0**-22, 0.5),
        (slanted * 3, 2.5 / 3, 0.5 * 0.75),
        (slanted * 3, 3.5 / 3, 0.5 * 0.75 * 0.83623),
        (up, float(FAR), 0.0),
    ]
    # Index 1.5 at 60 degrees: (1 - R) / (1 + R) of R = .0892.
    n = len(rows)
    out = wp.zeros(n, dtype=wp.vec3)
    wp.launch(
        ask,
        dim=n,
        inputs=[
            scene.data,
            wp.zeros(n, dtype=wp.vec3),
            wp.array(np.array([r[0] for r in rows], np.float32), dtype=wp.vec3),
            wp.array(np.array([r[1] for r in rows], np.float32), dtype=wp.float32),
            out,
        ],
    )
    np.testing.assert_allclose(out.numpy()[:, 1], [r[2] for r in rows], atol=1e-3)
    assert out.numpy()[6, 0] < 0.5 * out.numpy()[6, 1]
