"""What must not change a bit: threads, launches, batches, crops. What must not change a mean: the engine."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mrbatch.film.window import Window
from mrbatch.methods.delta_path_tracing import METHOD as DELTA
from mrbatch.methods.estimate import estimate
from mrbatch.methods.image_based_lighting import METHOD as IMAGE_BASED
from mrbatch.methods.one_pass import METHOD as ONE_PASS
from mrbatch.methods.two_pass import METHOD as TWO_PASS
from mrbatch.metrics.tiles import tile_sums
from mrbatch.scene.closed_forms import ball, corner, lamp_sky, look_at, real, scene_of, virtual
from mrbatch.scene.mesh import box
from mrbatch.scene.scene import Material

METHODS = pytest.mark.parametrize("method", [DELTA, IMAGE_BASED, TWO_PASS, ONE_PASS], ids=lambda m: m.name)
WIDTH, HEIGHT = 70, 50
FIELDS = ("P", "a", "D", "variance", "samples", "halves")


def scene():
    shiny = replace(
        virtual("metal", ball(0.3, at=(1.4, 0.6, 0.3), subdivisions=3)),
        material=Material("conductor", (0.9, 0.7, 0.3), 0.2),
    )
    objects = [
        *corner(0.5, size=16.0),
        real("box", box((0.4, 0.4, 0.4), centre=(0.8, -0.8, 0.2)), (0.2, 0.5, 0.7)),
        virtual("ball", ball(0.4, at=(0.7, 0.1, 0.4), subdivisions=3), (0.8, 0.4, 0.3)),
        shiny,
    ]
    return scene_of(objects, lamp_sky())


def camera():
    return look_at((3.5, -2.5, 2.0), (0.7, 0, 0.3), width=WIDTH, height=HEIGHT, focal=70)


PHOTO = np.random.default_rng(5).uniform(0, 1, (HEIGHT, WIDTH, 3)).astype(np.float32)


def render(method, **options):
    given = {"spp": 8, "background": PHOTO, "seed": 11, "frame": 3, "engine": "auto", **options}
    return estimate(method, scene(), camera(), **given)


def same(one, other, part=None):
    for name in FIELDS:
        a, b = getattr(one.developed, name), getattr(other.developed, name)
        if part is not None:
            a = a[:, part[0], part[1]] if name == "halves" else a[part]
        assert np.array_equal(a, b), name


@pytest.mark.case("RNG-01")
@METHODS
def test_threads_and_launches_show_in_no_bit(method):
    base = render(method, threads=1)
    assert base.developed.P.any()
    for threads, units in ((2, 1), (4, 3), (2, 64), (1, 5)):
        other = render(method, threads=threads, units_per_launch=units)
        same(base, other)
        assert other.counters == base.counters


@METHODS
def test_batches_show_in_no_bit(method):
    base = render(method, spp=16, settings={"batch": 8})
    for batch in (1, 3, 4, 64):
        same(base, render(method, spp=16, settings={"batch": batch}))


@pytest.mark.case("RNG-01", "IO-07")
@METHODS
@pytest.mark.parametrize("window", [Window(0, 0, 16, 16), Window(13, 9, 31, 27), Window(69, 49, 1, 1)])
def test_a_crop_is_the_crop_of_the_whole(method, window):
    whole = render(method)
    part = render(method, window=window)
    rows = slice(window.y, window.y + window.height)
    columns = slice(window.x, window.x + window.width)
    same(whole, part, (rows, columns))


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
    plain = render(DELTA)
    split = render(DELTA, needs=frozenset({"D_indirect"}))
    same(plain, split)
    parts = split.developed.blocked + split.developed.indirect
    assert np.allclose(parts, split.developed.D, rtol=1e-5, atol=1e-7)
    assert split.developed.blocked.max() <= 0.0
