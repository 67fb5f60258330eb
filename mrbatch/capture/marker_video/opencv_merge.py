"""OpenCV's merges of exposures behind the same interface, for comparison and for habit.

Both weigh by the code alone and give nothing where every shot is clipped: those pixels are filled in
from the shortest exposure, as in our own merge.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mrbatch.capture.marker_video.response_curve import ResponseCurve
from mrbatch.errors import InputError


def merge_opencv(
    codes: Sequence[np.ndarray], curve: ResponseCurve, seconds: np.ndarray, method: str
) -> np.ndarray:
    """(height, width, 3) float32 radiance, in units of full scale a second.

    `method`: debevec or robertson. `curve`: the response, given to OpenCV. Raises InputError for 16 bits.
    """
    import cv2

    if codes[0].dtype != np.uint8:
        raise InputError(f"OpenCV's {method} merges 8-bit pictures only", hint="use --method variance")
    # OpenCV takes the logarithm of the response: code 0 gets half of code 1's.
    table = curve.table.copy()
    table[0] = 0.5 * table[1]
    response = np.maximum(table, 1e-9).astype(np.float32).reshape(256, 1, 3)
    times = np.asarray(seconds, dtype=np.float32)
    merge = cv2.createMergeDebevec() if method == "debevec" else cv2.createMergeRobertson()
    found = np.asarray(merge.process(list(codes), times, response), dtype=np.float32)
    shortest = int(np.argmin(seconds))
    bound = curve.exposure(codes[shortest]) / np.float32(seconds[shortest])
    return np.where(np.isfinite(found) & (found > 0.0), found, bound)
