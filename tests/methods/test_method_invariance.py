"""What must not change a bit: threads, launches, batches, crops. What must not change a mean: the engine."""

from __future__ import annotations

import numpy as np
import pytest
from held import holds

from mrbatch.film.window import Window
from mrbatch.methods.delta_path_tracing import METHOD as DELTA
from mrbatch.methods.delta_path_tracing import picture_cases
from mrbatch.methods.image_based_lighting import METHOD as IMAGE_BASED
from mrbatch.methods.invariance_cases import (
    HEIGHT,
    WIDTH,
    batches,
    crops,
    same_pictures,
    small_photo,
    small_picture,
    threads_and_launches,
)
from mrbatch.methods.one_pass import METHOD as ONE_PASS
from mrbatch.methods.two_pass import METHOD as TWO_PASS
from mrbatch.metrics.tiles import tile_sums

METHODS = pytest.mark.parametrize("method", [DELTA, IMAGE_BASED, TWO_PASS, ONE_PASS], ids=lambda m: m.name)
PHOTO = small_photo()
render = small_picture


def same(one, other, part=None):
    holds(same_pictures(one, other, part))


@pytest.mark.case("RNG-01")
@METHODS
def test_threads_and_launches_show_in_no_bit(method):
    holds(threads_and_launches(method, 11, ways=((2, 1), (4, 3), (2, 64), (1, 5))))


@pytest.mark.case("MC-04")
@METHODS
def test_batches_show_in_no_bit(method):
    holds(batches(method, 11, sizes=(1, 3, 4, 64)))


@pytest.mark.case("RNG-01", "IO-07")
@METHODS
def test_a_crop_is_the_crop_of_the_whole(method):
    holds(crops(method, 11))


@METHODS
def test_overscan_goes_on_beyond_the_picture(method):
    """Negative pixels are pixels: the middle is the picture, the rim is what a wider camera sees there."""
    whole = render(method)
    wide = render(method, window=Window(-20, -17, WIDTH + 40, HEIGHT + 34))
    inner = (slice(17, 17 + HEIGHT), slice(20, 20 + WIDTH))
    same(wide, whole, inner)
    rim = np.ones(wide.developed.a.shape, bool)
    rim[inner] = False
    assert wide.developed.samples[rim].max() in (0, 8)
    if method is not IMAGE_BASED:
        assert wide.developed.samples[rim].max() == 8
        assert np.abs(wide.developed.D[rim]).max() > 0


@METHODS
def test_seed_frame_and_half_give_other_numbers(method):
    base = render(method)
    for change in ({"seed": 12}, {"frame": 4}):
        assert not np.array_equal(base.developed.P, render(method, **change).developed.P)
    halves = base.developed.halves
    assert not np.array_equal(halves[0], halves[1])
    # Both halves together are the whole.
    assert np.allclose(halves.mean(axis=0)[..., :3], base.developed.P, rtol=1e-6, atol=1e-9)


@pytest.mark.slow
@METHODS
def test_both_engines_agree(method):
    """Other last bits of hits, the same picture: no tile differs by more than its noise."""
    found = [
        render(method, engine=engine, spp=64, seed=k).developed for k, engine in enumerate(("embree", "warp"))
    ]
    one, two = (d.P - d.a[..., None] * PHOTO + d.D for d in found)
    spread = np.sqrt(found[0].variance + found[1].variance).mean(axis=2)
    difference = (one - two).mean(axis=2)
    assert abs(difference.sum() / np.sqrt((spread**2).sum())) < 4
    tile, noise = tile_sums(difference), np.sqrt(tile_sums(spread**2))
    assert np.all(np.abs(tile) <= 5 * noise)
    same_numbers = [render(method, engine=engine, spp=4).developed.P for engine in ("embree", "warp")]
    # The first hits, and with them nearly all paths, are the same.
    assert np.mean(np.isclose(*same_numbers, rtol=1e-3, atol=1e-5)) > 0.95


@pytest.mark.slow
def test_variance_is_that_of_independent_runs():
    """With independent numbers the film's variance is what separate seeds scatter by."""
    runs = [render(DELTA, seed=k, settings={"sampler": "independent"}).developed for k in range(24)]
    pictures = np.array([d.P - d.a[..., None] * PHOTO + d.D for d in runs])
    told = np.mean([d.variance for d in runs], axis=0)
    assert pictures.var(axis=0, ddof=1).mean() == pytest.approx(told.mean(), rel=0.1)


@pytest.mark.case("RNG-01")
def test_an_effect_elsewhere_changes_no_number():
    """A pixel's numbers do not depend on which other effects are on: one split, one not."""
    holds(picture_cases.split_layers(11))
