"""What the printed algorithm gives where the answer is known, and what ours gives there.

Each case of the listing's mistakes runs the listing itself (`printed_listing`), so that the reason for every
departure from it can be seen to be one.
"""

from __future__ import annotations

import numpy as np
import pytest
from numpy_tracer import Ball, Plane, radiance
from printed_listing import printed

from mrbatch.methods.delta_path_tracing.cases import delta_probe as probe
from mrbatch.scene.closed_forms import ball, ball_share, corner, floor, placed, real, scene_of, virtual
from mrbatch.scene.mesh import plane

UP = (0, 0, 1)
FLOOR = Plane(UP, 0.0, 0.5)
REPAIRED = {"miss_adds": False, "late_update": False}


def near(found, oracle, tolerance=0.0):
    """Within four standard errors of the listing's mean."""
    mean, error, _ = found
    assert abs(mean - oracle) < 4 * error + tolerance, (mean, error, oracle)


@pytest.mark.case("TRAP-1")
def test_an_empty_table_would_be_seventy_per_cent_too_bright():
    found = printed([FLOOR], (0, 0, 0), UP, 0.5, 100_000, 1)
    near(found, 0.5 * (0.5 + np.log(5) / 8))
    dot = virtual("dot", ball(2.0**-10, at=(100, 0, 1)), 0.0)
    ours = probe(scene_of([real("floor", floor()), dot]), (0, 0, 0))
    assert np.abs(ours.delta).max() < 1e-6


@pytest.mark.case("TRAP-1a")
def test_what_a_ball_sends_would_be_taken_away():
    """A ball of reflectance .8 rests on the floor, one radius off: light that it sends raises the floor's."""
    items = [FLOOR, Ball((0, 0, 1), 1.0, 0.8)]
    at = ((1, 0, 0), UP, 0.5, 100_000)
    with_ball, error = radiance(items, *at, 5)
    truth = with_ball - 0.5
    # The number is known to three digits.
    assert abs(truth + 0.102) < 5e-4 + 4 * error
    late = [printed(items, *at, 1, bounces=b, miss_adds=False)[0] for b in (1, 2)]
    right = [printed(items, *at, 1, bounces=b, **REPAIRED)[0] for b in (1, 2)]
    assert late[1] < late[0] - 0.03 and right[1] > right[0] + 0.02
    near(printed(items, *at, 1), 0.039, 1e-3)
    near(printed(items, *at, 1, **REPAIRED), -0.109, 1e-3)
    scene = scene_of([real("floor", floor()), virtual("ball", ball(), 0.8, camera=False)])
    ours = probe(scene, (1, 0, 0), spp=512)
    assert abs(ours.delta[0] - truth) < 4 * np.hypot(ours.delta_error[0], error) + 1e-4
    # A red card bleeds red: of three channels the one that it sends is missing least.
    red = virtual(
        "card", placed(plane(2, 2), at=(-0.5, 0, 1), normal=(1, 0, 0)), (0.9, 0.1, 0.1), camera=False
    )
    ours = probe(scene_of([real("floor", floor()), red]), (0, 0, 0), spp=256)
    assert ours.delta[0] > ours.delta[1] + 10 * ours.delta_error[0]


@pytest.mark.case("TRAP-1c")
def test_a_ball_before_a_black_wall_would_darken_the_floor():
    """The wall's light is none, with the ball or without; the listing takes all of the sky behind both."""
    items = [FLOOR, Plane((1, 0, 0), -2.0, 0.0), Ball((-1, 0, 1), 0.3, 0.0)]
    near(printed(items, (0, 0, 0), UP, 0.5, 100_000, 2, **REPAIRED), -0.25)
    big = 2.0**12
    wall = real("wall", placed(plane(big, big), at=(-2, 0, big / 2), normal=(1, 0, 0)), 0.0)
    black = virtual("ball", ball(0.3, at=(-1, 0, 1)), 0.0, camera=False)
    assert not probe(scene_of([real("floor", floor()), wall, black]), (0, 0, 0), spp=64).pixels.any()


@pytest.mark.case("TRAP-1d")
@pytest.mark.parametrize("s", [0.3, 0.8, 1.7])
def test_a_corner_with_a_ball_would_lose_half_its_light(s):
    """Light between real surfaces is in the photo already, and what they hide from each other is too."""
    walls = [FLOOR, Plane((1, 0, 0), 0.0, 0.5)]
    items = [*walls, Ball((0.8, 0, 0.6), 0.5, 0.2)]
    at = ((s, 0, 0), UP, 0.5, 100_000)
    m, em = radiance(items, *at, 3)
    truth = m - 1 / 3
    mean, error, _ = printed(items, *at, 4, **REPAIRED)
    assert mean - truth == pytest.approx(-0.515 / 3, abs=4 * np.hypot(error, em) + 0.01 / 3)
    thing = virtual("ball", ball(0.5, at=(0.8, 0, 0.6)), 0.2, camera=False)
    ours = probe(scene_of([*corner(0.5), thing]), (s, 0, 0), spp=512)
    assert abs(ours.delta[0] - truth) < 4 * np.hypot(ours.delta_error[0], em) + 1e-4


@pytest.mark.case("TRAP-1f")
def test_a_lamp_would_be_a_shadow():
    """The listing never adds what a surface sends of itself: a black ball is black, however it glows."""
    share = float(ball_share(1.0, 1.0, 0.5))
    near(
        printed([FLOOR, Ball((0, 0, 1), 1.0, 0.0)], (0.5, 0, 0), UP, 0.5, 100_000, 6, **REPAIRED),
        -0.5 * share,
    )


@pytest.mark.slow
@pytest.mark.case("TRAP-1j")
def test_the_map_is_read_once_for_each_ray_that_something_blocks():
    """The listing reads it twice a bounce, before it knows whether anything is in the way."""
    items = [FLOOR, Ball((0, 0, 2), 1.0, 0.0)]
    assert printed(items, (0, 0, 0), UP, 0.5, 1000, 1, bounces=1)[2] == 2.0
    scene = scene_of([real("floor", floor()), virtual("ball", ball(at=(0, 0, 2)), 0.0, camera=False)])
    # Directions drawn to an even sky are uniform: of those the ball fills a cap of 30 degrees half angle, of
    # cosine ones F = 1/4; both are known exactly.
    for strategy, expected in (("environment", (1 - np.sqrt(0.75)) / 2), ("bsdf", 0.25)):
        ours = probe(scene, (0, 0, 0), spp=1024, settings={"strategy": strategy, "sampler": "independent"})
        samples = 64 * 1024
        share = ours.counters["lookups"] / samples
        assert abs(share - expected) < 4 * np.sqrt(expected * (1 - expected) / samples) + 1e-4
    ours = probe(scene, (0, 0, 0), spp=1024, settings={"sampler": "independent"})
    both = (1 - np.sqrt(0.75)) / 2 + 0.25
    assert abs(ours.counters["lookups"] / samples - both) < 4 / np.sqrt(samples)


@pytest.mark.case("TRAP-2")
def test_a_cosine_that_may_be_negative_would_double_the_table():
    """Directions drawn over the whole map: those below a closed table are blocked by it, and would count."""
    found = printed([FLOOR], (0, 0, 0), UP, 0.5, 100_000, 7, bounces=1, miss_adds=False, clamped_cosine=False)
    near(found, 0.5)
    near(printed([FLOOR], (0, 0, 0), UP, 0.5, 1000, 7, bounces=1, miss_adds=False), 0.0, 1e-12)
