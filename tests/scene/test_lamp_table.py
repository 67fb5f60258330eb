"""The table of lamps: what is chosen how often, and where on it."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from scipy import stats

from mrbatch.scene.closed_forms import placed, scene_of
from mrbatch.scene.lamp_table import LampData, mean_radiance
from mrbatch.scene.lamps import draw_lamp
from mrbatch.scene.mesh import Mesh, box, plane
from mrbatch.scene.scene import Material, SceneObject, Texture
from mrbatch.scene.scene_data import upload


@wp.kernel(enable_backward=False, module="unique")
def _draw(lamps: LampData, real_only: bool, bits: wp.array(dtype=wp.vec2ui), out: wp.array(dtype=wp.vec3)):
    i = wp.tid()
    found = draw_lamp(lamps, bits[i], real_only)
    out[i] = wp.vec3(float(found.triangle), found.u, found.v)


def draw(data, bits, real_only=False):
    out = wp.zeros(len(bits), dtype=wp.vec3, device="cpu")
    given = wp.array(np.asarray(bits, np.uint32), dtype=wp.vec2ui, device="cpu")
    wp.launch(_draw, len(bits), [data.lamps, real_only, given], [out], device="cpu")
    return out.numpy()


def item(name, mesh, emission, *, is_virtual=True, **more):
    look = Material(emission=(emission,) * 3, emission_texture=more.pop("texture", None))
    return SceneObject(name, mesh, look, is_virtual, **more)


def objects():
    """An uneven lot: a dark box first, lamps of 1 : 4 in radiance, a triangle without area, one unseen."""
    flat = plane(2.0, 1.0)
    sliver = Mesh(
        np.vstack([flat.vertices, [[9, 0, 0]]]), np.vstack([flat.faces, [[0, 4, 4]]]).astype(np.int32)
    )
    return [
        item("dark", box((1, 1, 1)), 0.0),
        item("big", placed(sliver, at=(0, 0, 3)), 1.0),
        item("unseen", plane(5, 5), 7.0, cast_shadow=False),
        item("real", box((0.5, 0.5, 0.5)), 4.0, is_virtual=False),
        item("small", plane(0.1, 0.1), 40.0),
    ]


def test_density_over_area_is_that_of_what_is_drawn():
    device = upload(scene_of(objects()), "warp")
    data = device.data
    records = data.triangles.numpy()
    edges = records["e1"].astype(float), records["e2"].astype(float)
    areas = 0.5 * np.linalg.norm(np.cross(*edges), axis=1)
    chance = areas * records["lamp"]
    assert chance.sum() == pytest.approx(1.0, rel=1e-6)
    by_object = [chance[records["object"] == k].sum() for k in range(5)]
    power = np.array([0.0, 2.0, 0.0, 6 * 0.25 * 4.0, 0.01 * 40.0])
    np.testing.assert_allclose(by_object, power / power.sum(), rtol=1e-6)
    bits = np.random.default_rng(1).integers(0, 2**32, (400_000, 2), dtype=np.uint32)
    found = draw(data, bits)
    counts = np.bincount(found[:, 0].astype(int), minlength=len(chance))
    there = chance > 0
    assert not counts[~there].any()
    assert stats.chisquare(counts[there], chance[there] / chance.sum() * len(bits)).pvalue > 1e-3
    # Uniform on a triangle: of the square of halves each of four equal parts gets a quarter.
    u, v = found[:, 1], found[:, 2]
    assert u.min() >= 0 and v.min() >= 0 and (u + v).max() <= 1 + 1e-6
    part = np.where(u > 0.5, 0, np.where(v > 0.5, 1, np.where(u + v < 0.5, 2, 3)))
    assert stats.chisquare(np.bincount(part, minlength=4)).pvalue > 1e-3
    # Among real ones alone: the same proportions.
    assert data.lamps.real_share == pytest.approx(power[3] / power.sum())
    owners = records["object"][draw(data, bits[:1000], True)[:, 0].astype(int)]
    assert np.all(owners == 3)


def test_ends_of_the_numbers_stay_inside():
    data = upload(scene_of(objects()), "warp").data
    most = 2**32 - 1
    found = draw(data, [[0, 0], [most, most], [0, most], [most, 0]])
    assert np.all(data.triangles.numpy()["lamp"][found[:, 0].astype(int)] > 0)
    assert np.all(np.isfinite(found)) and np.all(found[:, 1:] >= 0) and np.all(found[:, 1] + found[:, 2] <= 1)


def test_nothing_is_drawn_where_nothing_emits():
    data = upload(scene_of([item("dark", box((1, 1, 1)), 0.0)]), "warp").data
    assert draw(data, [[5, 5]])[0, 0] == -1
    alone = upload(scene_of([item("lamp", plane(1, 1), 1.0)]), "warp").data
    assert draw(alone, [[5, 5]], True)[0, 0] == -1
    assert draw(alone, [[5, 5]])[0, 0] >= 0


def test_clear_media_are_left_to_scattered_rays():
    glass = SceneObject("glass", box((1, 1, 1)), Material("dielectric", emission=(1.0,) * 3), True)
    data = upload(scene_of([glass]), "warp").data
    assert data.lamps.count == 0 and not data.triangles.numpy()["lamp"].any()


def test_mean_of_a_texture_over_a_triangle():
    """Against many random points; a triangle in the dark part is never chosen."""
    rng = np.random.default_rng(4)
    pixels = rng.random((16, 32, 3), dtype=np.float32)
    pixels[:, 16:] = 0.0
    uvs = np.array([[0.1, 0.1], [0.4, 0.2], [0.2, 0.9], [0.6, 0.1], [0.9, 0.2], [0.7, 0.9]], np.float32)
    mesh = Mesh(rng.random((6, 3)), np.array([[0, 1, 2], [3, 4, 5]], np.int32), None, uvs)
    found = mean_radiance(item("lamp", mesh, 1.0, texture=Texture(pixels)))
    a, b = rng.random((2, 200_000))
    a, b = np.where(a + b > 1, 1 - a, a), np.where(a + b > 1, 1 - b, b)
    at = uvs[0] + a[:, None] * (uvs[1] - uvs[0]) + b[:, None] * (uvs[2] - uvs[0])
    x, y = at[:, 0] * 32 - 0.5, (1 - at[:, 1]) * 16 - 0.5
    x0, y0 = np.floor(x).astype(int), np.floor(y).astype(int)
    fx, fy = x - x0, y - y0
    t = pixels.sum(axis=2)
    value = (1 - fy) * ((1 - fx) * t[y0, x0] + fx * t[y0, x0 + 1])
    value += fy * ((1 - fx) * t[(y0 + 1) % 16, x0] + fx * t[(y0 + 1) % 16, x0 + 1])
    assert found[0] == pytest.approx(value.mean(), rel=0.02) and found[1] == 0.0
