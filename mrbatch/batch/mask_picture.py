"""The mask of influence as a picture: the captured frame, with the tiles that are traced standing out."""

from __future__ import annotations

import numpy as np

from mrbatch.batch.framing import framed
from mrbatch.batch.prepare import Prepared
from mrbatch.film.preview import preview_codes
from mrbatch.film.window import Window

DIM = 0.35
"""How much of its brightness is left to what is not traced."""
EDGE = (255, 170, 0)


def mask_picture(prepared: Prepared, number: int) -> np.ndarray:
    """8-bit RGB (height, width, 3) of one frame's data windows, the views side by side.

    Tiles that are not traced are dimmed, and lines divide them from the others. Raises InputError
    where the frame's picture cannot be read.
    """
    data = prepared.capture.frame(number, prepared.shot.table)
    none = np.empty(0, dtype=np.int32)
    made = []
    for name, window in prepared.windows.items():
        photo = framed(data.views[name].background, prepared.display[name], window)
        codes = preview_codes(photo, prepared.facts.transfer)
        ids = prepared.shot.plan.tiles.get((number, name), none)
        made.append(_drawn(codes, window, ids))
    return np.concatenate(made, axis=1)


def _drawn(codes: np.ndarray, window: Window, ids: np.ndarray) -> np.ndarray:
    traced = np.zeros(codes.shape[:2], dtype=bool)
    for x0, y0, x1, y1 in window.tile_rectangles()[ids]:
        rows = slice(max(0, y0 - window.y), max(0, y1 - window.y))
        traced[rows, max(0, x0 - window.x) : max(0, x1 - window.x)] = True
    drawn = np.where(traced[..., None], codes, (DIM * codes).astype(np.uint8))
    edge = np.zeros_like(traced)
    edge[1:] |= traced[1:] != traced[:-1]
    edge[:, 1:] |= traced[:, 1:] != traced[:, :-1]
    drawn[edge] = EDGE
    return drawn
