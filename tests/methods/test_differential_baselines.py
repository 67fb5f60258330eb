"""The baselines of differential rendering: the same means as delta path tracing, at more work or noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mrbatch.film.composite import composite
from mrbatch.methods.delta_path_tracing import METHOD as DELTA
from mrbatch.methods.estimate import estimate
from mrbatch.methods.one_pass import METHOD as ONE_PASS
from mrbatch.methods.probe import probe
from mrbatch.methods.two_pass import METHOD as TWO_PASS
from mrbatch.metrics.statistics import equivalence_test
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
    virtual,
)
from mrbatch.scene.environment import Environment
from mrbatch.scene.mesh import box, plane
from mrbatch.scene.scene import Material

BIG = 2.0**15
"""Side of walls that stand for endless ones: a smaller one's end shows by 1e-4."""
BASELINES = pytest.mark.parametrize("method", [TWO_PASS, ONE_PASS], ids=lambda m: m.name)
CASES = [(m, case) for m in (TWO_PASS, ONE_PASS) for case in m.cases]


def shown_equal(found, error, other, other_error, size, *, share=0.01, tolerance=1e-6):
    """|found - other| is within `tolerance` and 4 standard errors, and the 99 % interval of the difference
    within `share` of `size`."""
    found, other = np.atleast_1d(found), np.atleast_1d(other)
    errors = np.hypot(error, other_error) * np.ones_like(found)
    for difference, deviation in zip(found - other, errors):
        assert abs(difference) <= 4 * deviation + tolerance
        assert equivalence_test(float(difference), float(deviation), share * size).passed, (
            difference,
            deviation,
            share * size,
        )


@pytest.mark.slow
@pytest.mark.parametrize(("method", "case"), CASES, ids=[f"{m.name}-{c.name}" for m, c in CASES])
def test_hard_case_of_the_product(method, case):
    outcome = case.run(3)
    assert outcome.passed, outcome


# --- closed forms, with power -------------------------------------------------------------------


@BASELINES
def test_black_ball_takes_its_share_of_the_sky(method):
    objects = [real("floor", floor()), virtual("ball", ball(), 0.0, camera=False)]
    oracle = -0.5 * ball_share(1.0, 1.0, 0.5)
    found = probe(method, scene_of(objects), (0.5, 0, 0), spp=512)
    shown_equal(found.delta, found.delta_error, np.full(3, oracle), 0.0, abs(oracle))


@BASELINES
def test_huge_virtual_wall_bleeds(method):
    rr, colours = 0.5, np.array([0.5, 0.0, 1.0])
    closed = rr * (0.5 + colours / 4) / (1 - rr * colours / 4) - rr
    wall = placed(plane(BIG, BIG), at=(0, 0, BIG / 2), normal=(1, 0, 0))
    objects = [real("floor", floor(BIG), rr), virtual("wall", wall, colours, camera=False)]
    found = probe(method, scene_of(objects), (1, 0, 0), spp=8192)
    for c in range(3):
        shown_equal(found.delta[c], found.delta_error[c], closed[c], 0.0, abs(closed[c]), tolerance=2e-5)


@BASELINES
@pytest.mark.parametrize(
    "material",
    [Material(reflectance=(0.2, 0.5, 0.8)), Material("conductor", (0.9, 0.7, 0.3), 0.2)],
    ids=["diffuse", "conductor"],
)
def test_ball_in_a_corner_equals_delta_path_tracing(method, material):
    """Two objects of which each changes what the other gets; the seeds differ, so the numbers do."""
    lid = replace(virtual("ball", ball(0.5, at=(0.8, 0, 0.5)), camera=False), material=material)
    scene = scene_of([*corner(0.5), lid])
    truth = probe(DELTA, scene, (0.4, 0, 0), spp=2048, seed=1)
    found = probe(method, scene, (0.4, 0, 0), spp=2048, seed=2)
    size = float(np.abs(truth.delta).max())
    shown_equal(found.delta, found.delta_error, truth.delta, truth.delta_error, size)


@BASELINES
def test_light_that_does_not_change_stays_where_a_surface_takes_no_change(method):
    """`receive` off: the wall sends what it sent before, so the floor loses less than otherwise."""
    base = corner(0.5)
    stiff = [base[0], replace(base[1], receive=False)]
    lid = virtual("lid", ball(0.4, at=(0.6, 0, 0.6), subdivisions=4), 0.0, camera=False)
    truth = probe(DELTA, scene_of([*stiff, lid]), (0.6, 0, 0), spp=2048, seed=1)
    found = probe(method, scene_of([*stiff, lid]), (0.6, 0, 0), spp=2048, seed=2)
    shown_equal(found.delta, found.delta_error, truth.delta, truth.delta_error, abs(truth.delta[0]))
    if method is ONE_PASS:
        # Not one bit is left of paths that never met the lid.
        aside = probe(method, scene_of([*stiff, lid]), (0, 0, 0.6), normal=(1, 0, 0), distance=8.0, spp=16)
        assert not aside.pixels.any()


# --- sample by sample ---------------------------------------------------------------------------


def rich_scene():
    """Real things that see each other, a metal and a diffuse virtual ball, a lamp in a dim sky."""
    metal = replace(
        virtual("metal", ball(0.3, at=(1.4, 0.6, 0.3), subdivisions=3)),
        material=Material("conductor", (0.9, 0.7, 0.3), 0.2),
    )
    objects = [
        *corner(0.5, size=16.0),
        real("box", box((0.4, 0.4, 0.4), centre=(0.8, -0.8, 0.2)), (0.2, 0.5, 0.7)),
        virtual("ball", ball(0.4, at=(0.7, 0.1, 0.4), subdivisions=3), (0.8, 0.4, 0.3)),
        metal,
    ]
    return scene_of(objects, lamp_sky())


def rich_picture(method, **options):
    view = look_at((3.5, -2.5, 2.0), (0.7, 0, 0.3), width=48, height=40, focal=48)
    photo = np.full((40, 48, 3), 0.4, np.float32)
    given = {"spp": 16, "background": photo, "gain": (0.5, 0.6, 0.7), "seed": 4, **options}
    return estimate(method, rich_scene(), view, **given)


@BASELINES
def test_light_on_virtual_objects_is_the_same_to_the_bit(method):
    """The three methods differ on real surfaces only."""
    ours, other = rich_picture(DELTA).developed, rich_picture(method).developed
    assert ours.P.any()
    assert np.array_equal(ours.a, other.a) and np.array_equal(ours.P, other.P)


@pytest.mark.slow
@pytest.mark.parametrize("settings", [{}, {"max_depth": 3, "light_samples": 2}], ids=["roulette", "capped"])
def test_one_pass_with_common_numbers_is_delta_path_tracing_plus_what_cancels(settings):
    ours, other = (rich_picture(m, settings=settings) for m in (DELTA, ONE_PASS))
    size = np.abs(ours.developed.D).max()
    near = np.abs(ours.developed.D - other.developed.D) < 1e-5 * size
    # Rounding may turn a throw of roulette.
    assert near.mean() > 0.999
    assert ours.counters["lookups"] < other.counters["lookups"]
    assert ours.counters["camera rays"] == other.counters["camera rays"]


@pytest.mark.slow
def test_two_pass_takes_numbers_of_its_own_for_the_second_picture():
    """Where nothing changes the difference is noise around zero: no common numbers cancel it."""
    scene = scene_of([*corner(0.5), virtual("hidden", ball(0.5, at=(-3, 0, 1)), 0.9)], lamp_sky())
    noise = probe(TWO_PASS, scene, (1, 0, 0), spp=64)
    assert np.all(np.abs(noise.delta) <= 4 * noise.delta_error)
    assert np.all(noise.delta_error > 1e-4)
    assert not probe(ONE_PASS, scene, (1, 0, 0), spp=64).pixels.any()


@pytest.mark.slow
def test_strategies_have_the_same_mean():
    """MIS-05 for the vertices that both paths of one-pass share; two-pass has the shared leg alone."""
    objects = [real("floor", floor()), virtual("ball", ball(0.6, at=(0.3, 0, 0.6)), 0.6, camera=False)]
    scene = scene_of(objects, lamp_sky())
    found = [
        probe(ONE_PASS, scene, (-0.4, 0, 0), spp=2048, seed=k, settings={"strategy": s})
        for k, s in enumerate(("mis", "environment", "bsdf"))
    ]
    for other in found[1:]:
        assert np.all(
            np.abs(other.delta - found[0].delta) <= 4 * np.hypot(other.delta_error, found[0].delta_error)
        )


# --- nothing virtual ----------------------------------------------------------------------------


@BASELINES
@pytest.mark.parametrize(
    "extra",
    [[], [virtual("ghost", ball(0.5, at=(1, 0, 0.5)), camera=False, cast_shadow=False)]],
    ids=["no object", "object without any switch on"],
)
def test_without_virtual_objects_no_bit_changes_and_nothing_is_traced(method, extra):
    scene = scene_of([*corner(0.5, size=64.0), *extra])
    camera = look_at((3, -2, 2), (0, 0, 0), width=40, height=24, focal=40)
    photo = np.random.default_rng(1).normal(0.4, 0.5, (24, 40, 3)).astype(np.float32)
    photo[0, 0] = -0.0
    result = estimate(method, scene, camera, spp=4, background=photo)
    d = result.developed
    assert not d.D.any() and not d.P.any() and not d.a.any()
    out = composite(d.P, d.a, photo, d.D)
    assert np.array_equal(out.astype(np.float32).view(np.uint32), photo.view(np.uint32))
    assert sum(result.counters.values()) == 0
    assert result.plan.effects["light-change"].state == "absent"


# --- what it costs ------------------------------------------------------------------------------


def paper_scene():
    """As the paper's: a table and a sheet of paper, three objects on it, a room with two windows."""
    light = np.full((32, 64, 3), 0.15, np.float32)
    light[9:14, 10:15], light[9:14, 24:30] = 9.0, 6.0
    shiny = Material("conductor", (0.9, 0.8, 0.6), 0.2)
    objects = [
        real("table", plane(2.0, 2.0, centre=(0, 0, -0.001)), (0.3, 0.2, 0.1)),
        real("paper", plane(0.3, 0.21), 0.8),
        virtual("left", ball(0.03, at=(-0.07, 0, 0.03), subdivisions=3), (0.7, 0.3, 0.2)),
        virtual("middle", ball(0.03, at=(0, 0.02, 0.03), subdivisions=3), (0.3, 0.6, 0.2)),
        replace(virtual("right", ball(0.03, at=(0.08, 0, 0.03), subdivisions=3)), material=shiny),
    ]
    return scene_of(objects, Environment(light))


@pytest.mark.slow
def test_delta_path_tracing_reads_the_environment_less_often():
    """The paper's claim, on counters: look-ups of one-pass, and both pictures of two-pass, against ours."""
    view = look_at((0, -0.35, 0.25), (0, 0, 0.01), width=64, height=48, focal=60)
    options = {"spp": 8, "background": np.full((48, 64, 3), 0.3, np.float32)}
    for depth in (2, 4):
        found = {
            m.name: estimate(m, paper_scene(), view, settings={"max_depth": depth}, **options).counters
            for m in (DELTA, ONE_PASS, TWO_PASS)
        }
        lookups = {name: counters["lookups"] for name, counters in found.items()}
        assert 2 * lookups["delta-path-tracing"] < lookups["one-pass"] < lookups["two-pass"]
        rays = {name: c["shadow rays"] + c["scatter rays"] for name, c in found.items()}
        assert rays["delta-path-tracing"] < rays["two-pass"]
