"""The mask of tiles: it may only leave out what does not change, and it must leave out what it can."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mrbatch.methods.delta_path_tracing import METHOD
from mrbatch.methods.estimate import estimate
from mrbatch.methods.image_based_lighting import METHOD as IMAGE_BASED
from mrbatch.scene.closed_forms import ball, lamp_sky, look_at, placed, real, scene_of, sky, virtual
from mrbatch.scene.mesh import Mesh, box, plane
from mrbatch.scene.scene import Material, SceneObject

HALF_CODE = 0.5 / 255 / 12.92
"""Half the smallest step of 8-bit sRGB codes, linear."""
WIDTH, HEIGHT = 64, 48


def camera(eye=(0.5, -4.0, 3.0), target=(0, 0, 0.3), distortion=None):
    found = look_at(eye, target, width=WIDTH, height=HEIGHT, focal=50)
    return found if distortion is None else replace(found, distortion=np.array(distortion))


def small_ball(at, reflectance=0.5, radius=0.3, **switches):
    return virtual("ball", ball(radius, at=at, subdivisions=3), reflectance, **switches)


def table(size=6.0):
    return real("table", plane(size, size), 0.5)


@pytest.mark.parametrize("method", [METHOD, IMAGE_BASED], ids=lambda m: m.name)
def test_object_and_influence_outside_the_frame_trace_nothing(method):
    objects = [table(), small_ball((400.0, 300.0, 0.3))]
    result = estimate(method, scene_of(objects), camera(), spp=64, half_code=HALF_CODE)
    assert sum(result.counters.values()) == 0
    assert not result.developed.D.any() and not result.developed.a.any()
    why = result.plan.influence[0, ""]
    assert "no virtual object is in the frame" in why or "neither a virtual object" in why
    # The same object by its shadow alone: traced.
    if method is METHOD:
        near = estimate(
            method, scene_of([table(), small_ball((1.0, -5.2, 1.0))]), camera(), spp=2, half_code=HALF_CODE
        )
        assert near.counters["camera rays"] > 0


def test_object_under_the_table_changes_nothing():
    objects = [table(60.0), small_ball((0, 0, -2.0), camera=False)]
    result = estimate(METHOD, scene_of(objects), camera(), spp=4, half_code=HALF_CODE)
    assert sum(result.counters.values()) == 0


def test_masked_and_unmasked_tiles_have_the_same_bits():
    objects = [table(40.0), small_ball((0, 0, 0.1), radius=0.1)]
    masked = estimate(METHOD, scene_of(objects), camera(), spp=4, half_code=0.02)
    full = estimate(METHOD, scene_of(objects), camera(), spp=4, half_code=0.0)
    done = masked.developed.samples > 0
    tiles = masked.plan.tiles[0, ""]
    assert 0 < len(tiles) < 12 and done.sum() == 256 * len(tiles)
    for name in ("P", "a", "D", "variance"):
        assert np.array_equal(getattr(masked.developed, name)[done], getattr(full.developed, name)[done])
        assert not getattr(masked.developed, name)[~done].any()
    assert masked.counters["camera rays"] < full.counters["camera rays"]


def dish(at, towards, radius, aperture):
    """A concave mirror: a cap of a sphere about `at + radius towards`, of half width `aperture`."""
    n = np.asarray(towards, np.float64) / np.linalg.norm(towards)
    side = np.cross(n, [0.0, 1.0, 0.0]) / np.linalg.norm(np.cross(n, [0.0, 1.0, 0.0]))
    frame = np.stack([side, np.cross(n, side), n], axis=1)
    rings, spokes = 16, 32
    polar = np.arcsin(aperture / radius) * np.arange(1, rings + 1) / rings
    azimuth = 2 * np.pi * np.arange(spokes) / spokes
    ring = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
    flat = (radius * np.sin(polar))[:, None, None] * ring
    height = np.broadcast_to((radius * (1 - np.cos(polar)))[:, None, None], (rings, spokes, 1))
    local = np.concatenate([np.zeros((1, 3)), np.concatenate([flat, height], axis=2).reshape(-1, 3)])
    at_ring = 1 + np.arange(rings)[:, None] * spokes + np.arange(spokes)
    right = np.roll(at_ring, -1, axis=1)
    fan = np.stack([np.zeros(spokes, int), at_ring[0], right[0]], axis=1)
    first = np.stack([at_ring[:-1], at_ring[1:], right[1:]], axis=-1).reshape(-1, 3)
    second = np.stack([at_ring[:-1], right[1:], right[:-1]], axis=-1).reshape(-1, 3)
    faces = np.concatenate([fan, first, second]).astype(np.int32)
    mesh = Mesh(np.asarray(at) + local @ frame.T, faces).with_angle_weighted_normals()
    return SceneObject("dish", mesh, Material("conductor", (0.95,) * 3, 0.02), True, camera=False)


@pytest.mark.slow
def test_metal_that_focuses_light_is_bounded_by_the_brightest_of_the_map():
    """A dish throws an image of the lamp onto the table: it is no brighter than the lamp itself."""
    lamp, target, at = np.array([0.63, 0.0, 0.78]), np.zeros(3), np.array([-0.6, 0.0, 0.3])
    to_target = (target - at) / np.linalg.norm(target - at)
    focal = 2 * float(np.linalg.norm(target - at))
    mirror = dish(at, lamp / np.linalg.norm(lamp) + to_target, focal, 0.1)
    scene = scene_of([table(40.0), mirror], lamp_sky())
    # Found by chance alone, by rays that leave the table for the dish: 0.09, with a tenth of noise left.
    found = estimate(METHOD, scene, camera(), spp=4096).developed.D
    assert found.max() > 0.06, "no image of the lamp"
    skipped, excess = skipped_change(scene.objects, lamp_sky(), camera(), 0.1, spp=256)
    assert skipped >= 3 and excess <= 0.0


def test_a_surface_of_unknown_reflectance_does_not_need_every_tile():
    """Reflectance from the photo may be anything up to 1: what is far from the object is still left out."""
    photo = replace(table(40.0), material=Material(from_photo=True))
    box_there = replace(
        real("box", box((0.2, 0.2, 0.2), centre=(1.5, 0.5, 0.1))), material=Material(from_photo=True)
    )
    scene = scene_of([photo, box_there, small_ball((0, 0, 0.03), radius=0.03)])
    facts = estimate(METHOD, scene, camera(), spp=2, half_code=0.02)
    assert 0 < len(facts.plan.tiles[0, ""]) < 12


def skipped_change(objects, light, view, half_code, *, spp=64, seed=0):
    """(number of skipped tiles, largest excess of a skipped tile's |Delta| over half a code in its noise)."""
    scene = scene_of(objects, light)
    plan = estimate(METHOD, scene, view, spp=2, half_code=half_code).plan
    done = np.zeros((HEIGHT // 16) * (WIDTH // 16), bool)
    done[plan.tiles[0, ""]] = True
    if done.all():
        return 0, -np.inf
    D = estimate(METHOD, scene, view, spp=spp, seed=seed).developed.D
    tiles = (
        D.reshape(HEIGHT // 16, 16, WIDTH // 16, 16, 3).transpose(0, 2, 1, 3, 4).reshape(len(done), 256, 3)
    )
    # Blocks of 4x4 pixels: small enough to see a shadow's core, large enough to beat the noise.
    blocks = tiles.reshape(len(done), 4, 4, 4, 4, 3).transpose(0, 1, 3, 2, 4, 5).reshape(len(done), 16, 16, 3)
    mean, error = np.abs(blocks.mean(axis=2)), blocks.std(axis=2, ddof=1) / 4
    excess = mean - half_code - 6 * error
    return int((~done).sum()), float(excess[~done].max())


def corner_objects(position, radius, reflectance, wall, rho, colour):
    return [
        real("floor", plane(8, 8), rho),
        real("wall", placed(plane(8, 8), at=(0, wall, 1.0), normal=(0, -1, 0)), (rho, 0.8, 0.2)),
        small_ball(position, reflectance=(reflectance, 0.2, colour), radius=radius, camera=False),
    ]


def test_light_over_a_second_surface_is_in_the_mask():
    """A ball behind a low screen: the floor before it changes only by way of the wall."""
    objects = [
        real("floor", plane(8, 8), 0.8),
        real("wall", placed(plane(8, 8), at=(0, 1.5, 0), normal=(0, -1, 0)), 0.9),
        virtual("lid", plane(8, 1.5, centre=(0, 3.0, 0.0)), 0.0, camera=False),
        small_ball((0, 0.9, -0.6), radius=0.5, camera=False),
    ]
    # The ball lies under the floor's plane, beside the floor's edge at y = 0.7: only the wall sees it.
    objects[0] = real("floor", plane(8, 4, centre=(0, -1.3, 0)), 0.8)
    view = camera(eye=(0, -3.0, 2.0), target=(0, -0.3, 0))
    skipped, excess = skipped_change(objects, sky(4.0), view, 2e-3, spp=512)
    assert excess <= 0.0, (skipped, excess)
    D = estimate(METHOD, scene_of(objects, sky(4.0)), view, spp=512).developed.D
    floor_part = D[36:, 24:40].mean(axis=(0, 1))
    assert floor_part.min() < -1e-3


@settings(max_examples=25, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(
    st.tuples(*[st.floats(-2.5, 2.5)] * 2, st.floats(-1.0, 2.5)),
    st.floats(0.02, 0.6),
    st.floats(0.0, 0.9),
    st.floats(0.5, 3.0),
    st.floats(0.05, 0.95),
    st.floats(0.0, 0.9),
    st.sampled_from([0.003, 0.01, 0.03, 0.1]),
    st.booleans(),
    st.tuples(st.floats(-2, 2), st.floats(-4.0, -2.0), st.floats(0.3, 4.0)),
)
def test_no_skipped_tile_changes_by_half_a_code(
    position, radius, reflectance, wall, rho, colour, half_code, lamp, eye
):
    objects = corner_objects(position, radius, reflectance, wall, rho, colour)
    light = lamp_sky() if lamp else sky()
    skipped, excess = skipped_change(objects, light, camera(eye=eye), half_code)
    assert excess <= 0.0, (skipped, excess)


@pytest.mark.slow
@settings(max_examples=15, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(
    st.tuples(*[st.floats(-2.5, 2.5)] * 2, st.floats(-0.5, 2.5)),
    st.floats(0.02, 0.6),
    st.sampled_from([0.003, 0.01, 0.03, 0.1]),
    st.booleans(),
    st.sampled_from([None, (-0.3, 0.1, 0.01, -0.01, 0, 0, 0, 0), (0.4, 0, 0, 0, 0, 0, 0, 0)]),
)
def test_no_skipped_tile_of_a_lone_plane_changes(position, radius, half_code, lamp, distortion):
    """One plane alone: the mask is tighter here, and the lens may bend it."""
    objects = [table(12.0), small_ball(position, radius=radius)]
    light = lamp_sky() if lamp else sky()
    skipped, excess = skipped_change(objects, light, camera(distortion=distortion), half_code)
    assert excess <= 0.0, (skipped, excess)


def test_the_mask_is_worth_having():
    """A small ball on a large plane: most tiles are left out where half a per cent does not matter."""
    objects = [table(40.0), small_ball((0, 0, 0.05), radius=0.05)]
    skipped, excess = skipped_change(objects, sky(), camera(), 0.005)
    assert skipped >= 6 and excess <= 0.0
    # With a box beside it too: real surfaces that see each other make the mask wider, not useless.
    objects.insert(1, real("box", box((0.2, 0.2, 0.2), centre=(1.5, 0.5, 0.1)), 0.5))
    skipped, excess = skipped_change(objects, sky(), camera(), 0.05)
    assert skipped >= 3 and excess <= 0.0
