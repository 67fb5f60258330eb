"""Output pixels: scale, crop and overscan of a view, and its background on them."""

from __future__ import annotations

import numpy as np

from mrbatch.errors import JobError
from mrbatch.film.window import Window
from mrbatch.job.model import Output
from mrbatch.scene.camera import Camera


def display_size(output: Output, camera: Camera) -> tuple[int, int]:
    """Width and height of the whole output picture."""
    width = max(1, round(camera.width * output.scale))
    height = max(1, round(camera.height * output.scale))
    return width, height


def data_window(output: Output, display: tuple[int, int]) -> Window:
    """The pixels that are rendered. Raises JobError for a crop that leaves the picture."""
    width, height = display
    if output.crop is not None:
        x, y, w, h = output.crop
        if x + w > width or y + h > height:
            raise JobError(
                f"the crop {x},{y},{w},{h} leaves the picture of {width} x {height} pixels",
                hint="give X,Y,W,H inside the picture",
            )
        window = Window(x, y, w, h)
    else:
        window = Window(0, 0, width, height)
    o = output.overscan
    return Window(window.x - o, window.y - o, window.width + 2 * o, window.height + 2 * o)


def framed(picture: np.ndarray, display: tuple[int, int], window: Window) -> np.ndarray:
    """A captured picture (h, w[, c]) on the data window: resampled by area where the size differs, black
    beyond its edges, and the very values where it does not differ."""
    width, height = display
    if picture.shape[:2] != (height, width):
        import cv2

        smaller = width <= picture.shape[1] and height <= picture.shape[0]
        picture = cv2.resize(
            picture, (width, height), interpolation=cv2.INTER_AREA if smaller else cv2.INTER_LINEAR
        )
    out = np.zeros((window.height, window.width, *picture.shape[2:]), dtype=picture.dtype)
    x0, y0 = max(window.x, 0), max(window.y, 0)
    x1, y1 = min(window.x + window.width, width), min(window.y + window.height, height)
    if x1 > x0 and y1 > y0:
        out[y0 - window.y : y1 - window.y, x0 - window.x : x1 - window.x] = picture[y0:y1, x0:x1]
    return out
