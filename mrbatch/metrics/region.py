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
    changed = np.any(np.abs(a - b) > threshold, axis=2)
    return dilate(changed, dilation, wraps=projection == "equirectangular")


def changed_region(
    picture: np.ndarray,
    without_objects: np.ndarray,
    variance: np.ndarray,
    *,
    share: float = SHARE,
    dilation: float = DILATION,
    window: int = 7,
    significance: float = 3.0,
) -> np.ndarray:
    """`region_of_interest` of a picture that is still noisy, over the photo, which is not.

    `variance` (height, width, 3) of the picture's noise. A pixel belongs where the change stands out by
    itself, or averaged over `window` x `window` pixels, so that wide and faint changes are found with few
    samples.
    """
    from scipy.ndimage import uniform_filter

    change = np.asarray(picture, dtype=np.float64) - without_objects
    threshold = share * float(np.abs(picture).mean())
    found = np.zeros(change.shape, dtype=bool)
    for size in (1, window):
        box = (size, size, 1)
        mean = uniform_filter(change, box) if size > 1 else change
        noise = uniform_filter(variance, box) if size > 1 else variance
        found |= np.abs(mean) > np.maximum(threshold, significance * np.sqrt(np.maximum(noise, 0.0)) / size)
    return dilate(np.any(found, axis=2), dilation)


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


def noisy_region_of_interest(
    with_objects: np.ndarray,
    without_objects: np.ndarray,
    *,
    share: float = SHARE,
    dilation: float = DILATION,
    projection: Projection = "perspective",
    window: int = 7,
    significance: float = 5.0,
) -> np.ndarray:
    """`region_of_interest` of two references rendered with noise of their own.

    Where both pictures carry a per cent of independent noise, the plain rule takes nearly every pixel.
    Here |with - without| is averaged over `window` x `window` pixels and must exceed both the threshold
    and `significance` times the noise left in that average; the noise is read off the difference itself
    (`noise_deviation`). A firefly or a chance finding is smaller than the window and is opened away.
    Changes narrower than the window and fainter than its noise are missed.
    """
    from scipy.ndimage import binary_opening, uniform_filter

    a = np.asarray(with_objects, dtype=np.float64)
    b = np.asarray(without_objects, dtype=np.float64)
    if a.shape != b.shape:
        return region_of_interest(a, b)
    if a.ndim == 2:
        a, b = a[..., None], b[..., None]
    wraps = projection == "equirectangular"
    mode = ("reflect", "wrap" if wraps else "reflect", "reflect")
    smooth = uniform_filter(a - b, (window, window, 1), mode=mode)
    deviation = noise_deviation(a - b, wraps=wraps) / window
    # The mean of the pictures, not of their smoothed difference, scales the threshold.
    mean = weighted_mean(np.abs(a).mean(axis=2), pixel_weights(a.shape[0], a.shape[1], projection))
    changed = np.any(np.abs(smooth) > np.maximum(share * mean, significance * deviation), axis=2)
    changed = binary_opening(changed, np.ones((3, 3), bool))
    return dilate(changed, dilation, wraps=wraps)


def noise_deviation(picture: np.ndarray, *, window: int = 15, wraps: bool = False) -> np.ndarray:
    """Standard deviation of pixel noise around each pixel, (height, width, channels) float64.

    Immerkaer's filter (1996), blind to planes and to straight edges along rows and columns; of its
    response the root mean square over `window` x `window` pixels is taken (his mean of magnitudes
    assumes Gaussian noise). Texture counts as noise.
    """
    from scipy.ndimage import correlate1d, uniform_filter

    a = np.asarray(picture, dtype=np.float64)
    a = a[..., None] if a.ndim == 2 else a
    across = "wrap" if wraps else "reflect"
    second = np.array([1.0, -2.0, 1.0])
    response = correlate1d(correlate1d(a, second, axis=0, mode="reflect"), second, axis=1, mode=across) / 6.0
    square = uniform_filter(response**2, (window, window, 1), mode=("reflect", across, "reflect"))
    return np.sqrt(np.maximum(square, 0.0))
