"""How light is sampled and counted: splits of the weights, units, the pole; against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from held import holds

from mrbatch.methods.delta_path_tracing import METHOD as DELTA
from mrbatch.methods.delta_path_tracing.cases import delta_probe as probe
from mrbatch.methods.estimate import estimate
from mrbatch.methods.one_pass import METHOD as ONE_PASS
from mrbatch.methods.two_pass import METHOD as TWO_PASS
from mrbatch.scene.closed_forms import ball, corner, floor, lamp_sky, look_at, real, scene_of, sky, virtual
from mrbatch.scene.environment import Environment
from mrbatch.scene.mesh import plane
from mrbatch.stability import weight_cases


@pytest.mark.case("MIS-06", "TRAP-2")
@pytest.mark.parametrize("sampler", ["median-cut", "cdf"])
def test_an_open_plane_under_an_even_sky_is_split_as_the_weights_say(sampler):
    """Dividing the sum by both counts of samples, as if they were one pool, would halve the table."""
    assert pytest.approx(0.70118, abs=1e-5) == weight_cases.SCATTERED
    holds(weight_cases.split(5, sampler))
    drawn, scattered = weight_cases.open_plane(5, sampler)
    assert abs(0.5 * (drawn + scattered).mean() - 1) > 0.4


@pytest.mark.case("ENV-03")
def test_one_texel_at_the_pole_lights_a_card_by_its_solid_angle():
    """Through sampler, paths and film: E = L (pi / W) sin^2(pi / H) of a texel in row 0, nearest look-up."""
    height, width = 32, 48
    image = np.zeros((height, width, 3), np.float32)
    image[0, 5] = 1e4
    light = Environment(image, interpolation="nearest")
    card = virtual("card", plane(1.0, 1.0), 0.8)
    found = probe(scene_of([card], light), (0.1, 0.05, 0), spp=512, settings={"strategy": "environment"})
    oracle = 0.8 / np.pi * 1e4 * np.pi / width * np.sin(np.pi / height) ** 2
    assert np.all(np.abs(found.virtual / oracle - 1) < 1e-3 + 4 * found.virtual_error / oracle)
    assert np.all(found.virtual_error < 1e-3 * oracle)


MAPS = {
    "even": sky(),
    "lamp": lamp_sky(),
    "halves": Environment(
        np.repeat([[[2.0] * 3] * 8] * 8 + [[[0.1] * 3] * 8] * 8, 1, axis=0).astype(np.float32)
    ),
    "many": Environment((np.random.default_rng(4).random((24, 48, 3)) ** 8 * 20).astype(np.float32)),
}


@pytest.mark.slow
@pytest.mark.case("MIS-05")
@pytest.mark.parametrize("name", MAPS)
def test_every_way_of_drawing_has_the_same_mean(name):
    """Scattered directions alone, drawn ones alone, both, and 64 drawn for one scattered, pair by pair."""
    thing = virtual("ball", ball(0.6, at=(0.5, 0, 0.6)), (0.7, 0.4, 0.2), camera=False)
    scene = scene_of([*corner(0.5), thing], MAPS[name])
    ways = (
        {"strategy": "mis"},
        {"strategy": "environment"},
        {"strategy": "bsdf"},
        {"strategy": "mis", "light_samples": 64},
    )
    found = [
        probe(scene, (0.3, 0.1, 0), spp=64 if "light_samples" in way else 512, seed=k, settings=way)
        for k, way in enumerate(ways)
    ]
    for i, one in enumerate(found):
        for other in found[:i]:
            error = np.hypot(one.delta_error, other.delta_error)
            # Six pairs of three channels from 64 pixels each.
            assert np.all(np.abs(one.delta - other.delta) <= 4 * error)
    assert np.abs(found[0].delta).min() > 20 * found[0].delta_error.max()


@pytest.mark.case("TRAP-3a", "DPT-19")
@pytest.mark.parametrize("method", [DELTA, ONE_PASS, TWO_PASS], ids=lambda m: m.name)
def test_units_of_map_and_photo_meet_in_the_gain(method):
    """A map four times as bright under a quarter of the gain: the same bits. A frame of half the exposure has
    half the gain, and half the change, to the bit."""
    objects = [*corner(0.5, size=16.0), virtual("ball", ball(0.4, at=(0.6, 0, 0.4), subdivisions=3), 0.6)]
    view = look_at((3, -2, 2), (0.4, 0, 0.2), width=24, height=20, focal=30)
    light = lamp_sky()
    photo = np.random.default_rng(2).uniform(0.1, 0.8, (20, 24, 3)).astype(np.float32)

    def shown(radiance, gain, background):
        scene = scene_of(objects, Environment(radiance))
        return estimate(method, scene, view, spp=8, background=background, gain=(gain,) * 3).developed

    base = shown(light.radiance, 0.5, photo)
    bright = shown(4 * light.radiance, 0.125, photo)
    half = shown(light.radiance, 0.25, 0.5 * photo)
    assert base.D.any() and base.P.any()
    for name in ("P", "D", "variance"):
        assert np.array_equal(getattr(bright, name), getattr(base, name)), name
    assert np.array_equal(half.D, 0.5 * base.D) and np.array_equal(half.P, 0.5 * base.P)
    # Printed: an albedo tuned until shadows fit hides the scale; virtual surfaces are 4 times too bright.
    assert np.array_equal(shown(4 * light.radiance, 0.5, photo).P, 4 * base.P)


@pytest.mark.case("MIS-02")
def test_smooth_glass_is_lit_by_scattered_directions_alone():
    """A direction drawn to the light never is the mirrored or the bent one: no shadow ray, no weight lost."""
    from mrbatch.scene.scene import Material, SceneObject

    glass = Material("dielectric", (1.0,) * 3, 0.0, ior=1.5)
    found = probe(
        scene_of([SceneObject("ball", ball(at=(0, 0, 0)), glass, True)], sky()),
        (0, 0, 1.0),
        distance=3.0,
        spp=64,
        settings={"roulette_depth": 64},
    )
    assert found.counters["shadow rays"] == 0
    np.testing.assert_allclose(found.virtual, 1.0, rtol=1e-5)


@pytest.mark.slow
@pytest.mark.case("MC-02", "TRAP-3c")
def test_a_table_whose_light_is_all_blocked_is_black_in_the_mean():
    """Clamping each sample's sum with the photo, and not the mean, leaves light: sigma / sqrt(2 pi) of it."""
    lid = virtual("lid", plane(2.0**12, 2.0**12, centre=(0, 0, 0.25)), 0.0, camera=False)
    scene = scene_of([real("floor", floor(2.0**12), 0.5), lid], lamp_sky(4.0))
    photo = 0.5 / np.pi * lamp_sky(4.0).irradiance(np.array([[0, 0, 1.0]]))[0]
    few = {"sampler": "independent"}
    pixels = np.concatenate(
        [
            probe(scene, (0, 0, 0), distance=2.0**-3, spp=2, seed=k, settings=few).pixels[:, 0]
            for k in range(32)
        ]
    )
    left = photo[0] + pixels
    error = left.std() / np.sqrt(len(left))
    assert left.std() > 0.02 * photo[0]
    assert abs(left.mean()) < 4 * error + 2e-4 * photo[0]
    assert np.maximum(left, 0).mean() > 10 * error
