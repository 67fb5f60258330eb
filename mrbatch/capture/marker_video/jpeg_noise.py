"""What a JPEG file's own tables say of its noise.

JPEG rounds each coefficient of an 8x8 block's cosine transform to a multiple of a step; the file holds the
steps (ITU-T T.81, A.3.4). Rounding errs evenly within a step where much is going on in a block; where
little is, most coefficients are 0 and err by less. So steps bound the noise of a block from above.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

_RGB_FROM_YCC = np.array([[1.0, 0.0, 1.402], [1.0, -0.344136, -0.714136], [1.0, 1.772, 0.0]])
"""JFIF's matrix (ITU-R BT.601)."""


def quantisation_noise(path: Path) -> tuple[float, float, float] | None:
    """Standard deviations of red, green and blue codes in a busy block; None for all but JPEGs of colours.

    The transform keeps the sum of squares, so a pixel's variance is the mean of step^2 / 12 over the 64
    coefficients.
    """
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(path) as picture:
            tables = getattr(picture, "quantization", None)
            layers = getattr(picture, "layer", None)
            if picture.mode != "RGB" or not tables or not layers or len(layers) != 3:
                return None
            steps = [np.asarray(tables[layer[3]], dtype=np.float64) for layer in layers]
    except (UnidentifiedImageError, OSError, KeyError, ValueError, Image.DecompressionBombError):
        return None
    variance = np.array([np.mean(s**2) / 12.0 for s in steps])
    red, green, blue = np.sqrt((_RGB_FROM_YCC**2) @ variance)
    return float(red), float(green), float(blue)
