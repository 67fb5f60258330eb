"""Shares of light at a pane, against the sum over its inner reflections in float64."""

from __future__ import annotations

import numpy as np
import warp as wp

from mrbatch.kernels.thin_dielectric import pane_shares


@wp.kernel(enable_backward=False, module="unique")
def _shares(
    cosine: wp.array(dtype=wp.float32),
    ior: wp.array(dtype=wp.float32),
    colour: wp.array(dtype=wp.vec3),
    passed: wp.array(dtype=wp.vec3),
    returned: wp.array(dtype=wp.vec3),
    stops: wp.array(dtype=wp.float32),
):
    i = wp.tid()
    shares = pane_shares(cosine[i], ior[i], colour[i])
    passed[i] = shares.passed
    returned[i] = shares.returned
    stops[i] = shares.stops


def computed(cosine, ior, colour):
    n = len(cosine)
    out = [wp.zeros(n, dtype=wp.vec3), wp.zeros(n, dtype=wp.vec3), wp.zeros(n, dtype=wp.float32)]
    given = [wp.array(np.asarray(x, np.float32), dtype=wp.float32) for x in (cosine, ior)]
    wp.launch(_shares, dim=n, inputs=[*given, wp.array(np.asarray(colour, np.float32), dtype=wp.vec3), *out])
    return [x.numpy().astype(np.float64) for x in out]


def bounced(cosine, ior, colour):
    """Both shares by following light to and fro, with Fresnel's equations from both angles."""
    inside = np.sqrt(1 - (1 - cosine**2) / ior**2)
    s = (cosine - ior * inside) / (cosine + ior * inside)
    p = (ior * cosine - inside) / (ior * cosine + inside)
    r = ((s * s + p * p) / 2)[:, None]
    t = colour ** (1 / inside)[:, None]
    passed, returned = np.zeros_like(t), r * np.ones_like(t)
    light = 1 - r
    for _ in range(4000):
        light = light * t
        passed += light * (1 - r)
        light = light * r * t
        returned += light * (1 - r)
        light = light * r
    return passed, returned


def test_shares_are_the_sum_over_inner_reflections():
    rng = np.random.default_rng(3)
    n = 4000
    cosine = np.clip(rng.random(n), 0.02, 1)
    ior = rng.uniform(1.0, 2.6, n)
    colour = np.where(rng.random((n, 3)) < 0.3, 1.0, rng.uniform(0.01, 1, (n, 3)))
    cosine, ior, colour = (x.astype(np.float32).astype(np.float64) for x in (cosine, ior, colour))
    passed, returned, stops = computed(cosine, ior, colour)
    p, r = bounced(cosine, ior, colour)
    np.testing.assert_allclose(passed, p, atol=2e-5)
    np.testing.assert_allclose(returned, r, atol=2e-5)
    np.testing.assert_allclose(stops, 1 - p.max(axis=1), atol=2e-5)
    assert (passed + returned < 1 + 1e-6).all()
    clear = (colour == 1.0).all(axis=1)
    np.testing.assert_allclose((passed + returned)[clear], 1.0, atol=1e-6)


def test_known_values_and_ends():
    """BSDF-07: (1 - R) / (1 + R) = .92308 for index 1.5; index 1 is air; grazing light is all returned."""
    passed, returned, stops = computed([1.0, 1.0, 0.3, 0.0, 0.0], [1.5, 1.0, 1.0, 1.5, 1.0], np.ones((5, 3)))
    np.testing.assert_allclose(passed[0], 0.92308, atol=1e-5)
    np.testing.assert_allclose(returned[0], 0.07692, atol=1e-5)
    assert np.all(passed[1:3] == 1.0) and not returned[1:3].any() and not stops[1:3].any()
    assert not passed[3].any() and np.allclose(returned[3], 1.0) and stops[3] == 1.0
    assert np.isfinite([*passed[4], *returned[4], stops[4]]).all()
