"""Motion blur against integrals over the exposure that are known in closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mrbatch.methods.delta_path_tracing import METHOD as DELTA
from mrbatch.methods.estimate import estimate
from mrbatch.methods.image_based_lighting import METHOD as IBL
from mrbatch.methods.one_pass import METHOD as ONE_PASS
from mrbatch.methods.two_pass import METHOD as TWO_PASS
from mrbatch.scene.camera import Camera
from mrbatch.scene.closed_forms import real, scene_of, virtual
from mrbatch.scene.mesh import plane
from mrbatch.scene.moment import Moment
from mrbatch.scene.motion import Motion

WIDTH, HEIGHT, FOCAL, TALL = 48, 24, 50.0, 2.0
METRE = FOCAL / TALL
"""Pixels of a metre on the plane z = 0."""


def above(x: float = 0.0, tall: float = TALL) -> Camera:
    """Looking down on z = 0 from over (x, 0)."""
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[0, 3], pose[2, 3] = x, tall
    k = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]])
    return Camera(WIDTH, HEIGHT, k, np.zeros(8), pose)


def sliding(size: float, speed: float, **switches):
    """A card that goes `speed` metres a frame along x, over the origin at frame 0."""
    card = plane(size, size)
    frames = np.array([-1.0, 1.0])
    places = np.array([[-speed, 0, 0], [speed, 0, 0]])
    turns = np.tile([0.0, 0, 0, 1], (2, 1))
    motion = Motion(frames, places, turns, np.ones((2, 3)))
    return replace(virtual("card", card, 0.4, **switches), motion=motion, still=card)


def moments(first: float, last: float, n: int, camera=lambda time: above()) -> list[Moment]:
    times = [first + (last - first) * (k + 0.5) / n for k in range(n)]
    return [Moment(time, {"": camera(time)}) for time in times]


def swept(width: float, left: float, travel: float) -> np.ndarray:
    """(WIDTH,) share of pixel and exposure that a bar of `width` pixels covers whose left edge goes from
    `left` on by `travel` pixels, at an even speed."""

    def clipped(s):
        # Integral of clip(s, 0, 1).
        return np.where(s < 0, 0.0, np.where(s < 1, s * s / 2, s - 0.5))

    p = np.arange(WIDTH)

    def beyond(edge):
        return (clipped(edge + travel - p) - clipped(edge - p)) / travel

    return beyond(left + width) - beyond(left)


@pytest.mark.slow
@pytest.mark.parametrize("method", [DELTA, IBL, ONE_PASS, TWO_PASS], ids=lambda m: m.name)
@pytest.mark.parametrize("who", ["object", "camera"])
def test_a_moving_card_covers_its_share_of_pixel_and_time(method, who):
    """10 pixels wide, over half a frame at 30 pixels a frame: a trapezium with ramps of 10 pixels."""
    size, speed = 10 / METRE, 30 / METRE
    if who == "object":
        scene, looks = scene_of([sliding(size, speed)]), moments(-0.25, 0.25, 64)
    else:
        scene = scene_of([virtual("card", plane(size, size), 0.4)])
        looks = moments(-0.25, 0.25, 64, lambda time: above(-speed * time))
    found = estimate(method, scene, above(), spp=2048, moments=looks)
    assert found.plan.effects["motion-blur"].state == "needed"
    travel = 15.0
    share = swept(10.0, WIDTH / 2 - 5 - travel / 2, travel)
    rows = found.developed.a[HEIGHT // 2 - 4 : HEIGHT // 2 + 4].mean(axis=0)
    np.testing.assert_allclose(rows, share, atol=0.004)
    # A shutter open for all of the frame, or opened at the frame's own time, would be far off.
    for wrong in (swept(10.0, WIDTH / 2 - 5 - 15, 30.0), swept(10.0, WIDTH / 2 - 5, travel)):
        assert np.abs(rows - wrong).max() > 0.2


def test_a_shadow_on_the_floor_is_averaged_over_the_exposure():
    """Under a panning camera the change on the real floor is the sharp one, swept over the pan."""
    card = virtual("card", plane(0.3, 0.3, centre=(0, 0, 0.02)), 0.2, camera=False)
    scene = scene_of([real("floor", plane(20, 20)), card])
    photo = np.ones((HEIGHT, WIDTH, 3), np.float32)
    speed = 24 / METRE
    looks = moments(-0.25, 0.25, 32, lambda time: above(speed * time))
    sharp = estimate(DELTA, scene, above(), spp=1024, background=photo).developed.D[..., 0]
    found = estimate(DELTA, scene, above(), spp=1024, background=photo, moments=looks).developed
    soft, noise = found.D[..., 0], np.sqrt(found.variance[..., 0])
    at = np.arange(12, WIDTH - 12)
    offsets = 12 * ((np.arange(200) + 0.5) / 200 - 0.5)
    for row in (8, 12, 15):
        expected = np.interp(at[:, None] + offsets, np.arange(WIDTH), sharp[row]).mean(axis=1)
        assert np.all(np.abs(soft[row, at] - expected) < 4.5 * noise[row, at] + 1e-3)
    assert np.abs(soft - sharp).max() > 10 * noise.max()


@pytest.mark.slow
@pytest.mark.parametrize("method", [DELTA, IBL, ONE_PASS, TWO_PASS], ids=lambda m: m.name)
def test_moments_at_which_nothing_has_moved_change_no_bit(method):
    """Looked at sixteen times, each at the same scene: the samples are those of one look."""
    scene = scene_of([sliding(0.3, 0.0), real("floor", plane(20, 20, centre=(0, 0, -0.1)))])
    photo = np.ones((HEIGHT, WIDTH, 3), np.float32)
    options = {"spp": 64, "background": photo, "settings": {"batch": 5}}
    once = estimate(method, scene, above(), **options)
    # Poses that differ by less than kernels see, so that the rule does not leave the moments out.
    looks = moments(-0.25, 0.25, 16, lambda time: above(1e-13 * time))
    often = estimate(method, scene, above(), moments=looks, forced={"motion-blur": "on"}, **options)
    assert often.plan.on("motion-blur") and not once.plan.on("motion-blur")
    for part in ("P", "a", "D", "variance", "samples"):
        assert np.array_equal(getattr(once.developed, part), getattr(often.developed, part))
    still = estimate(method, scene, above(), moments=moments(-0.25, 0.25, 16), **options)
    assert still.plan.effects["motion-blur"].state == "absent" and still.counters == once.counters


def test_what_moves_under_half_a_pixel_is_left_out():
    card = virtual("card", plane(0.3, 0.3), cast_shadow=False)
    for pixels, state in ((0.49, "negligible"), (0.51, "needed")):
        looks = [Moment(t, {"": above(t * pixels / METRE)}) for t in (-0.5, 0.5)]
        found = estimate(DELTA, scene_of([card]), above(), spp=4, moments=looks)
        assert found.plan.effects["motion-blur"].state == state
        assert found.plan.effects["motion-blur"].numbers["largest_px"] == pytest.approx(pixels)


def test_a_caster_that_moves_at_all_is_blurred():
    """Its shadow may go much further than itself."""
    scene = scene_of([sliding(0.3, 1e-4), real("floor", plane(20, 20, centre=(0, 0, -0.1)))])
    plan = estimate(DELTA, scene, above(), spp=4, moments=moments(-0.25, 0.25, 2)).plan
    assert plan.effects["motion-blur"].state == "needed"


def test_tiles_are_those_of_all_moments():
    """The same bits as with every tile done."""
    size, speed = 4 / METRE, 80 / METRE
    scene, looks = scene_of([sliding(size, speed)]), moments(-0.25, 0.25, 16)
    found = estimate(DELTA, scene, above(), spp=32, moments=looks)
    covered = np.nonzero(found.developed.a.any(axis=0))[0]
    assert covered.min() < 6 and covered.max() > WIDTH - 7
    # A picture wide enough holds tiles that nothing reaches.
    assert len(found.plan.tiles[0, ""]) > len(estimate(DELTA, scene, above(), spp=2).plan.tiles[0, ""])


def test_samples_that_cannot_be_shared_are_refused():
    scene, looks = scene_of([sliding(0.3, 1.0)]), moments(-0.25, 0.25, 6)
    with pytest.raises(ValueError, match="shared"):
        estimate(DELTA, scene, above(), spp=16, moments=looks)
