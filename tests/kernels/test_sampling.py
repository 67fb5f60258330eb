"""Samplers against their densities, counted over equal-probability cells or against float64 quadrature."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from scipy import integrate, stats

from mrbatch.kernels.sampling import (
    concentric_disk,
    cosine_hemisphere,
    ggx_visible_normal,
    make_pixel_filter,
    uniform_sphere,
)

N = 200_000
LAST = np.float32(1.0 - 2.0**-24)


@wp.kernel(enable_backward=False, module="unique")
def _sample(
    u: wp.array(dtype=wp.vec2), disk: wp.array(dtype=wp.vec2), cosine: wp.array(dtype=wp.vec3),
    sphere: wp.array(dtype=wp.vec3),
):  # fmt: skip
    i = wp.tid()
    disk[i] = concentric_disk(u[i])
    cosine[i] = cosine_hemisphere(u[i])
    sphere[i] = uniform_sphere(u[i])


@wp.kernel(enable_backward=False, module="unique")
def _visible(
    u: wp.array(dtype=wp.vec2), wo: wp.array(dtype=wp.vec3), alpha: float, out: wp.array(dtype=wp.vec3)
):
    i = wp.tid()
    out[i] = ggx_visible_normal(wo[i], alpha, u[i])


def squares(n: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).random((n, 2), dtype=np.float32)


def corners() -> np.ndarray:
    line = np.array([0.0, 2.0**-24, 0.25, 0.5, 0.75, LAST], dtype=np.float32)
    return np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2).astype(np.float32)


def shapes(u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    out = [wp.zeros(len(u), dtype=t, device="cpu") for t in (wp.vec2, wp.vec3, wp.vec3)]
    wp.launch(_sample, len(u), [wp.array(u, dtype=wp.vec2, device="cpu")], out, device="cpu")
    return tuple(o.numpy().astype(np.float64) for o in out)


def chi_square_p(counts: np.ndarray, expected: np.ndarray) -> float:
    """p-value; cells expecting fewer than 10 are pooled."""
    counts, expected = counts.ravel().astype(float), expected.ravel().astype(float)
    small = expected < 10.0
    counts = np.append(counts[~small], counts[small].sum())
    expected = np.append(expected[~small], expected[small].sum())
    if expected[-1] < 10.0:
        counts[-2] += counts[-1]
        expected[-2] += expected[-1]
        counts, expected = counts[:-1], expected[:-1]
    return float(stats.chi2.sf(((counts - expected) ** 2 / expected).sum(), len(counts) - 1))


def test_discs_and_spheres_have_their_densities():
    disk, cosine, sphere = shapes(squares(N, 1))
    # In these coordinates each density is uniform on the unit square.
    angle = lambda d: np.mod(np.arctan2(d[:, 1], d[:, 0]) / (2 * np.pi), 1.0)  # noqa: E731
    for first, d in (
        ((disk**2).sum(axis=1), disk),
        (cosine[:, 2] ** 2, cosine),
        (0.5 * (1.0 - sphere[:, 2]), sphere),
    ):
        counts, _, _ = np.histogram2d(first, angle(d), bins=(16, 32), range=((0, 1), (0, 1)))
        assert counts.sum() >= N - 2  # what rounds to 1 or over falls outside
        assert chi_square_p(counts, np.full_like(counts, N / counts.size)) > 1e-4


def test_shapes_are_finite_and_unit_at_the_rim_of_the_square():
    disk, cosine, sphere = shapes(corners())
    assert np.isfinite(disk).all() and (np.linalg.norm(disk, axis=1) <= 1.0 + 2.0**-22).all()
    assert (cosine[:, 2] >= 0.0).all()
    for d in (cosine, sphere):
        np.testing.assert_allclose(np.linalg.norm(d, axis=1), 1.0, atol=4e-4 if d is cosine else 1e-6)


def test_concentric_disc_keeps_strata_together():
    # Neighbouring points of the square stay neighbours: distortion is bounded (Shirley and Chiu).
    u = squares(20_000, 2)
    near = np.minimum(u + np.float32(1e-3), LAST)
    moved = np.linalg.norm(shapes(near)[0] - shapes(u)[0], axis=1)
    assert moved.max() < 4.5e-3


def visible_normals(alpha: float, cosine: float, u: np.ndarray) -> np.ndarray:
    wo = np.array([np.sqrt(1.0 - cosine * cosine), 0.0, cosine], dtype=np.float32)
    out = wp.zeros(len(u), dtype=wp.vec3, device="cpu")
    wos = wp.array(np.tile(wo, (len(u), 1)), dtype=wp.vec3, device="cpu")
    wp.launch(_visible, len(u), [wp.array(u, dtype=wp.vec2, device="cpu"), wos, alpha], [out], device="cpu")
    return out.numpy().astype(np.float64)


@pytest.mark.parametrize("alpha", [1e-4, 0.01, 0.3, 1.0])
@pytest.mark.parametrize("cosine", [1.0, 0.5, 0.0872])
def test_visible_normals_chi_square(alpha, cosine):
    """With t = tan(theta) / alpha and q = t^2 / (1 + t^2), D cos d_omega is dq dphi / (2 pi), so that

    the density of visible normals is G1 max(0, o_z + alpha sqrt(q / (1 - q)) o_x cos phi) / (2 pi o_z):
    smooth for every alpha. Expected counts are its midpoint sums in float64.
    """
    m = visible_normals(alpha, cosine, squares(N, 3))
    np.testing.assert_allclose(np.linalg.norm(m, axis=1), 1.0, atol=3e-7)
    t2 = (m[:, 0] ** 2 + m[:, 1] ** 2) / (alpha * m[:, 2]) ** 2
    q = t2 / (1.0 + t2)
    phi = np.mod(np.arctan2(m[:, 1], m[:, 0]) / (2 * np.pi), 1.0)
    cells, fine = (16, 32), 32
    counts, _, _ = np.histogram2d(q, phi, bins=cells, range=((0, 1), (0, 1)))
    assert counts.sum() == N
    # The tail q -> 1 has a square-root pole: substitute q = 1 - s^2 within the sums.
    q_edges = np.linspace(0.0, 1.0, cells[0] + 1)
    s_lo, s_hi = np.sqrt(1.0 - q_edges[1:]), np.sqrt(1.0 - q_edges[:-1])
    s = s_lo[:, None] + (s_hi - s_lo)[:, None] * ((np.arange(fine) + 0.5) / fine)
    weight = 2.0 * s * ((s_hi - s_lo) / fine)[:, None]
    p = 2.0 * np.pi * (np.arange(cells[1] * fine) + 0.5) / (cells[1] * fine)
    sine = np.sqrt(1.0 - cosine * cosine)
    slope = alpha * np.sqrt(1.0 - s * s) / s
    density = np.maximum(0.0, cosine + slope[..., None] * sine * np.cos(p))
    mass = (density * weight[..., None]).sum(axis=1).reshape(cells[0], cells[1], fine).sum(axis=2)
    g1 = 2.0 / (1.0 + np.sqrt(1.0 + alpha**2 * (1.0 / cosine**2 - 1.0)))
    expected = N * g1 * mass / (cosine * cells[1] * fine)
    assert expected.sum() == pytest.approx(N, rel=2e-4)
    assert chi_square_p(counts, expected * (N / expected.sum())) > 1e-4


@pytest.mark.parametrize("alpha", [1e-4, 1.0])
@pytest.mark.parametrize("cosine", [1.0, 1e-4])
def test_visible_normals_stay_finite_at_the_rim(alpha, cosine):
    m = visible_normals(alpha, cosine, corners())
    assert np.isfinite(m).all()
    assert (m[:, 2] >= 0.0).all()


def _offsets(filter_func, u: np.ndarray) -> np.ndarray:
    @wp.kernel(enable_backward=False, module="unique")
    def offsets(u: wp.array(dtype=wp.vec2), out: wp.array(dtype=wp.vec2)):
        i = wp.tid()
        out[i] = filter_func(u[i])

    out = wp.zeros(len(u), dtype=wp.vec2, device="cpu")
    wp.launch(offsets, len(u), [wp.array(u, dtype=wp.vec2, device="cpu")], [out], device="cpu")
    return out.numpy().astype(np.float64)


def _gaussian(x, stddev=0.5):
    return np.exp(-0.5 * (x / stddev) ** 2)


def _window(x, radius=1.5):
    n = 0.5 * (x / radius + 1.0)
    return (
        0.35875 - 0.48829 * np.cos(2 * np.pi * n) + 0.14128 * np.cos(4 * np.pi * n)
        - 0.01168 * np.cos(6 * np.pi * n)
    )  # fmt: skip


@pytest.mark.parametrize(
    ("kind", "radius", "curve"),
    [("box", 0.5, np.ones_like), ("gaussian", 1.5, _gaussian), ("blackman-harris", 1.5, _window)],
)
def test_pixel_filters_invert_their_integral(kind, radius, curve):
    # The float64 integral of the curve up to the offset gives back u.
    line = np.concatenate([[0.0, 1e-6], np.linspace(0.002, 0.998, 199), [LAST]]).astype(np.float32)
    x = _offsets(make_pixel_filter(kind), np.stack([line, line[::-1]], axis=1))
    assert np.isfinite(x).all() and (x >= -radius).all() and (x <= radius).all()
    np.testing.assert_array_equal(x[:, 0], x[::-1, 1])
    total = integrate.quad(lambda v: float(curve(np.float64(v))), -radius, radius)[0]
    back = [integrate.quad(lambda v: float(curve(np.float64(v))), -radius, a)[0] / total for a in x[:, 0]]
    np.testing.assert_allclose(back, line, atol=2e-6)


def test_box_filter_is_the_default_and_half_open():
    assert make_pixel_filter() is make_pixel_filter("box")
    assert make_pixel_filter("gaussian") is make_pixel_filter("gaussian")
    x = _offsets(make_pixel_filter(), np.array([[0.0, LAST]], dtype=np.float32))
    assert x[0, 0] == -0.5 and x[0, 1] < 0.5


def test_pixel_filters_refuse_nonsense():
    with pytest.raises(ValueError, match="unknown pixel filter"):
        make_pixel_filter("lanczos")
    for bad in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(ValueError, match="positive"):
            make_pixel_filter("gaussian", radius=bad)
