"""Boundaries of clear media against Fresnel, Snell and float64 sums over the sphere."""

from __future__ import annotations

import numpy as np
import pytest
from held import holds

from mrbatch.stability import scattering_cases
from mrbatch.stability.scattering_draws import boundary_evaluated as evaluated
from mrbatch.stability.scattering_draws import boundary_sampled as sampled
from mrbatch.stability.scattering_draws import sphere


def view(cosine, azimuth=0.3):
    sine = np.sqrt(1 - cosine**2)
    return np.array([sine * np.cos(azimuth), sine * np.sin(azimuth), cosine])


@pytest.mark.case("BSDF-07")
def test_fresnel_equals_snell_and_fresnel_in_float64():
    assert np.degrees(np.arcsin(1 / 1.5)) == pytest.approx(41.8103, abs=1e-4)
    assert np.degrees(np.arctan(1.5)) == pytest.approx(56.3099, abs=1e-4)
    holds(scattering_cases.snell(0))


@pytest.mark.case("BSDF-07", "MIS-02")
@pytest.mark.parametrize("eta", [1.5, 1 / 1.5, 1.0])
def test_smooth_boundary_reflects_and_refracts(eta):
    holds(scattering_cases.smooth_boundary(0, eta))


@pytest.mark.parametrize("correlated", [True, False])
@pytest.mark.parametrize("eta", [1.5, 1 / 1.5])
@pytest.mark.parametrize("alpha", [0.1, 0.4])
def test_samples_have_the_density_and_value_that_are_told(alpha, eta, correlated):
    """Sums over the sphere by uniform directions and by the boundary's own, on each side."""
    n = 400_000
    for cosine in (0.95, 0.4):
        wo = view(cosine)
        uniform = sphere(n, 3)
        f, p = evaluated(alpha, eta, wo[None], uniform, correlated)
        wi, weight, pdf = sampled(alpha, eta, wo, np.random.default_rng(4).random((n, 2)), correlated)
        drawn = weight > 0
        again_f, again_p = evaluated(alpha, eta, wo[None], wi[drawn], correlated)
        np.testing.assert_allclose(again_p, pdf[drawn], rtol=2e-3)
        np.testing.assert_allclose(again_f / again_p, weight[drawn], rtol=2e-3)
        for side in (1, -1):
            here, there = uniform[:, 2] * side > 0, wi[:, 2] * side > 0
            for by_uniform, by_own in (
                (f * here * 4 * np.pi, weight * there),
                (p * here * 4 * np.pi, (there & drawn).astype(float)),
                (f * here * 4 * np.pi * uniform[:, 0], weight * there * wi[:, 0]),
            ):
                error = np.hypot(by_uniform.std(), by_own.std()) / np.sqrt(n)
                assert abs(by_uniform.mean() - by_own.mean()) < 4 * error + 1e-5


@pytest.mark.case("BSDF-04")
@pytest.mark.parametrize("eta", [1.5, 1 / 1.5])
def test_reciprocity_with_the_square_of_the_index(eta):
    """BSDF-04: f / n^2 of light's side is symmetric: f(wo, wi) eta^2 = f(wi, wo) seen from behind."""
    holds(scattering_cases.through_glass(0, eta))


@pytest.mark.parametrize("eta", [1.5, 1 / 1.5])
def test_little_energy_is_lost_and_none_won(eta):
    u = np.random.default_rng(7).random((200_000, 2))
    for alpha, least in ((0.02, 0.995), (0.1, 0.96), (0.3, 0.78)):
        for cosine in (1.0, 0.6):
            wi, weight, _ = sampled(alpha, eta, view(cosine), u)
            # What passes is divided by eta^2 and multiplied again where it leaves.
            total = weight * np.where(wi[:, 2] < 0, eta**2, 1.0)
            assert least < total.mean() < 1.0 + 4 * total.std() / np.sqrt(len(u))
