"""Transfer functions and primaries: code values of a picture to scene-linear Rec.709, and back.

Two ways in, both free of the maths library's last digit, so that every machine gets the same bits:
integer codes go through one float64 table with an entry for each code (`to_linear`); values that
lie between codes, as a YUV matrix makes them, are interpolated in the 16-bit table
(`to_linear_between`; off by less than 1e-9 of full scale).

What is inverted is the *encoding*, as the file names it. A camera's footage tagged bt709 is not
strictly scene-referred (a camera bends the curve to taste), but the inverse of the tagged curve is
the one assumption that a file lets us make; who knows better says so in `colour.transfer`.

Sources: IEC 61966-2-1 (srgb), ITU-R BT.709-6 item 1.2 (bt709; BT.601 and BT.2020 share it),
ITU-R BT.1886 with black at 0 (bt1886), ITU-R BT.2100-2 tables 4 and 5 (pq, hlg).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache

import numpy as np

HLG_WHITE = 0.26496256042100724
"""HLG scene light of a 75 % signal, the reference white of ITU-R BT.2408; it becomes 1.0 here."""
PQ_WHITE = 203.0
"""cd/m2 of reference white in ITU-R BT.2408; it becomes 1.0 here, so PQ reaches 49.26."""

_BT709_BETA = 0.018053968510807
_BT709_ALPHA = 1.09929682680944
_HLG_A = 0.17883277
_HLG_B = 1.0 - 4.0 * _HLG_A
_HLG_C = 0.5 - _HLG_A * math.log(4.0 * _HLG_A)
_PQ_M1, _PQ_M2 = 2610.0 / 16384.0, 2523.0 / 4096.0 * 128.0
_PQ_C1, _PQ_C2, _PQ_C3 = 3424.0 / 4096.0, 2413.0 / 4096.0 * 32.0, 2392.0 / 4096.0 * 32.0


def _srgb_decode(v: float) -> float:
    return v / 12.92 if v <= 0.04045 else ((v + 0.055) / 1.055) ** 2.4


def _srgb_encode(x: np.ndarray) -> np.ndarray:
    return np.where(x <= 0.04045 / 12.92, 12.92 * x, 1.055 * np.power(x, 1.0 / 2.4) - 0.055)


def _bt709_decode(v: float) -> float:
    if v < 4.5 * _BT709_BETA:
        return v / 4.5
    return ((v + (_BT709_ALPHA - 1.0)) / _BT709_ALPHA) ** (1.0 / 0.45)


def _bt709_encode(x: np.ndarray) -> np.ndarray:
    return np.where(x < _BT709_BETA, 4.5 * x, _BT709_ALPHA * np.power(x, 0.45) - (_BT709_ALPHA - 1.0))


def _pq_decode(v: float) -> float:
    p = v ** (1.0 / _PQ_M2)
    return (max(p - _PQ_C1, 0.0) / (_PQ_C2 - _PQ_C3 * p)) ** (1.0 / _PQ_M1) * (10000.0 / PQ_WHITE)


def _pq_encode(x: np.ndarray) -> np.ndarray:
    y = np.power(x * (PQ_WHITE / 10000.0), _PQ_M1)
    return np.power((_PQ_C1 + _PQ_C2 * y) / (1.0 + _PQ_C3 * y), _PQ_M2)


def _hlg_decode(v: float) -> float:
    light = v * v / 3.0 if v <= 0.5 else (math.exp((v - _HLG_C) / _HLG_A) + _HLG_B) / 12.0
    return light / HLG_WHITE


def _hlg_encode(x: np.ndarray) -> np.ndarray:
    light = x * HLG_WHITE
    high = _HLG_A * np.log(np.maximum(12.0 * light - _HLG_B, 1e-30)) + _HLG_C
    return np.where(light <= 1.0 / 12.0, np.sqrt(3.0 * light), high)


def _power(gamma: float) -> tuple[Callable[[float], float], Callable[[np.ndarray], np.ndarray]]:
    return (lambda v: v**gamma), (lambda x: np.power(x, 1.0 / gamma))


_CURVES: dict[str, tuple[Callable[[float], float], Callable[[np.ndarray], np.ndarray]]] = {
    "linear": (lambda v: v, lambda x: x),
    "srgb": (_srgb_decode, _srgb_encode),
    "bt709": (_bt709_decode, _bt709_encode),
    "bt1886": _power(2.4),
    "gamma22": _power(2.2),
    "gamma28": _power(2.8),
    "pq": (_pq_decode, _pq_encode),
    "hlg": (_hlg_decode, _hlg_encode),
}
TRANSFERS = tuple(_CURVES)


def _curve(transfer: str):
    if transfer not in _CURVES:
        raise ValueError(f"unknown transfer function `{transfer}`: expected one of {', '.join(TRANSFERS)}")
    return _CURVES[transfer]


@lru_cache(maxsize=32)
def decode_table(transfer: str, bits: int) -> np.ndarray:
    """(2^bits,) float64: the linear value of each code, code 2^bits - 1 standing for a signal of 1.

    Raises ValueError for an unknown transfer or bits outside 1..16.
    """
    if not 1 <= bits <= 16:
        raise ValueError(f"{bits} bits a code: expected 1 to 16")
    decode = _curve(transfer)[0]
    top = float(2**bits - 1)
    # Python's own arithmetic, not NumPy's: the latter picks its `power` by the machine's instructions.
    table = np.array([decode(code / top) for code in range(2**bits)], dtype=np.float64)
    table.flags.writeable = False
    return table


@lru_cache(maxsize=32)
def _decode_table_32(transfer: str, bits: int) -> np.ndarray:
    table = decode_table(transfer, bits).astype(np.float32)
    table.flags.writeable = False
    return table


@lru_cache(maxsize=8)
def _between_tables(transfer: str) -> tuple[np.ndarray, np.ndarray]:
    table = decode_table(transfer, 16)
    return table.astype(np.float32), np.append(np.diff(table), 0.0).astype(np.float32)


def to_linear(codes: np.ndarray, transfer: str, bits: int) -> np.ndarray:
    """Integer codes of any shape to linear float32, exact to the float's rounding.

    Raises ValueError for codes that are not integers or need more than `bits`.
    """
    if codes.dtype.kind != "u":
        raise ValueError(f"codes must be unsigned integers, not {codes.dtype}")
    if codes.dtype.itemsize * 8 > bits and codes.size and int(codes.max()) >= 2**bits:
        raise ValueError(f"code {int(codes.max())} does not fit into {bits} bits")
    return _decode_table_32(transfer, bits)[codes]


def to_linear_between(signal: np.ndarray, transfer: str) -> np.ndarray:
    """Non-linear signal (float, clipped to 0..1) of any shape to linear float32 by a 2^16 table."""
    table, step = _between_tables(transfer)
    position = np.clip(np.asarray(signal, dtype=np.float32), 0.0, 1.0) * np.float32(65535.0)
    index = position.astype(np.int32)
    position -= index
    position *= step[index]
    position += table[index]
    return position


def encode(linear: np.ndarray, transfer: str) -> np.ndarray:
    """Linear values of any shape, negative ones taken as 0, to the non-linear signal in float64."""
    return _curve(transfer)[1](np.maximum(np.asarray(linear, dtype=np.float64), 0.0))


def from_linear(linear: np.ndarray, transfer: str, bits: int) -> np.ndarray:
    """Linear values of any shape to the nearest code, clipped: uint8 up to 8 bits, uint16 above.

    The inverse of `to_linear` for every code of every transfer. NaN becomes code 0.
    """
    top = 2**bits - 1
    signal = np.nan_to_num(encode(linear, transfer), nan=0.0, posinf=1.0)
    codes = np.floor(np.clip(signal, 0.0, 1.0) * top + 0.5)
    return codes.astype(np.uint8 if bits <= 8 else np.uint16)


_D65 = (0.3127, 0.3290)
PRIMARIES: dict[str, tuple[tuple[float, float], ...]] = {
    "bt709": ((0.64, 0.33), (0.30, 0.60), (0.15, 0.06), _D65),
    "bt601-625": ((0.64, 0.33), (0.29, 0.60), (0.15, 0.06), _D65),
    "bt601-525": ((0.63, 0.34), (0.31, 0.595), (0.155, 0.07), _D65),
    "bt2020": ((0.708, 0.292), (0.170, 0.797), (0.131, 0.046), _D65),
    "p3": ((0.68, 0.32), (0.265, 0.69), (0.15, 0.06), _D65),
}
"""Chromaticities (x, y) of red, green, blue and white."""

_BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])


def xyz_from_rgb(chromaticities) -> np.ndarray:
    """(3, 3) float64 of four (x, y) pairs, red green blue white; white has Y = 1 (SMPTE RP 177)."""
    xyz = np.array([[x / y, 1.0, (1.0 - x - y) / y] for x, y in chromaticities], dtype=np.float64)
    scale = np.linalg.solve(xyz[:3].T, xyz[3])
    return xyz[:3].T * scale


def rec709_from_primaries(chromaticities) -> np.ndarray:
    """(3, 3) float64 from linear RGB of these primaries to linear Rec.709/D65.

    `chromaticities`: a name of `PRIMARIES` or four (x, y) pairs, red green blue white. Exactly the
    identity for Rec.709 itself. A white other than D65 is adapted by Bradford's transform. Derived
    as in SMPTE RP 177. Its inverse leads back (`numpy.linalg.inv`). Raises ValueError for an
    unknown name or primaries on one line.
    """
    if isinstance(chromaticities, str):
        if chromaticities not in PRIMARIES:
            names = ", ".join(PRIMARIES)
            raise ValueError(f"unknown primaries `{chromaticities}`: expected one of {names}")
        chromaticities = PRIMARIES[chromaticities]
    given = np.asarray(chromaticities, dtype=np.float64).reshape(4, 2)
    target = np.asarray(PRIMARIES["bt709"])
    # Files keep chromaticities in float32; what agrees to that is the same primaries.
    if np.all(np.abs(given - target) <= 2.0**-22):
        return np.eye(3)
    if not np.all(np.isfinite(given)) or np.any(given[:, 1] == 0.0):
        raise ValueError("chromaticities must be finite, with y above 0")
    try:
        source = xyz_from_rgb(given)
    except np.linalg.LinAlgError:
        raise ValueError("these primaries lie on one line") from None
    white = source.sum(axis=1)
    to_xyz = xyz_from_rgb(target)
    ratio = (_BRADFORD @ to_xyz.sum(axis=1)) / (_BRADFORD @ white)
    adapt = np.linalg.solve(_BRADFORD, ratio[:, None] * _BRADFORD)
    return np.linalg.solve(to_xyz, adapt @ source)


def to_rec709(linear: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """Linear RGB (..., 3) float32 through a (3, 3) matrix, in float64, back to float32.

    Written out term by term, because the order in which a BLAS adds up differs between machines.
    """
    m = np.asarray(matrix, dtype=np.float64)
    if np.array_equal(m, np.eye(3)):
        return linear
    r, g, b = (linear[..., i].astype(np.float64) for i in range(3))
    return np.stack([m[i, 0] * r + m[i, 1] * g + m[i, 2] * b for i in range(3)], axis=-1).astype(np.float32)
