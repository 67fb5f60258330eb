"""The environment light: tables, integrals and files against closed forms and plain float64 sums."""

from __future__ import annotations

import numpy as np
import OpenImageIO as oiio
import pytest
from held import holds
from scipy import integrate

from mrbatch.errors import InputError
from mrbatch.scene.environment import Environment, load_environment, rotation_from_yaw
from mrbatch.stability import environment_cases
from mrbatch.stability.map_statistics import random_map, reference, sphere_grid

MAPS = {
    # Peak and mean luminance as the set's own description states them.
    "st_fagans_interior_1k": (1272.0, 0.826),
    "lebombo_1k": (41.3, 0.722),
    "rooitou_park_1k": (65504.0, 0.756),
    "moonless_golf_1k": (10880.0, 0.167),
}


def directions(count, seed=0):
    d = np.random.default_rng(seed).normal(size=(count, 3))
    return d / np.linalg.norm(d, axis=1)[:, None]


# --- Tables ---


@pytest.mark.parametrize("rows", ["centres", "endpoints"])
@pytest.mark.parametrize("interpolation", ["bilinear", "nearest"])
def test_tables_are_a_density(rows, interpolation):
    t = Environment(random_map(13, 22), rows, interpolation=interpolation).tables()
    omega = -np.diff(t.row_z)[:, None] * 2.0 * np.pi / 22
    assert abs((t.pdf[:, :-1] * omega).sum() - 1.0) < 1e-12
    assert np.array_equal(t.pdf[:, 0], t.pdf[:, -1])
    assert t.row_cdf[0] == 0.0 and t.row_cdf[-1] == 1.0
    assert (t.column_cdf[:, 0] == 0.0).all() and (t.column_cdf[:, -1] == 1.0).all()
    assert (np.diff(t.row_cdf) >= 0.0).all() and (np.diff(t.column_cdf) >= 0.0).all()
    assert abs(omega.sum() - 4.0 * np.pi / 22) < 1e-12


def test_weight_is_the_root_mean_square_of_the_cell():
    """By quadrature of the reference over each cell in (u, v), cells of the padded rows included."""
    image = random_map(6, 9)
    t = Environment(image).tables()
    v_edges = np.clip((np.arange(8) - 0.5) / 6, 0, 1)
    x, w = np.polynomial.legendre.leggauss(4)
    x, w = 0.5 * (x + 1), 0.5 * w
    for row in range(7):
        for column in range(9):
            v = v_edges[row] + (v_edges[row + 1] - v_edges[row]) * x
            u = (column - 0.5 + x) / 9
            theta, phi = np.meshgrid(np.pi * v, 2 * np.pi * (0.5 - u), indexing="ij")
            d = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1)
            square = (reference(image, "centres", d.reshape(-1, 3)) ** 2).sum(axis=1).reshape(4, 4)
            mean = w @ square @ w
            omega = (np.cos(np.pi * v_edges[row]) - np.cos(np.pi * v_edges[row + 1])) * 2 * np.pi / 9
            assert abs(t.weight[row, column] / (omega * np.sqrt(mean)) - 1.0) < 1e-9


@pytest.mark.case("ENV-05", "TRAP-2e")
def test_cdf_keeps_a_range_of_1e9():
    """ENV-05, TRAP-2e: stored widths equal the float64 weights; a flat float32 sum loses texels."""
    holds(environment_cases.wide_range(0))
    image = random_map(128, 256, contrast=1.0)
    image[50, 60] = 1e9
    weight = Environment(image, interpolation="nearest").tables().weight
    printed = np.cumsum(weight.astype(np.float32).ravel(), dtype=np.float32)
    assert (np.diff(printed) == 0.0).mean() > 0.3


def test_endpoint_rows_reach_the_poles():
    """The first row of `endpoints` is the pole itself; of `centres` half a row away."""
    image = np.zeros((5, 8, 3), dtype=np.float32)
    image[0] = 1.0
    step = np.pi / 4
    # L falls linearly in theta from the pole to the second row.
    cap = 2 * np.pi * integrate.quad(lambda a: (1 - a / step) * np.sin(a), 0, step)[0]
    assert np.allclose(Environment(image, "endpoints").fluence(), cap, rtol=1e-12)
    low, high = 0.5 * np.pi / 5, 1.5 * np.pi / 5
    tent = integrate.quad(lambda a: (high - a) / (high - low) * np.sin(a), low, high)[0]
    cap = 2 * np.pi * (1 - np.cos(low) + tent)
    assert np.allclose(Environment(image, "centres").fluence(), cap, rtol=1e-12)


# --- Integrals ---


@pytest.mark.case("ENV-04")
@pytest.mark.parametrize("shape", [(1, 1), (1, 2), (5, 3), (1, 7), (40, 90)])
@pytest.mark.parametrize("interpolation", ["bilinear", "nearest"])
def test_constant_map_gives_pi(shape, interpolation):
    """ENV-04: E = pi L to 1e-6, whatever the normal; fluence 4 pi L."""
    environment = Environment(np.full((*shape, 3), 0.7, np.float32), interpolation=interpolation)
    value = float(np.float32(0.7))
    normals = np.concatenate([np.eye(3), -np.eye(3), directions(20)])
    assert np.abs(environment.irradiance(normals) / (np.pi * value) - 1.0).max() < 1e-6
    assert np.abs(environment.fluence() / (4.0 * np.pi * value) - 1.0).max() < 1e-12


@pytest.mark.case("TRAP-2d")
@pytest.mark.parametrize("rows", ["centres", "endpoints"])
@pytest.mark.parametrize("shape", [(2, 2), (5, 3), (33, 50)])
def test_irradiance_and_fluence_equal_a_dense_sum(rows, shape):
    """TRAP-2d: the sum of L dw is kept. The dense sum itself is good to its step squared."""
    image = random_map(*shape, seed=4)
    turn = rotation_from_yaw(0.7) @ np.array([[1.0, 0, 0], [0, 0.6, -0.8], [0, 0.8, 0.6]])
    environment = Environment(image, rows, turn)
    # Whole steps to each kink of the map, so that midpoints converge with the step squared.
    height, width = shape
    step = 2 * height if rows == "centres" else height - 1
    d, weight = sphere_grid(step * (1200 // step), 2 * width * (1200 // width))
    light = reference(image, rows, d) * weight[:, None]
    assert np.allclose(environment.fluence(), light.sum(axis=0), rtol=2e-6)
    normals = np.concatenate([np.eye(3), directions(5)])
    expected = np.stack([(light * np.maximum(d @ (turn.T @ n), 0.0)[:, None]).sum(axis=0) for n in normals])
    assert np.allclose(environment.irradiance(normals), expected, rtol=2e-5)


@pytest.mark.case("ENV-03")
def test_one_texel_at_the_pole():
    """ENV-03: with texels as steps, E = L (pi / W) sin^2(pi / H); bilinear, the tent's own integral."""
    height, width = 16, 24
    image = np.zeros((height, width, 3), dtype=np.float32)
    image[0, 5] = 3.0
    up = np.array([[0.0, 0.0, 1.0]])
    steps = Environment(image, interpolation="nearest").irradiance(up)
    assert np.allclose(steps, 3.0 * np.pi / width * np.sin(np.pi / height) ** 2, rtol=1e-9)
    low, high = 0.5 * np.pi / height, 1.5 * np.pi / height
    flat = 0.5 * np.sin(low) ** 2
    tent = integrate.quad(lambda a: (high - a) / (high - low) * np.sin(a) * np.cos(a), low, high)[0]
    exact = 3.0 * (2.0 * np.pi / width) * (flat + tent)
    assert np.allclose(Environment(image).irradiance(up), exact, rtol=1e-9)


@pytest.mark.parametrize("interpolation", ["bilinear", "nearest"])
@pytest.mark.parametrize("shape", [(1, 1), (3, 5), (64, 128)])
def test_cone_bound_is_never_below_the_light(shape, interpolation):
    """Against a polar quadrature round each cone's axis; cones from a ray to the whole sphere."""
    image = random_map(*shape, seed=6)
    image[0, -1] = 50.0
    turn = rotation_from_yaw(-1.2)
    environment = Environment(image, "centres", turn, interpolation)
    cosine = np.concatenate([np.cos(np.linspace(0.0, np.pi, 60)), [1.0, 0.9999, -1.0]])
    axes = directions(cosine.size, 8)
    axes[:8] = [[0, 0, 1], [0, 0, -1], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [-1, 1e-9, 0], [0, 0, 1]]
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    bound = environment.bound_in_cones(axes, cosine)
    count = 250
    for axis, c, got in zip(axes, cosine, bound):
        z = 1.0 - (np.arange(count) + 0.5) / count * (1.0 - c)
        phi = (np.arange(count) + 0.5) * 2.0 * np.pi / count
        z, phi = (v.ravel() for v in np.meshgrid(z, phi, indexing="ij"))
        side = np.linalg.svd(axis[None])[2][1:]
        sine = np.sqrt(1.0 - z * z)
        d = (
            z[:, None] * axis
            + (sine * np.cos(phi))[:, None] * side[0]
            + (sine * np.sin(phi))[:, None] * side[1]
        )
        local = d @ turn
        if interpolation == "bilinear":
            light = reference(image, "centres", local)
        else:
            v = np.arccos(np.clip(local[:, 2], -1, 1)) / np.pi
            u = 0.5 - np.arctan2(local[:, 1], local[:, 0]) / (2 * np.pi)
            row = np.minimum((v * shape[0]).astype(int), shape[0] - 1)
            light = image[row, np.minimum((u * shape[1]).astype(int), shape[1] - 1)]
        true = light.mean(axis=0, dtype=np.float64) * 2.0 * np.pi * (1.0 - c)
        assert (got >= true * (1.0 - 5e-3)).all()
    sphere = environment.bound_in_cones(axes[:1], np.array([-1.0]))
    assert np.allclose(sphere, environment.fluence(), rtol=1e-6)


def test_most_radiance_and_irradiance_are_never_exceeded():
    random = np.random.default_rng(5)
    for shape in ((7, 9), (64, 128)):
        radiance = random.lognormal(0.0, 2.0, (*shape, 3)).astype(np.float32)
        found = Environment(radiance)
        directions = random.normal(size=(2000, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        # Both peaks lie near the map's brightest texels: look there too.
        row, column = np.unravel_index(np.argsort(radiance.sum(axis=2), axis=None)[-20:], shape)
        theta, phi = np.pi * (row + 0.5) / shape[0], 2 * np.pi * (0.5 - (column + 0.5) / shape[1])
        bright = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=1)
        normals = np.concatenate([directions[:200], bright])
        irradiance = found.irradiance(normals).max(axis=0)
        assert (irradiance <= found.most_irradiance()).all()
        assert (found.most_irradiance() < found.fluence()).all()
        assert (radiance.max(axis=(0, 1)) <= found.most_radiance()).all()
    even = Environment(np.ones((8, 16, 3), np.float32)).most_irradiance()
    assert (np.pi <= even).all() and (even < 1.3 * np.pi).all()


def test_cone_bound_is_useful():
    """On a flat map it is tight; away from a lamp it does not see the lamp."""
    flat = Environment(np.ones((32, 64, 3), dtype=np.float32))
    cosine = np.cos(np.radians([1.0, 10.0, 40.0, 90.0]))
    bound = flat.bound_in_cones(np.tile([[0.6, 0.0, 0.8]], (4, 1)), cosine)[:, 0]
    assert np.allclose(bound, 2.0 * np.pi * (1.0 - cosine), rtol=1e-6)
    image = np.ones((64, 128, 3), dtype=np.float32)
    image[32, 64] = 1e6
    lamp = Environment(image)
    bound = lamp.bound_in_cones(np.array([[-1.0, 0, 0], [1.0, 0, 0]]), np.cos(np.radians([60.0, 1.0])))
    assert np.allclose(bound[0], np.pi, rtol=1e-6)
    assert (bound[1] > 100.0).all()


# --- What is refused ---


@pytest.mark.case("ENV-09")
def test_values_that_are_no_radiance_are_refused_with_places():
    """ENV-09, and TRAP-2d's +inf from a half that was too small."""
    holds(environment_cases.poison(0))
    with pytest.raises(InputError) as caught:
        Environment(np.full((4, 6, 3), np.nan, np.float32))
    assert caught.value.hint and caught.value.exit_code == 3


def test_black_map_is_allowed():
    dark = Environment(np.zeros((4, 8, 3), dtype=np.float32))
    assert dark.black
    assert (dark.irradiance(np.eye(3)) == 0.0).all() and (dark.fluence() == 0.0).all()
    assert (dark.bound_in_cones(np.eye(3), np.zeros(3)) == 0.0).all()
    assert (dark.tables().pdf == 0.0).all()


@pytest.mark.parametrize(
    "change",
    [
        {"world_from_map": np.diag([1.0, -1.0, 1.0])},
        {"world_from_map": 2.0 * np.eye(3)},
        {"world_from_map": np.full((3, 3), np.nan)},
        {"rows": "corners"},
        {"interpolation": "cubic"},
        {"radiance": np.ones((1, 4, 3)), "rows": "endpoints"},
        {"radiance": np.ones((4, 4))},
        {"radiance": np.ones((0, 4, 3))},
    ],
)
def test_wrong_settings_are_refused(change):
    with pytest.raises(InputError):
        Environment(**{"radiance": np.ones((4, 8, 3), dtype=np.float32), **change})


def test_quarter_turns_are_exact():
    assert np.array_equal(rotation_from_yaw(np.pi / 2), [[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    assert np.array_equal(rotation_from_yaw(-np.pi), np.diag([-1.0, -1.0, 1.0]))
    turned = rotation_from_yaw(0.3) @ [1.0, 0.0, 0.0]
    assert np.allclose(turned, [np.cos(0.3), np.sin(0.3), 0.0])


# --- Files ---


def write(path, image, names=("R", "G", "B"), pixel_type="half", window=None):
    spec = oiio.ImageSpec(image.shape[1], image.shape[0], image.shape[2], pixel_type)
    spec.channelnames = names
    if window:
        spec.full_width, spec.full_height = window
    output = oiio.ImageOutput.create(str(path))
    assert output.open(str(path), spec), output.geterror()
    assert output.write_image(np.ascontiguousarray(image))
    output.close()
    return path


def test_exr_and_hdr_are_read(tmp_path):
    image = random_map(8, 16).astype(np.float16).astype(np.float32)
    exr = load_environment(write(tmp_path / "a.exr", image))
    assert np.array_equal(exr.radiance, image) and exr.source.endswith("a.exr")
    hdr = load_environment(write(tmp_path / "a.hdr", image, pixel_type="float"))
    # Shared exponents: 8 bits of the largest channel.
    assert np.abs(hdr.radiance - image).max() < image.max() / 128
    scaled = load_environment(tmp_path / "a.exr", scale=(1.0, 2.0, 0.5), yaw=0.25, rows="endpoints")
    assert np.allclose(scaled.radiance, image * np.array([1.0, 2.0, 0.5]))
    assert np.array_equal(scaled.world_from_map, rotation_from_yaw(0.25)) and scaled.rows == "endpoints"


def test_channels_are_found_by_name(tmp_path):
    image = random_map(4, 8)
    path = write(tmp_path / "a.exr", image[..., [2, 1, 0, 0]], ("B", "G", "R", "A"), "float")
    assert np.array_equal(load_environment(path).radiance, image)
    grey = write(tmp_path / "y.exr", image[..., :1], ("Y",), "float")
    assert np.array_equal(load_environment(grey).radiance, np.repeat(image[..., :1], 3, axis=2))
    with pytest.raises(InputError, match="channels"):
        load_environment(write(tmp_path / "z.exr", image[..., :2], ("Z", "N"), "float"))


@pytest.mark.case("ENV-09")
def test_files_that_cannot_be_used(tmp_path):
    image = random_map(16, 32)
    with pytest.raises(InputError, match="does not exist"):
        load_environment(tmp_path / "none.exr")
    codes = write(tmp_path / "a.png", (image * 255).astype(np.uint8), pixel_type="uint8")
    with pytest.raises(InputError, match="codes, not radiance"):
        load_environment(codes)
    path = write(tmp_path / "a.exr", image)
    with pytest.raises(InputError, match="more than 100"):
        load_environment(path, max_pixels=100)
    (tmp_path / "text.exr").write_text("no picture")
    with pytest.raises(InputError, match="but text"):
        load_environment(tmp_path / "text.exr")
    whole = path.read_bytes()
    for length in range(0, len(whole), 97):
        (tmp_path / "cut.exr").write_bytes(whole[:length])
        with pytest.raises(InputError):
            load_environment(tmp_path / "cut.exr")
    with pytest.raises(InputError, match="data window"):
        load_environment(write(tmp_path / "crop.exr", image, window=(64, 32)))
    image[3, 4, 1] = np.nan
    bad = write(tmp_path / "nan.exr", image)
    with pytest.raises(InputError, match="1 NaN"):
        load_environment(bad)
    repaired = load_environment(bad, repair=True)
    assert repaired.radiance[3, 4, 1] == 0.0 and "1 texels set to 0" in repaired.source


P3 = (0.680, 0.320, 0.265, 0.690, 0.150, 0.060, 0.3127, 0.3290)


def test_named_primaries_are_converted_once(tmp_path):
    """Light of Display P3: its own white stays, its red is more than Rec.709's and clamped in green, blue."""
    image = np.ones((4, 8, 3), np.float32)
    image[0, 0] = (3.0, 0.0, 0.0)
    spec = oiio.ImageSpec(8, 4, 3, "float")
    spec.attribute("chromaticities", oiio.TypeDesc("float[8]"), P3)
    out = oiio.ImageOutput.create("openexr")
    assert out.open(str(tmp_path / "p3.exr"), spec) and out.write_image(image) and out.close()
    environment = load_environment(tmp_path / "p3.exr")
    np.testing.assert_allclose(environment.radiance[1, 1], [1, 1, 1], atol=1e-6)
    # The first column of Rec.709 from P3-D65 (Apple, ICC; SMPTE RP 431-2 primaries).
    np.testing.assert_allclose(environment.radiance[0, 0], [3 * 1.2249401, 0, 0], rtol=1e-6)
    assert "primaries" in environment.notes[0] and "1 texels" in environment.notes[0]
    assert load_environment(write(tmp_path / "plain.exr", image)).notes == ()


def test_channels_that_are_no_light_are_never_read(tmp_path):
    """Sixty further channels of a map cost neither memory nor a refusal."""
    image = np.random.default_rng(3).random((4, 8, 63), dtype=np.float32)
    names = [f"extra.{i:02d}" for i in range(60)] + ["B", "G", "R"]
    got = load_environment(write(tmp_path / "many.exr", image, names, "float")).radiance
    assert np.array_equal(got, image[..., [62, 61, 60]])


@pytest.mark.data
@pytest.mark.parametrize("name", sorted(MAPS))
def test_real_maps_have_the_light_they_are_said_to_have(shared_data, name):
    environment = load_environment(shared_data / "environments" / name / f"{name}.exr")
    peak, mean = MAPS[name]
    assert abs(environment.radiance.max() / peak - 1.0) < 1e-2
    luminance = environment.fluence() @ [0.2126, 0.7152, 0.0722] / (4.0 * np.pi)
    assert abs(luminance - mean) < 1e-3 + 1e-3 * mean
