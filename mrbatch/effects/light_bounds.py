"""How much the light on a real surface can change, at most: closed bounds, without a ray.

From a part of a surface a virtual object lies in some cone of directions, and fills a solid angle Omega of
it at most, no higher than cos:

    |Delta| <= rho / pi cos (light taken away + light sent)
            <= rho / pi cos (least of the light in the cone and Omega times its largest radiance
                             + Omega times the largest radiance that surfaces can send, twice).

What changes on one real surface also changes what it sends to others: they change by no more than
rho times the share G of their hemisphere that real surfaces fill, times the largest change anywhere,

    |Delta| <= direct + rho G sup direct / (1 - largest rho of a real surface).

No surface sends more radiance than the brightest of the map, unless one emits: what scatters light here only
loses of it. So metal, which focuses light, and surfaces whose reflectance is not known, are bounded too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mrbatch.scene.mesh import plane_of
from mrbatch.scene.scene import Scene, SceneObject

Side = tuple[np.ndarray, float]
"""Normal (3,) and offset of a plane, the normal towards the side that is looked at."""


@dataclass(frozen=True)
class Box:
    """Axis-aligned, corners (3,) in world metres."""

    low: np.ndarray
    high: np.ndarray

    @cached_property
    def corners(self) -> np.ndarray:
        """(8, 3)."""
        grid = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij"), -1).reshape(-1, 3)
        return self.low + grid * (self.high - self.low)

    @property
    def centre(self) -> np.ndarray:
        return (self.low + self.high) / 2

    @property
    def radius(self) -> float:
        return float(np.linalg.norm(self.high - self.low)) / 2

    def height_above(self, side: Side) -> float:
        """How far the box reaches above a plane."""
        return float((self.corners @ side[0] - side[1]).max())


@dataclass(frozen=True)
class Boxes:
    """Boxes (n, 3) that hold parts of a surface."""

    low: np.ndarray
    high: np.ndarray

    def cones(self, box: Box) -> tuple[np.ndarray, np.ndarray]:
        """Cones that hold every direction from a point of each box to a point of `box`: axes (n, 3),
        cosines of the half angle (n,)."""
        axis = box.centre - (self.low + self.high) / 2
        distance = np.linalg.norm(axis, axis=1)
        # From any point of one ball to any point of another.
        radius = np.linalg.norm(self.high - self.low, axis=1) / 2 + box.radius
        apart = distance > radius
        with np.errstate(invalid="ignore", divide="ignore"):
            cosine = np.where(apart, np.sqrt(np.maximum(1 - (radius / distance) ** 2, 0.0)), -1.0)
            unit = np.where(distance[:, None] > 0, axis / distance[:, None], [0.0, 0.0, 1.0])
        return unit, cosine

    def reach(self, box: Box, height: float) -> tuple[np.ndarray, np.ndarray]:
        """Seen from any one point of each of these: the most solid angle (n,) that `box` fills, and the
        largest cosine (n,) of a direction there, where it reaches `height` above their plane."""
        centre = np.maximum(np.maximum(box.centre - self.high, self.low - box.centre), 0.0)
        distance = np.linalg.norm(centre, axis=1)
        gap = np.linalg.norm(np.maximum(np.maximum(box.low - self.high, self.low - box.high), 0.0), axis=1)
        with np.errstate(invalid="ignore", divide="ignore"):
            sine = np.where(distance > box.radius, box.radius / distance, 1.0)
            cosine = np.where(gap > 0.0, np.minimum(height / gap, 1.0), 1.0)
        # 1 - cos in a form that keeps its digits for small angles.
        omega = 2 * np.pi * sine**2 / (1 + np.sqrt(1 - sine**2))
        return np.where(distance > box.radius, omega, 4 * np.pi), cosine


@dataclass(frozen=True)
class Body:
    """What bounds need of an object, found once: its box, its plane if it is flat, the most it reflects."""

    item: SceneObject
    box: Box
    plane: Side | None
    albedo: np.ndarray


def most_emission(items: Sequence[SceneObject]) -> np.ndarray:
    """(3,): what none of the objects emits more than."""
    return np.max([o.material.most_emission for o in items] or [np.zeros(3)], axis=0)


def body_of(item: SceneObject) -> Body:
    return Body(item, Box(*item.mesh.bounds()), plane_of(item.mesh), _albedo(item))


def _albedo(item: SceneObject) -> np.ndarray:
    if item.material.from_photo:
        return np.ones(3)
    if item.material.texture is not None:
        return item.material.texture.pixels.reshape(-1, 3).max(axis=0).astype(np.float64)
    return np.asarray(item.material.reflectance, dtype=np.float64)


class LightBounds:
    """Bounds of the light change on the real surfaces of a scene.

    `exact`: there is no smallest step below which a change does not count, so that any change at all does.
    """

    def __init__(self, scene: Scene, *, exact: bool) -> None:
        self.exact = exact
        self.light = scene.environment
        self.virtual = [body_of(o) for o in scene.virtual]
        self.real = [body_of(o) for o in scene.real]
        self.senders = [b for b in self.virtual if b.item.cast_shadow]
        self.walls = [b for b in self.real if b.item.cast_shadow]
        self.ceiling = self._most_anywhere()
        """(3,): no surface sends more."""
        self.sent = self._most_sent()
        self.anywhere = self._most_change()

    def _most_anywhere(self) -> np.ndarray:
        """No surface returns more than it gets; where one emits, what goes to and fro adds up as a series."""
        most = self.light.most_radiance()
        emitted = most_emission([b.item for b in self.virtual + self.real])
        if not emitted.any():
            return most
        albedo = max((float(b.albedo.max()) for b in self.senders + self.walls), default=0.0)
        if albedo >= 1.0 or any(b.item.material.kind != "diffuse" for b in self.senders):
            return np.full(3, np.inf)
        return (most + emitted) / (1.0 - albedo)

    def _most_sent(self) -> np.ndarray:
        """(3,): the largest radiance that any surface sends to another."""
        casting = self.senders + self.walls
        albedo = max((float(b.albedo.max()) for b in casting), default=0.0)
        if any(b.item.material.kind != "diffuse" for b in casting) or albedo >= 1.0:
            return self.ceiling
        # Of a diffuse surface: albedo / pi times its irradiance, which is at most the map's and what other
        # surfaces return of it, a geometric series.
        emitted = most_emission([b.item for b in casting])
        series = (emitted + albedo / np.pi * self.light.most_irradiance()) / (1 - albedo)
        return np.minimum(series, self.ceiling)

    def _most_change(self) -> np.ndarray:
        """(3,): the largest change of radiance on any real surface that others see."""
        most = max((float(b.albedo.max()) for b in self.walls), default=0.0)
        direct = np.zeros(3)
        for body in self.walls if self.senders else ():
            if body.item.receive:
                whole = Boxes(body.box.low[None], body.box.high[None])
                direct = np.maximum(direct, self._direct(body, whole, None)[0])
        with np.errstate(divide="ignore", invalid="ignore"):
            series = np.where(direct > 0.0, direct / (1 - most), 0.0)
        return series if self.exact else np.minimum(series, self.ceiling)

    def change(self, surface: Body, boxes: Boxes, side: Side | None) -> np.ndarray:
        """(n, 3): no less than |Delta| on the part of `surface` in each box.

        `side`: the plane of the surface, towards the side that is seen, or None where it is not flat.
        """
        return self._direct(surface, boxes, side) + self._indirect(surface, boxes, side)

    def _direct(self, surface: Body, boxes: Boxes, side: Side | None) -> np.ndarray:
        total = np.zeros((len(boxes.low), 3))
        for body in self.senders:
            height = np.inf if side is None else body.box.height_above(side)
            if height <= 0.0:
                continue
            if surface.item.material.kind != "diffuse":
                # A highlight may show any of the map, and stands on a black base too.
                return np.full_like(total, np.inf)
            if self.exact:
                return np.where(surface.albedo > 0.0, np.full_like(total, np.inf), 0.0)
            omega, slope = boxes.reach(body.box, height)
            # Taken away: the map's light or what real surfaces behind send. Added: what the object sends.
            taken = self.light.bound_in_cones(*boxes.cones(body.box), omega)
            total += slope[:, None] * (taken + omega[:, None] * 2 * self.sent)
        return surface.albedo / np.pi * total

    def _indirect(self, surface: Body, boxes: Boxes, side: Side | None) -> np.ndarray:
        share = np.zeros(len(boxes.low))
        for body in self.walls:
            height = np.inf
            if side is not None:
                height = body.box.height_above(side)
                if height <= 4 * np.spacing(np.float32(np.abs(body.box.corners).max())):
                    continue
            omega, slope = boxes.reach(body.box, height)
            share += np.minimum(slope * omega / np.pi, 1.0)
        factor = np.minimum(share, 1.0)[:, None] * surface.albedo
        if surface.item.material.kind != "diffuse":
            factor = np.where(share[:, None] > 0.0, np.full_like(factor, np.inf), 0.0)
        with np.errstate(invalid="ignore"):
            return np.where((factor > 0.0) & (self.anywhere > 0.0), factor * self.anywhere, 0.0)
