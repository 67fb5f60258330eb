"""Where in the picture virtual objects can change anything: a mask of decision tiles for each frame.

A tile is done where a virtual object may be seen, or where a real surface is seen whose light a
virtual object may change by half a code value or more. The bound is the light in the cone that
holds all directions from the tile's part of the surface to the object:

    |Delta| <= gain rho / pi (light blocked + light sent) <= gain rho / pi (sum of L dw in the cone
               + solid angle of the cone times the largest radiance the object can send).

No ray is traced for it. Only surfaces that send bounded radiance (diffuse ones) have the second
term; for others the tile is done wherever the object is on the surface's side.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mrbatch.effects.facts import FrameFacts, ShotFacts
from mrbatch.film.window import Window
from mrbatch.scene.camera import Camera
from mrbatch.scene.mesh import Mesh
from mrbatch.scene.scene import SceneObject

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
    near = NEAR_PLANE * max(bounds.radius, np.finfo(np.float32).tiny)
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
    point (only a bound is wanted: `MARGIN` covers its error)."""
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
            xu, yu = (xd - dx) / radial, (yd - dy) / radial
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


def _largest_radiance(item: SceneObject, fluence: np.ndarray, most_albedo: float) -> np.ndarray | None:
    """(3,) bound of the radiance that a virtual object can send, None where there is none.

    A diffuse surface: albedo / pi times its irradiance, at most the light from all directions, and
    what other surfaces return of it as a geometric series.
    """
    if item.material.kind != "diffuse" or most_albedo >= 1.0:
        return None
    return _albedo(item) / np.pi * fluence / (1.0 - most_albedo)


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
    fluence = facts.scene.environment.fluence()
    most_albedo = max(float(_albedo(o).max()) for o in facts.scene.objects)
    threshold = facts.half_code
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
        total = np.zeros((len(tiles), 3))
        for item in virtual:
            if not item.cast_shadow:
                continue
            box = _bounds(item.mesh)
            if plane is not None:
                # Points of a plane change only by what is on the side that the camera sees.
                side = np.sign(camera.world_from_camera[:3, 3] @ plane[0] - plane[1])
                if np.all((box.corners @ plane[0] - plane[1]) * side <= 0):
                    continue
            centre = (low + high) / 2
            radius = np.linalg.norm(high - low, axis=1) / 2 + box.radius
            axis = box.centre - centre
            distance = np.linalg.norm(axis, axis=1)
            with np.errstate(invalid="ignore", divide="ignore"):
                sine = np.where(distance > radius, radius / distance, 1.0)
            cosine = np.where(distance > radius, np.sqrt(np.maximum(1 - sine**2, 0.0)), -1.0)
            unit = np.where(
                distance[:, None] > 0, axis / np.maximum(distance, 1e-300)[:, None], [0.0, 0.0, 1.0]
            )
            sent = _largest_radiance(item, fluence, most_albedo)
            if sent is None or threshold == 0.0:
                total[here] = np.inf
                continue
            unit = np.where(here[:, None], unit, [0.0, 0.0, 1.0])
            blocked = facts.scene.environment.bound_in_cones(unit, np.where(here, cosine, 1.0))
            omega = 2 * np.pi * (1 - cosine)
            # Light of real surfaces that is blocked is at most what they can send, as for virtual ones.
            total += blocked + omega[:, None] * (sent + most_albedo / np.pi * fluence / (1 - most_albedo))
        bound = gain * _albedo(surface) / np.pi * np.where(here[:, None], total, 0.0)
        changed |= np.any(bound > threshold, axis=1)
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
