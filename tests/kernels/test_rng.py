"""Random numbers against an integer twin in NumPy, SciPy's Sobol sequence, and statistics."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from held import holds
from scipy import stats

from mrbatch.kernels import rng
from mrbatch.stability import random_cases
from mrbatch.stability.random_cases import LAST
from mrbatch.stability.random_draws import KINDS, draw, draw_start, keys, pixel_keys

wp.config.quiet = True


# --- The twin: the same integers, written in NumPy on uint64 and Python's arbitrary integers. ---

M64 = (1 << 64) - 1
M32 = (1 << 32) - 1


def twin_mix(x):
    x = ((x ^ (x >> 30)) * 0xBF58476D1CE4E5B9) & M64
    x = ((x ^ (x >> 27)) * 0x94D049BB133111EB) & M64
    return x ^ (x >> 31)


def twin_key(seed, frame, view, half, x, y):
    golden = 0x9E3779B97F4A7C15
    h = twin_mix(((seed << 32 | frame & M32) + golden) & M64)
    h = twin_mix((h + ((view & M32) << 32 | half & M32) + golden) & M64)
    return twin_mix((h + ((y & M32) << 32 | x & M32) + golden) & M64)


def twin_reverse(x):
    return int(f"{x:032b}"[::-1], 2)


def twin_scramble(x, seed):
    x = twin_reverse(x)
    x ^= x * 0x3D20ADEA & M32
    x = x + seed & M32
    x = x * (seed >> 16 | 1) & M32
    x ^= x * 0x05526C56 & M32
    x ^= x * 0x53A22864 & M32
    return twin_reverse(x)


def twin_directions():
    """Direction numbers of Sobol's second dimension: polynomial x + 1, m = 1 (Joe and Kuo 2008)."""
    m = [1]
    while len(m) < 32:
        m.append(m[-1] ^ 2 * m[-1])
    return [m[k] << (31 - k) for k in range(32)]


def twin_sobol(index):
    y = 0
    for k, v in enumerate(twin_directions()):
        if index >> k & 1:
            y ^= v
    return twin_reverse(index), y


def twin_owen(key, index, dimension):
    h = twin_mix(key + ((dimension & M32) + 1) * 0xD1342543DE82EF95 & M64)
    permuted = twin_scramble(index & M32, h & M32)
    x, y = twin_sobol(permuted)
    other = (h * 0xD1342543DE82EF95 & M64) >> 32
    return twin_scramble(x, h >> 32), twin_scramble(y, other)


def test_twin_has_scipys_sobol_points():
    """SciPy walks the sequence in Gray code; the twin in plain order."""
    reference = stats.qmc.Sobol(2, scramble=False).random(1024)
    gray = [i ^ i >> 1 for i in range(1024)]
    ours = np.array([twin_sobol(i) for i in gray]) / 2.0**32
    assert np.array_equal(ours, reference)


def test_keys_equal_the_twin_overscan_included():
    random = np.random.default_rng(0)
    words = random.integers(-(2**31), 2**31, size=(500, 6))
    words[:, 0] = np.abs(words[:, 0])
    words[:100, 4:] = random.integers(-8, 8, size=(100, 2))
    assert keys(words).tolist() == [twin_key(*map(int, row)) for row in words]


def test_owen_equals_the_twin_to_the_bit():
    random = np.random.default_rng(1)
    key = random.integers(0, 2**63, 400).astype(np.uint64) * np.uint64(2) + np.uint64(1)
    index = np.concatenate([np.arange(200), random.integers(-(2**31), 2**31, 200)])
    dimension = np.concatenate([random.integers(0, 64, 200), random.integers(-(2**31), 2**31, 200)])
    one, two, precise = draw("owen", key, index, dimension)
    twin = np.array([twin_owen(int(k), int(i), int(d)) for k, i, d in zip(key, index, dimension)])
    assert np.array_equal(precise, (twin + 0.5) * 2.0**-32)
    assert np.array_equal(two, ((twin >> 8) * 2.0**-24).astype(np.float32))
    assert np.array_equal(one, two[:, 0])


def test_start_and_vertex_equal_the_twin_to_the_bit():
    random = np.random.default_rng(4)
    key = random.integers(0, 2**63, 300).astype(np.uint64) * np.uint64(2) + np.uint64(1)
    index = np.concatenate([np.arange(150), random.integers(-(2**31), 2**31, 150)])
    got = draw_start("owen", key, index, pixel=3, vertex=40)
    for row, k, i in zip(got.tolist(), key.tolist(), index.tolist()):
        light = twin_owen(k, i, 40)
        h = twin_mix(k + 4 * 0xD1342543DE82EF95 & M64)
        x, y = twin_sobol(i & M32)
        pixel = twin_scramble(x, h >> 32), twin_scramble(y, (h * 0xD1342543DE82EF95 & M64) >> 32)
        h = twin_mix(k + 41 * 0xD1342543DE82EF95 & M64)
        x, y = twin_sobol(twin_scramble(i & M32, h & M32))
        scatter = (
            twin_scramble(x, (h * 0xAF251AF3B0F025B5 & M64) >> 32),
            twin_scramble(y, (h * 0xF1357AEA2E62A9C5 & M64) >> 32),
        )
        assert [tuple(pair) for pair in row] == [pixel, light, scatter, light, scatter]


@pytest.mark.parametrize("kind", ["independent", "cranley-patterson"])
def test_start_of_the_other_samplers_is_their_pairs(kind):
    key = pixel_keys(16, 16).ravel()
    got = (draw_start(kind, key, 5).astype(np.float64) + 0.5) * 2.0**-32
    for column, dimension in ((0, 0), (1, 8), (2, 9), (3, 8), (4, 9)):
        assert np.array_equal(got[:, column], draw(kind, key, 5, dimension)[2])


def test_shifted_points_equal_the_twin_to_the_bit():
    random = np.random.default_rng(6)
    key = random.integers(0, 2**63, 300).astype(np.uint64) * np.uint64(2) + np.uint64(1)
    index = np.concatenate([np.arange(150), random.integers(-(2**31), 2**31, 150)])
    dimension = random.integers(-(2**31), 2**31, 300)
    one, two, precise = draw("cranley-patterson", key, index, dimension)
    twin = []
    for k, i, d in zip(key.tolist(), index.tolist(), dimension.tolist()):
        h = twin_mix(k + ((d & M32) + 1) * 0xD1342543DE82EF95 & M64)
        x, y = twin_sobol(twin_scramble(i & M32, h & M32))
        twin.append((x + (h >> 32) & M32, y + ((h * 0xD1342543DE82EF95 & M64) >> 32) & M32))
    twin = np.array(twin)
    assert np.array_equal(precise, (twin + 0.5) * 2.0**-32)
    assert np.array_equal(two, ((twin >> 8) * 2.0**-24).astype(np.float32))
    assert np.array_equal(one, two[:, 0])
    assert two.max() <= LAST


def test_shifted_points_are_one_set_of_points_on_a_torus():
    """The first 2^k differ from Sobol's by one shift: their differences are multiples of 2^-k, exactly."""
    key = pixel_keys(8, 8).ravel()[:, None]
    for k in (0, 3, 6, 10):
        bits = np.floor(draw("cranley-patterson", key, np.arange(1 << k), 5)[2] * 2.0**32).astype(np.int64)
        step = np.sort((bits - bits[:, :1]) % (1 << 32), axis=1)
        wanted = np.arange(1 << k)[:, None] << (32 - k)
        assert np.array_equal(step, np.broadcast_to(wanted, step.shape))
    shifts = draw("cranley-patterson", pixel_keys(64, 64).ravel(), 0, 5)[2]
    assert stats.kstest(shifts[:, 0], "uniform").pvalue > 1e-4
    assert stats.kstest(shifts[:, 1], "uniform").pvalue > 1e-4


def test_both_pairs_of_a_vertex_are_nets_and_independent_of_each_other():
    """One permutation serves both. A sum of functions of one each, as light and scattered directions are
    added, must have the variance that it has when both permutations differ; so must a path's later part."""
    got = (draw_start("owen", pixel_keys(64, 64).ravel()[:, None], np.arange(16)) + 0.5) * 2.0**-32
    pixel, light, scatter = (got[:, :, n] for n in range(3))
    for points in (light, scatter):
        box = np.floor(points[..., 0] * 4) * 4 + np.floor(points[..., 1] * 4)
        assert np.array_equal(np.sort(box, axis=1), np.broadcast_to(np.arange(16), box.shape))

    def mean_over_samples(points):
        # Discontinuous, so that 16 samples leave noise.
        return (points[..., 0] + points[..., 1] ** 2 < 0.7).mean(axis=1)

    a, b, c = (mean_over_samples(points) for points in (pixel, light, scatter))
    for x, y in ((a, b), (a, c), (b, c)):
        assert abs(np.corrcoef(x, y)[0, 1]) < 4.0 / 64
    # Nor are single numbers tied: each quarter of one with each quarter of another, at one index.
    for x, y in ((pixel, light), (pixel, scatter), (light, scatter)):
        for i, j in ((0, 0), (0, 1), (1, 1)):
            for n in (0, 7):
                count = np.histogram2d(x[:, n, i], y[:, n, j], bins=4, range=[[0, 1], [0, 1]])[0]
                assert stats.chisquare(count.ravel()).pvalue > 1e-5


def test_independent_is_one_number_in_three_forms():
    key = pixel_keys(64, 64).ravel()
    one, two, precise = draw("independent", key, 5, 3)
    assert np.array_equal(one, two[:, 0])
    assert np.array_equal(np.floor(precise * 2.0**24) * 2.0**-24, two)


@pytest.mark.case("RNG-03", "RNG-06", "TRAP-2g")
def test_conversion_never_reaches_one():
    """RNG-03, RNG-06: the naive forms give 1.0, and with it column W."""
    holds(random_cases.largest_number(0))
    x = np.array([0, 255, 256, 2**31, 2**32 - 257, 2**32 - 128, 2**32 - 1], dtype=np.uint32)
    naive = x.astype(np.float32) * np.float32(2.0**-32)
    assert (naive == 1.0).sum() == 2
    shifted = np.float32(LAST) + np.float32(2.0**-25)
    assert shifted == 1.0 and int(shifted * 1024) == 1024, "Cranley-Patterson in floats leaves the table"


@pytest.mark.case("RNG-04")
def test_owen_points_fill_every_elementary_interval():
    holds(random_cases.elementary_boxes(0))


def test_later_blocks_are_nets_too():
    """Progressive rendering takes samples in batches: each aligned block of 2^k is a net."""
    _, two, _ = draw("owen", pixel_keys(4, 4).ravel()[:, None], np.arange(192, 256), 9)
    box = np.floor(two[..., 0] * 8) * 8 + np.floor(two[..., 1] * 8)
    assert np.array_equal(np.sort(box, axis=1), np.broadcast_to(np.arange(64), box.shape))


@pytest.mark.case("TRAP-2g")
def test_cranley_patterson_breaks_the_net():
    """TRAP-2g: shifted Sobol points leave half of the 8x8 cells with another count than one."""
    key = pixel_keys(20, 10).ravel()[:, None]
    wrong = {}
    for kind in KINDS:
        points = draw(kind, key, np.arange(64), 3)[1]
        cell = (np.floor(points * 8) @ [8, 1]).astype(int)
        wrong[kind] = np.mean([(np.bincount(row, minlength=64) != 1).mean() for row in cell])
    assert wrong["owen"] == 0.0
    assert 0.3 < wrong["cranley-patterson"] < 0.6 < wrong["independent"]


@pytest.mark.case("TRAP-2f")
def test_pairs_are_independent_of_each_other():
    """TRAP-2f: shifted copies of one sequence converge to a wrong value in every pixel."""
    holds(random_cases.independent_pairs(0))
    for n in (64, 4096):
        points = stats.qmc.Sobol(2, scramble=False).random(n)
        shift = np.random.default_rng(1).random((2, 64, 1, 2))
        u, v = (points + shift) % 1.0
        printed = ((u[..., 0] < 0.5) & (v[..., 0] < 0.5)).mean(axis=-1)
        assert 0.10 < printed.std() < 0.20, "no number of samples helps the printed form"


@pytest.mark.case("RNG-05")
@pytest.mark.parametrize("kind", KINDS)
def test_padding_of_64_dimensions(kind):
    holds(random_cases.padding(0, kind=kind))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("index", "dimension"), [(0, 0), (1, 0), (37, 5), (4095, 1000003)])
def test_one_sample_is_uniform_over_pixels(kind, index, dimension):
    key = pixel_keys(512, 512, seed=7, x0=-40, y0=-40).ravel()
    _, two, _ = draw(kind, key, index, dimension)
    cell = np.floor(two * 32).astype(int)
    count = np.bincount(cell[:, 0] * 32 + cell[:, 1], minlength=1024)
    assert stats.chisquare(count).pvalue > 1e-4
    # The low bits too: the last 8 of the 24.
    low = (two[:, 1].astype(np.float64) * 2**24).astype(np.int64) & 255
    assert stats.chisquare(np.bincount(low, minlength=256)).pvalue > 1e-4


@pytest.mark.parametrize("kind", KINDS)
def test_two_dimensions_of_one_pixel_are_jointly_uniform(kind):
    key = pixel_keys(512, 512, seed=8).ravel()
    for d in ((0, 1), (3, 11), (8, 16)):
        a, b = (draw(kind, key, 0, v)[0] for v in d)
        count = np.histogram2d(a, b, bins=32, range=[[0, 1], [0, 1]])[0]
        assert stats.chisquare(count.ravel()).pvalue > 1e-4


@pytest.mark.case("RNG-02")
@pytest.mark.parametrize("kind", KINDS)
def test_neighbours_in_pixels_frames_and_views_are_uncorrelated(kind):
    holds(random_cases.neighbours(0, kind=kind))


def test_correlated_neighbours_are_seen(monkeypatch):
    """The half view of a picture moved by a pixel, as a key without x would give it."""
    monkeypatch.setattr(
        random_cases, "pixel_keys", lambda w, h, *a, **more: pixel_keys(w, h, *a)[:, :1].repeat(w, axis=1)
    )
    assert not random_cases.neighbours(0).passed


def test_keys_do_not_collide_and_every_bit_counts():
    blocks = [
        pixel_keys(256, 256, x0=-128, y0=-128, seed=s, frame=f, view=v, half=h)
        for s, f, v, h in [
            (0, 0, 0, 0),
            (1, 0, 0, 0),
            (0, 1, 0, 0),
            (0, 0, 1, 0),
            (0, 0, 0, 1),
            (0, -1, 0, 0),
        ]
    ]
    everything = np.concatenate([b.ravel() for b in blocks])
    assert np.unique(everything).size == everything.size
    random = np.random.default_rng(3)
    words = random.integers(0, 1000, size=(200, 6))
    start = keys(words)
    for column in range(6):
        for bit in (0, 7, 20):
            changed = words.copy()
            changed[:, column] ^= 1 << bit
            flips = np.unpackbits((start ^ keys(changed)).view(np.uint8)).mean()
            assert abs(flips - 0.5) < 4.0 * 0.5 / np.sqrt(200 * 64)


@pytest.mark.case("RNG-07")
@pytest.mark.parametrize("kind", KINDS)
def test_no_repeat_far_out(kind):
    holds(random_cases.far_out(0, kind=kind))


def test_owen_beats_shifts_and_random_numbers_on_a_smooth_function():
    """xy at n = 64 over 1024 pixels: standard error 0.0275 for random numbers, 0.0067 for shifts, about 0.001
    for Owen."""
    key = pixel_keys(32, 32, seed=5).ravel()[:, None]
    rmse = {}
    for kind in KINDS:
        pair = draw(kind, key, np.arange(64), 1)[2]
        error = (pair[..., 0] * pair[..., 1]).mean(axis=1) - 0.25
        rmse[kind] = np.sqrt((error**2).mean())
        assert abs(error.mean()) < 4.0 * error.std() / np.sqrt(error.size), "no bias"
    assert abs(rmse["independent"] / 0.0275 - 1.0) < 0.15
    assert rmse["owen"] < 0.0015
    assert abs(rmse["cranley-patterson"] / 0.0067 - 1.0) < 0.15


def test_unknown_sampler_is_refused():
    with pytest.raises(ValueError, match="owen, independent, cranley-patterson"):
        rng.make_sampler("halton")
