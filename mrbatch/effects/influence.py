"""Where in the picture virtual objects can change anything: a mask of decision tiles for each frame.

A tile is done where a virtual object may be seen, or where a real surface is seen whose light a
virtual object may change by half a code value or more. From the tile's part of the surface the object
lies in some cone of directions, and fills a solid angle Omega of it at most, no higher than cos:

    |Delta| <= gain rho / pi cos (light taken away + light sent)
            <= gain rho / pi cos (least of the light in the cone and Omega times its largest radiance
                                  + Omega times the largest radiance that surfaces can send, twice).

What changes on one real surface also changes what it sends to others: they change by no more than
rho times the share G of their hemisphere that real surfaces fill, times the largest change anywhere,

    |Delta| <= direct + rho G sup direct / (1 - largest rho of a real surface).

No ray is traced for it. Where any surface is not diffuse, light can be focused and nothing bounds it:
a tile is then done wherever the object, or a real surface that the object may change, is on its side.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mrbatch.effects.facts import FrameFacts, ShotFacts
from mrbatch.film.window import Window
from mrbatch.scene.camera import Camera
from mrbatch.scene.mesh import Mesh
from mrbatch.scene.scene import Scene, SceneObject

MARGIN = 3.0
"""Pixels added around a tile: reconstruction filter, and the bend of a distorted edge within a tile."""
NEAR_PLANE = 2.0**-20
"""Depth in front of the camera, relative to the object's size, below which its outline is not trusted."""


@dataclass(frozen=True)
class Influence:
    """Tiles (units of the window's domain) of one view that have to be done, and in words why not more."""

    tiles: np.ndarray
    seen: int
    changed: int
    why: str


@dataclass(frozen=True)
class _Bounds:
    low: np.ndarray
    high: np.ndarray

    @property
    def corners(self) -> np.ndarray:
        grid = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij"), -1).reshape(-1, 3)
        return self.low + grid * (self.high - self.low)

    @property
    def centre(self) -> np.ndarray:
        return (self.low + self.high) / 2

    @property
    def radius(self) -> float:
        return float(np.linalg.norm(self.high - self.low)) / 2


@dataclass(frozen=True)
class _Boxes:
    """Boxes (n, 3) that hold parts of a surface."""

    low: np.ndarray
    high: np.ndarray

    def cones(self, bounds: _Bounds) -> tuple[np.ndarray, np.ndarray]:
        """Cones that hold every direction from a point of each box to a point of `bounds`: axes (n, 3),
        cosines of the half angle (n,)."""
        axis = bounds.centre - (self.low + self.high) / 2
        distance = np.linalg.norm(axis, axis=1)
        # From any point of one ball to any point of another.
        radius = np.linalg.norm(self.high - self.low, axis=1) / 2 + bounds.radius
        apart = distance > radius
        with np.errstate(invalid="ignore", divide="ignore"):
            cosine = np.where(apart, np.sqrt(np.maximum(1 - (radius / distance) ** 2, 0.0)), -1.0)
            unit = np.where(distance[:, None] > 0, axis / distance[:, None], [0.0, 0.0, 1.0])
        return unit, cosine

    def reach(self, bounds: _Bounds, height: float) -> tuple[np.ndarray, np.ndarray]:
        """Seen from any one point of each box: the most solid angle (n,) that `bounds` fills, and the
        largest cosine (n,) of a direction there, where it reaches `height` above the box's plane."""
        centre = np.maximum(np.maximum(bounds.centre - self.high, self.low - bounds.centre), 0.0)
        distance = np.linalg.norm(centre, axis=1)
        gap = np.linalg.norm(
            np.maximum(np.maximum(bounds.low - self.high, self.low - bounds.high), 0.0), axis=1
        )
        with np.errstate(invalid="ignore", divide="ignore"):
            sine = np.where(distance > bounds.radius, bounds.radius / distance, 1.0)
            cosine = np.where(gap > 0.0, np.minimum(height / gap, 1.0), 1.0)
        # 1 - cos in a form that keeps its digits for small angles.
        omega = 2 * np.pi * sine**2 / (1 + np.sqrt(1 - sine**2))
        return np.where(distance > bounds.radius, omega, 4 * np.pi), cosine


class _LightBounds:
    """Bounds of the light change on real surfaces of a scene. `unbounded`: any change at all counts."""

    def __init__(self, scene: Scene, *, unbounded: bool) -> None:
        self.light = scene.environment
        self.fluence = scene.environment.fluence()
        self.senders = [o for o in scene.virtual if o.cast_shadow]
        self.real = [o for o in scene.real if o.cast_shadow]
        casting = self.senders + self.real
        albedo = max((float(_albedo(o).max()) for o in casting), default=0.0)
        diffuse = all(o.material.kind == "diffuse" for o in casting)
        # Radiance of a diffuse surface: albedo / pi times its irradiance, which is at most the light from
        # all directions and what other surfaces return of it, a geometric series.
        self.largest = albedo / np.pi * self.fluence / (1 - albedo) if diffuse and albedo < 1 else None
        self.bounded = self.largest is not None and not unbounded
        self.anywhere = np.zeros(3)
        most = max((float(_albedo(o).max()) for o in self.real), default=0.0)
        for o in self.real if self.senders else ():
            if o.receive:
                box = _bounds(o.mesh)
                whole = _Boxes(box.low[None], box.high[None])
                self.anywhere = np.maximum(self.anywhere, self._direct(o, whole, None)[0])
        with np.errstate(divide="ignore", invalid="ignore"):
            self.anywhere = np.where(self.anywhere > 0.0, self.anywhere / (1 - most), 0.0)

    def change(
        self, surface: SceneObject, boxes: _Boxes, side: tuple[np.ndarray, float] | None
    ) -> np.ndarray:
        """(n, 3): no less than |Delta| on the part of `surface` in each box.

        `side`: normal and offset of its plane, the normal towards the side that is seen, or None where it
        is not flat.
        """
        return self._direct(surface, boxes, side) + self._indirect(surface, boxes, side)

    def _direct(
        self, surface: SceneObject, boxes: _Boxes, side: tuple[np.ndarray, float] | None
    ) -> np.ndarray:
        total = np.zeros((len(boxes.low), 3))
        for item in self.senders:
            box = _bounds(item.mesh)
            if side is not None and _height(box, side) <= 0.0:
                continue
            if not self.bounded or surface.material.kind != "diffuse":
                return np.where(_albedo(surface) > 0.0, np.full_like(total, np.inf), 0.0)
            height = np.inf if side is None else _height(box, side)
            omega, slope = boxes.reach(box, height)
            # Taken away: the map's light or what real surfaces behind send. Added: what the object sends.
            taken = self.light.bound_in_cones(*boxes.cones(box), omega)
            total += slope[:, None] * (taken + omega[:, None] * 2 * self.largest)
        return _albedo(surface) / np.pi * total

    def _indirect(
        self, surface: SceneObject, boxes: _Boxes, side: tuple[np.ndarray, float] | None
    ) -> np.ndarray:
        share = np.zeros(len(boxes.low))
        for other in self.real:
            box = _bounds(other.mesh)
            height = np.inf
            if side is not None:
                height = _height(box, side)
                if height <= 4 * np.spacing(np.float32(max(np.abs(box.low).max(), np.abs(box.high).max()))):
                    continue
            omega, slope = boxes.reach(box, height)
            share += np.minimum(slope * omega / np.pi, 1.0)
        factor = np.minimum(share, 1.0)[:, None] * _albedo(surface)
        if surface.material.kind != "diffuse":
            factor = np.where(factor > 0.0, np.inf, 0.0)
        with np.errstate(invalid="ignore"):
            return np.where((factor > 0.0) & (self.anywhere > 0.0), factor * self.anywhere, 0.0)


def _height(bounds: _Bounds, side: tuple[np.ndarray, float]) -> float:
    """How far a box reaches above a plane."""
    return float((bounds.corners @ side[0] - side[1]).max())


def _bounds(mesh: Mesh) -> _Bounds:
    return _Bounds(*mesh.bounds())


def plane_of(mesh: Mesh) -> tuple[np.ndarray, float] | None:
    """Unit normal n and offset c with n . x = c for every vertex, or None where the mesh is not flat.

    Flat within the float32 spacing of its coordinates.
    """
    areas = mesh.face_areas()
    if len(areas) == 0 or areas.max() == 0.0:
        return None
    n = mesh.face_normals()[int(np.argmax(areas))]
    n = n / np.linalg.norm(n)
    used = mesh.vertices[np.unique(mesh.faces)]
    offsets = used @ n
    spacing = np.spacing(np.float32(np.abs(used).max()))
    if offsets.max() - offsets.min() > 4 * spacing:
        return None
    return n, float(offsets.mean())


def screen_rectangle(camera: Camera, bounds: _Bounds) -> tuple[float, float, float, float] | None:
    """Pixels (x0, y0, x1, y1) that a box may cover; everything where it reaches behind the camera; None
    where it is wholly behind."""
    pixels, depth = camera.project(bounds.corners)
    near = NEAR_PLANE * max(bounds.radius, float(np.finfo(np.float32).tiny))
    if camera.model != "perspective":
        return (-np.inf, -np.inf, np.inf, np.inf)
    if np.all(depth <= 0):
        return None
    if np.any(depth <= near) or not np.isfinite(pixels).all() or np.any(camera.distortion != 0):
        if np.all(depth > near) and np.any(camera.distortion != 0):
            return _distorted_rectangle(camera, bounds)
        return (-np.inf, -np.inf, np.inf, np.inf)
    (x0, y0), (x1, y1) = pixels.min(axis=0), pixels.max(axis=0)
    return (x0, y0, x1, y1)


def _distorted_rectangle(camera: Camera, bounds: _Bounds) -> tuple[float, float, float, float]:
    # Distortion bends the box's edges: sample its surface densely and widen by the samples' spacing.
    t = np.linspace(0, 1, 9)
    grid = np.stack(np.meshgrid(t, t, t, indexing="ij"), -1).reshape(-1, 3)
    grid = grid[np.any((grid == 0) | (grid == 1), axis=1)]
    pixels, _ = camera.project(bounds.low + grid * (bounds.high - bounds.low))
    if not np.isfinite(pixels).all():
        return (-np.inf, -np.inf, np.inf, np.inf)
    (x0, y0), (x1, y1) = pixels.min(axis=0), pixels.max(axis=0)
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


def _pixel_directions(camera: Camera, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """World directions of pixels (n, 3), float64, not normalized; distortion undone by Newton-free fixed
    point (only a bound is wanted: `MARGIN` covers its error), NaN where that does not settle to a pixel."""
    k = camera.matrix
    yd = (y - k[1, 2]) / k[1, 1]
    xd = (x - k[0, 2] - k[0, 1] * yd) / k[0, 0]
    k1, k2, p1, p2, k3, k4, k5, k6 = camera.distortion
    xu, yu = xd.copy(), yd.copy()
    if np.any(camera.distortion != 0):
        for _ in range(20):
            r2 = xu * xu + yu * yu
            radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
            dx = 2 * p1 * xu * yu + p2 * (r2 + 2 * xu * xu)
            dy = p1 * (r2 + 2 * yu * yu) + 2 * p2 * xu * yu
            last = xu, yu
            xu, yu = (xd - dx) / radial, (yd - dy) / radial
        moved = np.maximum(np.abs(xu - last[0]) * k[0, 0], np.abs(yu - last[1]) * k[1, 1])
        xu = np.where(moved < 1.0, xu, np.nan)
    local = np.stack([xu, yu, np.ones_like(xu)], axis=-1)
    return local @ camera.world_from_camera[:3, :3].T


def _surface_boxes(
    camera: Camera, tiles: np.ndarray, bounds: _Bounds, plane: tuple[np.ndarray, float] | None
) -> tuple[np.ndarray, np.ndarray]:
    """Boxes (n, 3) low and high that hold the part of a surface seen in each tile."""
    n = len(tiles)
    low = np.broadcast_to(bounds.low, (n, 3)).copy()
    high = np.broadcast_to(bounds.high, (n, 3)).copy()
    if plane is None or camera.model != "perspective":
        return low, high
    normal, offset = plane
    eye = camera.world_from_camera[:3, 3]
    x = np.stack([tiles[:, 0], tiles[:, 2], tiles[:, 0], tiles[:, 2]], axis=1).astype(np.float64)
    y = np.stack([tiles[:, 1], tiles[:, 1], tiles[:, 3], tiles[:, 3]], axis=1).astype(np.float64)
    x += np.array([-1, 1, -1, 1]) * MARGIN
    y += np.array([-1, -1, 1, 1]) * MARGIN
    d = _pixel_directions(camera, x.ravel(), y.ravel()).reshape(n, 4, 3)
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (offset - eye @ normal) / (d @ normal)
    good = np.all(np.isfinite(t) & (t > 0), axis=1)
    points = eye + t[..., None] * d
    size = 8 * np.spacing(np.float32(np.abs(np.stack([bounds.low, bounds.high])).max()))
    low[good] = np.maximum(points[good].min(axis=1) - size, bounds.low)
    high[good] = np.minimum(points[good].max(axis=1) + size, bounds.high)
    # A tile that sees the plane beside the surface sees none of it.
    beside = good & np.any(high < low, axis=1)
    low[beside], high[beside] = np.nan, np.nan
    return low, high


def _albedo(item: SceneObject) -> np.ndarray:
    if item.material.from_photo:
        return np.ones(3)
    if item.material.texture is not None:
        return item.material.texture.pixels.reshape(-1, 3).max(axis=0).astype(np.float64)
    return np.asarray(item.material.reflectance, dtype=np.float64)


def influence(facts: ShotFacts, frame: FrameFacts, view: str, *, light_change: bool) -> Influence:
    """The tiles of one view of one frame where virtual objects may change something.

    `light_change`: whether the light on real surfaces is simulated at all.
    """
    window: Window = facts.windows[view]
    camera = frame.cameras[view]
    tiles = window.tile_rectangles()
    seen = np.zeros(len(tiles), dtype=bool)
    changed = np.zeros(len(tiles), dtype=bool)
    if facts.everywhere:
        return Influence(np.arange(len(tiles), dtype=np.int32), len(tiles), 0, "participants may be anywhere")
    virtual, real = facts.scene.virtual, facts.scene.real
    if not virtual:
        return Influence(np.zeros(0, np.int32), 0, 0, "there is no virtual object")
    for item in virtual:
        if item.camera:
            seen |= _overlaps(tiles, screen_rectangle(camera, _bounds(item.mesh)))
    light = _LightBounds(facts.scene, unbounded=facts.half_code == 0.0 or not light_change)
    gain = np.asarray(frame.gains[view], dtype=np.float64)
    receivers = 0
    for surface in real if light_change else ():
        if not (surface.camera and surface.receive):
            continue
        bounds = _bounds(surface.mesh)
        here = _overlaps(tiles, screen_rectangle(camera, bounds))
        if not here.any():
            continue
        receivers += 1
        plane = plane_of(surface.mesh)
        low, high = _surface_boxes(camera, tiles, bounds, plane)
        here &= np.isfinite(low[:, 0])
        side = None
        if plane is not None:
            # Points of a plane see only what is on the side that the camera sees.
            sign = np.sign(camera.world_from_camera[:3, 3] @ plane[0] - plane[1])
            side = (plane[0] * sign, plane[1] * sign)
        bound = light.change(surface, _Boxes(low[here], high[here]), side)
        changed[here] |= np.any(gain * bound > facts.half_code, axis=1)
    ids = np.nonzero(seen | changed)[0].astype(np.int32)
    if len(ids) == 0:
        why = (
            "no virtual object is in the frame, and no real surface in it changes by half a code value"
            if receivers
            else "neither a virtual object nor a real surface that receives light is in the frame"
        )
    else:
        more = int((changed & ~seen).sum())
        why = f"{len(ids)} of {len(tiles)} tiles: objects may be seen in {int(seen.sum())}, "
        why += f"light may change in {more} more"
    return Influence(ids, int(seen.sum()), int((changed & ~seen).sum()), why)
