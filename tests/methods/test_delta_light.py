"""How light is sampled and counted: splits of the weights, units, the pole; against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from held import holds

from mrbatch.methods.delta_path_tracing import METHOD as DELTA
from mrbatch.methods.delta_path_tracing import noise_cases
from mrbatch.methods.estimate import estimate
from mrbatch.methods.one_pass import METHOD as ONE_PASS
from mrbatch.methods.two_pass import METHOD as TWO_PASS
from mrbatch.scene.closed_forms import ball, corner, lamp_sky, look_at, scene_of, virtual
from mrbatch.scene.environment import Environment
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
    holds(noise_cases.pole_texel(0))


@pytest.mark.slow
@pytest.mark.case("MIS-05")
@pytest.mark.parametrize("name", noise_cases.maps())
def test_every_way_of_drawing_has_the_same_mean(name):
    """Scattered directions alone, drawn ones alone, both, and 64 drawn for one scattered, pair by pair."""
    holds(noise_cases.ways_of_drawing(0, names=(name,)))


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


@pytest.mark.slow
@pytest.mark.case("MC-02", "TRAP-3c")
def test_a_table_whose_light_is_all_blocked_is_black_in_the_mean():
    """Clamping each sample's sum with the photo, and not the mean, leaves light: sigma / sqrt(2 pi) of it."""
    holds(noise_cases.nothing_left(0))
    left, _ = noise_cases.blocked_light(0)
    assert np.maximum(left, 0).mean() > 10 * left.std() / np.sqrt(len(left))
