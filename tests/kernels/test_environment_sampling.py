"""Look-ups and samples of an environment map against the house formula in float64 and statistics."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from held import holds

from mrbatch.kernels.environment import make_environment
from mrbatch.scene.environment import Environment, load_environment, rotation_from_yaw
from mrbatch.stability import environment_cases
from mrbatch.stability.environment_cases import SHAPES, SPECIAL
from mrbatch.stability.map_draws import draw, lamp, look
from mrbatch.stability.map_statistics import (
    bins_of,
    chi_square,
    directions,
    expected_bins,
    house_uv,
    mean_and_error,
    random_map,
    reference,
    sphere_grid,
)

wp.config.quiet = True
MAPS = ["st_fagans_interior_1k", "lebombo_1k", "rooitou_park_1k", "moonless_golf_1k"]


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("rows", ["centres", "endpoints"])
def test_radiance_follows_the_convention(shape, rows):
    if rows == "endpoints" and shape[0] < 2:
        pytest.skip("a map of one row has no end points")
    image = random_map(*shape)
    d = np.concatenate([directions(20000), SPECIAL.astype(np.float32)])
    light, _ = look(Environment(image, rows), d)
    # Directions are float32: their u, v are good to 2e-7, and a cell spans 1 / size.
    assert np.abs(light - reference(image, rows, d)).max() < 1e-6 * max(shape) + 1e-6


def test_nearest_follows_the_convention():
    image = random_map(9, 14)
    d = directions(20000)
    light, _ = look(Environment(image, interpolation="nearest"), d)
    u, v = house_uv(d)
    expected = image[np.floor(v * 9).astype(int), np.floor(u * 14).astype(int)]
    assert (light == expected).all(axis=1).mean() > 0.999, "only directions on an edge may differ"


@pytest.mark.case("ENV-04", "TRAP-2d")
@pytest.mark.parametrize("interpolation", ["bilinear", "nearest"])
@pytest.mark.parametrize("shape", SHAPES)
def test_constant_map_has_constant_density(shape, interpolation):
    """ENV-04: p = 1 / (4 pi) to 1e-6, at the poles too (TRAP-2d: without sine 326 times too dense)."""
    holds(environment_cases.odd_sizes(0, shapes=[shape], interpolations=(interpolation,)))


@pytest.mark.case("TRAP-2d")
def test_density_without_sine_fails_at_the_poles():
    """TRAP-2d, printed: p = p_uv of texels weighted by luminance alone."""
    height = 512
    v = (np.arange(height) + 0.5) / height
    printed = 1.0 / (2.0 * np.pi**2 * np.sin(np.pi * v)) * 4.0 * np.pi
    assert 150.0 < printed[0] < 450.0
    _, density = look(Environment(np.ones((height, 1, 3), dtype=np.float32)), [[np.sin(np.pi * v[0]), 0, 1]])
    assert abs(density[0] * 4.0 * np.pi - 1.0) < 1e-6


@pytest.mark.parametrize("rows", ["centres", "endpoints"])
@pytest.mark.parametrize("interpolation", ["bilinear", "nearest"])
def test_sample_agrees_with_look_up_and_density(rows, interpolation):
    """The radiance and density of a sample are those of its direction, but on edges of cells."""
    turn = rotation_from_yaw(0.4) @ np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])
    environment = Environment(random_map(17, 40), rows, turn, interpolation)
    d, light, density = draw(environment, 50000)
    seen, again = look(environment, d)
    assert (np.abs(again / density - 1.0) < 1e-5).mean() > 0.999
    assert (np.abs(seen - light).max(axis=1) < 1e-4).mean() > 0.999
    uniform = look(environment, directions(200000, 5))[1]
    mean, error = mean_and_error(uniform.astype(np.float64) * 4.0 * np.pi)
    assert abs(mean - 1.0) < 4.0 * error


@pytest.mark.parametrize("rows", ["centres", "endpoints"])
@pytest.mark.parametrize(
    ("shape", "interpolation"), [((5, 3), "bilinear"), ((31, 64), "bilinear"), ((20, 48), "nearest")]
)
def test_chi_square(shape, rows, interpolation):
    image = random_map(*shape, seed=3)
    image[2] = 0.0
    image[1, 1] = 30.0
    environment = Environment(image, rows, rotation_from_yaw(1.0), interpolation)
    d, _, _ = draw(environment, 500000)
    assert chi_square(bins_of(environment, d, 64, 32), expected_bins(environment, 64, 32)) > 1e-4


@pytest.mark.data
@pytest.mark.parametrize("name", MAPS)
def test_chi_square_and_light_of_real_maps(shared_data, name):
    environment = load_environment(shared_data / "environments" / name / f"{name}.exr")
    d, light, density = draw(environment, 600_000)
    assert chi_square(bins_of(environment, d, 64, 32), expected_bins(environment, 64, 32)) > 1e-4
    # Two closed sums of the light: by the sampler, and by texels in float64.
    mean, error = mean_and_error(light / density[:, None].astype(np.float64))
    assert (np.abs(mean - environment.fluence()) < 4.0 * error).all()
    # TRAP-2a: the light in discs of 5 degrees, anywhere.
    axes = directions(24, 4).astype(np.float64)
    inside = (d.astype(np.float64) @ axes.T) > np.cos(np.radians(5.0))
    value = light[:, 1] / density
    grid_d, grid_weight = sphere_grid(768, 1536)
    truth_light = reference(environment.radiance, "centres", grid_d)[:, 1] * grid_weight
    for index in range(24):
        sample = np.where(inside[:, index], value, 0.0)
        mean, error = mean_and_error(sample)
        truth = truth_light[(grid_d @ axes[index]) > np.cos(np.radians(5.0))].sum()
        # The grid puts the rim of a disc within a third of its own steps.
        assert abs(mean - truth) < 4.5 * error + 0.01 * truth


@pytest.mark.case("TRAP-2a")
def test_stored_sample_map_never_draws_most_texels():
    """TRAP-2a, printed: W x H inverted points are a fixed set. Ours reaches every lit bin."""
    image = random_map(64, 128, contrast=1.0)
    image[20, 30] = 3e5
    weight = image.mean(axis=2) * np.sin(np.pi * (np.arange(64) + 0.5) / 64)[:, None]
    row_cdf = np.cumsum(weight.sum(axis=1)) / weight.sum()
    column_cdf = np.cumsum(weight, axis=1) / weight.sum(axis=1, keepdims=True)
    row = np.searchsorted(row_cdf, (np.arange(64) + 0.5) / 64)
    stored = {(r, c) for r in row for c in np.searchsorted(column_cdf[r], (np.arange(128) + 0.5) / 128)}
    assert len(stored) < 0.5 * image.shape[0] * image.shape[1]
    rows_drawn = np.unique(row).size
    assert rows_drawn < 32
    environment = Environment(image)
    d, light, density = draw(environment, 1_000_000)
    away = d[:, 2] < -0.5
    mean, error = mean_and_error(np.where(away, light[:, 1] / density, 0.0))
    grid_d, grid_weight = sphere_grid(1024, 1024)
    truth = (reference(image, "centres", grid_d)[:, 1] * grid_weight)[grid_d[:, 2] < -0.5].sum()
    assert abs(mean - truth) < 4.0 * error + 1e-3 * truth
    assert error < 0.05 * truth


@pytest.mark.case("TRAP-2b")
def test_samples_lie_on_lamps_beside_the_seam():
    """TRAP-2b: a linear read of stored directions invents some between lamps at azimuth +-179 deg."""
    holds(environment_cases.seam(0))
    stored = np.array([179.5, -179.5])
    assert abs(stored.mean()) < 1.0, "printed: half way between the two is the other side of the world"


@pytest.mark.case("ENV-02")
def test_no_draw_where_no_light_is():
    holds(environment_cases.black_parts(0))


def test_density_is_positive_wherever_light_is():
    """Any channel counts: a blue lamp has little luminance, a lamp's tent reaches over three texels."""
    image = lamp(16, 32, 7, 0, (0.0, 0.0, 5.0)) + lamp(16, 32, 0, 9, (0.0, 2.0, 0.0))
    for rows in ("centres", "endpoints"):
        light, density = look(Environment(image, rows), directions(200000))
        assert (density[light.max(axis=1) > 0.0] > 0.0).all()


@pytest.mark.case("ENV-01")
@pytest.mark.parametrize("normal", [(0, 0, 1), (1, 0, 0), (0.6, 0, 0.8)])
def test_two_strong_texels(normal):
    holds(environment_cases.strong_texels(0, normals=(normal,)))


@pytest.mark.case("ENV-06", "TRAP-2c")
def test_lamp_on_black_by_light_samples_alone():
    """ENV-06 and TRAP-2c: bilinear radiance with a density constant in the texel loses 43.75 %."""
    holds(environment_cases.lamp_on_black(0))
    height, width, row = 65, 128, 32
    u = np.random.default_rng(0).random((200000, 2))
    theta = (row + u[:, 0]) * np.pi / height
    phi = 2 * np.pi * (0.5 - (40 + u[:, 1]) / width)
    inside = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=1)
    printed = reference(lamp(height, width, row, 40, 7.0), "centres", inside)[:, 0].mean() / 7.0
    assert abs(printed - 0.5625) < 0.005


@pytest.mark.case("ENV-07")
@pytest.mark.parametrize("degrees", [0.0, 90.0, 37.3, -180.0])
def test_turned_map_is_a_turned_world(degrees):
    holds(environment_cases.turned(0, degrees=(degrees,)))


@pytest.mark.case("ENV-08")
def test_lamp_is_where_the_house_formula_says():
    holds(environment_cases.lamp_direction(0))


def test_inversion_equals_a_search():
    """Guides shorten the search and change nothing: `searchsorted` on the same tables."""
    image = random_map(40, 90, contrast=6.0)
    image[::3] = 0.0
    image[:, 10:30] = 0.0
    environment = Environment(image, "endpoints")
    t = environment.tables()
    random = np.random.default_rng(2)
    u = random.random((100000, 2))
    bins = t.column_guide.shape[1] - 1
    u[:1000] = random.integers(0, bins, (1000, 2)) / bins
    u[1000:2000, 0] = t.row_cdf[random.integers(0, t.row_cdf.size - 1, 1000)]
    # Fractions of 32 bits stand for the middle of their interval.
    u = (np.floor(np.minimum(u, 1.0 - 2.0**-53) * 2.0**32) + 0.5) * 2.0**-32
    row = np.searchsorted(t.row_cdf, u[:, 0], side="right") - 1
    expected = np.empty(len(u))
    for r in np.unique(row):
        here = row == r
        column = np.searchsorted(t.column_cdf[r], u[here, 1], side="right") - 1
        expected[here] = t.pdf[r, column]
    assert np.allclose(draw(environment, u)[2], expected, rtol=1e-6, atol=0.0)


def test_unknown_interpolation_is_refused():
    with pytest.raises(ValueError, match="bilinear or nearest"):
        make_environment("cubic")
