"""Where in the picture virtual objects can change anything: a mask of decision tiles for each frame.

A tile is done where a virtual object may be seen, or where a real surface is seen whose light a virtual
object may change by half a code value or more (`light_bounds`). No ray is traced for it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mrbatch.effects.facts import FrameFacts, ShotFacts
from mrbatch.effects.light_bounds import Body, Box, Boxes, LightBounds, Side
from mrbatch.film.window import Window
from mrbatch.scene.camera import Camera

MARGIN = 3.0
"""Pixels added around a tile: reconstruction filter, and the bend of a distorted edge within a tile."""
NEAR_PLANE = 2.0**-20
"""Depth in front of the camera, relative to the object's size, below which its outline is not trusted."""


@dataclass(frozen=True)
class Influence:
    """Tiles (units of the window's domain) of one view that have to be done, and in words why not more.

    `seen`: those of `tiles` where something virtual may be seen.
    """

    tiles: np.ndarray
    seen: np.ndarray
    why: str


def screen_rectangle(camera: Camera, bounds: Box) -> tuple[float, float, float, float] | None:
    """Pixels (x0, y0, x1, y1) that a box may cover; everything where it reaches behind the camera; None
    where it is wholly behind."""
    pixels, depth = camera.project_through_rim(bounds.corners)
    near = NEAR_PLANE * max(bounds.radius, float(np.finfo(np.float32).tiny))
    if camera.model != "perspective":
        return (-np.inf, -np.inf, np.inf, np.inf)
    if np.all(depth <= 0):
        return None
    if np.any(depth <= near) or not np.isfinite(pixels).all() or np.any(camera.distortion != 0):
        if np.all(depth > near) and np.any(camera.distortion != 0):
            return _distorted_rectangle(camera, bounds)
        return (-np.inf, -np.inf, np.inf, np.inf)
    (x0, y0), (x1, y1) = pixels.min(axis=(0, 1)), pixels.max(axis=(0, 1))
    return (x0, y0, x1, y1)


def _distorted_rectangle(camera: Camera, bounds: Box) -> tuple[float, float, float, float]:
    # Distortion bends the box's edges: sample its surface densely and widen by the samples' spacing.
    t = np.linspace(0, 1, 9)
    grid = np.stack(np.meshgrid(t, t, t, indexing="ij"), -1).reshape(-1, 3)
    grid = grid[np.any((grid == 0) | (grid == 1), axis=1)]
    pixels, _ = camera.project_through_rim(bounds.low + grid * (bounds.high - bounds.low))
    if not np.isfinite(pixels).all():
        return (-np.inf, -np.inf, np.inf, np.inf)
    (x0, y0), (x1, y1) = pixels.min(axis=(0, 1)), pixels.max(axis=(0, 1))
    sx, sy = (x1 - x0) / 8, (y1 - y0) / 8
    return (x0 - sx, y0 - sy, x1 + sx, y1 + sy)


def _overlaps(tiles: np.ndarray, rectangle: tuple[float, float, float, float] | None) -> np.ndarray:
    if rectangle is None:
        return np.zeros(len(tiles), dtype=bool)
    x0, y0, x1, y1 = rectangle
    return (
        (tiles[:, 0] - MARGIN < x1)
        & (tiles[:, 2] + MARGIN > x0)
        & (tiles[:, 1] - MARGIN < y1)
        & (tiles[:, 3] + MARGIN > y0)
    )


def seen_part(
    camera: Camera, tiles: np.ndarray, bounds: Box, plane: Side | None
) -> tuple[np.ndarray, np.ndarray]:
    """Boxes (n, 3) low and high that hold the part of a surface seen in each of `tiles` (n, 4) pixels
    x0, y0, x1, y1; NaN where none is.

    Where a plane is met is projective in the pixel and in the point of the lens, so the corners of both tell.
    """
    n = len(tiles)
    low = np.broadcast_to(bounds.low, (n, 3)).copy()
    high = np.broadcast_to(bounds.high, (n, 3)).copy()
    if plane is None or camera.model != "perspective":
        return low, high
    normal, offset = plane
    centre = camera.world_from_camera[:3, 3]
    eyes = centre[None]
    if camera.lens is not None:
        eyes = centre + camera.lens.rim @ camera.world_from_camera[:3, :2].T
    x = np.stack([tiles[:, 0], tiles[:, 2], tiles[:, 0], tiles[:, 2]], axis=1).astype(np.float64)
    y = np.stack([tiles[:, 1], tiles[:, 1], tiles[:, 3], tiles[:, 3]], axis=1).astype(np.float64)
    x += np.array([-1, 1, -1, 1]) * MARGIN
    y += np.array([-1, -1, 1, 1]) * MARGIN
    d = camera.directions(np.stack([x.ravel(), y.ravel()], axis=1)) @ camera.world_from_camera[:3, :3].T
    d = d.reshape(n, 4, 1, 3)
    if camera.lens is not None:
        d = centre + camera.lens.focus * d - eyes
    heights = offset - eyes @ normal
    with np.errstate(divide="ignore", invalid="ignore"):
        t = heights / (d @ normal)
    good = np.all(np.isfinite(t) & (t > 0), axis=(1, 2)) & (np.ptp(np.sign(heights)) == 0)
    points = (eyes + t[..., None] * d).reshape(n, 4 * len(eyes), 3)
    size = 8 * np.spacing(np.float32(np.abs(np.stack([bounds.low, bounds.high])).max()))
    low[good] = np.maximum(points[good].min(axis=1) - size, bounds.low)
    high[good] = np.minimum(points[good].max(axis=1) + size, bounds.high)
    # A tile that sees the plane beside the surface sees none of it.
    beside = good & np.any(high < low, axis=1)
    low[beside], high[beside] = np.nan, np.nan
    return low, high


class InfluenceMask:
    """The mask of a shot: what of it is the same for every frame is found once.

    `light_change`: whether the light on real surfaces is simulated at all.
    """

    def __init__(self, facts: ShotFacts, *, light_change: bool) -> None:
        self.facts = facts
        self.light_change = light_change
        self._bounds: LightBounds | None = None

    def bounds(self, time: float, frame: int) -> LightBounds:
        """At a moment of a frame; of a still scene the same for all, and found once."""
        if self._bounds is None or self.facts.scene.moves:
            self._bounds = LightBounds(self.facts.scene.at(time, frame), exact=self.facts.half_code == 0.0)
        return self._bounds

    def tiles(self, frame: FrameFacts, view: str) -> Influence:
        """The tiles of one view of one frame where virtual objects may change something."""
        window: Window = self.facts.windows[view]
        tiles = window.tile_rectangles()
        if self.facts.everywhere:
            every = np.arange(len(tiles), dtype=np.int32)
            return Influence(every, every, "participants may be anywhere")
        if not self.facts.scene.virtual:
            none = np.zeros(0, np.int32)
            return Influence(none, none, "there is no virtual object")
        seen = np.zeros(len(tiles), dtype=bool)
        changed = np.zeros(len(tiles), dtype=bool)
        gain = np.asarray(frame.gains[view], dtype=np.float64)
        receivers = 0
        for moment in frame.looks:
            camera = moment.cameras[view]
            bounds = self.bounds(moment.time, frame.number)
            for body in bounds.virtual:
                if body.item.camera:
                    seen |= _overlaps(tiles, screen_rectangle(camera, body.box))
            for body in bounds.real if self.light_change else ():
                if not (body.item.camera and body.item.receive):
                    continue
                here = _overlaps(tiles, screen_rectangle(camera, body.box))
                if not here.any():
                    continue
                receivers += 1
                # What is known to change, or to be done anyway, needs no bound.
                rows = np.nonzero(here & ~seen & ~changed)[0]
                changed[rows] = self._may_change(bounds, body, camera, tiles[rows], gain)
        ids = np.nonzero(seen | changed)[0].astype(np.int32)
        more = int((changed & ~seen).sum())
        if len(ids) == 0:
            why = (
                "no virtual object is in the frame, and no real surface in it changes by half a code value"
                if receivers
                else "neither a virtual object nor a real surface that receives light is in the frame"
            )
        else:
            why = f"{len(ids)} of {len(tiles)} tiles: objects may be seen in {int(seen.sum())}, "
            why += f"light may change in {more} more"
        return Influence(ids, np.nonzero(seen)[0].astype(np.int32), why)

    def _may_change(
        self, bounds: LightBounds, surface: Body, camera: Camera, tiles: np.ndarray, gain: np.ndarray
    ) -> np.ndarray:
        """(n,): where the light on a surface seen in the tiles may change by half a code value."""
        low, high = seen_part(camera, tiles, surface.box, surface.plane)
        side: Side | None = None
        if surface.plane is not None:
            # Points of a plane see only what is on the side that the camera sees.
            normal, offset = surface.plane
            height = float(camera.world_from_camera[:3, 3] @ normal - offset)
            # A lens that reaches through the plane sees both sides.
            if camera.lens is None or abs(height) > float(np.abs(camera.lens.rim).sum(axis=1).max()):
                sign = float(np.sign(height))
                side = (normal * sign, offset * sign)
        found = np.zeros(len(tiles), dtype=bool)
        there = np.isfinite(low[:, 0])
        bound = bounds.change(surface, Boxes(low[there], high[there]), side)
        found[there] = np.any(gain * bound > self.facts.half_code, axis=1)
        return found
