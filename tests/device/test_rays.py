"""Both ray engines against a float64 oracle and against each other."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from mrbatch.device.rays import RayMesh
from mrbatch.stability.ray_draws import cast


def two_balls():
    ball = trimesh.creation.icosphere(subdivisions=3)
    a = RayMesh(0, ball.vertices.astype(np.float32), ball.faces.astype(np.int32), 0)
    b = RayMesh(
        3, (ball.vertices * 0.5 + [3, 0, 0]).astype(np.float32), ball.faces.astype(np.int32), len(ball.faces)
    )
    return [a, b]


def random_rays(n, seed=0):
    rng = np.random.default_rng(seed)
    o = rng.uniform(-4, 4, (n, 3))
    target = rng.uniform([-1, -1, -1], [3.5, 1, 1], (n, 3))
    d = target - o
    return o.astype(np.float32), (d / np.linalg.norm(d, axis=1, keepdims=True)).astype(np.float32)


@pytest.mark.parametrize("engine", ["embree", "warp"])
def test_hit_point_lies_on_the_ray_and_matches_brute_force(engine):
    meshes = two_balls()
    o, d = random_rays(400)
    t, uv, triangle, blocked = cast(engine, meshes, o, d)
    corners = np.concatenate([m.vertices[m.faces] for m in meshes]).astype(np.float64)
    e1, e2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    for i in range(len(o)):
        p = np.cross(d[i].astype(np.float64), e2)
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse = 1 / np.einsum("ij,ij->i", p, e1)
            s = o[i] - corners[:, 0]
            u = np.einsum("ij,ij->i", s, p) * inverse
            q = np.cross(s, e1)
            v = q @ d[i].astype(np.float64) * inverse
            hit_t = np.einsum("ij,ij->i", q, e2) * inverse
            ok = (u >= 0) & (v >= 0) & (u + v <= 1) & (hit_t > 0)
        assert (triangle[i] >= 0) == ok.any() == bool(blocked[i])
        if ok.any():
            nearest = np.where(ok, hit_t, np.inf).argmin()
            assert t[i] == pytest.approx(hit_t[nearest], rel=2e-5)
            c = corners[triangle[i]]
            point = c[0] + uv[i, 0] * (c[1] - c[0]) + uv[i, 1] * (c[2] - c[0])
            assert np.allclose(point, o[i] + hit_t[nearest] * d[i].astype(np.float64), atol=2e-5)


@pytest.mark.parametrize("engine", ["embree", "warp"])
def test_empty_set_is_never_hit(engine):
    o, d = random_rays(10)
    t, _, triangle, blocked = cast(engine, [], o, d)
    assert (triangle == -1).all() and (blocked == 0).all() and (t > 1e38).all()


def test_engines_agree():
    o, d = random_rays(20000, seed=1)
    a = cast("embree", two_balls(), o, d)
    b = cast("warp", two_balls(), o, d)
    assert (a[3] == b[3]).mean() > 0.9995
    both = (a[2] >= 0) & (b[2] >= 0)
    assert np.allclose(a[0][both], b[0][both], rtol=1e-4)
