"""The region of interest: the pixels that the virtual objects change, found on the reference alone.

A reference with the objects and one without them are compared; what is near the change is taken in,
so that a shadow in the wrong place counts, while the untouched rest of the photo does not dilute
the error.
"""

from __future__ import annotations

import numpy as np

from mrbatch.errors import InputError
from mrbatch.metrics.errors import Projection, pixel_weights, weighted_mean

SHARE = 0.005
DILATION = 8


def region_of_interest(
    with_objects: np.ndarray,
    without_objects: np.ndarray,
    *,
    share: float = SHARE,
    dilation: float = DILATION,
    projection: Projection = "perspective",
    deviation: np.ndarray | None = None,
    significance: float = 4.0,
) -> np.ndarray:
    """(height, width) bool from two references (height, width, 3), scene-linear, of the same frame.

    A pixel belongs where the largest channel of |with - without| exceeds `share` times the mean of
    `with_objects` (over pixels and channels, by solid angle in a panorama; one scalar, so that a
    coloured light does not move the threshold of a dark channel). All pixels whose centre lies within
    `dilation` pixels (Euclidean) of such a one are added; a panorama is dilated across its seam.

    `deviation`: standard deviation of with - without, like the pictures. Where it is given a channel
    must also exceed `significance` of it: without that, a noisy reference is all region.

    Raises InputError where shapes differ.
    """
    a = np.asarray(with_objects, dtype=np.float64)
    b = np.asarray(without_objects, dtype=np.float64)
    if a.shape != b.shape:
        raise InputError(
            f"the references with and without objects differ in size: {a.shape} and {b.shape}",
            hint="both must show the same frame in the same resolution",
        )
    if a.ndim == 2:
        a, b = a[..., None], b[..., None]
    height, width = a.shape[:2]
    mean = weighted_mean(np.abs(a).mean(axis=2), pixel_weights(height, width, projection))
    threshold = np.full(a.shape, share * mean)
    if deviation is not None:
        threshold = np.maximum(threshold, significance * np.asarray(deviation, np.float64).reshape(a.shape))
    changed = (np.abs(a - b) > threshold).any(axis=2)
    return dilate(changed, dilation, wraps=projection == "equirectangular")


def dilate(mask: np.ndarray, radius: float, *, wraps: bool = False) -> np.ndarray:
    """All pixels whose centre lies within `radius` pixels of one in `mask`, columns wrapped on request."""
    from scipy.ndimage import distance_transform_edt

    mask = np.asarray(mask, dtype=bool)
    if not mask.any() or radius <= 0:
        return mask.copy()
    halo = min(int(np.ceil(radius)), mask.shape[1]) if wraps else 0
    wide = np.pad(mask, ((0, 0), (halo, halo)), mode="wrap") if halo else mask
    near = distance_transform_edt(~wide) <= radius
    return near[:, halo : near.shape[1] - halo]
