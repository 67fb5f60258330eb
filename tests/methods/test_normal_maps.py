"""Shading normals from a map: against the same normals given at vertices, and what may not leak."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mrbatch.methods.delta_path_tracing import METHOD as DELTA
from mrbatch.methods.estimate import estimate
from mrbatch.methods.image_based_lighting import METHOD as IMAGE_BASED
from mrbatch.methods.one_pass import METHOD as ONE_PASS
from mrbatch.scene.closed_forms import lamp_sky, look_at, scene_of, sky
from mrbatch.scene.mesh import plane
from mrbatch.scene.scene import Material, SceneObject, Texture

METHODS = [DELTA, ONE_PASS, IMAGE_BASED]


def tilted(degrees, azimuth):
    t, a = np.radians(degrees), np.radians(azimuth)
    return np.array([np.sin(t) * np.cos(a), np.sin(t) * np.sin(a), np.cos(t)])


def mapped(vector):
    return Material(
        reflectance=(0.8,) * 3, normal_texture=Texture(np.float32(2.5) * np.float32(vector)[None, None])
    )


def seen(mesh, material, light, *, method=DELTA, eye=(0, -1.0, 4.0), **options):
    scene = scene_of([SceneObject("card", mesh, material, True)], light)
    camera = look_at(eye, (0, 0, 0), width=16, height=16, focal=40)
    return estimate(method, scene, camera, spp=options.pop("spp", 64), **options).developed


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS, ids=lambda m: m.name)
@pytest.mark.parametrize("azimuth", [0.0, 90.0, 200.0])
def test_a_constant_map_is_a_constant_normal(method, azimuth):
    """u runs along x and v along y: the map's x, y, z are the world's; its length does not count."""
    n = tilted(30.0, azimuth)
    card = plane(2, 2)
    oracle = replace(card, normals=np.tile(n.astype(np.float32), (4, 1)))
    found = seen(card, mapped(n), lamp_sky(), method=method)
    expected = seen(oracle, Material(reflectance=(0.8,) * 3), lamp_sky(), method=method)
    assert (found.a[4:12, 4:12] == 1).all()
    np.testing.assert_allclose(found.P, expected.P, rtol=2e-4, atol=1e-5)
    flat = seen(card, Material(reflectance=(0.8,) * 3), lamp_sky(), method=method)
    assert np.abs(flat.P - expected.P).max() > 0.05


def test_turned_texture_coordinates_turn_the_map():
    """With u along -y the map's x tilts towards -y; mirrored coordinates keep u and v, not their turn."""
    n = tilted(30.0, 0.0)
    card = plane(2, 2)
    uv = card.uvs
    for coordinates, world in (
        (np.stack([1 - uv[:, 1], uv[:, 0]], axis=1), [0, -n[0], n[2]]),
        (np.stack([1 - uv[:, 0], uv[:, 1]], axis=1), [-n[0], 0, n[2]]),
    ):
        turned = replace(card, uvs=coordinates.astype(np.float32))
        oracle = replace(card, normals=np.tile(np.float32(world), (4, 1)))
        found = seen(turned, mapped(n), lamp_sky())
        expected = seen(oracle, Material(reflectance=(0.8,) * 3), lamp_sky())
        np.testing.assert_allclose(found.P, expected.P, rtol=2e-4, atol=1e-5)


def test_from_behind_the_map_is_turned_over():
    """Seen from below, the normal of the outside is turned round as a whole."""
    n = tilted(30.0, 0.0)
    card = plane(2, 2)
    oracle = replace(card, normals=np.tile(n.astype(np.float32), (4, 1)))
    below = {"eye": (0, -1.0, -4.0)}
    found = seen(card, mapped(n), lamp_sky(), **below)
    expected = seen(oracle, Material(reflectance=(0.8,) * 3), lamp_sky(), **below)
    np.testing.assert_allclose(found.P, expected.P, rtol=2e-4, atol=1e-5)


@pytest.mark.case("BSDF-10")
@pytest.mark.parametrize("degrees", [60.0, 85.0])
def test_bsdf_10_steep_maps_gain_nothing(degrees):
    """BSDF-10: a white card under the sky sends at most what comes, wherever it is seen from."""
    white = replace(mapped(tilted(degrees, 30.0)), reflectance=(1.0, 1.0, 1.0))
    for eye in ((0, -1.0, 4.0), (3.0, 0, 1.0), (-3.0, 0.5, 0.7)):
        found = seen(plane(2, 2), white, sky(), eye=eye, spp=256)
        inside = found.P[found.a == 1][:, 0]
        assert np.isfinite(inside).all() and inside.min() >= 0.0
        assert inside.mean() <= 1.0 + 4 * inside.std() / np.sqrt(len(inside))
        assert inside.mean() > 0.2, "bent only as far as it can be seen"
