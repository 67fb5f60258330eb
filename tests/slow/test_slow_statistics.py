"""Noise over a wide range of samples, intervals, and light that hardly any ray finds."""

from __future__ import annotations

import numpy as np
import pytest
from held import holds

from mrbatch.methods.delta_path_tracing import noise_cases
from mrbatch.methods.delta_path_tracing.cases import delta_probe as probe
from mrbatch.metrics.statistics import log_log_slope
from mrbatch.scene.closed_forms import ball, ball_share, floor, lamp_sky, real, scene_of, virtual

pytestmark = pytest.mark.slow
RANDOM = {"sampler": "independent"}


def shadow(light=None):
    return scene_of([real("floor", floor()), virtual("ball", ball(), 0.0, camera=False)], light)


@pytest.mark.case("MC-01")
def test_variance_falls_as_one_over_samples_from_4_to_4096():
    """Against the closed form, so that a bias would bend the line where noise is least."""
    truth = -0.5 * float(ball_share(1.0, 1.0, 1.0))
    counts = (4, 16, 64, 256, 1024, 4096)
    errors = []
    for count in counts:
        pixels = [
            probe(shadow(), (1.0, 0, 0), spp=count, seed=100 * count + k, settings=RANDOM).pixels[:, 0]
            for k in range(8)
        ]
        errors.append(np.mean((np.concatenate(pixels) - truth) ** 2))
    slope = log_log_slope(counts, errors).slope
    print(f"slope {slope.value:+.3f} ({slope.low:+.3f} .. {slope.high:+.3f})")
    assert abs(slope.value + 1) < 0.05


@pytest.mark.case("MC-05")
def test_intervals_hold_the_truth_as_often_as_they_say():
    """1024 estimates with the variance that the film tells of each. Under a lamp that scattered rays find by
    chance the law is skewed, and the same interval holds less: told, not hidden."""
    holds(noise_cases.intervals(0))
    exact = float(probe(shadow(lamp_sky()), (1.0, 0, 0), spp=1 << 15, seed=5).delta[0])
    drawn = noise_cases.coverage(0, lamp_sky(), exact)
    chance = noise_cases.coverage(0, lamp_sky(), exact, strategy="bsdf")
    print(f"coverage under a lamp: both ways {drawn:.3f}, by scattered rays alone {chance:.3f}")
    assert chance < 0.97


@pytest.mark.case("MC-08", "TRAP-1g")
def test_a_lamp_that_one_ray_in_seventy_thousand_finds_keeps_its_mean():
    """Nothing is clamped: by scattered rays alone a lamp of 6.7e-5 sr lights a card as its solid angle says,
    in bright specks."""
    holds(noise_cases.seldom_found(0))
