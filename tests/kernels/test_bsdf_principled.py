"""The principled surface: energy, Fresnel, reciprocity and sampling against closed forms and quadrature."""

from __future__ import annotations

import math

import numpy as np
import pytest
from held import holds

from mrbatch.kernels.bsdf import make_bsdf
from mrbatch.kernels.ggx_albedo import averages, load_table, make_table, quadrature
from mrbatch.stability import scattering_cases
from mrbatch.stability.scattering_draws import evaluated, kernels, principled, sampled, squares, surface, view
from mrbatch.stability.scattering_twins import twin, twin_albedo

ALPHAS = (0.02, 0.1, 0.3, 0.7, 1.0)


# --- the table ---------------------------------------------------------------------------------


def test_stored_table_is_what_its_script_makes():
    stored = load_table()
    rows = np.array([0, 1, 7, 16, 31])
    nodes = np.maximum((rows / 31) ** 2, 1e-4)
    for i, mu in zip(rows, nodes, strict=True):
        for j, alpha in zip(rows, nodes, strict=True):
            np.testing.assert_allclose(stored[i, j], quadrature(mu, alpha), atol=1e-6)
    assert make_table(2).shape == (2, 2, 2)


def test_quadrature_agrees_with_one_made_elsewhere():
    """A + B is the albedo of a lobe with F = 1; at alpha 1 and normal incidence it is 1 - ln 2."""
    assert sum(quadrature(1.0, 1.0, 1024)) == pytest.approx(1.0 - math.log(2.0), abs=1e-5)
    for alpha, degrees in ((0.2, 30.0), (0.5, 70.0), (1.0, 85.0)):
        wo = view(degrees)
        assert sum(quadrature(float(wo[2]), alpha)) == pytest.approx(twin_albedo(alpha, wo)[0], abs=2e-4)


def test_averages_are_those_of_the_table():
    """Against a dense sum of the interpolated table, and against the integral of the lobe itself."""
    table, side = load_table().astype(np.float64), 32
    t = (np.arange(20000) + 0.5) / 20000 * (side - 1)
    i = np.minimum(t.astype(int), side - 2)
    f = (t - i)[:, None, None]
    dense = (table[i] * (1 - f) + table[i + 1] * f) * (4.0 * (t / (side - 1)) ** 3)[:, None, None]
    np.testing.assert_allclose(averages(load_table()), dense.mean(axis=0), atol=1e-6)
    alpha = (21 / 31) ** 2
    mu = (np.arange(64) + 0.5) / 64
    exact = np.mean([2.0 * m * sum(quadrature(m, alpha, 128)) for m in mu])
    assert averages(load_table())[21].sum() == pytest.approx(exact, abs=1e-3)


# --- energy ------------------------------------------------------------------------------------


@pytest.mark.case("BSDF-03")
@pytest.mark.parametrize("alpha", ALPHAS)
def test_bsdf_03_white_returns_all(alpha):
    """BSDF-03: the furnace, 0.5 %; the single-scattering metal beside it loses up to 60 %."""
    views, kinds = (0.0, 45.0, 75.0, 85.0), (0.0, 0.5, 1.0)
    holds(scattering_cases.white_metal(21, alphas=(alpha,), degrees=views, metalness=kinds))


def test_glossy_base_of_the_exchange_format_would_gain_energy():
    """The form that glTF prints, base (1 - F(wo.m)) under the lobe, at 85 degrees: over 1, ours is 1."""
    wo, alpha, f0 = view(85.0), 0.1, 0.04
    u = np.random.default_rng(3).random((400_000, 2))
    r, phi = np.sqrt(u[:, 0]), 2 * np.pi * u[:, 1]
    wi = np.stack([r * np.cos(phi), r * np.sin(phi), np.sqrt(1 - u[:, 0])], axis=1)
    h = (wo + wi) / np.linalg.norm(wo + wi, axis=1, keepdims=True)
    base = 1.0 - (f0 + (1 - f0) * (1 - h @ wo) ** 5)
    a, b = quadrature(float(wo[2]), alpha)
    assert base.mean() + f0 * a + b > 1.15


@pytest.mark.parametrize("alpha", [0.1, 0.5, 1.0])
def test_coloured_metal_against_its_series(alpha):
    """Light leaves after one microfacet, or two, ...: <F> each time, 1 - <E1> to go on."""
    base = np.array([0.9, 0.5, 0.1])
    wo = view(40.0)
    _, weight, _ = sampled(principled(alpha, base=base, metalness=1.0), wo, squares(400_000, 22))
    a, b = quadrature(float(wo[2]), alpha)
    mean = 1.0 - 2.0 * np.mean([m * sum(quadrature(m, alpha, 128)) for m in (np.arange(64) + 0.5) / 64])
    f = base + (1 - base) / 21.0
    expected = base * a + b + (1 - a - b) * f * f * (1 - mean) / (1 - f * mean)
    np.testing.assert_allclose(weight.mean(axis=0), expected, atol=0.004)


def test_nothing_is_made_of_nothing():
    """A black base under the interface returns the interface's share, black metal its edge's."""
    for alpha in (0.1, 0.6):
        wo = view(60.0)
        a, b = quadrature(float(wo[2]), alpha)
        _, weight, _ = sampled(principled(alpha, base=(0, 0, 0)), wo, squares(400_000, 23))
        assert weight[:, 0].mean() == pytest.approx(0.04 * a + b, abs=0.003)


# --- Fresnel -----------------------------------------------------------------------------------


def fresnel(cosine, base, edge):
    """F82-tint in float64, as its authors print it."""
    c, edge_c = cosine, 1.0 / 7.0
    schlick = lambda x: base + (1 - base) * (1 - x) ** 5  # noqa: E731
    return schlick(c) - c * (1 - c) ** 6 * schlick(edge_c) * (1 - edge) / (edge_c * (1 - edge_c) ** 6)


@pytest.mark.parametrize("degrees", [0.0, 30.0, 60.0, math.degrees(math.acos(1 / 7)), 88.0])
def test_fresnel_of_metal(degrees):
    """In the mirror direction of a nearly smooth metal, f cos is F times the white lobe."""
    base, edge = np.array([0.9, 0.4, 0.1]), np.array([0.5, 0.9, 1.0])
    wo = view(degrees)
    wi = wo * [-1, -1, 1]
    found = evaluated(principled(0.02, base=base, edge=edge, metalness=1.0), wo, wi)[0][0]
    lobe, _ = twin(0.02, wo, wi)
    np.testing.assert_allclose(found / lobe, fresnel(wo[2], base, edge), rtol=1e-4, atol=1e-4)
    if 80 < degrees < 83:
        schlick = base + (1 - base) * (6 / 7) ** 5
        np.testing.assert_allclose(found / lobe, schlick * edge, rtol=1e-4)


# --- reciprocity and sampling ------------------------------------------------------------------

SURFACES = [
    principled(0.15, base=(0.8, 0.3, 0.1)),
    principled(0.5, base=(0.8, 0.3, 0.1), metalness=0.4, edge=(0.7, 0.8, 0.9)),
    principled(0.9, base=(0.9, 0.6, 0.2), metalness=1.0, f0=0.1),
]


@pytest.mark.case("BSDF-04")
@pytest.mark.parametrize("s", SURFACES, ids=["plastic", "mixed", "metal"])
def test_reciprocity(s):
    holds(scattering_cases.swapped(s, 0, 2e-5))


@pytest.mark.parametrize("s", SURFACES, ids=["plastic", "mixed", "metal"])
@pytest.mark.parametrize("degrees", [0.0, 60.0, 89.0])
def test_weight_is_evaluate_over_pdf(s, degrees):
    wo = view(degrees)
    wi, weight, pdf = sampled(s, wo, squares(20_000, 8))
    f, p = evaluated(s, wo, wi)
    up = pdf > 0.0
    np.testing.assert_array_equal(p, pdf)
    np.testing.assert_allclose(weight[up], f[up] / p[up, None], rtol=2e-6)
    assert np.isfinite(weight).all() and weight.min() >= 0.0 and weight.max() < 12.0


@pytest.mark.parametrize("s", SURFACES, ids=["plastic", "mixed", "metal"])
@pytest.mark.parametrize("degrees", [0.0, 50.0, 80.0])
def test_samples_follow_the_density(s, degrees):
    """Moments of samples against integrals over the density: share above, mean direction, mean square."""
    n, wo = 400_000, view(degrees)
    wi, _, pdf = sampled(s, wo, squares(n, 31))
    up = pdf > 0.0
    side = 1200
    z = (np.arange(side) + 0.5)[:, None] / side
    phi = 2 * np.pi * (np.arange(side) + 0.5) / side
    r = np.sqrt(1 - z * z)
    d = np.stack(np.broadcast_arrays(r * np.cos(phi), r * np.sin(phi), z), axis=-1).reshape(-1, 3)
    p = evaluated(s, wo, d.astype(np.float32))[1] * 2 * np.pi / side**2
    for power in (
        lambda v: np.ones(len(v)),
        lambda v: v[:, 2],
        lambda v: v[:, 0],
        lambda v: v[:, 2] ** 2,
        lambda v: v[:, 0] * v[:, 2],
        lambda v: (v[:, 2] > 0.5) * 1.0,
    ):
        values = np.where(up, power(wi), 0.0)
        error = values.std() / math.sqrt(n)
        assert abs(values.mean() - (p * power(d)).sum()) < 4.0 * error + 3e-4


def test_its_absence_leaves_no_code():
    from pathlib import Path

    import warp as wp

    bsdf = make_bsdf(frozenset({"diffuse", "conductor"}))
    kernel = kernels(bsdf)[1]
    list(sampled(surface("conductor", 0.3), view(10), squares(10, 1), bsdf))
    found = list(Path(wp.config.kernel_cache_dir).glob(f"*{kernel.module.name}*/*.cpp"))
    text = "".join(p.read_text() for p in found)
    assert found and "principled_sample" not in text and "ggx_albedo" not in text
