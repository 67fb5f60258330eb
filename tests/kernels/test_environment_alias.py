"""The alias table and the sample map against exact probabilities: one draws them, the other cannot."""

from __future__ import annotations

import time

import numpy as np
import pytest
import warp as wp

from mrbatch.kernels.environment import EnvironmentData, make_environment
from mrbatch.scene.environment import Environment, load_environment, rotation_from_yaw
from mrbatch.scene.environment_alias import PARTS, alias_table, fill_buckets, whole_parts
from mrbatch.stability.map_statistics import (
    bins_of,
    chi_square,
    directions,
    expected_bins,
    mean_and_error,
    random_map,
    reference,
    sphere_grid,
)

TURN = rotation_from_yaw(0.4) @ np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])


def make_draw(sampler):
    functions = make_environment("bilinear", sampler)
    radiance, pdf, sample, prefetch = functions.radiance, functions.pdf, functions.sample, functions.prefetch

    @wp.kernel(enable_backward=False, module="unique")
    def draw(
        env: EnvironmentData,
        bits: wp.array(dtype=wp.vec2ui),
        d: wp.array(dtype=wp.vec3),
        light: wp.array(dtype=wp.vec3),
        density: wp.array(dtype=float),
        again: wp.array(dtype=float),
    ):
        i = wp.tid()
        prefetch(env, bits[i])
        s = sample(env, bits[i])
        d[i] = s.direction
        light[i] = radiance(env, s.direction)
        density[i] = s.pdf
        again[i] = pdf(env, s.direction)

    return draw


DRAW = {name: make_draw(name) for name in ("cdf", "alias", "sample-map")}


def draw(environment, count, sampler="alias", seed=99):
    """Directions, radiance, density, and density by look-up, of `count` (or given) pairs of 32-bit words."""
    bits = count
    if isinstance(count, int):
        bits = np.random.default_rng(seed).integers(0, 2**32, size=(count, 2))
    bits = wp.array(np.asarray(bits).astype(np.uint32), dtype=wp.vec2ui, device="cpu")
    d, light = (wp.zeros(len(bits), dtype=wp.vec3, device="cpu") for _ in range(2))
    density, again = (wp.zeros(len(bits), dtype=float, device="cpu") for _ in range(2))
    data = environment.upload()
    environment.provide(data, sampler)
    wp.launch(DRAW[sampler], len(bits), [data, bits, d, light, density, again], device="cpu")
    return d.numpy().astype(np.float64), light.numpy(), density.numpy(), again.numpy()


def lamps(height=31, width=64):
    image = random_map(height, width, seed=3)
    image[2] = 0.0
    image[:, 5:9] = 0.0
    image[1, 1] = 30.0
    return image


# --- the alias table -----------------------------------------------------------------------------


def drawn(keep, other):
    """Parts of each cell that the buckets hold."""
    total = keep.copy()
    np.add.at(total, other, PARTS - keep)
    return total


@pytest.mark.parametrize("seed", range(6))
def test_buckets_hold_what_cells_weigh_to_the_last_part(seed):
    random = np.random.default_rng(seed)
    weight = 10.0 ** random.uniform(-12.0, 0.0, 5000) * (random.random(5000) > 0.3)
    weight[:: 1 + seed] += seed * 1e-3
    parts = whole_parts(weight)
    assert parts.sum() == PARTS * weight.size
    assert ((parts > 0) == (weight > 0.0)).all()
    share = weight / weight.sum() * PARTS * weight.size
    # The heaviest cell pays for those that would round to nothing.
    assert np.abs(parts - share)[np.arange(5000) != parts.argmax()].max() <= 1.5
    keep, other = fill_buckets(parts)
    assert keep.min() >= 0 and keep.max() <= PARTS
    assert np.array_equal(drawn(keep, other), parts)


@pytest.mark.parametrize(
    "weight",
    [
        [0.0, 2.0, 0.0, 2.0],
        [1.0],
        [0.0, 0.0],
        [1.0] * 7,
        [0.0, 0.0, 5.0, 0.0],
        [1.0, 2.0, 3.0],
        [1e-300, 1.0],
        [3.0] + [1.0] * 9,
    ],
    ids=["ties", "one", "black", "equal", "one lit", "rising", "nearly nothing", "one above"],
)
def test_small_tables(weight):
    parts = whole_parts(np.array(weight))
    keep, other = fill_buckets(parts)
    assert np.array_equal(drawn(keep, other), parts) and parts.sum() == PARTS * len(weight)
    if not any(weight) or len(set(weight)) == 1:
        assert (keep == PARTS).all()


def test_table_is_fast_enough_to_be_made_for_every_shot():
    """No loop over cells: a map of 1200 x 600 takes a tenth of a second."""
    environment = Environment(np.random.default_rng(0).random((600, 1200, 3)).astype(np.float32))
    tables = environment.tables()
    start = time.process_time()
    table = alias_table(tables)
    assert time.process_time() - start < 2.0
    assert np.array_equal(drawn(table.keep, table.other), table.parts)
    again = alias_table(environment.tables())
    assert all(np.array_equal(getattr(table, n), getattr(again, n)) for n in ("keep", "other", "density"))


@pytest.mark.parametrize("rows", ["centres", "endpoints"])
@pytest.mark.parametrize("sampler", ["cdf", "alias"])
def test_chi_square(rows, sampler):
    environment = Environment(lamps(), rows, TURN)
    d, *_ = draw(environment, 500_000, sampler)
    assert chi_square(bins_of(environment, d, 64, 32), expected_bins(environment, 64, 32)) > 1e-4


@pytest.mark.parametrize("rows", ["centres", "endpoints"])
def test_chi_square_within_cells(rows):
    """Few cells, many bins: uniform in solid angle inside each, whichever part of a bucket it came from."""
    image = random_map(3, 5, seed=1)
    environment = Environment(image, rows, TURN)
    d, *_ = draw(environment, 500_000)
    assert chi_square(bins_of(environment, d, 64, 32), expected_bins(environment, 64, 32)) > 1e-4


@pytest.mark.parametrize("rows", ["centres", "endpoints"])
def test_density_of_a_sample_is_that_of_its_direction(rows):
    d, _, density, again = draw(Environment(lamps(), rows, TURN), 100_000)
    assert (density > 0.0).all()
    assert (np.abs(again / density - 1.0) < 1e-5).mean() > 0.999
    assert np.abs(np.linalg.norm(d, axis=1) - 1.0).max() < 3e-7


def test_light_is_the_maps():
    environment = Environment(lamps(), "centres", TURN)
    _, light, density, _ = draw(environment, 500_000)
    mean, error = mean_and_error(light / density[:, None].astype(np.float64))
    assert (np.abs(mean - environment.fluence()) < 4.0 * error).all()


def test_extreme_numbers_and_black_maps():
    corners = np.array([[a, b] for a in (0, 2**31, 2**32 - 1) for b in (0, 2**31, 2**32 - 1)])
    for image in (lamps(), np.ones((1, 1, 3), np.float32), random_map(2, 1)):
        d, light, density, _ = draw(Environment(image), corners)
        assert np.isfinite(d).all() and (density > 0.0).all() and np.isfinite(light).all()
    d, light, density, _ = draw(Environment(np.zeros((4, 8, 3), np.float32)), corners)
    assert np.isfinite(d).all() and (density == 0.0).all() and (light == 0.0).all()


def test_nothing_is_drawn_where_no_light_is():
    image = np.zeros((16, 32, 3), np.float32)
    image[5:12, 7:] = random_map(7, 25)
    _, light, density, _ = draw(Environment(image), 100_000)
    assert (density > 0.0).all()
    # A tent is 0 only at the rim of its cell.
    assert (light.max(axis=1) > 0.0).mean() > 0.999


def test_tables_are_made_only_where_asked_for():
    environment = Environment(lamps())
    data = environment.upload()
    for sampler in ("cdf", "median-cut"):
        environment.provide(data, sampler)
        assert not data.buckets and not data.stored
    environment.provide(data, "alias")
    buckets = data.buckets
    assert buckets.size == environment.tables().weight.size and not data.stored
    environment.provide(data, "alias")
    assert data.buckets is buckets, "made once"
    environment.provide(data, "sample-map")
    assert data.stored.shape == (31, 64)


# --- the sample map, and what it misses -----------------------------------------------------------


def test_a_stored_direction_is_an_inversion_of_the_cdf():
    """Each number finds the direction that the CDF's sampler gives at the middle of its square."""
    image = random_map(16, 32, seed=7)
    environment = Environment(image, "endpoints", TURN)
    y, x = np.meshgrid(np.arange(16), np.arange(32), indexing="ij")
    middle = np.stack([(2 * y + 1) << 27, (2 * x + 1) << 26], axis=-1).reshape(-1, 2)
    wanted = draw(environment, middle, "cdf")
    random = np.random.default_rng(2)
    anywhere = middle + random.integers(-(1 << 26) + 1, 1 << 26, middle.shape) // [[1, 2]]
    found = draw(environment, anywhere, "sample-map")
    # A middle may lie on the edge of a cell.
    near = (np.abs(found[0] - wanted[0]).max(axis=1) < 1e-5) & (np.abs(found[2] / wanted[2] - 1.0) < 1e-5)
    assert near.mean() > 0.99


@pytest.mark.slow
@pytest.mark.case("TRAP-2a")
def test_sample_map_is_biased_where_the_others_pass():
    """TRAP-2a: chi-square, and the light of discs of 10 degrees, that no number of samples brings right."""
    image = random_map(64, 128, contrast=1.0)
    image[20, 30] = 3e4
    environment = Environment(image)
    expected = expected_bins(environment, 64, 32)
    axes = directions(24, 4).astype(np.float64)
    grid_d, weight = sphere_grid(768, 1536)
    grid_light = reference(image, "centres", grid_d)[:, 1] * weight
    truth = np.array([grid_light[grid_d @ axis > np.cos(np.radians(10.0))].sum() for axis in axes])
    worst = {}
    for sampler in DRAW:
        d, light, density, _ = draw(environment, 1_000_000, sampler)
        fits = chi_square(bins_of(environment, d, 64, 32), expected)
        assert fits < 1e-100 if sampler == "sample-map" else fits > 1e-4
        inside = d @ axes.T > np.cos(np.radians(10.0))
        mean, error = mean_and_error(np.where(inside, (light[:, 1] / density)[:, None], 0.0))
        worst[sampler] = (np.abs(mean - truth) / (error + 2e-3 * truth)).max()
    assert worst["cdf"] < 4.5 and worst["alias"] < 4.5
    assert worst["sample-map"] > 20.0
    assert len(np.unique(d, axis=0)) <= 64 * 128


@pytest.mark.data
def test_real_maps(shared_data):
    """13 to 24 % of the energy of captured maps is in cells that a sample map never draws; none for alias."""
    for name in ("lebombo_1k", "moonless_golf_1k"):
        environment = load_environment(shared_data / "environments" / name / f"{name}.exr")
        expected = expected_bins(environment, 64, 32)
        d, light, density, _ = draw(environment, 600_000)
        assert chi_square(bins_of(environment, d, 64, 32), expected) > 1e-4
        mean, error = mean_and_error(light / density[:, None].astype(np.float64))
        assert (np.abs(mean - environment.fluence()) < 4.0 * error).all()
        y, x = np.meshgrid(np.arange(environment.height), np.arange(environment.width), indexing="ij")
        every = np.stack(
            [(2 * y + 1) * 2**31 // environment.height, (2 * x + 1) * 2**31 // environment.width], axis=-1
        )
        # All that it ever draws.
        d, *_ = draw(environment, every.reshape(-1, 2), "sample-map")
        assert missed(environment, d) > 0.08


def missed(environment, d):
    """Share of the light in cells without any of these directions."""
    t = environment.tables()
    local = d @ environment.world_from_map
    u = 0.5 - np.arctan2(local[:, 1], local[:, 0]) / (2 * np.pi)
    v = np.arccos(np.clip(local[:, 2], -1, 1)) / np.pi
    column = np.floor(u * t.column_scale + t.column_offset).astype(int) % t.weight.shape[1]
    row = np.clip(np.floor(v * t.row_scale + t.row_offset).astype(int), 0, t.weight.shape[0] - 1)
    seen = np.zeros(t.weight.shape, bool)
    seen[row, column] = True
    return t.weight[~seen].sum() / t.weight.sum()


def test_unknown_light_sampler_is_refused():
    with pytest.raises(ValueError, match="median-cut, cdf, alias, sample-map"):
        make_environment("bilinear", "rejection")
