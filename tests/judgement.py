"""What a composite is judged by, against a truth whose noise is not known.

The noise is read off the difference of composite and truth, by a filter that is blind to smooth errors
(`noise_deviation`): that difference holds the noise of the truth, of the photo under the composite, and
ours, and nothing else of high frequency.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mrbatch.metrics.errors import relmse_map
from mrbatch.metrics.region import noise_deviation
from mrbatch.metrics.statistics import TileTest, tile_z_test

HALF_ROUNDING = 2.0**-11


@dataclass(frozen=True)
class Judgement:
    """`spread` (h, w, 3): variance of the difference. `relmse`: on the region, the noise of truth and photo
    included. `beyond`: share of the region's tiles that differ by more than the test's limit."""

    test: TileTest
    spread: np.ndarray
    relmse: float
    beyond: float


def against_truth(
    picture: np.ndarray,
    truth: np.ndarray,
    region: np.ndarray,
    *,
    origin: tuple[int, int] = (0, 0),
    rounding: float = 0.0,
) -> Judgement:
    """Two pictures (h, w, 3) on a region (h, w), whose upper left pixel is `origin` (x, y) of the frame."""
    truth = truth.astype(np.float64)
    spread = noise_deviation(picture - truth) ** 2
    test = tile_z_test(
        picture, truth, spread, region=region, origin=origin, rounding=rounding, confidence=0.99
    )
    relmse = float(relmse_map(picture, truth, float(truth.mean()))[region].mean())
    largest = np.abs(test.z).max(axis=2)
    filled = np.isfinite(largest)
    return Judgement(test, spread, relmse, float((largest[filled] > test.limit).sum() / filled.sum()))
