"""Resampled directions to the light: equal means, less noise, one shadow ray."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mrbatch.methods.delta_path_tracing import METHOD as DELTA
from mrbatch.methods.estimate import estimate
from mrbatch.methods.one_pass import METHOD as ONE_PASS
from mrbatch.scene.closed_forms import ball, corner, lamp_sky, look_at, scene_of, sky, virtual
from mrbatch.scene.environment import Environment
from mrbatch.scene.scene import Material

PHOTO = np.full((24, 32, 3), 0.3, np.float32)
SHINY = Material("conductor", (0.9, 0.7, 0.3), 0.3)
FROSTED = Material("dielectric", (1.0,) * 3, 0.3, ior=1.5)


def lamps():
    """Two lamps, one behind the corner's walls, on a sky of many brightnesses."""
    image = np.random.default_rng(3).uniform(0.02, 0.5, (16, 32, 3)).astype(np.float32)
    image[3, 14:16] = 40.0
    image[6, 2] = 30.0
    return Environment(image)


def scene(kind):
    balls = [
        virtual("left", ball(0.4, at=(0.6, -0.5, 0.4), subdivisions=3), (0.8, 0.4, 0.3)),
        virtual("right", ball(0.4, at=(1.4, 0.2, 0.4), subdivisions=3), (0.3, 0.5, 0.8)),
    ]
    if kind == "glossy":
        balls = [replace(item, material=material) for item, material in zip(balls, (SHINY, FROSTED))]
    return scene_of([*corner(0.5, size=16.0), *balls], lamps())


def runs(method, what, count=16, spp=32, first_seed=0, **settings):
    """(count, 2, 3) means over the picture of P and of D, one a seed, and the counters of the last."""
    view = look_at((3.5, -2.5, 2.0), (0.8, 0, 0.3), width=32, height=24, focal=40)
    found = []
    for seed in range(first_seed, first_seed + count):
        given = {"spp": spp, "background": PHOTO, "seed": seed, "settings": settings}
        estimated = estimate(method, what, view, **given)
        developed = estimated.developed
        found.append([developed.P.mean(axis=(0, 1)), developed.D.mean(axis=(0, 1))])
    return np.array(found, dtype=np.float64), developed, estimated.counters


def agree(a, b):
    error = np.hypot(a.std(axis=0, ddof=1), b.std(axis=0, ddof=1)) / np.sqrt(len(a))
    assert a.mean(axis=0).any() and (error < 0.02 * np.abs(a.mean(axis=0)).max()).all()
    # Sixteen runs each: four standard errors of a normal variable are 4.8 of Student's.
    assert (np.abs(a.mean(axis=0) - b.mean(axis=0)) < 4.8 * error).all()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "strategy", "rays"), [("diffuse", "mis", 1), ("glossy", "mis", 2), ("glossy", "environment", 1)]
)
def test_mean_is_that_of_one_candidate(kind, strategy, rays):
    plain, *_ = runs(DELTA, scene(kind), strategy=strategy)
    settings = {"light_candidates": 5, "light_samples": rays}
    several, *_ = runs(DELTA, scene(kind), strategy=strategy, first_seed=100, **settings)
    agree(plain, several)


@pytest.mark.slow
def test_a_baseline_resamples_too():
    plain, *_ = runs(ONE_PASS, scene("glossy"))
    several, *_ = runs(ONE_PASS, scene("glossy"), light_candidates=5, first_seed=100)
    agree(plain, several)


@pytest.mark.slow
def test_noise_falls_and_shadow_rays_hardly_rise():
    """Light alone on an even sky: of the cosine's noise, 8 candidates leave an eighth; shadows stay."""
    what = scene_of(scene("diffuse").objects, sky())
    noise, rays = {}, {}
    for n in (1, 8):
        settings = {"strategy": "environment", "max_depth": 2, "sampler": "independent"}
        _, developed, counters = runs(DELTA, what, 1, 256, light_candidates=n, **settings)
        seen = developed.a == 1.0
        noise[n] = developed.variance[seen].mean()
        rays[n] = counters["shadow rays"]
    assert noise[8] < 0.5 * noise[1]
    # One ray a vertex, which with one candidate is saved where that lies below the surface.
    assert rays[1] < rays[8] < 2.2 * rays[1]


@pytest.mark.slow
def test_one_candidate_is_the_same_picture():
    view = look_at((3.5, -2.5, 2.0), (0.8, 0, 0.3), width=32, height=24, focal=40)
    found = [
        estimate(DELTA, scene_of(scene("glossy").objects, lamp_sky()), view, spp=8, background=PHOTO, **given)
        for given in ({}, {"settings": {"light_candidates": 1}})
    ]
    assert np.array_equal(found[0].developed.P, found[1].developed.P)
    assert np.array_equal(found[0].developed.D, found[1].developed.D)
