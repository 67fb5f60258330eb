"""What all filters keep: shadows, the mean, texture, objects, coverage, and the photo's bits."""

from __future__ import annotations

import numpy as np
import pytest
from filter_frames import apply, developed, flat_guide, nothing, real_frame, strip

from mrbatch.film.composite import composite
from mrbatch.film.guides import Guides

H, W = 40, 60
LOCAL = ["bilateral", "variance"]
ALL = [*LOCAL, "oidn"]


def printed(picture):
    """The 5 x 5 cross-bilateral as printed, on a plane, where all guides are equal: a Gaussian of 1.5
    pixels over the radiance. Float64, on the inner pixels; the rest is as it was."""
    g = np.exp(-0.5 * (np.arange(-2, 3) / 1.5) ** 2)
    kernel = np.outer(g, g) / g.sum() ** 2
    out = picture.copy()
    view = np.lib.stride_tricks.sliding_window_view(picture, (5, 5), axis=(0, 1))
    out[2:-2, 2:-2] = np.einsum("yxcij,ij->yxc", view, kernel)
    return out


def mean_of(runs, shadow, columns, smooth):
    """Mean and standard error of D in some columns, over independent frames."""
    found = [smooth(real_frame(shadow, noise=0.02, seed=seed))[5:-5, columns, 0].mean() for seed in runs]
    return np.mean(found), np.std(found, ddof=1) / np.sqrt(len(found))


@pytest.mark.case("TRAP-3f")
@pytest.mark.parametrize("kind", ALL)
def test_a_thin_shadow_keeps_its_depth_where_the_printed_filter_loses_it(kind):
    """TRAP-3f: a shadow of 3 pixels, 20 standard errors deep; the 5-tap Gauss keeps 68 % of it."""
    shadow = strip(H, W, 30, 33, -0.4)
    truth = -0.4 * 0.8
    runs = range(8)
    kept, error = mean_of(runs, shadow, slice(30, 33), lambda f: apply(kind, f).D)
    assert abs(kept / truth - 1) < 0.02
    lost, _ = mean_of(runs, shadow, slice(30, 33), lambda f: printed(f[0].D))
    assert lost / truth < 0.75
    assert error < 0.002  # or the first line says nothing


@pytest.mark.case("TRAP-3f")
@pytest.mark.parametrize("kind", ALL)
def test_a_step_of_any_height_errs_by_less_than_two_standard_errors(kind):
    """TRAP-3f: the printed filter is off by .35 of the step at its first pixel."""
    noise = 0.02
    worst, printed_worst = 0.0, 0.0
    for height in (1, 2, 3, 5, 10, 30, 100):
        step = strip(H, W, 30, W, -height * noise)
        first = []
        for smooth in (lambda frame: apply(kind, frame).D, lambda frame: printed(frame[0].D)):
            runs = [smooth(real_frame(step, noise, seed))[5:-5, 28:32, 0].mean(axis=0) for seed in range(6)]
            error = np.abs(np.mean(runs, axis=0) - 0.8 * step[0, 28:32])
            first.append(error.max() / (0.8 * noise))
        worst, printed_worst = max(worst, first[0]), max(printed_worst, first[1])
    assert worst < 2
    assert printed_worst > 20


@pytest.mark.parametrize("kind", ALL)
def test_with_less_noise_the_picture_comes_to_the_unfiltered_one(kind):
    """Light in waves of a few pixels, the worst for a filter: its bias falls as the noise does, or faster, so
    that a picture with many samples comes to the same as without it."""
    y, x = np.mgrid[:H, :W]
    light = -0.5 + 0.2 * np.sin(x) * np.sin(1.7 * y)

    def bias(noise):
        runs = [apply(kind, real_frame(light, noise, seed)).D[..., 0] - 0.8 * light for seed in range(8)]
        chance = np.mean(np.var(runs, axis=0, ddof=1)) / len(runs)
        return np.sqrt(max(0.0, np.mean(np.mean(runs, axis=0) ** 2) - chance))

    assert bias(1e-2) < 0.008
    assert bias(1e-4) < 4e-5
    still = real_frame(light, 0.0)
    np.testing.assert_allclose(apply(kind, still).D, still[0].D, rtol=1e-5)


@pytest.mark.parametrize("kind", ALL)
def test_the_mean_is_kept(kind):
    """To 0.1 %, with noise of many small and few large values and a shadow with edges."""
    light = strip(96, 96, 30, 60, -0.3) - 0.1
    before, after = [], []
    for seed in range(8):
        frame = real_frame(light, 0.08, seed, skew=True)
        before.append(frame[0].D.mean())
        after.append(apply(kind, frame).D.mean())
    assert abs(np.mean(after) / np.mean(before) - 1) < 1e-3


@pytest.mark.parametrize("kind", ALL)
def test_texture_is_neither_blurred_nor_in_the_way(kind):
    """Ink on paper under an even shadow: D / reflectance is smooth, so all of it is averaged."""
    ink = np.where((np.mgrid[:H, :W].sum(0) // 2) % 2, 0.8, 0.04)[..., None]
    frame = real_frame(np.full((H, W), -0.3), noise=0.05, reflectance=ink)
    after = apply(kind, frame).D / ink
    before = frame[0].D / ink
    dark = np.broadcast_to(ink == 0.04, after.shape)
    for part in (dark, ~dark):
        assert np.std(after[part]) < 0.4 * np.std(before[part])
        assert np.mean(after[part]) == pytest.approx(-0.3, abs=0.004)


@pytest.mark.parametrize("kind", LOCAL)
def test_a_pixel_that_shows_several_objects_stays_and_gives_nothing(kind):
    owner = np.where(np.arange(W) == 30, -1, 1)[None]
    frame = real_frame(np.full((H, W), -0.3), 0.1, owner=owner)
    frame[0].D[:, 30] = frame[0].halves[:, :, 30, 4:] = -100.0
    after = apply(kind, frame).D
    assert (after[:, 30] == -100).all()
    assert np.abs(after[:, 26:30] + 0.24).max() < 0.3


@pytest.mark.parametrize("kind", LOCAL)
def test_objects_do_not_mix(kind):
    owner = np.where(np.arange(W) < 30, 1, 2)[None]
    noisy, guides = real_frame(strip(H, W, 30, W, -1.0), 0.3, owner=owner)
    whole = apply(kind, (noisy, guides)).D
    alone = np.where(guides.real.object == 1, 1, 0).astype(np.int32)
    left = Guides(guides.virtual, flat_guide(H, W, owner=alone))
    part = apply(kind, (noisy, left)).D
    assert np.array_equal(whole[:, :30], part[:, :30])
    assert not np.array_equal(whole[:, 29], noisy.D[:, 29])
    assert np.array_equal(part[:, 30:], noisy.D[:, 30:])


@pytest.mark.case("TRAP-3f")
@pytest.mark.parametrize("kind", ALL)
def test_where_nothing_changes_the_photo_keeps_its_bits(kind):
    rng = np.random.default_rng(3)
    light = strip(H, W, 20, 40, -0.4)
    frame, guides = real_frame(light, 0.1, seed=4)
    zero = light == 0
    halves = np.where(zero[None, :, :, None], 0.0, frame.halves)
    frame = developed(halves)
    photo = rng.normal(0.4, 0.5, (H, W, 3)).astype(np.float32)
    after = apply(kind, (frame, guides))
    out = composite(after.P, after.a, photo, after.D)
    assert np.array_equal(out[zero].view(np.uint8), photo.astype(out.dtype)[zero].view(np.uint8))
    assert not np.array_equal(after.D[~zero], frame.D[~zero])
    # Unchanged pixels give nothing either: the shadow next to them keeps its depth.
    assert np.mean(after.D[:, 20]) == pytest.approx(np.mean(after.D[:, 21:39]), rel=0.1)


@pytest.mark.parametrize("kind", ALL)
def test_coverage_stays_and_edges_are_laid_over_it_again(kind):
    """A virtual card with an edge of coverage 0.37 on a plane: P = a light, D = (1 - a) light."""
    a = np.where(np.arange(W) < 30, 1.0, 0.0) + np.where(np.arange(W) == 30, 0.37, 0.0)
    rng = np.random.default_rng(5)
    shine = 0.5 + 0.1 * rng.normal(size=(2, H, W, 1))
    lost = -0.2 + 0.1 * rng.normal(size=(2, H, W, 1))
    cover = np.broadcast_to(a, (2, H, W))[..., None]
    halves = np.concatenate(
        [np.repeat(cover * shine * 0.6, 3, -1), cover, np.repeat((1 - cover) * lost * 0.8, 3, -1)], axis=-1
    )
    frame = developed(halves)
    card = np.where(a > 0, 3, 0)[None]
    real = np.where(a < 1, 1, 0)[None]
    guides = Guides(flat_guide(H, W, card, 0.6), flat_guide(H, W, real, 0.8))
    after = apply(kind, (frame, guides))
    assert np.array_equal(after.a, frame.a)
    assert np.mean(after.P[:, 30]) == pytest.approx(0.37 * 0.6 * 0.5, rel=0.05)
    assert np.std(after.P[:, 30]) < 0.5 * np.std(frame.P[:, 30])
    assert np.mean(after.D[:, 30]) == pytest.approx(-0.63 * 0.8 * 0.2, rel=0.08)
    assert not after.D[:, :30].any() and not after.P[:, 31:].any()


@pytest.mark.parametrize("kind", ALL)
def test_a_part_of_the_change_is_filtered_with_the_same_weights(kind):
    """Direct and indirect light of D still add up to it."""
    frame, guides = real_frame(np.full((H, W), -0.3), 0.05)
    frame = developed(frame.halves, indirect=0.25 * frame.D, blocked=0.75 * frame.D)
    after = apply(kind, (frame, guides))
    # The halves, whose weights differ, are known of the whole alone.
    loose = 1e-5 if kind == "bilateral" else 0.1
    np.testing.assert_allclose(after.indirect, 0.25 * after.D, rtol=loose, atol=1e-7)
    assert np.std(after.indirect) < 0.4 * np.std(frame.indirect)
    np.testing.assert_allclose(after.blocked + after.indirect, after.D, rtol=1e-12)


@pytest.mark.parametrize("kind", LOCAL)
def test_a_bend_and_a_gap_stand_in_the_way_as_another_object_would(kind):
    """Normals that turn by 90 degrees; and a parallel plane 20 pixels behind, of the same object."""
    noisy, guides = real_frame(strip(H, W, 30, W, -1.0), 0.3)
    far = np.arange(W) >= 30
    bend, gap = flat_guide(H, W), flat_guide(H, W)
    bend.normal[:, far] = [1, 0, 0]
    bend.position[:, far] = bend.position[:, far][..., [2, 1, 0]]
    gap.position[:, far, 2] -= 0.02
    apart = apply(kind, (noisy, Guides(guides.virtual, flat_guide(H, W, np.where(far, 2, 1)[None])))).D
    for guide in (bend, gap):
        found = apply(kind, (noisy, Guides(guides.virtual, guide))).D
        np.testing.assert_allclose(found[:, :29], apart[:, :29], atol=0.004)
    assert np.abs(apply(kind, (noisy, guides)).D - apart).max() > 0.04


@pytest.mark.parametrize("kind,reach", [("bilateral", 32), ("variance", 30)])
def test_a_pixel_depends_on_what_is_within_reach_and_no_more(kind, reach):
    """32 = radius + 4 of the strength + 24 of what is given back to the mean + 2 that tell a speck;
    30 = radius + 2 + 24 + 2. Every fiftieth pixel has a speck."""
    frame, guides = real_frame(np.full((100, 120), -0.3), 0.1)
    specks = np.random.default_rng(9).random((2, 100, 120, 1)) < 0.01
    halves = frame.halves.copy()
    halves[..., 4:] += 20.0 * specks
    frame = developed(halves)
    whole = apply(kind, (frame, guides), radius=2).D
    cut = np.s_[8:92, 10:110]
    part = developed(frame.halves[(slice(None), *cut)])
    crop = Guides(nothing(84, 100), flat_guide(84, 100))
    crop.real.position[:] = guides.real.position[cut]
    found = apply(kind, (part, crop), radius=2).D
    inner = np.s_[reach:-reach, reach:-reach]
    assert np.array_equal(found[inner], whole[cut][inner])
    assert not np.array_equal(found[:, 0], whole[cut][:, 0])


@pytest.mark.parametrize("kind", ALL)
def test_threads_do_not_show(kind):
    frame = real_frame(strip(H, W, 20, 40, -0.3), 0.1)
    assert np.array_equal(apply(kind, frame, threads=1).D, apply(kind, frame, threads=3).D)


@pytest.mark.parametrize("kind", ALL)
def test_without_guides_nothing_is_filtered(kind):
    frame, _ = real_frame(np.full((H, W), -0.3), 0.1)
    assert apply(kind, (frame, None)) is frame


@pytest.mark.parametrize("kind", LOCAL)
def test_pixels_without_neighbours_stay_as_they_are(kind):
    """Their weights are those of the pixel alone, so what the filter adds is rounding, and its strength the
    ratio of two rounding errors, of either sign."""
    apart = np.zeros((120, 120), bool)
    apart[::4, ::4] = True
    rng = np.random.default_rng(8)
    shade = rng.uniform(0.01, 1.0, (120, 120, 3))
    frame, guides = real_frame(np.where(apart, -0.3, 0.0), reflectance=shade)
    halves = frame.halves * apart[None, :, :, None]
    halves[..., 4:] += np.array([10.0, -10.0])[:, None, None, None] * apart[..., None]
    frame = developed(halves)
    guides.real.normal[:] = rng.normal(size=(120, 120, 3))
    np.testing.assert_allclose(apply(kind, (frame, guides)).D, frame.D, rtol=1e-5, atol=2e-6)
