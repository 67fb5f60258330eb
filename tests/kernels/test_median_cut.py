"""Median-cut sampling of an environment map against exact areas in float64 and statistics."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from mrbatch.scene.environment import Environment, load_environment, rotation_from_yaw
from mrbatch.scene.environment_median_cut import median_cut
from mrbatch.stability import map_draws


def draw(environment, count, seed=99):
    """Directions, light and density of samples, and the density that their directions have."""
    d, light, density = map_draws.draw(environment, count, seed, "median-cut")
    _, again = map_draws.look(environment, d, "median-cut")
    return d.astype(np.float64), light, density, again


def random_map(height, width, seed=0):
    random = np.random.default_rng(seed)
    image = (10.0 ** random.uniform(-2.0, 0.0, (height, width, 3))).astype(np.float32)
    image[height // 3, width // 3] = 60.0
    return image


MAPS = {
    "small": Environment(random_map(9, 14), "centres", rotation_from_yaw(1.0)),
    "end points": Environment(random_map(33, 64, 1), "endpoints"),
    "flat": Environment(np.ones((4, 8, 3), np.float32)),
    "one texel": Environment(np.ones((1, 1, 3), np.float32)),
}


def expected_bins(environment, columns, rows):
    """(rows, columns) probability of equal steps in u and in z: each leaf is uniform in both."""
    leaves = environment.median_cut.leaves.astype(np.float64).reshape(-1, 4)
    z_edges = 1.0 - 2.0 * np.arange(rows + 1) / rows
    u_edges = np.arange(columns + 1) / columns

    def share(low, high, edges_low, edges_high):
        overlap = np.minimum(high[:, None], edges_high) - np.maximum(low[:, None], edges_low)
        return np.clip(overlap, 0, None) / (high - low)[:, None]

    in_z = share(leaves[:, 0] - leaves[:, 1], leaves[:, 0], z_edges[1:], z_edges[:-1])
    left, right = leaves[:, 2], leaves[:, 2] + leaves[:, 3]
    in_u = sum(share(left + turn, right + turn, u_edges[:-1], u_edges[1:]) for turn in (-1, 0, 1))
    return in_z.T @ in_u / len(leaves)


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in MAPS])
def test_chi_square(name):
    environment = MAPS[name]
    d, *_ = draw(environment, 400_000)
    local = d @ environment.world_from_map
    u = 0.5 - np.arctan2(local[:, 1], local[:, 0]) / (2 * np.pi)
    column = np.minimum((u * 64).astype(int), 63)
    row = np.minimum(((1 - local[:, 2]) * 16).astype(int), 31)
    counts = np.bincount(row * 64 + column, minlength=64 * 32)
    expected = expected_bins(environment, 64, 32).ravel() * len(d)
    assert expected.sum() == pytest.approx(len(d), rel=1e-6)
    order = np.argsort(expected)
    pooled = int(np.searchsorted(np.cumsum(expected[order]), 20.0)) + 1
    few = max(pooled, int(np.searchsorted(expected[order], 5.0)))
    e = np.append(expected[order][few:], expected[order][:few].sum())
    c = np.append(counts[order][few:], counts[order][:few].sum())
    e, c = (e, c) if e[-1] > 5 else (e[:-1], c[:-1])
    assert stats.chisquare(c, e * c.sum() / e.sum()).pvalue > 1e-4


@pytest.mark.parametrize("name", [name for name in MAPS])
def test_density_of_a_sample_is_what_its_direction_says(name):
    _, _, density, again = draw(MAPS[name], 100_000)
    # A direction is rounded, so one in some ten thousand lies in the leaf next door.
    assert (np.abs(again / density - 1) < 1e-5).mean() > 0.999
    assert (density > 0).all() and np.isfinite(density).all()


@pytest.mark.parametrize("name", [name for name in MAPS])
def test_mean_of_light_over_density_is_the_light(name):
    _, light, density, _ = draw(MAPS[name], 400_000)
    value = light / density[:, None].astype(np.float64)
    error = value.std(axis=0) / np.sqrt(len(value))
    # A constant map has no scatter: what is left is float32.
    assert (np.abs(value.mean(axis=0) - MAPS[name].fluence()) < 4 * error + 2e-6 * value.mean()).all()


def test_leaves_hold_equal_light_and_cover_the_sphere():
    environment = MAPS["end points"]
    cut = median_cut(environment.tables(), 5)
    leaves = cut.leaves.astype(np.float64).reshape(-1, 4)
    assert (leaves[:, 1] * leaves[:, 3]).sum() == pytest.approx(2.0, rel=1e-5)
    # The weight of each leaf by brute force: many points of its rectangle, the cell each falls into.
    t = environment.tables()
    omega = -np.diff(t.row_z) * 2 * np.pi / t.weight.shape[1]
    density = t.weight / omega[:, None]
    s = (np.arange(64) + 0.5) / 64
    mass = []
    for z0, dz, u0, du in leaves:
        row = np.searchsorted(-t.row_z, -(z0 - s * dz)) - 1
        column = np.floor((u0 + s * du) * t.column_scale + t.column_offset).astype(int)
        picked = density[np.clip(row, 0, len(omega) - 1)[:, None], column[None] % t.weight.shape[1]]
        mass.append(picked.mean() * dz * du * 2 * np.pi)
    mass = np.array(mass) / t.weight.sum() * len(leaves)
    assert abs(mass.mean() - 1) < 0.01 and np.median(np.abs(mass - 1)) < 0.05


def test_black_map_is_never_drawn():
    _, light, density, again = draw(Environment(np.zeros((4, 8, 3), np.float32)), 1000)
    assert (density == 0).all() and (again == 0).all() and (light == 0).all()


def test_black_rows_beyond_all_light_are_not_drawn():
    image = np.zeros((64, 128, 3), np.float32)
    image[20:24, 40:44] = 5.0
    environment = Environment(image, interpolation="nearest")
    cut = environment.median_cut.leaves.reshape(-1, 4)
    z = np.cos(np.pi * np.array([20, 24]) / 64)
    assert cut[:, 0].max() <= z[0] + 1e-5 and (cut[:, 0] - cut[:, 1]).min() >= z[1] - 1e-5
    assert cut[:, 2].min() >= 40 / 128 - 1e-5 and (cut[:, 2] + cut[:, 3]).max() <= 44 / 128 + 1e-5


def test_small_lamps_in_the_dark_go_to_the_other_sampler():
    assert MAPS["flat"].light_sampler == "median-cut"
    dark = np.full((256, 512, 3), 1e-3, np.float32)
    random = np.random.default_rng(5)
    for row, column in zip(random.integers(20, 236, 60), random.integers(0, 512, 60)):
        dark[row, column] = 10.0 ** random.uniform(0, 4)
    environment = Environment(dark)
    assert environment.light_sampler == "cdf"


def test_excess_is_the_ratio_of_second_moments():
    """`excess` against samples: E[(L / pdf)^2], L squared being the sum of squares of the channels.

    The map has more cells than leaves, as real ones do: within a cell `excess` takes L as constant.
    """
    environment = Environment(random_map(257, 512, 2))
    _, light, density, _ = draw(environment, 400_000)
    moment = ((light.astype(np.float64) ** 2).sum(axis=1) / density.astype(np.float64) ** 2).mean()
    cdf = environment.tables().weight.sum() ** 2
    assert moment / cdf == pytest.approx(environment.median_cut.excess, rel=0.05)


@pytest.mark.data
def test_real_maps(shared_data):
    for name, sampler in (("lebombo_1k", "median-cut"), ("moonless_golf_1k", "cdf")):
        environment = load_environment(shared_data / "environments" / name / f"{name}.exr")
        assert environment.light_sampler == sampler
        _, light, density, _ = draw(environment, 400_000)
        value = light / density[:, None].astype(np.float64)
        error = value.std(axis=0) / np.sqrt(len(value))
        assert (np.abs(value.mean(axis=0) - environment.fluence()) < 4 * error).all()
