"""Cryptomatte: mattes by name, with soft edges, in ordinary channels.

After "Cryptomatte Specification" 1.2.0 (Psyop, 2018; first shown by Friedman and Jones, "Fully
automatic ID mattes with support for motion blur and transparency", SIGGRAPH 2015 posters). A name
is hashed to 32 bits with MurmurHash3_x86_32; the bits are stored as a float32. Each pixel holds
pairs of (id, coverage), the largest coverage first, two pairs to each set of four channels.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping

import numpy as np

OBJECT = "CryptoObject"
MATERIAL = "CryptoMaterial"
RANKS = 6
"""Pairs a pixel keeps; the specification's usual depth, three sets of four channels."""

_MASK = 0xFFFFFFFF


def murmur3_32(data: bytes, seed: int = 0) -> int:
    """MurmurHash3_x86_32 (Appleby, public domain) of `data`, unsigned."""
    h = seed & _MASK
    whole = len(data) - len(data) % 4
    for i in range(0, whole, 4):
        k = int.from_bytes(data[i : i + 4], "little")
        h ^= _scramble(k)
        h = ((h << 13) | (h >> 19)) & _MASK
        h = (h * 5 + 0xE6546B64) & _MASK
    if tail := data[whole:]:
        h ^= _scramble(int.from_bytes(tail, "little"))
    h ^= len(data)
    h ^= h >> 16
    h = (h * 0x85EBCA6B) & _MASK
    h ^= h >> 13
    h = (h * 0xC2B2AE35) & _MASK
    return h ^ (h >> 16)


def _scramble(k: int) -> int:
    k = (k * 0xCC9E2D51) & _MASK
    k = ((k << 15) | (k >> 17)) & _MASK
    return (k * 0x1B873593) & _MASK


def name_id(name: str) -> int:
    """The 32 bits that stand for a name in pixels.

    The hash of its UTF-8 bytes; where these bits would be a float that is denormal, infinite or NaN
    (exponent 0 or 255), the lowest bit of the exponent is turned over. So 0 never stands for a name:
    it means that nothing is there.
    """
    bits = murmur3_32(name.encode("utf-8"))
    if (bits >> 23) & 255 in (0, 255):
        bits ^= 1 << 23
    return bits


def ranked(ids: np.ndarray, coverage: np.ndarray, ranks: int = RANKS) -> np.ndarray:
    """Pairs sorted for storage: (h, w, 2 * ranks) float32, id bits and coverage in turn.

    `ids` (h, w, k) uint32 from `name_id`, 0 for none, in any order and repeated at will; `coverage`
    (h, w, k), 0..1. Pairs of one id are added up in float64; the largest coverage comes first, equal
    ones by id, so that the order is a function of the pixel alone. What does not fit is dropped.
    """
    ids = np.ascontiguousarray(ids, dtype=np.uint32)
    height, width, k = ids.shape
    amount = np.where(ids == 0, 0.0, np.asarray(coverage, dtype=np.float64))
    order = np.argsort(ids, axis=-1, kind="stable")
    ids = np.take_along_axis(ids, order, axis=-1)
    amount = np.take_along_axis(amount, order, axis=-1)
    for i in range(1, k):  # moves the sum of each run of equal ids to its last place
        same = ids[..., i] == ids[..., i - 1]
        amount[..., i] += np.where(same, amount[..., i - 1], 0.0)
        amount[..., i - 1] = np.where(same, 0.0, amount[..., i - 1])
    order = np.argsort(-amount, axis=-1, kind="stable")[..., :ranks]
    best = np.take_along_axis(amount, order, axis=-1)
    out = np.zeros((height, width, 2 * ranks), dtype=np.float32)
    used = order.shape[-1]
    out[..., 1 : 2 * used : 2] = best
    named = np.where(best > 0.0, np.take_along_axis(ids, order, axis=-1), 0).astype(np.uint32)
    # A float32 view keeps the bits; a conversion would not.
    out.view(np.uint32)[..., 0 : 2 * used : 2] = named
    return out


def channels(layer: str, pairs: np.ndarray) -> dict[str, np.ndarray]:
    """Channels `LAYER00.R` ... of what `ranked` gave, in order."""
    named = {}
    for i in range(pairs.shape[-1]):
        named[f"{layer}{i // 4:02d}.{'RGBA'[i % 4]}"] = pairs[..., i]
    if pairs.shape[-1] % 4:
        for letter in "BA":
            named[f"{layer}{pairs.shape[-1] // 4:02d}.{letter}"] = np.zeros_like(pairs[..., 0])
    return named


def metadata(layer: str, names: Iterable[str]) -> dict[str, str]:
    """The attributes that tell readers of a Cryptomatte layer, its hash and its names.

    Raises ValueError where two names have one id.
    """
    manifest: dict[str, str] = {}
    owner: dict[int, str] = {}
    for name in sorted(set(names)):
        bits = name_id(name)
        if bits in owner:
            raise ValueError(f"Cryptomatte ids of `{owner[bits]}` and `{name}` are equal: rename one")
        owner[bits] = name
        manifest[name] = f"{bits:08x}"
    key = f"cryptomatte/{murmur3_32(layer.encode('utf-8')):08x}"[: len("cryptomatte/") + 7]
    return {
        f"{key}/name": layer,
        f"{key}/hash": "MurmurHash3_32",
        f"{key}/conversion": "uint32_to_float32",
        f"{key}/manifest": json.dumps(manifest, ensure_ascii=False, separators=(",", ":")),
    }


def coverage_of(name: str, layer_channels: Mapping[str, np.ndarray], layer: str = OBJECT) -> np.ndarray:
    """The matte (h, w) of one name out of a file's channels: what a compositor's node would give."""
    wanted = name_id(name)
    total: np.ndarray | None = None
    i = 0
    while f"{layer}{i:02d}.R" in layer_channels:
        for id_letter, amount_letter in ("RG", "BA"):
            bits = np.ascontiguousarray(layer_channels[f"{layer}{i:02d}.{id_letter}"], dtype=np.float32)
            amount = layer_channels[f"{layer}{i:02d}.{amount_letter}"]
            part = np.where(bits.view(np.uint32) == wanted, amount, np.float32(0))
            total = part if total is None else total + part
        i += 1
    if total is None:
        raise KeyError(layer)
    return total
