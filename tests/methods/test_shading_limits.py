"""Paths through layers of glass and water, and steep normal maps: against Snell's law, and exact zeros."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mrbatch.methods.delta_path_tracing import METHOD as DELTA
from mrbatch.methods.estimate import estimate
from mrbatch.methods.one_pass import METHOD as ONE_PASS
from mrbatch.scene.closed_forms import look_at, scene_of, sky, virtual
from mrbatch.scene.environment import Environment
from mrbatch.scene.mesh import box, plane
from mrbatch.scene.scene import Material, SceneObject, Texture

GLASS = Material("dielectric", (1.0,) * 3, 0.0, ior=1.5, priority=2)
WATER = replace(GLASS, ior=1.33, priority=1)
THICK = 0.010


def layer(name, material, top, bottom):
    mesh = box((2.0, 2.0, top - bottom), centre=(0, 0, 0.5 * (top + bottom)))
    return SceneObject(name, mesh, material, True)


@pytest.mark.case("BSDF-09")
@pytest.mark.parametrize("gap", [-1e-5, 1e-5], ids=["apart", "overlapping"])
def test_the_way_through_glass_water_and_glass_is_snells(gap):
    """Water between two panes, reaching a hundredth of a millimetre into both or ending as much before them:
    seen at 60 degrees, an edge below is where Snell's law puts it, to 1e-5 of the way of half a metre."""
    at = np.radians(60)
    tops = {"upper": 0.02, "water": 0.01 + gap, "lower": -0.01}
    layers = [
        layer("upper", GLASS, 0.02, 0.01),
        layer("water", WATER, 0.01 + gap, -0.01 - gap),
        layer("lower", GLASS, -0.01, -0.02),
    ]
    assert tops["water"] != 0.01
    # What is there from top to bottom: glass beats the water that reaches into it.
    edges = [0.02, 0.01, min(0.01, 0.01 + gap), -min(0.01, 0.01 + gap), -0.01, -0.02, -0.1]
    indices = [1.5, 1.0, 1.33, 1.0, 1.5, 1.0]
    y = -edges[0] * np.tan(at)
    for top, bottom, n in zip(edges[:-1], edges[1:], indices, strict=True):
        y += (top - bottom) * np.tan(np.arcsin(np.sin(at) / n))
    eye = np.array([0.0, -np.sin(at), np.cos(at)]) * 0.5
    # All 64 pixels lie within a micrometre.
    view = look_at(eye, (0, 0, 0), width=8, height=8, focal=8 * 2.0**19)
    black = virtual("black", box((9.0, 9.0, 0.001), centre=(0.0, 0.0, -0.102)), 0.0)
    for side, white in ((-5e-6, False), (5e-6, True)):
        strip = virtual("strip", box((4.0, 4.0, 0.001), centre=(0.0, y + side - 2.0, -0.1005)), 1.0)
        found = estimate(DELTA, scene_of([*layers, strip, black], sky()), view, spp=256).developed.P
        assert (found.mean() > 0.5) == white, (side, found.mean())


@pytest.mark.slow
@pytest.mark.case("BSDF-10")
@pytest.mark.parametrize("method", [DELTA, ONE_PASS], ids=lambda m: m.name)
def test_a_steep_map_takes_no_light_from_behind_its_surface(method):
    """Normals at 60 degrees see 30 degrees below the card; the card itself is in nobody's way. Lit from below
    alone, what is seen from above is black to the bit."""
    t = np.radians(60.0)
    leaning = Texture(np.float32([[[np.sin(t), 0, np.cos(t)]]]))
    image = np.zeros((64, 8, 3), np.float32)
    image[33:] = 1.0
    light = Environment(image, interpolation="nearest")
    assert light.irradiance(np.array([[np.sin(t), 0, np.cos(t)]]))[0, 0] > 0.5, "printed form: a leak"
    view = look_at((0.5, -1.0, 3.0), (0, 0, 0), width=8, height=8, focal=32)
    for look in (
        Material(reflectance=(1.0,) * 3, normal_texture=leaning),
        Material("conductor", (1.0,) * 3, 0.4, normal_texture=leaning),
        Material("principled", (1.0,) * 3, 0.4, f0=0.04, normal_texture=leaning),
    ):
        card = SceneObject("card", plane(4.0, 4.0), look, True, cast_shadow=False)
        found = estimate(method, scene_of([card], light), view, spp=64).developed
        assert (found.a == 1).all() and not found.P.any(), look.kind
