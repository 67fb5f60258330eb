"""Delta path tracing against closed forms, and against a path tracer of its own in NumPy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from held import holds
from numpy_tracer import Ball, Plane, radiance

from mrbatch.film.composite import composite
from mrbatch.methods.delta_path_tracing import METHOD, noise_cases, picture_cases, shadow_cases
from mrbatch.methods.delta_path_tracing.cases import delta_probe as probe
from mrbatch.methods.estimate import estimate
from mrbatch.scene.closed_forms import (
    ball,
    ball_share,
    corner,
    everything_virtual,
    floor,
    lamp_sky,
    look_at,
    real,
    scene_of,
    sky,
    sunk_ball_share,
    virtual,
)
from mrbatch.scene.mesh import icosphere, plane
from mrbatch.scene.scene import Material, Scene, centre

BIG = 2.0**12


def agrees(found, error, oracle, tolerance=0.0, sigmas=4.0):
    """Asserts |found - oracle| <= tolerance + 4 standard errors, everywhere."""
    found, oracle = np.asarray(found), np.asarray(oracle)
    room = tolerance + sigmas * np.asarray(error)
    assert np.all(np.abs(found - oracle) <= room), (found, oracle, room)


# --- DPT-01: nothing virtual ------------------------------------------------------------------


@pytest.mark.case("DPT-01", "TRAP-1")
def test_without_virtual_objects_no_bit_changes_and_nothing_is_traced():
    """DPT-01; printed Algorithm 1 makes an empty plane 70 % too bright and darkens an empty corner."""
    holds(picture_cases.untouched(1))


@pytest.mark.slow
@pytest.mark.case("DPT-01", "DPT-07")
def test_an_object_behind_the_wall_changes_nothing():
    holds(shadow_cases.behind_the_wall(0))


@pytest.mark.case("TRAP-1")
def test_printed_miss_branch_brightens_an_empty_plane():
    """TRAP-1: lines 28-30 add w f cos L / p where a BRDF ray misses; p_env = 1 / 4 pi, Delta = .7012 rr."""
    c = (np.arange(200000) + 0.5) / 200000
    weight = (c / np.pi) / (c / np.pi + 1 / (4 * np.pi))
    printed = np.mean(2 * c * weight)
    assert printed == pytest.approx(0.5 + np.log(5) / 8, abs=1e-6)
    found = probe(
        scene_of([real("floor", floor()), virtual("dot", ball(2.0**-10, at=(100, 0, 1)), 0.0)]), (0, 0, 0)
    )
    assert abs(found.delta[0]) < 1e-6


# --- one ball ---------------------------------------------------------------------------------


@pytest.mark.case("DPT-02")
@pytest.mark.parametrize("gap", [0.5, 2.0])
@pytest.mark.parametrize("s", [0.0, 1.0, 3.0])
def test_black_ball_above_a_plane(gap, s):
    """DPT-02 with the ball off the plane."""
    scene = scene_of(
        [real("floor", floor(), 0.8), virtual("ball", ball(at=(0, 0, 1 + gap)), 0.0, camera=False)]
    )
    found = probe(scene, (s, 0, 0), spp=128)
    agrees(
        found.delta,
        found.delta_error,
        -0.8 * ball_share(1, 1 + gap, s),
        1e-3 * 0.8 * ball_share(1, 1 + gap, s),
    )


@pytest.mark.case("DPT-03")
def test_half_sunk_black_ball():
    """DPT-03: the horizon cuts the ball; published values .16694, .02883, .00338."""
    assert sunk_ball_share([1.2, 2.0, 4.0]) == pytest.approx([0.16694, 0.02883, 0.00338], abs=6e-6)
    holds(shadow_cases.half_sunk(0))


@pytest.mark.case("GEO-08", "TRAP-1k")
def test_contact_does_not_leak():
    holds(shadow_cases.contact(0))


@pytest.mark.case("DPT-13")
def test_two_balls_in_line_and_a_ball_twice():
    holds(shadow_cases.union(0))


@pytest.mark.case("DPT-04", "MC-03")
def test_white_furnace_ends_by_roulette_however_it_is_set():
    holds(shadow_cases.roulette(0))


@pytest.mark.case("TRAP-1e")
def test_capped_paths_are_cut_at_equal_length():
    """TRAP-1e: the listing subtracts all and adds up to B bounces; ours caps both sides alike.

    White ball and floor under the sky, paths of at most 3 edges: light that came over one surface. The
    open floor loses what the ball hides (-F) and gains what the ball sends after one scattering.
    """
    objects = [real("floor", floor(), 1.0), virtual("ball", ball(), 1.0, camera=False)]
    found = probe(scene_of(objects), (1.0, 0, 0), spp=256, settings={"max_depth": 3})
    items = [Plane((0, 0, 1), 0.0, 1.0), Ball((0, 0, 1), 1.0, 1.0)]
    with_ball, error = radiance(items, (1, 0, 0), (0, 0, 1), 1.0, 400000, 5, depth=2)
    agrees(found.delta, np.hypot(found.delta_error, error), with_ball - 1.0, 4e-4)
    printed = {
        depth: radiance(items, (1, 0, 0), (0, 0, 1), 1.0, 200000, 6, depth=depth)[0] - 1
        for depth in (2, 3, 8)
    }
    assert printed[2] < -0.2 and printed[3] < -0.05 and printed[8] < -0.005


# --- walls ------------------------------------------------------------------------------------


@pytest.mark.case("DPT-05")
@pytest.mark.parametrize(("rr", "rv", "oracle"), [(0.5, 0.5, -0.16667), (0.8, 0.2, -0.34167)])
def test_huge_virtual_wall_bleeds(rr, rv, oracle):
    """DPT-05: radiosity of two half-planes, each seeing the other with form factor 1/2."""
    assert rr * (0.5 + rv / 4) / (1 - rr * rv / 4) - rr == pytest.approx(oracle, abs=1e-5)
    holds(shadow_cases.bleeding(0, reflectances=((rr, rv),)))


@pytest.mark.case("DPT-21")
def test_black_wall_before_a_whole_real_wall():
    """DPT-21: what is lost is what the real wall sent, not the sky behind it (printed: -rho / 2)."""
    holds(shadow_cases.hidden_wall(0))
    assert all(abs(rho / 2 - rho**2 / (2 * (2 - rho))) > 0.05 for rho in (0.2, 0.5, 0.8))


@pytest.mark.case("DPT-08", "TRAP-1c")
def test_black_ball_wholly_before_a_black_wall_changes_nothing():
    """DPT-08, TRAP-1c: the printed form takes rr F away."""
    holds(shadow_cases.before_black_wall(0))


@pytest.mark.case("DPT-08", "DPT-15", "TRAP-1d")
def test_ball_before_a_lit_wall_and_in_a_corner_against_numpy():
    """DPT-08, DPT-15: two full path traces by an independent tracer."""
    r, rv = 0.5, 0.7
    objects = [*corner(0.6), virtual("ball", ball(r, at=(0.8, 0, 0.6)), rv, camera=False)]
    walls = [Plane((0, 0, 1), 0.0, 0.6), Plane((1, 0, 0), 0.0, 0.6)]
    for k, s in enumerate((0.3, 0.8, 1.7)):
        found = probe(scene_of(objects), (s, 0, 0), spp=256)
        m, em = radiance([*walls, Ball((0.8, 0, 0.6), r, rv)], (s, 0, 0), (0, 0, 1), 0.6, 250000, 10 + k)
        b, eb = radiance(walls, (s, 0, 0), (0, 0, 1), 0.6, 250000, 20 + k)
        agrees(found.delta, np.sqrt(found.delta_error**2 + em**2 + eb**2), m - b, 1e-4)
        # Against the closed form of the empty corner, and for the method as a plain path tracer.
        assert b == pytest.approx(0.6 / (2 - 0.6), abs=5 * eb)
    full = probe(scene_of(everything_virtual(objects), origin=centre(objects)), (1.7, 0, 0), spp=256)
    agrees(full.virtual, np.hypot(full.virtual_error, em), m, 1e-4)


@pytest.mark.case("TRAP-1b")
def test_printed_form_darkens_an_empty_corner():
    """TRAP-1b: O counts blockers that the photo has already, -(1 - rho) of an empty corner."""
    rho = 0.5
    walls = [Plane((0, 0, 1), 0.0, rho), Plane((1, 0, 0), 0.0, rho)]
    full, _ = radiance(walls, (1, 0, 0), (0, 0, 1), rho, 400000, 3)
    # Printed: all light from sky directions that any surface blocks, minus; what bounces find, plus.
    share_blocked = 0.5
    printed = -rho * share_blocked + (full - rho * (1 - share_blocked))
    assert full == pytest.approx(rho / (2 - rho), rel=5e-3)
    assert printed / full == pytest.approx(-(1 - rho), abs=0.01)
    found = probe(
        scene_of([*corner(rho), virtual("far", ball(2.0**-9, at=(300, 0, 1)), 0.0)]), (1, 0, 0), spp=64
    )
    assert abs(found.delta[0] / full) < 1e-6


# --- invariances of the scene -------------------------------------------------------------------


def corner_scene(**options):
    objects = [
        *corner(0.5, size=64.0),
        virtual("ball", ball(0.5, at=(0.8, 0, 0.5), subdivisions=4), (0.7, 0.4, 0.2), camera=False),
    ]
    return scene_of(objects, **options)


@pytest.mark.case("GEO-01")
@pytest.mark.parametrize("offset", [64.0, 2.0**20, 1e6])
def test_a_scene_far_from_the_origin_equals_its_recentred_twin(offset):
    """GEO-01: float32 has a spacing of 1/16 m at 1e6; kernels work relative to a float64 origin."""
    home = corner_scene()
    # Coordinates that float64 still holds exactly at the far place.
    grid = 2.0**-20
    objects = tuple(
        replace(o, mesh=replace(o.mesh, vertices=np.round(o.mesh.vertices / grid) * grid))
        for o in home.objects
    )
    home = Scene(objects, home.environment, centre(objects))
    shift = np.array([offset, -offset, offset])
    matrix = np.eye(4)
    matrix[:3, 3] = shift
    objects = tuple(replace(o, mesh=o.mesh.transformed(matrix)) for o in home.objects)
    moved = Scene(objects, home.environment, centre(objects))
    point = np.array([0.4, 0.25, 0.0])
    here, there = probe(home, point, spp=32), probe(moved, point + shift, spp=32)
    if offset != 1e6:
        # A whole number of the origin's steps: all relative positions are the same numbers.
        assert np.array_equal(moved.origin - home.origin, shift)
        assert np.array_equal(here.pixels, there.pixels)
    agrees(there.delta, np.hypot(here.delta_error, there.delta_error), here.delta)


def test_the_origin_moves_with_the_scene_wherever_its_middle_lies():
    for low in np.arange(-6, 6) * 0.5:
        mesh = plane(1.0, 1.0, centre=(low + 0.5, 0, 0))
        one = centre([real("a", mesh)])
        two = centre([real("a", plane(1.0, 1.0, centre=(low + 1.5, 0, 0)))])
        assert np.array_equal(two - one, [1.0, 0, 0])


@pytest.mark.case("GEO-01", "TRAP-1k")
def test_empty_tilted_plane_far_away_does_not_shadow_itself():
    """GEO-01: no self hits on a large tilted plane: all rays that leave it see the sky."""
    angle = 0.3
    for size, offset in ((100.0, 0.0), (1e4, 0.0), (10.0, 1e4)):
        matrix = np.eye(4)
        matrix[:3, :3] = [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
        matrix[:3, 3] = (offset, 0, 0)
        mesh = plane(size, size).transformed(matrix)
        n = matrix[:3, 2]
        objects = [virtual("plane", mesh, 1.0)]
        # Origin kept away on purpose: positions are large numbers.
        scene = Scene(tuple(objects), sky(), np.zeros(3))
        for at in (0.0, 0.4):
            point = matrix[:3, 3] + at * size * matrix[:3, 0]
            found = probe(scene, point, normal=n, spp=64, distance=1.0)
            agrees(found.virtual, found.virtual_error, 1.0, 1e-4)


@pytest.mark.case("DPT-19", "ENV-07")
def test_turning_scene_and_map_together_changes_nothing():
    """DPT-19: yaw of everything, and the order of the objects."""
    holds(noise_cases.turned_scene(0))


@pytest.mark.slow
@pytest.mark.case("MIS-05")
def test_strategies_have_the_same_mean():
    """MIS-05: light sampling, surface sampling and both, under a lamp."""
    home = corner_scene(environment=lamp_sky())
    found = [
        probe(home, (0.45, 0.1, 0), spp=512, seed=k, settings={"strategy": s})
        for k, s in enumerate(("mis", "environment", "bsdf"))
    ]
    for other in found[1:]:
        agrees(other.delta, np.hypot(other.delta_error, found[0].delta_error), found[0].delta)
    assert found[0].delta_error[0] < 0.5 * found[2].delta_error[0]


# --- furnaces and edges -------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.case("MIS-05")
@pytest.mark.parametrize("strategy", ["mis", "environment"])
def test_more_directions_to_the_light_have_the_same_mean(strategy):
    """MIS-05: the weights know how many directions are drawn; the noise falls, the shadow rays rise."""
    objects = [real("floor", floor()), virtual("ball", ball(0.6, at=(0.3, 0, 0.6)), 0.6, camera=False)]
    scene = scene_of(objects, lamp_sky())
    one, several = (
        probe(scene, (-0.4, 0, 0), spp=1024, seed=n, settings={"light_samples": n, "strategy": strategy})
        for n in (1, 7)
    )
    agrees(several.delta, np.hypot(one.delta_error, several.delta_error), one.delta)
    assert several.delta_error[0] < 0.8 * one.delta_error[0]
    assert several.counters["shadow rays"] > 4 * one.counters["shadow rays"]
    seen = [replace(objects[0], camera=False), replace(objects[1], camera=True)]
    lit = [
        probe(scene_of(seen, lamp_sky()), (0.3, 0, 1.2), seed=n, settings={"light_samples": n})
        for n in (1, 8)
    ]
    agrees(lit[1].virtual, np.hypot(lit[0].virtual_error, lit[1].virtual_error), lit[0].virtual)


@pytest.mark.parametrize(
    "material",
    [
        Material(reflectance=(1, 1, 1)),
        Material("conductor", (1, 1, 1), 0.001),
        Material("principled", (1, 1, 1), 0.3, f0=0.04),
        Material("principled", (1, 1, 1), 0.6, metalness=1.0),
    ],
    ids=["diffuse", "conductor", "plastic", "rough metal"],
)
def test_white_objects_vanish_in_a_white_world(material):
    """What the camera sees of a white object on a white floor under the sky is 1, and so is the composite.

    Metal as good as smooth loses no energy, nor does any principled surface; a ball of facets has no
    shading normals to lose it by.
    """
    mesh = replace(icosphere(1.0, subdivisions=4, centre=(0, 0, 1)), normals=None)
    objects = [real("floor", floor(), 1.0), replace(virtual("ball", mesh), material=material)]
    camera = look_at((0, -6, 2.5), (0, 0, 0.8), width=16, height=16, focal=20)
    photo = np.ones((16, 16, 3), np.float32)
    d = estimate(METHOD, scene_of(objects), camera, spp=256, background=photo).developed
    out = composite(d.P, d.a, photo, d.D)
    inside = d.a == 1
    edge = (d.a > 0) & (d.a < 1)
    assert inside.sum() > 20 and edge.sum() > 10
    for part in (inside, edge, d.a == 0):
        values = out[part].mean(axis=-1)
        # Principled surfaces know their albedo from a table.
        room = 4e-3 if material.kind == "principled" else 1e-3
        assert abs(values.mean() - 1) < room + 4 * values.std() / np.sqrt(len(values))


@pytest.mark.slow
@pytest.mark.case("DPT-11", "TRAP-3e")
def test_card_edge_with_fractional_coverage():
    """DPT-11, TRAP-3e: coverage .37; D is the change of what stays visible, weighted once."""
    holds(picture_cases.card_edge(0))


@pytest.mark.case("DPT-20", "TRAP-3c")
def test_black_photo_stays_black_and_delta_stays_signed():
    """DPT-20: the only cut is in the composite."""
    holds(picture_cases.black_photo(0))


# --- samples ------------------------------------------------------------------------------------


@pytest.mark.case("MC-04")
def test_one_batch_of_all_samples_equals_many_of_one():
    """MC-04: the same samples, summed in the same order: the same bits."""
    scene = corner_scene(environment=lamp_sky())
    one = probe(scene, (0.5, 0, 0), spp=64, settings={"batch": 1})
    all_at_once = probe(scene, (0.5, 0, 0), spp=64, settings={"batch": 32})
    assert np.array_equal(one.pixels, all_at_once.pixels)


@pytest.mark.slow
@pytest.mark.parametrize("s", [0.6, 2.0])
def test_owen_points_are_never_worse(s):
    """MC-01's other half: at equal spp the scrambled points' mean squared error is no larger."""
    from mrbatch.methods.delta_path_tracing.cases import squared_errors

    counts = (4, 16, 64)
    owen = squared_errors(5, 6, "owen", counts, s)
    independent = squared_errors(6, 6, "independent", counts, s)
    # 384 pixels: the ratio of two such variances has a standard deviation of about 0.1.
    assert np.all(owen < 1.3 * independent)
    assert owen[-1] < independent[-1]
