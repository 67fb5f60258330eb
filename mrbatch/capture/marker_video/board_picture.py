"""A sheet as a picture at a known resolution: each pixel is as dark as the ink that covers it."""

from __future__ import annotations

import numpy as np

from mrbatch.capture.marker_video.board_sheet import BoardSheet
from mrbatch.errors import JobError

MAX_PIXELS = 2**28


def board_picture(sheet: BoardSheet, dpi: float = 300.0, *, text: bool = True) -> np.ndarray:
    """(height, width) uint8, 255 white. Edges between pixels are grey by exact coverage.

    Raises JobError for a picture of more than `MAX_PIXELS`.
    """
    scale = dpi / 25.4
    width, height = round(sheet.width * scale), round(sheet.height * scale)
    if not 0 < width * height <= MAX_PIXELS:
        raise JobError(f"{dpi:g} dpi give a picture of {width}x{height} pixels", hint="choose fewer dpi")
    ink = np.zeros((height, width), dtype=np.float32)
    for x0, y0, x1, y1 in sheet.rectangles():
        left, across = _coverage(x0 * scale, x1 * scale, width)
        top, down = _coverage(y0 * scale, y1 * scale, height)
        ink[top : top + len(down), left : left + len(across)] += np.outer(down, across)
    picture = np.rint(255.0 * (1.0 - np.clip(ink, 0.0, 1.0))).astype(np.uint8)
    return _with_text(picture, sheet, scale) if text else picture


def _coverage(start: float, end: float, count: int) -> tuple[int, np.ndarray]:
    """First pixel, and the share of it and of each following one that start..end (in pixels) covers."""
    start, end = max(0.0, start), min(float(count), end)
    first, last = int(np.floor(start)), int(np.ceil(end))
    edges = np.arange(first, last + 1, dtype=np.float64)
    return first, np.clip(np.minimum(edges[1:], end) - np.maximum(edges[:-1], start), 0.0, 1.0)


def _with_text(picture: np.ndarray, sheet: BoardSheet, scale: float) -> np.ndarray:
    from PIL import Image, ImageDraw, ImageFont

    image = Image.fromarray(picture)
    draw = ImageDraw.Draw(image)
    for x, y, size, text in sheet.texts:
        font = ImageFont.load_default(size=max(1.0, size * scale))
        draw.text((x * scale, y * scale), text, fill=0, font=font, anchor="ls")
    return np.asarray(image)
