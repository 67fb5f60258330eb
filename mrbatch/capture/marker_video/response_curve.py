"""The curve between light on the sensor and a picture's codes: a known one, or recovered from a bracket."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mrbatch.errors import InputError
from mrbatch.kernels.transfer import decode_table

CURVES = ("srgb", "bt709", "gamma22", "linear")
"""Known curves, by the names of `capture.colour.transfer`."""


@dataclass(frozen=True, eq=False)
class ResponseCurve:
    """Exposure of each code: `table` (codes, 3) float64, not decreasing, 1 at full scale."""

    name: str
    table: np.ndarray

    def exposure(self, codes: np.ndarray) -> np.ndarray:
        """(..., 3) float32 exposure of codes (..., 3) of an integer type."""
        table = self.table.astype(np.float32)
        return np.stack([table[:, c][codes[..., c]] for c in range(3)], axis=-1)

    def code(self, exposure: np.ndarray) -> np.ndarray:
        """(..., 3) float32 codes, between integers too, of exposures (..., 3); clipped at both ends."""
        codes = np.arange(len(self.table), dtype=np.float64)
        return np.stack(
            [np.interp(exposure[..., c], self.table[:, c], codes) for c in range(3)], axis=-1
        ).astype(np.float32)

    def slope(self, code: np.ndarray) -> np.ndarray:
        """(..., 3) float32 change of exposure with one code, at codes (..., 3) that may be no integers."""
        index = np.clip(np.rint(code), 0, len(self.table) - 1).astype(np.int32)
        return np.stack([self._slopes[:, c][index[..., c]] for c in range(3)], axis=-1)

    @cached_property
    def _slopes(self) -> np.ndarray:
        return np.maximum(np.gradient(self.table, axis=0), 1e-9).astype(np.float32)


def known_curve(name: str, bits: int) -> ResponseCurve:
    """A curve of `CURVES` for pictures of 8 or 16 bits."""
    table = np.asarray(decode_table(name, bits), dtype=np.float64)
    return ResponseCurve(name, np.repeat(table[:, None], 3, axis=1))


def recovered_curve(codes: Sequence[np.ndarray], seconds: Sequence[float]) -> ResponseCurve:
    """The camera's own curve from a bracket with known exposure times (OpenCV's CalibrateDebevec).

    Each channel is scaled to 1 at full scale, and made to rise. Raises InputError for 16-bit codes.
    """
    import cv2

    if codes[0].dtype != np.uint8:
        raise InputError(
            "a curve can be recovered from 8-bit pictures only",
            hint="name the curve: --curve srgb, or linear for a raw conversion",
        )
    found = cv2.createCalibrateDebevec(samples=200, lambda_=20.0, random=False).process(
        list(codes), np.asarray(seconds, dtype=np.float32)
    )
    table = np.maximum.accumulate(np.asarray(found, dtype=np.float64).reshape(256, 3), axis=0)
    table = table / table[-1]
    table[0] = 0.0
    return ResponseCurve("recovered", table)
