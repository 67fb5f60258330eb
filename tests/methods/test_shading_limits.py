"""Paths through layers of glass and water, and steep normal maps: against Snell's law, and exact zeros."""

from __future__ import annotations

import numpy as np
import pytest
from held import holds

from mrbatch.methods.delta_path_tracing import METHOD as DELTA
from mrbatch.methods.delta_path_tracing import glass_cases
from mrbatch.methods.estimate import estimate
from mrbatch.methods.one_pass import METHOD as ONE_PASS
from mrbatch.scene.closed_forms import look_at, scene_of
from mrbatch.scene.environment import Environment
from mrbatch.scene.mesh import plane
from mrbatch.scene.scene import Material, SceneObject, Texture


@pytest.mark.case("BSDF-09")
def test_the_way_through_glass_water_and_glass_is_snells():
    holds(glass_cases.snells_way(0))


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
