"""Real surfaces that shine: what virtual objects change in their highlights and reflections."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import maximum_filter, minimum_filter

from mrbatch.methods.delta_path_tracing import METHOD as DELTA
from mrbatch.methods.estimate import estimate
from mrbatch.methods.one_pass import METHOD as ONE_PASS
from mrbatch.methods.probe import probe
from mrbatch.methods.two_pass import METHOD as TWO_PASS
from mrbatch.scene.closed_forms import ball, corner, floor, lamp_sky, look_at, real, scene_of, virtual
from mrbatch.scene.scene import Material

POLISHED = Material("conductor", (0.9, 0.7, 0.5), 0.0)
LACQUER = Material("principled", (0.3, 0.2, 0.1), 0.15, f0=0.04)


def shining(material, size=None):
    return replace(real("floor", floor() if size is None else floor(size)), material=material)


def mirrored_share(view, at, radius):
    """(h, w): 1 where the ray mirrored at z = 0 meets the ball, by 5 x 5 points a pixel; float64."""
    offsets = (np.arange(5) + 0.5) / 5
    total = np.zeros((view.height, view.width))
    k, pose = np.asarray(view.matrix), np.asarray(view.world_from_camera)
    for dx in offsets:
        for dy in offsets:
            x = (np.arange(view.width) + dx - k[0, 2]) / k[0, 0]
            y = (np.arange(view.height) + dy - k[1, 2]) / k[1, 1]
            d = np.stack([*np.meshgrid(x, y), np.ones((view.height, view.width))], axis=-1) @ pose[:3, :3].T
            o = pose[:3, 3]
            d /= np.linalg.norm(d, axis=-1, keepdims=True)
            down = d[..., 2] < 0
            p = o + d * (-o[2] / np.where(down, d[..., 2], -1.0))[..., None]
            m = d * [1, 1, -1]
            to = at - p
            along = np.sum(to * m, axis=-1)
            near = np.sum(to * to, axis=-1) - along**2 < radius**2
            total += down & near & (along > 0)
    return total / 25


def test_polished_floor_shows_a_black_ball_where_it_mirrors_it():
    """Under an even sky of 1 the floor loses its reflectance where the mirrored ray meets the ball."""
    at, radius = np.array([0.0, 0.0, 1.5]), 0.5
    view = look_at((3.0, 0.0, 2.0), (0.0, 0.0, 0.0), width=48, height=40, focal=60)
    objects = [
        shining(POLISHED),
        virtual("ball", ball(radius, at=tuple(at), subdivisions=6), 0.0, camera=False),
    ]
    found = estimate(DELTA, scene_of(objects), view, spp=256).developed.D
    share = mirrored_share(view, at, radius)
    assert 0.02 < share.mean() < 0.5
    # A pixel in from the rim, which is a chord of the mesh and has the tail of the lobe.
    inside, outside = minimum_filter(share, 3) == 1, maximum_filter(share, 3) == 0
    np.testing.assert_allclose(
        found[inside], np.broadcast_to([-0.9, -0.7, -0.5], found[inside].shape), rtol=1e-2
    )
    assert np.abs(found[outside]).max() < 2e-3
    np.testing.assert_allclose(found.mean(axis=(0, 1)), -share.mean() * np.array([0.9, 0.7, 0.5]), rtol=0.01)
    # A matt floor would show a soft shadow instead.
    matt = [replace(objects[0], material=Material(reflectance=POLISHED.reflectance)), objects[1]]
    assert np.abs(estimate(DELTA, scene_of(matt), view, spp=64).developed.D[inside]).max() < 0.7


@pytest.mark.slow
@pytest.mark.parametrize("material", [POLISHED, LACQUER, Material("conductor", (0.8,) * 3, 0.3)])
@pytest.mark.parametrize("method", [ONE_PASS, TWO_PASS], ids=lambda m: m.name)
def test_equals_full_path_tracing_with_and_without_the_objects(method, material):
    """A lamp, a corner and a coloured ball: shadow, mirrored ball and lamp, and light between real walls."""
    base = corner(0.5)
    glossy = [replace(base[0], material=material), base[1]]
    thing = virtual("ball", ball(0.4, at=(0.8, 0.2, 0.4)), (0.8, 0.4, 0.2), camera=False)
    scene = scene_of([*glossy, thing], lamp_sky())
    ours, other = (probe(m, scene, (0.5, 0, 0), spp=4096, seed=seed) for m, seed in ((DELTA, 1), (method, 2)))
    error = np.hypot(ours.delta_error, other.delta_error)
    assert np.all(np.abs(ours.delta - other.delta) <= 4 * error + 1e-6)
    assert np.all(error < 0.1 * np.abs(ours.delta).max())


def test_white_lacquer_among_white_things_changes_nothing():
    white = Material("principled", (1.0, 1.0, 1.0), 0.3, f0=0.04)
    thing = replace(virtual("ball", ball(), 1.0, camera=False), material=white)
    scene = scene_of([shining(white), thing])
    found = probe(DELTA, scene, (1.0, 0, 0), spp=2048)
    assert np.all(np.abs(found.delta) <= 4 * found.delta_error + 1e-3)
