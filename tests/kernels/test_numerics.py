"""Numerics against float64 NumPy and closed forms."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from held import holds

from mrbatch.kernels import numerics as nm
from mrbatch.stability import twin_cases, weight_cases
from mrbatch.stability.twin_cases import offset_starts, surface_starts

wp.config.quiet = True


@wp.kernel(enable_backward=False)
def _basis(n: wp.array(dtype=wp.vec3), out: wp.array(dtype=wp.mat33), back: wp.array(dtype=wp.vec3)):
    i = wp.tid()
    m = nm.orthonormal_basis(n[i])
    out[i] = m
    v = wp.vec3(0.25, -0.5, 0.125)
    back[i] = nm.to_local(m, nm.to_world(m, v)) - v


@wp.kernel(enable_backward=False)
def _angles(y: wp.array(dtype=float), x: wp.array(dtype=float), out: wp.array(dtype=float)):
    i = wp.tid()
    out[i] = nm.arctangent2(y[i], x[i])


@wp.kernel(enable_backward=False)
def _scalars(a: wp.array(dtype=wp.vec3), out: wp.array2d(dtype=float)):
    i = wp.tid()
    out[i, 0] = nm.luminance(a[i])
    out[i, 1] = nm.max_component(a[i])


def run(kernel, inputs, shape, dtype):
    out = wp.zeros(shape, dtype=dtype, device="cpu")
    arrays = []
    for values in inputs:
        values = np.ascontiguousarray(values, dtype=np.float32)
        arrays.append(wp.array(values, dtype=wp.vec3 if values.ndim == 2 else wp.float32, device="cpu"))
    wp.launch(kernel, len(inputs[0]), inputs=arrays, outputs=[out], device="cpu")
    return out.numpy()


def directions(count, rng):
    d = rng.normal(size=(count, 3))
    return (d / np.linalg.norm(d, axis=1)[:, None]).astype(np.float32)


@pytest.mark.case("GEO-01", "TRAP-1k")
def test_offset_leaves_the_surface_on_the_side_of_the_ray():
    """GEO-01: exact side of the exact plane in float64. A bare 1e-4 fails at both ends (TRAP-1k)."""
    scales, offsets = (1e-4, 1e-2, 1.0, 1e2, 1e4), (0.0, 1.0, 1e3, 1e6)
    holds(twin_cases.ray_starts(0, scales=scales, offsets=offsets))


@pytest.mark.case("TRAP-1k")
def test_a_bare_offset_fails_where_ours_holds():
    rng = np.random.default_rng(2)
    p, n, d, _t, exact = surface_starts(rng, 1.0, 1e3)
    side = np.sign(np.einsum("ij,ij->i", n, d)).astype(np.float32)
    bare = p + np.float32(1e-5) * side[:, None] * n
    height = np.einsum("ij,ij->i", bare.astype(np.float64) - exact, n.astype(np.float64)) * side
    assert (height <= 0.0).mean() > 0.1


@pytest.mark.case("GEO-01")
@pytest.mark.parametrize("power", [-20, -3, 1, 17])
def test_offset_scales_with_powers_of_two_to_the_bit(power):
    rng = np.random.default_rng(3)
    p, n, d, t, _ = surface_starts(rng, 1.0, 0.5)
    factor = np.float32(2.0**power)
    once = offset_starts(p, n, d, t)
    scaled = offset_starts(p * factor, n, d, t * factor)
    assert np.array_equal(scaled, once * factor)


def test_basis_is_a_rotation_with_n_as_third_column():
    rng = np.random.default_rng(4)
    n = directions(20000, rng)
    poles = np.array([[0, 0, 1], [0, 0, -1], [1e-9, 0, -1], [0, -1e-6, -1], [0, 0, -1 + 1e-7]])
    n = np.concatenate([n, (poles / np.linalg.norm(poles, axis=1)[:, None]).astype(np.float32)])
    out = wp.zeros(len(n), dtype=wp.mat33, device="cpu")
    back = wp.zeros(len(n), dtype=wp.vec3, device="cpu")
    wp.launch(_basis, len(n), inputs=[wp.array(n, dtype=wp.vec3, device="cpu"), out, back], device="cpu")
    m = out.numpy().astype(np.float64)
    assert np.array_equal(out.numpy()[:, :, 2], n)
    assert np.abs(np.swapaxes(m, 1, 2) @ m - np.eye(3)).max() < 1e-6
    assert np.abs(np.linalg.det(m) - 1.0).max() < 1e-6
    assert np.abs(back.numpy()).max() < 1e-6


@pytest.mark.case("MIS-01", "TRAP-2")
def test_weights_sum_to_one_over_the_whole_range():
    """MIS-01; the printed forms, in float32, meet 0/0, inf/inf and overflow."""
    holds(weight_cases.sums(5))
    _, a, _, b = weight_cases.wide_pairs(5)
    with np.errstate(all="ignore"):
        assert np.isnan(a / (a + b)).any()
        assert np.isnan(a * a / (a * a + b * b)).mean() > 0.1


@pytest.mark.case("MIS-04")
def test_weights_equal_float64():
    """MIS-04: the power heuristic at 1e20, where p^2 leaves float32."""
    holds(weight_cases.strong(6))


@pytest.mark.case("MIS-02", "MIS-03")
def test_special_weights():
    """MIS-03 and deltas: 0 against 0 is 0, a delta against a density 1, none drawn 0."""
    holds(weight_cases.special(0))


def test_arctangent_equals_numpy():
    rng = np.random.default_rng(7)
    x, y = rng.normal(size=(2, 200000)).astype(np.float32)
    x, y = (np.concatenate([v, v * np.float32(1e-30), v * np.float32(1e30)]) for v in (x, y))
    y[:1000] *= np.float32(1e-12)
    got = run(_angles, [y, x], y.size, float).astype(np.float64)
    assert np.abs(got - np.arctan2(y.astype(np.float64), x.astype(np.float64))).max() < 3e-7
    small = np.abs(y[:1000] / x[:1000]) < 1e-3
    front = small & (x[:1000] > 0)
    exact = np.arctan2(y[:1000].astype(np.float64), x[:1000].astype(np.float64))
    assert np.allclose(got[:1000][front], exact[front], rtol=3e-7, atol=0.0), "small angles keep their digits"
    axes = run(_angles, [np.array([0, 0, 1, -1, 0]), np.array([0, 1, 0, 0, -1])], 5, float)
    assert np.allclose(axes, [0, 0, np.pi / 2, -np.pi / 2, np.pi], rtol=1e-7, atol=0)


def test_luminance_and_max_component():
    a = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1], [-3, -2, -4]])
    got = run(_scalars, [a], (5, 2), float)
    assert np.allclose(got[:4, 0], [0.2126, 0.7152, 0.0722, 1.0], rtol=1e-6)
    assert got[:, 1].tolist() == [1, 1, 1, 1, -2]


def test_sine_and_cosine_are_exact_to_an_ulp_or_so():
    from mrbatch.kernels.numerics import sine_cosine, sine_cosine_turns

    @wp.kernel(enable_backward=False, module="unique")
    def run(a: wp.array(dtype=float), small: wp.array(dtype=wp.vec2), turns: wp.array(dtype=wp.vec2)):
        i = wp.tid()
        small[i] = sine_cosine(a[i] * 0.7853982)
        turns[i] = sine_cosine_turns(a[i])

    x = np.linspace(-1.0, 1.0, 200_001).astype(np.float32)
    out = [wp.zeros(len(x), dtype=wp.vec2, device="cpu") for _ in range(2)]
    wp.launch(run, len(x), [wp.array(x, dtype=float, device="cpu"), *out], device="cpu")
    angle = (x * np.float32(0.7853982)).astype(np.float32).astype(np.float64)
    truth = np.stack([np.sin(angle), np.cos(angle)], axis=1)
    assert np.abs(out[0].numpy() - truth).max() < 1.2e-7
    angle = 2.0 * np.pi * x.astype(np.float64)
    truth = np.stack([np.sin(angle), np.cos(angle)], axis=1)
    assert np.abs(out[1].numpy() - truth).max() < 2.5e-7
