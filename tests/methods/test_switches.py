"""The switches of objects, and the rules that prove effects absent."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from mrbatch.contracts import TILE
from mrbatch.device.rays import resolve_engine
from mrbatch.methods.delta_path_tracing import METHOD as DELTA
from mrbatch.methods.delta_path_tracing.cases import delta_probe as probe
from mrbatch.methods.delta_path_tracing.kernels import Flags, make_kernel
from mrbatch.methods.estimate import estimate
from mrbatch.methods.image_based_lighting import METHOD as IMAGE_BASED
from mrbatch.methods.one_pass import METHOD as ONE_PASS
from mrbatch.methods.probe import probe as probe_of
from mrbatch.methods.two_pass import METHOD as TWO_PASS
from mrbatch.metrics.region import dilate
from mrbatch.scene.closed_forms import (
    ball,
    ball_share,
    corner,
    floor,
    look_at,
    placed,
    real,
    scene_of,
    sky,
    virtual,
)
from mrbatch.scene.environment import Environment
from mrbatch.scene.mesh import plane
from mrbatch.scene.scene import Material, Texture
from mrbatch.scene.shading import ShadingFlags

EVERY = pytest.mark.parametrize("method", [DELTA, IMAGE_BASED, TWO_PASS, ONE_PASS], ids=lambda m: m.name)
DIFFERENTIAL = pytest.mark.parametrize("method", [DELTA, TWO_PASS, ONE_PASS], ids=lambda m: m.name)


def picture(objects, *, method=DELTA, spp=32, size=32, light=None, **options):
    view = look_at((0, -4, 4), (0, 0, 0), width=size, height=size, focal=size)
    photo = np.full((size, size, 3), 0.3, np.float32)
    return estimate(method, scene_of(objects, light), view, spp=spp, background=photo, **options)


def black_ball(**switches):
    return virtual("ball", ball(at=(0, 0, 1.5), subdivisions=4), 0.0, **switches)


# --- switches -----------------------------------------------------------------------------------


@pytest.mark.slow
@DIFFERENTIAL
def test_camera_switch_leaves_shadow_and_reflection(method):
    seen = picture([real("floor", floor()), black_ball()], method=method)
    unseen = picture([real("floor", floor()), black_ball(camera=False)], method=method)
    assert seen.developed.a.sum() > 50 and not unseen.developed.a.any()
    # A second picture has other offsets in a pixel: the ball's rim may cover one of them.
    clear = ~dilate(seen.developed.a > 0, 1.5) if method is TWO_PASS else seen.developed.a == 0
    assert seen.developed.D[clear].any()
    assert np.array_equal(seen.developed.D[clear], unseen.developed.D[clear])
    assert seen.plan.effects["virtual"].state == "needed" and unseen.plan.effects["virtual"].state == "absent"


@pytest.mark.slow
@EVERY
def test_object_without_cast_shadow_is_seen_by_the_camera_alone(method):
    ghost = picture([real("floor", floor()), black_ball(cast_shadow=False)], method=method)
    assert ghost.developed.a.sum() > 50 and not ghost.developed.D.any()
    if method is DELTA:
        # Nor does it hide light from other virtual objects.
        white = virtual("card", plane(2, 2, centre=(0, 0, 0.2)), 1.0)
        lid = virtual("lid", plane(20, 20, centre=(0, 0, 0.3)), 0.0, camera=False, cast_shadow=False)
        found = probe(scene_of([white, lid]), (0, 0, 0.2), distance=0.05, spp=16)
        assert np.allclose(found.virtual, 1.0, atol=5e-3)


@pytest.mark.slow
@DIFFERENTIAL
def test_real_object_that_takes_no_change_keeps_the_photo(method):
    """`receive` off: no Delta on it, and what it sends to others does not change either."""

    def probe(*arguments, **options):
        return probe_of(method, *arguments, **options)

    size = 2.0**14
    wall = placed(plane(size, size), at=(0, 0, size / 2), normal=(1, 0, 0))
    base = [real("floor", placed(plane(size, size), at=(size / 2, 0, 0)), 0.5), real("wall", wall, 0.5)]
    lid = virtual("lid", ball(0.4, at=(0.6, 0, 0.6), subdivisions=4), 0.0, camera=False)
    stiff = [base[0], replace(base[1], receive=False)]
    on_wall = probe(scene_of([*stiff, lid]), (0, 0, 0.6), normal=(1, 0, 0), distance=8.0, spp=16)
    assert not on_wall.pixels.any()
    # The floor gets from such a wall what it got before.
    under = probe(scene_of([*stiff, lid]), (0.6, 0, 0), spp=256)
    full = probe(scene_of([*base, lid]), (0.6, 0, 0), spp=256)
    assert full.delta[0] < under.delta[0] - 4 * np.hypot(full.delta_error[0], under.delta_error[0])
    # By hand: sky and wall light are lost where the ball is, nothing else changes. Of the ball's share F
    # of the hemisphere the part before the wall sends the wall's radiance, rho / (2 - rho) = 1/3.
    rng = np.random.default_rng(4)
    r, phi = np.sqrt(rng.random(400000)), 2 * np.pi * rng.random(400000)
    d = np.stack([r * np.cos(phi), r * np.sin(phi), np.sqrt(1 - r * r)], axis=1)
    b = d @ np.array([0.0, 0.0, 0.6])
    hits = b * b - (0.36 - 0.16) > 0
    # The radiance of the wall of an open corner is the same all over.
    lost = np.where(d[:, 0] < 0, 1 / 3, 1.0)[hits].sum() / len(d)
    assert under.delta[0] == pytest.approx(-0.5 * lost, abs=4 * under.delta_error[0] + 5e-4)


@pytest.mark.slow
@DIFFERENTIAL
def test_virtual_object_that_receives_nothing_is_lit_as_if_alone_among_real_things(method):
    card = virtual("card", plane(1, 1, centre=(0, 0, 0.2)), 1.0, receive=False)
    lid = virtual("lid", plane(20, 20, centre=(0, 0, 0.5)), 0.0, camera=False)
    for item, expected in ((card, 1.0), (replace(card, receive=True), None)):
        found = probe_of(method, scene_of([item, lid]), (0, 0, 0.2), distance=0.1, spp=32)
        if expected is None:
            assert found.virtual.max() < 0.1
        else:
            assert np.allclose(found.virtual, expected, atol=5e-3)


@pytest.mark.slow
@EVERY
def test_holdout_shows_the_photo_and_hides_what_is_behind(method):
    front = virtual("hold", plane(3, 3, centre=(0, -0.5, 2.0)), 0.5, holdout=True, cast_shadow=False)
    behind = virtual("card", plane(2, 2, centre=(0, 0, 0.5)), 0.5)
    alone = picture([real("floor", floor()), behind], method=method)
    held = picture([real("floor", floor()), behind, front], method=method)
    assert alone.developed.a.sum() > 50
    assert held.developed.a.sum() < 0.7 * alone.developed.a.sum()
    covered = (alone.developed.a > 0) & (held.developed.a == 0)
    assert covered.sum() > 20
    inside = held.developed.a[4:-4, 4:-4]
    assert inside.shape and not held.developed.P[covered].any() and not held.developed.D[covered].any()


@pytest.mark.slow
@pytest.mark.case("DPT-14", "TRAP-1i")
def test_real_holdout_keeps_the_photo_and_still_reflects_what_changed():
    """No Delta where the camera sees it, nothing virtual behind it; on others its light is as it was."""
    size = 2.0**14
    wall = placed(plane(size, size), at=(0, 0, size / 2), normal=(1, 0, 0))
    base = [real("floor", placed(plane(size, size), at=(size / 2, 0, 0)), 0.5), real("wall", wall, 0.5)]
    held = [base[0], replace(base[1], holdout=True)]
    lid = virtual("lid", ball(0.4, at=(0.6, 0, 0.6), subdivisions=4), 0.0, camera=False)
    assert not probe(scene_of([*held, lid]), (0, 0, 0.6), normal=(1, 0, 0), distance=8.0, spp=16).pixels.any()
    assert probe(scene_of([*base, lid]), (0, 0, 0.6), normal=(1, 0, 0), distance=8.0, spp=16).pixels.any()
    under, full = (probe(scene_of([*items, lid]), (0.6, 0, 0), spp=64) for items in (held, base))
    assert np.array_equal(under.pixels, full.pixels)
    front = real("card", plane(3, 3, centre=(0, -0.5, 2.0)), 0.5, holdout=True, cast_shadow=False)
    for method in (DELTA, IMAGE_BASED, TWO_PASS, ONE_PASS):
        found = picture([real("floor", floor()), black_ball(), front], method=method)
        seen = picture([real("floor", floor()), black_ball()], method=method)
        hidden = (seen.developed.a > 0) & (found.developed.a == 0)
        assert hidden.sum() > 20
        assert not found.developed.P[hidden].any() and not found.developed.D[hidden].any()


# --- rules --------------------------------------------------------------------------------------

TEXTURE = Texture(np.full((2, 2, 3), 0.5, np.float32))
FLAT = real("floor", plane(20, 20))
STATES = {
    "plane and ball": (
        [FLAT, virtual("ball", ball(subdivisions=2))],
        {"virtual": 1, "light-change": 1, "real-on-real": 0, "bleeding": 1, "glossy": 0, "textures": 0},
    ),
    "black ball": ([FLAT, black_ball()], {"bleeding": 0, "light-change": 1, "real-on-real": 0}),
    "metal": (
        [FLAT, replace(black_ball(), material=Material("conductor", (1, 1, 1), 0.1))],
        {"glossy": 1, "bleeding": 1},
    ),
    "two planes": ([*corner(0.5, size=20), black_ball()], {"real-on-real": 1}),
    "two in one plane": ([FLAT, real("paper", plane(1, 1)), black_ball()], {"real-on-real": 0}),
    "one seen by none": (
        [
            replace(FLAT, cast_shadow=False),
            real("wall", placed(plane(9, 9), normal=(1, 0, 0)), 0.5),
            black_ball(),
        ],
        {"real-on-real": 1},
    ),
    "textured": ([replace(FLAT, material=Material(texture=TEXTURE)), black_ball()], {"textures": 1}),
    "photo": ([replace(FLAT, material=Material(from_photo=True)), black_ball()], {"photo-reflectance": 1}),
    "nothing virtual": ([FLAT], {"virtual": 0, "light-change": 0, "bleeding": 0}),
    "no real surface": ([black_ball()], {"virtual": 1, "light-change": 0, "real-on-real": 0}),
    "no shadow": ([FLAT, black_ball(cast_shadow=False)], {"virtual": 1, "light-change": 0}),
    "veil": (
        [FLAT, replace(black_ball(), material=Material(opacity=0.5))],
        {"alpha": 1, "thin-glass": 0, "transmission": 0},
    ),
    "whole": (
        [
            FLAT,
            replace(black_ball(), material=Material(opacity_texture=Texture(np.ones((2, 2, 3), np.float32)))),
        ],
        {"alpha": 0, "textures": 0},
    ),
    "pane": (
        [FLAT, replace(black_ball(), material=Material("thin_dielectric", (1, 1, 1), ior=1.5))],
        {"thin-glass": 1, "alpha": 0, "transmission": 0, "glossy": 1, "bleeding": 1},
    ),
    "unseen": ([FLAT, black_ball(camera=False)], {"virtual": 0, "light-change": 1}),
    "holdout": ([FLAT, black_ball(holdout=True)], {"holdout": 1}),
    "real holdout": ([replace(FLAT, holdout=True), black_ball()], {"holdout": 1}),
    "stiff": ([replace(FLAT, receive=False), black_ball()], {"light-change": 0, "receive-switch": 1}),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", STATES)
def test_rules_see_what_a_scene_calls_for(name):
    objects, expected = STATES[name]
    from mrbatch.effects.facts import FrameFacts, ShotFacts
    from mrbatch.effects.plan import make_plan
    from mrbatch.film.window import Window

    view = look_at((0, -4, 4), (0, 0, 0), width=TILE, height=TILE, focal=TILE)
    facts = ShotFacts(
        scene=scene_of(objects),
        frames=(FrameFacts(0, {"": view}, {"": np.ones(3)}),),
        windows={"": Window(0, 0, TILE, TILE)},
        settings=DELTA.settings(),
        layers=frozenset(),
        half_code=0.0,
    )
    plan = make_plan(DELTA.rules, facts, {})
    for effect, on in expected.items():
        assert plan.effects[effect].state == ("needed" if on else "absent"), effect
        assert len(plan.effects[effect].why) > 10
    # The job's word counts, but where there is nothing to do nothing is done.
    for effect, on in expected.items():
        forced = make_plan(DELTA.rules, facts, {effect: "off"}).effects[effect].state
        assert forced == ("forced-off" if on else "absent")
        asked = make_plan(DELTA.rules, facts, {effect: "on"}).effects[effect].state
        assert asked == ("needed" if on else "absent")


def source(flags):
    """The C++ that Warp makes of a kernel."""
    from warp._src.context import ModuleBuilder

    module = make_kernel(flags).kernel.module
    builder = ModuleBuilder(module, options=dict(module.options))
    # Without comments: they quote the Python lines.
    return re.sub(r"//.*", "", builder.codegen("cpu"))


def test_what_is_off_leaves_no_code():
    """Absent effects are not branches that are never taken: they are not in the generated source."""
    engine = resolve_engine("auto")
    lean = source(Flags(engine=engine, real_on_real=False, virtual_paths=False, light_change=False))
    rich = source(
        Flags(
            engine=engine,
            real_on_real=True,
            shading=ShadingFlags(textures=True, cutouts=True, panes=True),
            bsdf_kinds=frozenset({"diffuse", "conductor", "thin_dielectric"}),
            distortion=True,
            lens=True,
        )
    )
    parts = ("opacity_at", "pane_shares", "transmittance", "through_lens")
    for name in ("sample_texture", "conductor", "undistort", *parts):
        assert name in rich and name not in lean, name
    plain = source(Flags(engine=engine, real_on_real=False))
    mixed = source(Flags(engine=engine, real_on_real=True))
    body = [text.split("_cpu_kernel_forward(", 1)[1] for text in (plain, mixed)]
    assert "real_set" not in body[0] and "real_set" in body[1]
    assert len(lean) < len(plain) < len(mixed) < len(rich)


def test_absent_effects_would_have_changed_nothing():
    """A picture with every branch compiled in equals the one whose absent effects were left out."""
    from mrbatch.methods.delta_path_tracing import passes

    objects = [FLAT, virtual("ball", ball(at=(0, 0, 1.2), subdivisions=3), 0.6)]
    lean = picture(objects, spp=8)
    make = passes.make_flags

    def everything(*arguments):
        return replace(
            make(*arguments),
            real_on_real=True,
            virtual_paths=True,
            unreceptive=True,
            holdout=True,
            shading=ShadingFlags(textures=True, cutouts=True, panes=True),
            bsdf_kinds=frozenset({"diffuse", "conductor"}),
        )

    passes.make_flags = everything
    try:
        full = picture(objects, spp=8)
    finally:
        passes.make_flags = make
    for name in ("P", "a", "D"):
        assert np.array_equal(getattr(lean.developed, name), getattr(full.developed, name)), name


@pytest.mark.slow
@pytest.mark.case("ENV-02")
@DIFFERENTIAL
def test_black_light_gives_nothing_at_all(method):
    objects = [FLAT, virtual("ball", ball(at=(0, 0, 1.2), subdivisions=2), 0.6)]
    dark = picture(objects, method=method, light=sky(0.0))
    assert dark.plan.effects["environment-light"].state == "absent"
    assert not dark.developed.P.any() and not dark.developed.D.any() and dark.developed.a.any()


def test_image_based_lighting_is_the_irradiance_of_the_map():
    """Unoccluded: rho E / pi. With occlusion a ball on a floor has the share (1 + cos) / 2 of its sky."""
    light = Environment(np.random.default_rng(2).uniform(0.2, 2, (8, 16, 3)).astype(np.float32))
    card = virtual("card", plane(1, 1), (0.3, 0.6, 0.9))
    view = look_at((0, 0, 1), (0, 0, 0), width=8, height=8, focal=64)
    found = estimate(IMAGE_BASED, scene_of([card], light), view, spp=256).developed.P.reshape(-1, 3)
    exact = np.array([0.3, 0.6, 0.9]) / np.pi * light.irradiance(np.array([0.0, 0.0, 1.0]))[0]
    assert np.all(np.abs(found.mean(axis=0) - exact) < 4 * found.std(axis=0) / 8 + 1e-5)
    # A horizontal strip of wall above a black floor: half its sky is left.
    wall = virtual("wall", placed(plane(1, 1), at=(0, 0, 2.0), normal=(0, -1, 0)), 1.0)
    view = look_at((0, -1, 2), (0, 0, 2), width=8, height=8, focal=64)
    objects = [wall, real("floor", floor(2.0**12), 0.0)]
    for occlusion, expected in ((False, 1.0), (True, 0.5)):
        found = estimate(
            IMAGE_BASED, scene_of(objects), view, spp=256, settings={"occlusion": occlusion}
        ).developed.P.reshape(-1, 3)
        assert abs(found.mean() - expected) < 1e-3 + 4 * found.mean(axis=1).std() / 8


@DIFFERENTIAL
def test_forced_off_virtual_layer_leaves_the_shadow_under_the_object(method):
    objects = [real("floor", floor()), black_ball()]
    whole = picture(objects, method=method)
    shadow = picture(objects, method=method, forced={"virtual": "off"})
    assert not shadow.developed.a.any() and not shadow.developed.P.any()
    unseen = picture([objects[0], black_ball(camera=False)], method=method)
    assert np.array_equal(shadow.developed.D, unseen.developed.D)
    assert shadow.developed.D.sum() < whole.developed.D.sum()
    assert ball_share(1, 1.5, 0.0) == pytest.approx(1 / 2.25)
