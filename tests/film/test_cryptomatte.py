"""Cryptomatte: hash vectors and keys known from elsewhere, ranks against plain Python sums."""

from __future__ import annotations

import json

import numpy as np
import pytest

from mrbatch.film import cryptomatte
from mrbatch.film.cryptomatte import channels, coverage_of, metadata, murmur3_32, name_id, ranked


@pytest.mark.parametrize(
    ("data", "seed", "expected"),
    [
        # Verification vectors of MurmurHash3_x86_32 that the field's implementations share.
        (b"", 0, 0x00000000),
        (b"", 1, 0x514E28B7),
        (b"", 0xFFFFFFFF, 0x81F16F39),
        (b"\xff\xff\xff\xff", 0, 0x76293B50),
        (b"\x21\x43\x65\x87", 0, 0xF55B516B),
        (b"\x21\x43\x65\x87", 0x5082EDEE, 0x2362F9DE),
        (b"\x21\x43\x65", 0, 0x7E4A8634),
        (b"\x21\x43", 0, 0xA0F7B07A),
        (b"\x21", 0, 0x72661CF4),
        (b"\x00\x00\x00\x00", 0, 0x2362F9DE),
        (b"Hello, world!", 0x9747B28C, 0x24884CBA),
        (b"The quick brown fox jumps over the lazy dog", 0x9747B28C, 0x2FA826CD),
    ],
)
def test_murmur_vectors(data, seed, expected):
    assert murmur3_32(data, seed) == expected


@pytest.mark.parametrize(
    ("layer", "key"),
    [("crypto_object", "f834d0a"), ("uCryptoAsset", "d593dd7"), ("uCryptoObject", "ae93ba3")],
)
def test_layer_keys_are_those_of_other_renderers(layer, key):
    """Keys as files of Arnold and of the format's authors carry them."""
    keys = {f"cryptomatte/{key}/{k}" for k in ("name", "hash", "conversion", "manifest")}
    assert set(metadata(layer, ["a"])) == keys
    assert metadata(layer, ["a"])[f"cryptomatte/{key}/name"] == layer


def test_an_id_is_that_of_another_renderer():
    """The float that Gaffer's own test asset has for a name."""
    bits = name_id("/GAFFERBOT/C_torso_GRP/C_head_GRP/C_head_CPT/C_head001_REN")
    assert np.array([bits], np.uint32).view(np.float32)[0] == np.float32(-2.5222249091461295e36)


def test_ids_are_ordinary_floats():
    turned = 0
    for i in range(4000):
        name = f"object_{i}"
        bits = name_id(name)
        value = np.array([bits], np.uint32).view(np.float32)[0]
        assert np.isfinite(value) and abs(value) >= np.finfo(np.float32).tiny
        turned += bits != murmur3_32(name.encode())
    assert 5 < turned < 90, "about 4000 * 2 / 256 names need their exponent turned"
    assert name_id("") != 0


def test_manifest_holds_utf8_names_and_id_bits():
    data = metadata("CryptoObject", ["bunny", "Tisch/Füße", "bunny", 'a "b"'])
    manifest = json.loads(next(v for k, v in data.items() if k.endswith("/manifest")))
    assert set(manifest) == {"bunny", "Tisch/Füße", 'a "b"'}
    assert int(manifest["Tisch/Füße"], 16) == name_id("Tisch/Füße") and len(manifest["bunny"]) == 8


def test_ranks_add_up_and_sort():
    rng = np.random.default_rng(3)
    names = [name_id(f"n{i}") for i in range(9)] + [0]
    k = 14
    ids = rng.choice(np.array(names, np.uint32), (6, 5, k))
    coverage = rng.uniform(0, 1 / k, (6, 5, k))
    coverage[0, 0] = 1 / k  # equal coverages: the order must still be a function of the pixel
    pairs = ranked(ids, coverage, ranks=6)
    shuffled = rng.permutation(k)
    assert np.array_equal(
        pairs.view(np.uint32)[..., ::2],
        ranked(ids[..., shuffled], coverage[..., shuffled], 6).view(np.uint32)[..., ::2],
    )
    for y in range(6):
        for x in range(5):
            totals: dict[int, float] = {}
            for i, c in zip(ids[y, x], coverage[y, x], strict=True):
                if i:
                    totals[int(i)] = totals.get(int(i), 0.0) + float(c)
            expected = sorted(totals.values(), reverse=True)[:6]
            expected += [0.0] * (6 - len(expected))
            np.testing.assert_allclose(pairs[y, x, 1::2], expected, rtol=1e-6)
            for bits, amount in zip(pairs[y, x, ::2].view(np.uint32), pairs[y, x, 1::2], strict=True):
                assert (bits == 0) == (amount == 0)
                if bits:
                    assert amount == pytest.approx(totals[int(bits)], rel=1e-6)


def test_fewer_names_than_ranks_and_odd_ranks():
    ids = np.full((2, 3, 1), name_id("one"), np.uint32)
    pairs = ranked(ids, np.full((2, 3, 1), 0.5), ranks=3)
    named = channels("CryptoObject", pairs)
    assert list(named) == [f"CryptoObject{i:02d}.{c}" for i in range(2) for c in "RGBA"]
    assert np.array_equal(coverage_of("one", named), np.full((2, 3), 0.5, np.float32))
    assert not coverage_of("two", named).any()


def test_two_names_of_one_id_are_refused(monkeypatch):
    monkeypatch.setattr(cryptomatte, "name_id", lambda name: 7)
    with pytest.raises(ValueError, match="rename"):
        metadata("CryptoObject", ["a", "b"])
