"""Light samplers and number sequences in whole methods: equal means, tables only where asked for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mrbatch.device.rays import resolve_engine
from mrbatch.methods.delta_path_tracing import METHOD as DELTA
from mrbatch.methods.estimate import estimate
from mrbatch.methods.image_based_lighting import METHOD as IMAGE_BASED
from mrbatch.scene.closed_forms import ball, corner, lamp_sky, look_at, scene_of, virtual
from mrbatch.scene.environment import Environment
from mrbatch.scene.scene import Material
from mrbatch.scene.scene_data import upload

PHOTO = np.full((24, 32, 3), 0.3, np.float32)


def scene(light=None):
    shiny = replace(
        virtual("metal", ball(0.4, at=(1.4, 0.2, 0.4), subdivisions=3)),
        material=Material("conductor", (0.9, 0.7, 0.3), 0.2),
    )
    matt = virtual("ball", ball(0.4, at=(0.6, -0.5, 0.4), subdivisions=3), (0.8, 0.4, 0.3))
    return scene_of([*corner(0.5, size=16.0), matt, shiny], light or lamp_sky())


def means(method, light=None, runs=8, spp=32, **settings):
    """Mean over the picture of P and of D, and their standard errors, from runs with seeds of their own."""
    view = look_at((3.5, -2.5, 2.0), (0.8, 0, 0.3), width=32, height=24, focal=40)
    found = []
    for seed in range(runs):
        given = {"spp": spp, "background": PHOTO, "seed": seed + len(str(settings)) * 100}
        developed = estimate(method, scene(light), view, settings=settings, **given).developed
        found.append([developed.P.mean(axis=(0, 1)), developed.D.mean(axis=(0, 1))])
    values = np.array(found, dtype=np.float64)
    return values.mean(axis=0), values.std(axis=0, ddof=1) / np.sqrt(runs)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "strategy"),
    [(DELTA, "mis"), (DELTA, "environment"), (IMAGE_BASED, "mis")],
    ids=["delta, mis", "delta, environment", "image-based"],
)
def test_alias_table_gives_the_same_mean(method, strategy):
    one, error = means(method, light_sampler="cdf", strategy=strategy)
    two, other = means(method, light_sampler="alias", strategy=strategy)
    assert one.any()
    assert np.all(np.abs(one - two) <= 4.5 * np.hypot(error, other))


@pytest.mark.slow
def test_shifted_points_give_the_same_mean():
    one, error = means(DELTA, sampler="owen")
    two, other = means(DELTA, sampler="cranley-patterson")
    assert np.all(np.abs(one - two) <= 4.5 * np.hypot(error, other))


@pytest.mark.slow
@pytest.mark.case("TRAP-2a")
def test_sample_map_gives_another_mean():
    """Thousands of samples do not help: only 8 x 16 directions are ever asked for light."""
    light = np.full((8, 16, 3), 0.2, np.float32)
    light[1, 5] = 60.0
    settings = {"light": Environment(light), "strategy": "environment", "spp": 512, "runs": 4}
    one, error = means(DELTA, light_sampler="cdf", **settings)
    two, other = means(DELTA, light_sampler="sample-map", **settings)
    assert np.abs(one - two).max() > 10 * np.hypot(error, other).max()


@pytest.mark.parametrize(("asked", "holds"), [("auto", ""), ("alias", "buckets"), ("sample-map", "stored")])
def test_a_shot_uploads_only_what_it_asks_for(asked, holds):
    device = upload(scene(), resolve_engine("auto"))
    assert device.light_sampler(asked) == (device.scene.environment.light_sampler if not holds else asked)
    environment = device.data.environment
    assert bool(environment.buckets) == (holds == "buckets")
    assert bool(environment.stored) == (holds == "stored")
    later = upload(device.scene, device.engine, shared=device.data).data.environment
    assert (bool(later.buckets), bool(later.stored)) == (holds == "buckets", holds == "stored"), (
        "moved scenes"
    )
