"""Transfer functions: round trips of every code, published anchor values, primaries."""

from __future__ import annotations

import numpy as np
import pytest
from held import holds

from mrbatch.kernels import transfer as tf
from mrbatch.stability import file_cases


@pytest.mark.case("IO-03")
def test_round_trip_is_exact_for_every_code():
    """And by half floats, those of 8 and 10 bits."""
    holds(file_cases.codes(0))


# Values computed by hand from the standards' formulas, six digits.
@pytest.mark.parametrize(
    ("name", "signal", "linear"),
    [
        ("srgb", 0.5, 0.214041),
        ("srgb", 0.04, 0.04 / 12.92),
        ("bt709", 0.5, 0.259719),
        ("bt709", 0.045, 0.01),
        ("bt1886", 0.5, 0.189465),
        ("gamma22", 0.5, 0.217638),
        ("gamma28", 0.5, 0.143587),
        ("linear", 0.3, 0.3),
        ("pq", 0.508078, 100.0 / 203.0),  # BT.2100: 100 cd/m2 is a signal of 50.8078 %
        ("hlg", 0.5, (1.0 / 12.0) / 0.264963),
        ("hlg", 0.75, 1.0),
        ("pq", 1.0, 10000.0 / 203.0),
    ],
)
def test_anchor_values(name, signal, linear):
    got = tf.to_linear_between(np.array([signal]), name)[0]
    assert got == pytest.approx(linear, rel=2e-5)
    assert tf.encode(np.array([linear]), name)[0] == pytest.approx(signal, rel=2e-6)


@pytest.mark.parametrize("name", tf.TRANSFERS)
def test_ends_are_black_and_white(name):
    white = {"pq": 10000.0 / 203.0, "hlg": 1.0 / tf.HLG_WHITE}.get(name, 1.0)
    got = tf.to_linear(np.array([0, 65535], np.uint16), name, 16)
    assert got[0] == 0.0
    assert got[1] == pytest.approx(white, rel=1e-6)


def test_between_table_agrees_with_the_formula():
    rng = np.random.default_rng(3)
    v = rng.random(20000).astype(np.float32)
    truth = np.where(v <= 0.04045, v / 12.92, ((v.astype(np.float64) + 0.055) / 1.055) ** 2.4)
    assert np.max(np.abs(tf.to_linear_between(v, "srgb") - truth)) < 2e-7  # float32 rounding near 1
    np.testing.assert_array_equal(tf.to_linear_between(np.array([-1.0, 2.0]), "srgb"), [0.0, 1.0])


def test_wrong_names_and_codes_are_refused():
    with pytest.raises(ValueError, match="unknown transfer"):
        tf.to_linear(np.zeros(1, np.uint8), "rec709", 8)
    with pytest.raises(ValueError, match="does not fit"):
        tf.to_linear(np.array([1024], np.uint16), "srgb", 10)
    with pytest.raises(ValueError, match="unsigned"):
        tf.to_linear(np.array([0.5]), "srgb", 8)
    with pytest.raises(ValueError, match="unknown primaries"):
        tf.rec709_from_primaries("adobe")


def test_rec709_passes_untouched_and_bt2020_matches_bt2087():
    np.testing.assert_array_equal(tf.rec709_from_primaries("bt709"), np.eye(3))
    # ITU-R BT.2087-0, annex 1, inverse of its BT.709 to BT.2020 matrix (four digits printed).
    bt2087 = np.array([[0.6274, 0.3293, 0.0433], [0.0691, 0.9195, 0.0114], [0.0164, 0.0880, 0.8956]])
    np.testing.assert_allclose(np.linalg.inv(tf.rec709_from_primaries("bt2020")), bt2087, atol=6e-5)


@pytest.mark.parametrize("name", ["bt601-525", "bt601-625", "bt2020", "p3"])
def test_primaries_keep_white_and_can_be_undone(name):
    m = tf.rec709_from_primaries(name)
    np.testing.assert_allclose(m @ np.ones(3), 1.0, atol=1e-12)
    codes = np.random.default_rng(1).integers(0, 256, (500, 3)).astype(np.uint8)
    linear = tf.to_linear(codes, "bt709", 8)
    moved = tf.to_rec709(linear, m)
    assert np.max(np.abs(moved - linear)) > 1e-3
    np.testing.assert_array_equal(tf.from_linear(tf.to_rec709(moved, np.linalg.inv(m)), "bt709", 8), codes)


def test_another_white_is_adapted():
    aces = [(0.7347, 0.2653), (0.0, 1.0), (0.0001, -0.077), (0.32168, 0.33767)]
    np.testing.assert_allclose(tf.rec709_from_primaries(aces) @ np.ones(3), 1.0, atol=1e-12)
    # AP0 to Rec.709 with Bradford, as published by the Academy (TB-2014-004 and its CTL).
    published = [2.52169, -1.13413, -0.38756]
    np.testing.assert_allclose(tf.rec709_from_primaries(aces)[0], published, atol=2e-4)
