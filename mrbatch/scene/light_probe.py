"""The rotation of an environment map from lamps seen in a mirror ball.

The brightest directions of the ball and, as many steradians, of the map are gathered into lamps.
Every pair of lamps in the ball that lies as far apart as a pair in the map gives a rotation (of a map that is
known to be upright, every lamp at the same height gives a turn about +Z); it is kept where the lamps meet,
and judged by how alike the whole ball and the map then look: the correlation of their logarithms, over the
ball's pixels by solid angle. So neither exposure nor clipping of the picture matters. What cannot be told is
refused.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mrbatch.errors import InputError, Place
from mrbatch.scene.environment import Environment
from mrbatch.scene.environment_alignment import MIN_ANGLE, align, angle_to
from mrbatch.scene.mirror_ball import BallPixels

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
LAMP_SHARE = 0.005
"""Share of the sphere that tells how bright lamps are: its brightest half per cent, a disc of 8 degrees."""
LEVEL = 0.3
"""Share of that brightness from which on a direction belongs to a lamp."""
LEAST_CONTRAST = 2.0
"""How many times brighter than the middle of all directions a lamp is."""
CUT = 3.0
"""How many times the middle luminance counts at most where ball and map are compared."""
MERGED = np.radians(6.0)
"""What is nearer together is one lamp."""
WEAKEST = 0.05
"""Share of the strongest lamp's power below which one is left out."""
MOST_LAMPS = 8
LEAST_PIXELS = 700
"""Of the ball, 15 across its radius: in its middle one of them spans 8 degrees there."""
LEAST_LIKENESS, LEAST_MARGIN = 0.6, 0.05
"""Correlation of ball and map, and how much better the best rotation does than any other. Right rotations
reach 0.97 where nothing else is in the way; of a room and 3000 random rotations the best reaches 0.53."""
OTHER = np.radians(10.0)
"""Rotations that differ by more are two answers."""


Patches = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class ProbeAlignment:
    """`world_from_map` (3, 3) float64; `residuals` (n,) radians of the lamps that meet; `likeness`: the
    correlation of ball and map, -1..1; `whole`: enough lamps are seen in full to rest on them alone."""

    world_from_map: np.ndarray
    residuals: np.ndarray
    likeness: float
    whole: bool


@dataclass(frozen=True)
class _Sphere:
    """Directions (n, 3) with luminance and solid angle (n,). `ends` (n,): whether nothing is known beyond."""

    directions: np.ndarray
    luminance: np.ndarray
    solid: np.ndarray
    ends: np.ndarray


@dataclass(frozen=True)
class _Lamps:
    """Directions (n, 3), strongest first; `whole` (n,): not cut by where nothing is known beyond; the
    steradians that they fill, and those of them that clip."""

    directions: np.ndarray
    whole: np.ndarray
    solid: float
    clipped: float


def align_by_ball(
    environment: Environment,
    picture: np.ndarray,
    ball: BallPixels,
    *,
    tolerance: float,
    upright: bool,
    place: Place | None = None,
) -> ProbeAlignment:
    """The rotation of a map, whose own one is not looked at. `picture` (H, W, 3), linear; `tolerance`
    in radians.

    Raises InputError: a ball of few pixels, no lamp in ball or map, lamps that no rotation brings together, a
    map that looks otherwise, two rotations that do as well.
    """
    if len(ball.rows) < LEAST_PIXELS:
        raise InputError(
            f"the mirror ball has {len(ball.rows)} pixels in the picture, fewer than {LEAST_PIXELS}",
            place=place,
            hint="check where it is, or film it from nearer",
        )
    luminance = picture[ball.rows, ball.columns].astype(np.float64) @ LUMINANCE
    seen = _Sphere(ball.directions, luminance, ball.solid_angles, ball.outermost)
    patches = _ball_patches(picture.shape[0], picture.shape[1], ball)
    shown = _lamps(seen, patches, None, "mirror ball", place)
    sky = _sphere_of(environment)
    marks = _lamps(sky, _map_patches(environment), shown, "environment map", place).directions
    world = shown.directions
    look = _Look(environment, seen, sky)
    found = _candidates(marks, world, tolerance, upright)
    if not found:
        raise InputError(
            f"no rotation brings lamps of the map ({len(marks)}) to where the mirror ball shows "
            f"{len(world)} within {np.degrees(tolerance):.2g} degrees",
            place=place,
            hint=_hint(upright, len(world)),
        )
    judged = sorted(((look.likeness(turn), turn) for turn in found), key=lambda pair: -pair[0])
    best, turn = judged[0]
    if best < LEAST_LIKENESS:
        raise InputError(
            f"the mirror ball does not look like the map: correlation {best:.2f} at the best rotation, "
            f"{LEAST_LIKENESS:g} is needed",
            place=place,
            hint="was the map made elsewhere, at another time, or mirrored? Mark directions instead",
        )
    for other, rival in judged[1:]:
        if best - other < LEAST_MARGIN and _apart(turn, rival) > OTHER:
            raise InputError(
                f"two rotations of the map fit the mirror ball as well: correlations {best:.3f} and "
                f"{other:.3f}, {np.degrees(_apart(turn, rival)):.0f} degrees apart",
                place=place,
                hint="mark directions instead" + ("" if upright else ", or say `upright` if the map is"),
            )
    # The middle of a lamp that goes on in the ball's blind spot is somewhere else: it does not count.
    better = _settled(marks, world[shown.whole], turn, tolerance, upright, 1 if upright else 2)
    turn = turn if better is None else better
    near = angle_to(marks @ turn.T, world[:, None]).min(axis=1)
    return ProbeAlignment(turn, near[near <= tolerance], best, better is not None)


def _hint(upright: bool, count: int) -> str:
    if count == 1 and not upright:
        return "one lamp leaves the map free to turn about it: say `upright` if it is, or mark directions"
    return "the map must be made near the ball, of the same light; raise `tolerance`, or mark directions"


def _sphere_of(environment: Environment) -> _Sphere:
    """The map's texels, as it lies in its own frame."""
    height, width = environment.height, environment.width
    edges = np.linspace(0.0, np.pi, height + 1)
    middle = 0.5 * (edges[:-1] + edges[1:])
    if environment.rows == "endpoints":
        middle = np.linspace(0.0, np.pi, height)
        edges = np.concatenate([[0.0], 0.5 * (middle[:-1] + middle[1:]), [np.pi]])
    azimuth = 2.0 * np.pi * (0.5 - (np.arange(width) + 0.5) / width)
    band = -np.diff(np.cos(edges)) * 2.0 * np.pi / width
    z, ring = np.cos(middle), np.sin(middle)
    d = np.stack(
        [
            ring[:, None] * np.cos(azimuth),
            ring[:, None] * np.sin(azimuth),
            np.broadcast_to(z[:, None], (height, width)),
        ],
        axis=-1,
    )
    luminance = environment.radiance.astype(np.float64) @ LUMINANCE
    nowhere = np.zeros(luminance.size, dtype=bool)
    return _Sphere(d.reshape(-1, 3), luminance.ravel(), np.repeat(band, width), nowhere)


def _level(sphere: _Sphere, solid: float) -> float:
    """The luminance that directions of `solid` steradians reach."""
    order = np.argsort(-sphere.luminance, kind="stable")
    at = int(np.searchsorted(np.cumsum(sphere.solid[order]), solid))
    return float(sphere.luminance[order[min(at, len(order) - 1)]])


def _middle(sphere: _Sphere) -> float:
    """The median luminance by solid angle."""
    return _level(sphere, 0.5 * float(sphere.solid.sum()))


def _ball_patches(height: int, width: int, ball: BallPixels) -> Patches:
    """A function from a choice (n,) of the ball's pixels to the number (n,) of each one's patch."""
    from scipy import ndimage

    def patches(chosen: np.ndarray) -> np.ndarray:
        mask = np.zeros((height, width), dtype=bool)
        mask[ball.rows, ball.columns] = chosen
        return ndimage.label(mask, np.ones((3, 3)))[0][ball.rows, ball.columns]

    return patches


def _map_patches(environment: Environment) -> Patches:
    from scipy import ndimage

    def patches(chosen: np.ndarray) -> np.ndarray:
        mask = chosen.reshape(environment.height, environment.width)
        number: np.ndarray = ndimage.label(mask, np.ones((3, 3)))[0]
        for row in np.flatnonzero(mask[:, 0] & mask[:, -1]):  # one patch goes over the seam
            number[number == number[row, -1]] = number[row, 0]
        return number.ravel()

    return patches


def _lamps(sphere: _Sphere, patches: Patches, other: _Lamps | None, what: str, place: Place | None) -> _Lamps:
    """The lamps of a ball or map. `other`: those of another picture of the same light, which fill and clip as
    much, so that both weigh alike. Raises InputError where there are none."""
    middle = _middle(sphere)
    if other is None:
        # Lamps are not all equally bright, and where they are many they fill more than this.
        level = LEVEL * _level(sphere, LAMP_SHARE * float(sphere.solid.sum()))
    else:
        level = _level(sphere, other.solid)
    level = max(level, LEAST_CONTRAST * middle)
    most = float(sphere.luminance.max())
    if not most > LEAST_CONTRAST * middle:
        raise InputError(
            f"no lamp is seen in the {what}: its brightest direction is "
            f"{most / middle if middle > 0.0 else 1.0:.1f} times as bright as the middle of all, more than "
            f"{LEAST_CONTRAST:g} times are needed",
            place=place,
            hint="under an even light the map's turn cannot be seen in a ball: mark directions instead",
        )
    chosen = sphere.luminance >= level
    ceiling = sphere.luminance >= 0.99 * most
    if other is not None and other.clipped > 0.0:
        most = max(_level(sphere, other.clipped), level)
    weight = np.where(chosen, np.minimum(sphere.luminance, most) * sphere.solid, 0.0)
    number = np.where(chosen, patches(chosen), 0)
    count = int(number.max()) + 1
    power = np.bincount(number, weight, count)[1:]  # 0 of a patch that became part of another
    pulls = [np.bincount(number, weight * sphere.directions[:, k], count)[1:] for k in range(3)]
    sums, cut = np.stack(pulls, axis=1), np.bincount(number, sphere.ends, count)[1:] > 0
    lamps: list[tuple[float, np.ndarray, bool]] = []
    for i in (i for i in np.argsort(-power, kind="stable") if power[i] > 0.0):
        # Patches of one lamp, round a pole or on both sides of the ball's blind spot, are one.
        for j, (strength, total, broken) in enumerate(lamps):
            if angle_to(total, sums[i]) < MERGED:
                lamps[j] = (strength + power[i], total + sums[i], broken or bool(cut[i]))
                break
        else:
            lamps.append((float(power[i]), sums[i], bool(cut[i])))
    lamps.sort(key=lambda lamp: -lamp[0])
    kept = [lamp for lamp in lamps if lamp[0] >= WEAKEST * lamps[0][0]][:MOST_LAMPS]
    return _Lamps(
        np.array([total / np.linalg.norm(total) for _, total, _ in kept]),
        np.array([not broken for _, _, broken in kept]),
        float(sphere.solid[chosen].sum()),
        float(sphere.solid[ceiling].sum()),
    )


def _candidates(marks: np.ndarray, world: np.ndarray, tolerance: float, upright: bool) -> list[np.ndarray]:
    """Rotations (3, 3) under which lamps of the map lie where the ball shows some."""
    found = []
    if upright:
        pairs = itertools.product(range(len(world)), range(len(marks)))
        for i, k in pairs:
            first = _settled(
                marks, world, _about_z(marks[k : k + 1], world[i : i + 1]), tolerance, upright, 1
            )
            found += [] if first is None else [first]
        return found
    for i, j in itertools.combinations(range(len(world)), 2):
        for k, m in itertools.permutations(range(len(marks)), 2):
            apart, there = angle_to(world[i], world[j]), angle_to(marks[k], marks[m])
            if abs(apart - there) > 2.0 * tolerance or not MIN_ANGLE < apart < np.pi - MIN_ANGLE:
                continue
            if not MIN_ANGLE < there < np.pi - MIN_ANGLE:
                continue
            turn = align(marks[[k, m]], world[[i, j]]).world_from_map
            first = _settled(marks, world, turn, tolerance, upright, 2)
            found += [] if first is None else [first]
    return found


def _about_z(marks: np.ndarray, world: np.ndarray) -> np.ndarray:
    """The turn about +Z that brings the one (n, 3) nearest to the other."""
    sine = np.sum(marks[:, 0] * world[:, 1] - marks[:, 1] * world[:, 0])
    cosine = np.sum(marks[:, 0] * world[:, 0] + marks[:, 1] * world[:, 1])
    c, s = np.array([cosine, sine]) / max(np.hypot(cosine, sine), 1e-300)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _settled(
    marks: np.ndarray, world: np.ndarray, turn: np.ndarray, tolerance: float, upright: bool, least: int
) -> np.ndarray | None:
    """The least squares fit to all lamps that a first turn brings together; None for fewer than `least`."""
    if len(world) < least:
        return None
    for _ in range(3):
        off = angle_to(marks @ turn.T, world[:, None])
        nearest = off.argmin(axis=1)
        met = off.min(axis=1) <= tolerance
        if met.sum() < least:
            return None
        a, b = marks[nearest[met]], world[met]
        try:
            turn = _about_z(a, b) if upright else align(a, b).world_from_map
        except ValueError:
            return None
    off = angle_to(marks @ turn.T, world[:, None]).min(axis=1)
    return turn if (off <= tolerance).sum() >= least else None


def _apart(a: np.ndarray, b: np.ndarray) -> float:
    """Angle in radians of the rotation between two."""
    return float(np.arccos(np.clip(0.5 * (np.trace(a.T @ b) - 1.0), -1.0, 1.0)))


class _Look:
    """How alike a ball's pixels and the map are under a rotation."""

    def __init__(self, environment: Environment, seen: _Sphere, sky: _Sphere):
        # Both are cut at a few times the middle, where the picture clips at the latest: lamps weigh no more
        # than all the rest.
        middle = _middle(seen)
        cut = min(CUT, float(seen.luminance.max()) / middle)
        self.weight = seen.solid / seen.solid.sum()
        self.directions = seen.directions
        self.rows = environment.rows
        luminance = (environment.radiance.astype(np.float64) @ LUMINANCE).clip(max=cut * _middle(sky))
        self.map = self._logarithm(luminance)
        self.ball = self._centred(self._logarithm(seen.luminance.clip(max=cut * middle)))

    @staticmethod
    def _logarithm(values: np.ndarray) -> np.ndarray:
        # What is darker than a fiftieth of the cut is noise.
        return np.log(values + 0.02 * values.max())

    def _centred(self, values: np.ndarray) -> np.ndarray:
        values = values - self.weight @ values
        spread = np.sqrt(self.weight @ values**2)
        return values / spread if spread > 0.0 else values

    def likeness(self, turn: np.ndarray) -> float:
        """Correlation over the ball, by solid angle."""
        d = self.directions @ turn
        height, width = self.map.shape
        u = 0.5 - np.arctan2(d[:, 1], d[:, 0]) / (2.0 * np.pi)
        v = np.arccos(np.clip(d[:, 2], -1.0, 1.0)) / np.pi
        row = v * height if self.rows == "centres" else v * (height - 1) + 0.5
        values = self.map[
            np.clip(row.astype(int), 0, height - 1), np.clip((u * width).astype(int), 0, width - 1)
        ]
        return float(self.weight @ (self.ball * self._centred(values)))
