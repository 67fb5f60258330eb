"""Compositing against arithmetic written out pixel by pixel in Python's own floats."""

from __future__ import annotations

import numpy as np
import pytest
from held import holds

from mrbatch.film.composite import Contribution, behind_matte, composite, over, shadow_matte
from mrbatch.stability import file_cases


def random_parts(seed: int, dtype=np.float64, shape=(5, 7)):
    rng = np.random.default_rng(seed)
    a = rng.uniform(0, 1, shape)
    P = rng.uniform(0, 3, (*shape, 3)) * a[..., None]
    D = rng.normal(0, 0.4, (*shape, 3)) * (1 - a[..., None])
    B = rng.uniform(0, 2, (*shape, 3))
    return P.astype(dtype), a.astype(dtype), B.astype(dtype), D.astype(dtype)


def test_composite_is_the_formula():
    P, a, B, D = random_parts(1)
    C = composite(P, a, B, D)
    cut = 0
    for y in range(5):
        for x in range(7):
            for c in range(3):
                value = float(P[y, x, c]) + (1 - float(a[y, x])) * float(B[y, x, c]) + float(D[y, x, c])
                cut += value < 0
                assert C[y, x, c] == pytest.approx(max(0.0, value), rel=1e-15)
    assert cut > 0, "the test must reach the cut at zero"


def test_untouched_pixels_keep_their_bits():
    odd = np.array([-0.25, -0.0, np.float32(1e-42), 70000.0, 0.1, 1.0], np.float32)
    B = np.stack([odd, odd[::-1], odd], axis=-1)[None]
    zero = np.zeros_like(B)
    C = composite(zero, zero[..., 0], B, zero)
    assert C.dtype == np.float32
    assert np.array_equal(C.view(np.uint32), B.view(np.uint32))
    # A single touched channel ends the exception for its pixel alone.
    D = zero.copy()
    D[0, 0, 2] = 1e-3
    C = composite(zero, zero[..., 0], B, D)
    assert C[0, 0, 0] == 0.0 and np.array_equal(C[0, 1:].view(np.uint32), B[0, 1:].view(np.uint32))


def test_laying_over_is_associative_and_equals_two_composites():
    B = random_parts(0)[2]
    layers = []
    for seed in (2, 3, 4):
        P, a, _, D = random_parts(seed)
        layers.append(Contribution(P, a, D, D_indirect=np.maximum(D, 0)))
    front, middle, back = layers
    left = over(over(front, middle), back)
    right = over(front, over(middle, back))
    for name in ("P", "a", "D", "D_indirect"):
        np.testing.assert_allclose(getattr(left, name), getattr(right, name), rtol=1e-13, atol=1e-15)
    # Without the cut at zero, one composite after the other is the same as all at once.
    step = B
    for c in (back, middle, front):
        step = c.P + (1 - c.a)[..., None] * step + c.D
    np.testing.assert_allclose(left.P + (1 - left.a)[..., None] * B + left.D, step, rtol=1e-12, atol=1e-14)


def test_parts_of_delta_may_be_absent():
    P, a, _, D = random_parts(5)
    plain = Contribution(P, a, D)
    split = Contribution(P, a, D, D_indirect=D)
    assert over(plain, plain).D_indirect is None and behind_matte(plain, a).D_indirect is None
    np.testing.assert_allclose(over(plain, split).D_indirect, (1 - a)[..., None] * D)
    assert np.array_equal(over(split, plain).D_indirect, D)
    np.testing.assert_allclose(behind_matte(split, a).D_indirect, behind_matte(split, a).D)


def test_matte_cuts_all_three():
    P, a, B, D = random_parts(6)
    m = np.zeros((5, 7), np.float32)
    m[1], m[2] = 1.0, 0.25
    cut = behind_matte(Contribution(P, a, D), m)
    assert (
        np.array_equal(cut.P[0], P[0]) and np.array_equal(cut.a[0], a[0]) and np.array_equal(cut.D[0], D[0])
    )
    assert np.array_equal(composite(cut.P, cut.a, B, cut.D)[1], B[1]), "wholly covered: the photo itself"
    np.testing.assert_allclose(
        (cut.P + (1 - cut.a)[..., None] * B + cut.D)[2],
        0.25 * B[2] + 0.75 * (P + (1 - a)[..., None] * B + D)[2],
        rtol=1e-13,
    )
    assert behind_matte(cut, None) is cut


def test_shadow_matte():
    B = np.full((1, 5, 3), 0.8)
    B[0, 3] = 0.0
    a = np.array([[0.0, 0.5, 1.0, 0.0, 0.0]])
    blocked = np.array([-0.4, -0.2, 0.0, 0.0, 0.1])[None, :, None] * np.ones(3)
    np.testing.assert_allclose(shadow_matte(a, B, blocked), [[0.5, 0.5, 0.0, 0.0, 0.0]], atol=1e-15)
    assert shadow_matte(a, B, 10 * blocked).max() == 1.0


@pytest.mark.case("TRAP-3d")
def test_a_change_of_light_is_added_to_light_and_not_to_codes():
    """Half of the light of a step wedge taken: every step of 8 bits has half of its light left, to a code.
    Added to codes, a grey of .5 under half a shadow would show .2 of its light, for .25."""
    holds(file_cases.step_wedge(0))

    def seen(code):
        return ((code + 0.055) / 1.055) ** 2.4

    grey = 1.055 * 0.5 ** (1 / 2.4) - 0.055
    assert seen(grey - 0.25) == pytest.approx(0.201, abs=2e-3)
