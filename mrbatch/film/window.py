"""Which pixels are computed: the data window, and its decision tiles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mrbatch.contracts import TILE, Domain


@dataclass(frozen=True)
class Window:
    """A rectangle of pixels in absolute coordinates; it may reach outside the picture (overscan)."""

    x: int
    y: int
    width: int
    height: int

    @property
    def first_tile(self) -> tuple[int, int]:
        """Column and row of the top left decision tile; tiles count from absolute pixel (0, 0)."""
        return self.x // TILE, self.y // TILE

    @property
    def tiles(self) -> tuple[int, int]:
        """Columns and rows of decision tiles that meet the window."""
        tx, ty = self.first_tile
        return (self.x + self.width - 1) // TILE - tx + 1, (self.y + self.height - 1) // TILE - ty + 1

    @property
    def pixels(self) -> int:
        return self.width * self.height

    def domain(self, view: str = "") -> Domain:
        """The window as the domain of a pass: a unit is one decision tile."""
        columns, rows = self.tiles
        return Domain("pixels", columns * rows, TILE * TILE, self.pixels, view)

    def tile_rectangles(self) -> np.ndarray:
        """(units, 4) int: x0, y0, x1, y1 of each whole tile, absolute, end exclusive.

        Not cut to the window, so that what is decided for a tile does not depend on the crop.
        """
        tx, ty = self.first_tile
        columns, rows = self.tiles
        x0 = (tx + np.arange(columns)) * TILE
        y0 = (ty + np.arange(rows)) * TILE
        gx, gy = np.meshgrid(x0, y0)
        return np.stack([gx, gy, gx + TILE, gy + TILE], axis=-1).reshape(-1, 4)

    def contains(self, other: Window) -> bool:
        return (
            self.x <= other.x
            and self.y <= other.y
            and other.x + other.width <= self.x + self.width
            and other.y + other.height <= self.y + self.height
        )
