"""Image errors against loops written out in float64, closed forms and a direct call of FLIP."""

from __future__ import annotations

import math

import flip_evaluator
import numpy as np
import pytest

from mrbatch.errors import InputError
from mrbatch.metrics import errors as e


def pair(height=21, width=37, seed=1, noise=0.1):
    rng = np.random.default_rng(seed)
    reference = rng.gamma(1.0, 0.4, (height, width, 3))
    return np.maximum(reference + rng.normal(0, noise, reference.shape), 0.0), reference


def srgb(v):
    v = min(max(v, 0.0), 1.0)
    return 12.92 * v if v <= 0.0031308 else 1.055 * v ** (1 / 2.4) - 0.055


def test_relmse_equals_the_written_out_sum():
    x, r = pair()
    m = sum(r.ravel().tolist()) / r.size
    total = math.fsum((a - b) ** 2 / (b * b + 1e-2 * m * m) for a, b in zip(x.ravel(), r.ravel()))
    got = e.image_errors(x, r, flip=False)
    assert got.frame.relmse == pytest.approx(total / r.size, rel=1e-12)
    assert got.reference_mean == pytest.approx(m, rel=1e-12)


def test_relmse_of_a_scaled_constant_is_its_closed_form():
    r = np.full((20, 20, 3), 0.7)
    got = e.image_errors(1.1 * r, r, flip=False)
    assert got.frame.relmse == pytest.approx(0.01 / 1.01, rel=1e-9)
    assert got.tile.relmse == pytest.approx(0.01 / 1.01, rel=1e-9)
    assert got.frame.rmse == pytest.approx(0.07, rel=1e-9)


def test_equal_pictures_have_no_error_even_where_black():
    r = np.zeros((18, 18, 3))
    got = e.image_errors(r, r)
    assert got.frame.relmse == 0.0 and got.frame.psnr == math.inf
    assert got.frame.ssim == pytest.approx(1.0)
    assert got.frame.flip_hdr == 0.0 and got.frame.flip_ldr == 0.0


def test_trimmed_leaves_out_exactly_a_thousandth():
    x, r = pair(50, 40, noise=0.01)
    x[10, 10] += 50.0
    x[20, 20] += 40.0
    x[30, 30] += 1.0
    per_pixel = np.sort(e.relmse_map(x, r, r.mean()).ravel())
    got = e.image_errors(x, r, flip=False)
    assert got.frame.relmse_trimmed == pytest.approx(per_pixel[:-2].mean(), rel=1e-12)
    assert got.frame.relmse > 50 * got.frame.relmse_trimmed


def test_display_error_goes_through_gain_clip_and_srgb():
    x, r = pair()
    gain = (0.5, 1.0, 2.0)
    total = math.fsum(
        (srgb(g * a) - srgb(g * b)) ** 2
        for px, pr in zip(x.reshape(-1, 3), r.reshape(-1, 3))
        for g, a, b in zip(gain, px, pr)
    )
    mse = total / r.size
    got = e.image_errors(x, r, gain=gain, flip=False).frame
    assert got.rmse_display == pytest.approx(math.sqrt(mse), rel=1e-9)
    assert got.psnr == pytest.approx(10 * math.log10(1 / mse), rel=1e-9)


def test_psnr_of_one_code_is_48_decibels():
    assert e.psnr((1 / 255) ** 2) == pytest.approx(20 * math.log10(255))


def reference_ssim(x, r, wraps):
    """SSIM with a window written out pixel by pixel, mirrored at edges: pixel -1 is pixel 0."""
    window = {}
    for i in range(-5, 6):
        for j in range(-5, 6):
            window[i, j] = math.exp(-(i * i + j * j) / (2 * 1.5**2))
    norm = sum(window.values())
    height, width = x.shape

    def mirrored(i, n):
        while not 0 <= i < n:
            i = -1 - i if i < 0 else 2 * n - 1 - i
        return i

    out = np.zeros((height, width))
    for y in range(height):
        for c in range(width):
            at = []
            for (i, j), w in window.items():
                column = (c + j) % width if wraps else mirrored(c + j, width)
                at.append((w / norm, x[mirrored(y + i, height), column], r[mirrored(y + i, height), column]))
            mx, mr = sum(w * a for w, a, _ in at), sum(w * b for w, _, b in at)
            vx = sum(w * (a - mx) ** 2 for w, a, _ in at)
            vr = sum(w * (b - mr) ** 2 for w, _, b in at)
            cov = sum(w * (a - mx) * (b - mr) for w, a, b in at)
            c1, c2 = 0.01**2, 0.03**2
            out[y, c] = (2 * mx * mr + c1) * (2 * cov + c2) / ((mx**2 + mr**2 + c1) * (vx + vr + c2))
    return out


@pytest.mark.parametrize("wraps", [False, True])
@pytest.mark.parametrize("size", [(13, 17), (4, 3)])
def test_ssim_equals_the_written_out_window(size, wraps):
    rng = np.random.default_rng(3)
    x, r = rng.random(size), rng.random(size)
    got = e.ssim_map(x, r, wraps=wraps)
    np.testing.assert_allclose(got, reference_ssim(x, r, wraps), rtol=0, atol=1e-10)


def test_ssim_of_two_constants_is_its_luminance_term():
    got = e.ssim_map(np.full((12, 12), 0.4), np.full((12, 12), 0.6))
    assert got == pytest.approx((2 * 0.24 + 1e-4) / (0.16 + 0.36 + 1e-4))


def test_flip_is_the_packages_own_figure():
    x, r = pair(40, 48)
    exposures = e.Exposures(-2.0, 3.0, 4)
    got = e.image_errors(x, r, exposures=exposures)
    x32, r32 = x.astype(np.float32), r.astype(np.float32)
    parameters = {"startExposure": -2.0, "stopExposure": 3.0, "numExposures": 4}
    _, mean, _ = flip_evaluator.evaluate(r32, x32, "HDR", applyMagma=False, parameters=parameters)
    assert got.frame.flip_hdr == pytest.approx(mean, rel=1e-5)
    shown = [np.vectorize(srgb)(p).astype(np.float32) for p in (r, x)]
    _, mean, _ = flip_evaluator.evaluate(*shown, "LDR", applyMagma=False)
    assert got.frame.flip_ldr == pytest.approx(mean, rel=1e-5)
    assert got.exposures == exposures


def test_exposures_are_those_that_flip_would_choose():
    _, r = pair(31, 33)
    _, _, used = flip_evaluator.evaluate(r.astype(np.float32), r.astype(np.float32), "HDR", applyMagma=False)
    ours = e.flip_exposures(r)
    # The package's luminance weights have more digits: 1e-3 stops.
    assert ours.start == pytest.approx(used["startExposure"], abs=1e-3)
    assert ours.stop == pytest.approx(used["stopExposure"], abs=1e-3)
    assert ours.count == used["numExposures"]


def test_a_black_or_nearly_black_reference_does_not_end_the_process():
    black = np.zeros((20, 20, 3))
    lit = black.copy()
    lit[3, 4] = 5.0
    assert e.image_errors(lit, black).frame.flip_hdr > 0
    assert e.image_errors(black, lit).frame.flip_hdr > 0


def test_panorama_weights_are_solid_angles():
    """Weights against the exact solid angle of each row, 2 pi / W (cos v0 - cos v1)."""
    height, width = 12, 24
    edges = np.cos(np.pi * np.arange(height + 1) / height)
    exact = np.repeat(((edges[:-1] - edges[1:]) * 2 * np.pi / width)[:, None], width, axis=1)
    got = e.pixel_weights(height, width, "equirectangular")
    np.testing.assert_allclose(got / got.sum(), exact / (4 * np.pi), rtol=1e-12)


def test_panorama_errors_are_weighted_and_crops_know_their_rows():
    x, r = pair(32, 64)
    x[0] += 3.0  # near the zenith: many pixels, little of the sphere
    w = np.array([math.cos(math.pi * (0.5 - (i + 0.5) / 32)) for i in range(32)])
    squared = ((x - r) ** 2).mean(axis=(1, 2))
    got = e.image_errors(x, r, projection="equirectangular", flip=False).frame
    assert got.rmse == pytest.approx(math.sqrt((w * squared).sum() / w.sum()), rel=1e-12)
    assert got.rmse < 0.5 * e.image_errors(x, r, flip=False).frame.rmse
    crop = e.image_errors(
        x[8:20], r[8:20], projection="equirectangular", origin=(0, 8), full_size=(64, 32), flip=False
    )
    part = w[8:20]
    assert crop.frame.rmse == pytest.approx(math.sqrt((part * squared[8:20]).sum() / part.sum()), rel=1e-12)


def test_panorama_does_not_see_its_seam():
    """A panorama turned by any number of columns has the same figures."""
    x, r = pair(32, 64)
    turned = [np.roll(p, 16, axis=1) for p in (x, r)]
    a = e.image_errors(x, r, projection="equirectangular")
    b = e.image_errors(*turned, projection="equirectangular")
    for (name, first), (_, second) in zip(a.frame.items(), b.frame.items()):
        assert second == pytest.approx(first, rel=1e-5), name


def test_worst_tile_is_found_by_absolute_pixel():
    r = np.full((40, 50, 3), 0.5)
    x = r.copy()
    x[35, 49] += 0.3  # alone in the corner tile of 2x8 pixels (columns 48.., rows 32..)
    got = e.image_errors(x, r, flip=False)
    assert got.tile_at["rmse"] == (48, 32)
    assert got.tile.rmse == pytest.approx(math.sqrt(0.3**2 / 16))
    assert got.tile.psnr < got.frame.psnr
    moved = e.image_errors(x, r, flip=False, origin=(10, 5))
    # Absolute (59, 40): the tile from (48, 32), of which 12 x 13 pixels lie in the crop.
    assert moved.tile_at["rmse"] == (48, 32)
    assert moved.tile.rmse == pytest.approx(math.sqrt(0.3**2 / (12 * 13)))


def test_figures_of_the_region_are_those_of_its_pixels():
    x, r = pair()
    region = np.zeros(r.shape[:2], bool)
    region[4:9, 6:20] = True
    got = e.image_errors(x, r, region=region, flip=False)
    assert got.region is not None
    assert got.region.rmse == pytest.approx(math.sqrt(((x - r)[4:9, 6:20] ** 2).mean()), rel=1e-12)
    assert got.region_share == pytest.approx(70 / (21 * 37))
    # The frame's mean stands in the region's relMSE as well, so the regions' sums add up.
    rest = e.image_errors(x, r, region=~region, flip=False)
    assert rest.region is not None
    n = region.sum()
    total = got.region.relmse * n + rest.region.relmse * (region.size - n)
    assert total / region.size == pytest.approx(got.frame.relmse, rel=1e-12)


@pytest.mark.parametrize(
    "change, words",
    [
        (lambda x, r: (x[:-1], r, None), "differ in size"),
        (lambda x, r: (np.where(x == x.max(), np.nan, x), r, None), "NaN or infinite"),
        (lambda x, r: (x, np.where(r == r.max(), np.inf, r), None), "reference are NaN"),
        (lambda x, r: (x, r, np.zeros(r.shape[:2], bool)), "region of interest is empty"),
        (lambda x, r: (x, r, np.ones((3, 3), bool)), "region of interest is 3x3"),
        (lambda x, r: (x[..., :2], r[..., :2], None), "cannot compare"),
    ],
)
def test_bad_pictures_are_clear_errors(change, words):
    x, r, region = change(*pair())
    with pytest.raises(InputError, match=words):
        e.image_errors(x, r, region=region, flip=False)


def test_single_channel_pictures_are_taken():
    x, r = pair()
    flat = e.image_errors(x[..., 0], r[..., 0])
    grey = e.image_errors(np.repeat(x[..., :1], 3, axis=2), np.repeat(r[..., :1], 3, axis=2))
    for (name, a), (_, b) in zip(flat.frame.items(), grey.frame.items()):
        assert a == pytest.approx(b, rel=1e-9), name


def test_one_exposure_alone_is_refused():
    """The package calls any two pictures equal over a single exposure step."""
    x, r = pair()
    with pytest.raises(InputError, match="exposures"):
        e.image_errors(x, r, exposures=e.Exposures(0.0, 0.0, 1))
    same = e.image_errors(1.5 * r, r, exposures=e.Exposures(0.0, 0.0, 2))
    assert same.frame.flip_hdr > 0.05
