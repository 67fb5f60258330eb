"""Giving back what a filter takes from the mean.

A filter whose weights depend on values does not keep means: of a few bright samples among many dark ones it
makes too little. What it took away, blurred by `WIDTH` pixels on each object, is given back: after such a
blur noise is next to nothing (variance by 800), a wrong mean is not.
"""

from __future__ import annotations

import numpy as np

WIDTH = 8.0
"""Standard deviation of the blur, pixels."""
CUT = 3.0
REACH = int(WIDTH * CUT)
"""Pixels to each side that the blur reads."""


def mean_kept(change: np.ndarray, weight: np.ndarray, group: np.ndarray) -> np.ndarray:
    """`change` (h, w, 3) with the local mean of each object taken off.

    The blurred change is spread by `weight` (h, w, 3), so that it is light that is given back, with texture
    and coverage. `group` (h, w) int: objects are apart; 0 stays 0.
    """
    from scipy.ndimage import find_objects, gaussian_filter

    def blurred(values: np.ndarray) -> np.ndarray:
        return gaussian_filter(values, (WIDTH, WIDTH, 0), mode="constant", truncate=CUT)

    kept = np.zeros(change.shape)
    numbers, index = np.unique(group, return_inverse=True)
    for number, box in zip(numbers, find_objects(index.reshape(group.shape) + 1)):
        if number == 0:
            continue
        mine = (group[box] == number)[..., None]
        moved = np.where(mine, change[box], 0.0)
        share = np.where(mine, weight[box], 0.0)
        spread = blurred(share)
        back = np.divide(blurred(moved), spread, out=np.zeros(moved.shape), where=spread > 0)
        kept[box] += moved - back * share
    return kept
