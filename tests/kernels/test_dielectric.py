"""Boundaries of clear media against Fresnel, Snell and float64 sums over the sphere."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from mrbatch.kernels.dielectric import DielectricSample, make_dielectric
from mrbatch.kernels.fresnel import fresnel_dielectric

wp.config.quiet = True


@wp.kernel(enable_backward=False)
def _fresnel(c: wp.array(dtype=float), eta: wp.array(dtype=float), out: wp.array(dtype=float)):
    i = wp.tid()
    out[i] = fresnel_dielectric(c[i], eta[i])


def _kernels(functions):
    evaluate, density, sample = functions.evaluate, functions.pdf, functions.sample

    @wp.kernel(enable_backward=False, module="unique")
    def evaluate_all(
        alpha: float,
        eta: float,
        wo: wp.array(dtype=wp.vec3),
        wi: wp.array(dtype=wp.vec3),
        f: wp.array(dtype=float),
        p: wp.array(dtype=float),
    ):
        i = wp.tid()
        f[i] = evaluate(alpha, eta, wo[i], wi[i])
        p[i] = density(alpha, eta, wo[i], wi[i])

    @wp.kernel(enable_backward=False, module="unique")
    def sample_all(
        alpha: float,
        eta: float,
        wo: wp.array(dtype=wp.vec3),
        u: wp.array(dtype=wp.vec2),
        out: wp.array(dtype=DielectricSample),
    ):
        i = wp.tid()
        out[i] = sample(alpha, eta, wo[i], u[i])

    return evaluate_all, sample_all


MADE = {correlated: _kernels(make_dielectric(correlated)) for correlated in (True, False)}


def vectors(a):
    return wp.array(np.ascontiguousarray(a, dtype=np.float32), dtype=wp.vec3, device="cpu")


def fresnel(c, eta):
    c, eta = np.broadcast_arrays(np.asarray(c, np.float32), np.asarray(eta, np.float32))
    out = wp.zeros(c.size, dtype=float, device="cpu")
    inputs = [wp.array(np.ascontiguousarray(x.ravel()), device="cpu") for x in (c, eta)]
    wp.launch(_fresnel, c.size, inputs, [out], device="cpu")
    return out.numpy().astype(np.float64).reshape(c.shape)


def evaluated(alpha, eta, wo, wi, correlated=True):
    wo, wi = (
        np.ascontiguousarray(np.broadcast_to(v, np.broadcast_shapes(wo.shape, wi.shape))) for v in (wo, wi)
    )
    f, p = (wp.zeros(len(wi), dtype=float, device="cpu") for _ in range(2))
    wp.launch(MADE[correlated][0], len(wi), [alpha, eta, vectors(wo), vectors(wi)], [f, p], device="cpu")
    return f.numpy().astype(np.float64), p.numpy().astype(np.float64)


def sampled(alpha, eta, wo, u, correlated=True):
    out = wp.zeros(len(u), dtype=DielectricSample, device="cpu")
    given = vectors(np.broadcast_to(wo, (len(u), 3)))
    u = wp.array(np.ascontiguousarray(u, dtype=np.float32), dtype=wp.vec2, device="cpu")
    wp.launch(MADE[correlated][1], len(given), [alpha, eta, given, u], [out], device="cpu")
    rows = out.numpy()
    return (rows[name].astype(np.float64) for name in ("wi", "weight", "pdf"))


def view(cosine, azimuth=0.3):
    sine = np.sqrt(1 - cosine**2)
    return np.array([sine * np.cos(azimuth), sine * np.sin(azimuth), cosine])


def sphere(n, seed):
    d = np.random.default_rng(seed).normal(size=(n, 3))
    return d / np.linalg.norm(d, axis=1, keepdims=True)


def truth(c, eta):
    """Rs and Rp from Snell's law in float64."""
    sine2 = (1 - c * c) / eta**2
    t = np.sqrt(np.maximum(1 - sine2, 0.0))
    rs, rp = (c - eta * t) / (c + eta * t), (eta * c - t) / (eta * c + t)
    beyond = sine2 >= 1
    return np.where(beyond, 1.0, rs**2), np.where(beyond, 1.0, rp**2)


@pytest.mark.case("BSDF-07")
def test_fresnel_equals_snell_and_fresnel_in_float64():
    """BSDF-07."""
    for eta in (1.5, 1 / 1.5, 1.001, 1 / 1.33, 2.4):
        c = np.linspace(1e-4, 1, 5001).astype(np.float32).astype(np.float64)
        rs, rp = truth(c, np.float64(np.float32(eta)))
        assert np.abs(fresnel(c, eta) - (rs + rp) / 2).max() < 1e-5
    critical = np.sqrt(1 - (1 / 1.5) ** 2)
    assert np.degrees(np.arccos(critical)) == pytest.approx(41.8103, abs=1e-4)
    assert np.all(fresnel([critical - 1e-6, 0.3, 0.0], 1 / 1.5) == 1.0)
    assert fresnel(critical + 1e-3, 1 / 1.5) < 0.9
    brewster = np.cos(np.radians(56.3099))
    assert fresnel(brewster, 1.5) == pytest.approx(truth(brewster, 1.5)[0] / 2, abs=1e-6)
    assert fresnel(1.0, 1.5) == pytest.approx(0.04, abs=1e-7)
    assert np.all(fresnel([0.0, 0.2, 1.0], 1.0) == 0.0)


@pytest.mark.case("BSDF-07", "MIS-02")
@pytest.mark.parametrize("eta", [1.5, 1 / 1.5, 1.0])
def test_smooth_boundary_reflects_and_refracts(eta):
    u = np.random.default_rng(1).random((40000, 2))
    for cosine in (1.0, 0.7, 0.2):
        wo = view(cosine)
        wi, weight, pdf = sampled(0.0, eta, wo, u)
        up = wi[:, 2] > 0
        rs, rp = truth(cosine, eta)
        share = (rs + rp) / 2
        assert abs(up.mean() - share) < 4 * np.sqrt(share * (1 - share) / len(u)) + 1e-6
        assert np.all(np.isinf(pdf[weight > 0])) and np.all(weight[up] == 1.0)
        np.testing.assert_allclose(wi[up], np.broadcast_to(wo * [-1, -1, 1], wi[up].shape), atol=1e-6)
        np.testing.assert_allclose(weight[~up], 1 / eta**2, rtol=1e-6)
        # Snell: sines in the ratio of the indices, on the other side.
        np.testing.assert_allclose(
            wi[~up][:, :2], np.broadcast_to(-wo[:2] / eta, wi[~up][:, :2].shape), atol=1e-6
        )
    f, p = evaluated(0.0, eta, view(0.7)[None], sphere(1000, 2))
    assert not f.any() and not p.any()


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
    a, b = sphere(20000, 5), sphere(20000, 6)
    a[:, 2], b[:, 2] = np.abs(a[:, 2]), -np.abs(b[:, 2])
    forth = evaluated(0.3, eta, a, b, False)[0] / np.abs(b[:, 2])
    # Seen from behind the frame turns over, and the ratio with it.
    flip = np.array([1.0, -1.0, -1.0])
    back = evaluated(0.3, 1 / eta, b * flip, a * flip, False)[0] / a[:, 2]
    some = (forth > 1e-3) & (np.abs(a[:, 2]) > 0.05) & (np.abs(b[:, 2]) > 0.05)
    assert some.sum() > 1000
    np.testing.assert_allclose(forth[some] * eta**2, back[some], rtol=1e-2)


@pytest.mark.parametrize("eta", [1.5, 1 / 1.5])
def test_little_energy_is_lost_and_none_won(eta):
    u = np.random.default_rng(7).random((200_000, 2))
    for alpha, least in ((0.02, 0.995), (0.1, 0.96), (0.3, 0.78)):
        for cosine in (1.0, 0.6):
            wi, weight, _ = sampled(alpha, eta, view(cosine), u)
            # What passes is divided by eta^2 and multiplied again where it leaves.
            total = weight * np.where(wi[:, 2] < 0, eta**2, 1.0)
            assert least < total.mean() < 1.0 + 4 * total.std() / np.sqrt(len(u))
