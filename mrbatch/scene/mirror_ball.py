"""What a mirror ball in a picture reflects, and from where.

A pixel's ray d meets the ball, seen as a cone about its axis, at a point with normal n; what is seen there
comes from r = d - 2 (d . n) n. With the ball's radius as unit of length its centre is at 1 / sin(half the
angle that it is seen under), so neither its size nor its distance has to be known. This is the law of
reflection under perspective: the usual shortcut of a ball seen from infinitely far away (n from the place in
the circle alone) is off by the angle at which the ball stands beside the picture's axis, and more.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mrbatch.scene.camera import Camera

LEAST_COSINE = 0.15
"""Of the angle at which a ray meets the ball: nearer to its rim a pixel mixes half of the world with what
stands behind the ball. What is left sees all but 17 degrees round the direction behind it."""
MOST_OFF_ROUND = 0.05
"""Share of the ball's radius by which marks on its outline may be off."""


@dataclass(frozen=True)
class BallView:
    """A ball seen by a camera: `axis` (3,) unit, to its centre, and `sine` of half the angle that it is seen
    under, in the camera's frame."""

    axis: np.ndarray
    sine: float


@dataclass(frozen=True)
class BallPixels:
    """What the pixels of a ball reflect.

    `rows`, `columns` (n,): which pixels. `directions` (n, 3) unit, world: from where their light comes.
    `solid_angles` (n,): how much of the world each of them shows, in steradians. `outermost` (n,): those
    beside the rim that is left out, where what is seen goes on unseen.
    """

    rows: np.ndarray
    columns: np.ndarray
    directions: np.ndarray
    solid_angles: np.ndarray
    outermost: np.ndarray


def ball_from_outline(camera: Camera, points: np.ndarray) -> BallView:
    """The ball whose rim goes through pixels (n, 2), three or more.

    Rays to the rim lie on a cone: axis . d = cosine of half its angle, linear in axis / cosine. Raises
    ValueError for points beyond the lens, on one line, or off any ball's outline.
    """
    rays = camera.directions(points)
    if not np.isfinite(rays).all():
        raise ValueError("its outline lies where the lens sees nothing")
    d = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    scaled, _, rank, _ = np.linalg.lstsq(d, np.ones(len(d)), rcond=1e-9)
    length = float(np.linalg.norm(scaled))
    if rank < 3 or length <= 1.0:
        raise ValueError("its outline is no ball's: the points lie on one line, or all round the camera")
    axis, half = scaled / length, np.arccos(1.0 / length)
    off = np.abs(np.arccos(np.clip(d @ axis, -1.0, 1.0)) - half)
    if off.max() > MOST_OFF_ROUND * half:
        raise ValueError(
            f"its outline is no ball's: point {int(off.argmax())} is {off.max() / half:.0%} of the radius off"
        )
    return BallView(axis, float(np.sin(half)))


def ball_from_circle(camera: Camera, x: float, y: float, radius: float) -> BallView:
    """The ball round whose outline this circle is drawn, in pixels. Raises ValueError as `ball_from_outline`.

    Beside the picture's axis a ball's outline is an ellipse: the circle is taken to share the middle of its
    bounding box, and the mean of its half sides as radius.
    """
    turn = 2.0 * np.pi * np.arange(128) / 128
    wanted = np.array([x, y, radius])
    tried = wanted.copy()
    for _ in range(20):
        rim = tried[:2] + tried[2] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
        ball = ball_from_outline(camera, rim)
        seen = _outline(camera, ball, turn)
        low, high = seen.min(axis=0), seen.max(axis=0)
        tried += wanted - np.array([*(0.5 * (low + high)), 0.25 * float(np.sum(high - low))])
        if not (np.isfinite(tried).all() and tried[2] > 0.0):
            raise ValueError("its outline lies where the lens sees nothing")
    return ball


def _outline(camera: Camera, ball: BallView, turn: np.ndarray) -> np.ndarray:
    """(n, 2) pixels of its rim."""
    side = np.cross(ball.axis, np.eye(3)[np.argmin(np.abs(ball.axis))])
    side /= np.linalg.norm(side)
    up = np.cross(ball.axis, side)
    rim = np.cos(turn)[:, None] * side + np.sin(turn)[:, None] * up
    return camera.at(np.eye(4)).project(np.sqrt(1.0 - ball.sine**2) * ball.axis + ball.sine * rim)[0]


def ball_from_world(camera: Camera, centre: np.ndarray, radius: float) -> BallView:
    """The ball at a place in the world. Raises ValueError where the camera is inside, or it lies behind."""
    seen = camera.camera_from_world[:3, :3] @ np.asarray(centre) + camera.camera_from_world[:3, 3]
    distance = float(np.linalg.norm(seen))
    if seen[2] <= 0.0 or distance <= radius:
        raise ValueError("it lies behind the camera, or round it")
    return BallView(seen / distance, radius / distance)


def reflected(camera: Camera, ball: BallView, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(n, 3) unit world directions that pixels (n, 2) show in the ball, and the cosines (n,) at which
    their rays meet it; NaN beside it."""
    rays = camera.directions(pixels)
    d = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    distance = 1.0 / ball.sine
    along = d @ ball.axis * distance
    with np.errstate(invalid="ignore"):
        depth = along - np.sqrt(along**2 - (distance**2 - 1.0))
        normal = depth[:, None] * d - distance * ball.axis
        cosine = -np.einsum("nk,nk->n", d, normal)
        r = d + 2.0 * cosine[:, None] * normal
        r[~(depth > 0.0)] = np.nan
    return r @ camera.world_from_camera[:3, :3].T, cosine


def ball_pixels(camera: Camera, ball: BallView) -> BallPixels:
    """All pixels that show the ball, but for its rim; none where it lies beyond the picture."""
    x, y = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    centres = np.stack([x.ravel(), y.ravel()], axis=1)
    directions, cosine = reflected(camera, ball, centres)
    chosen = np.flatnonzero(cosine > LEAST_COSINE)
    centres = centres[chosen]
    sides = [
        reflected(camera, ball, centres + np.array(shift))[0]
        for shift in ((-0.5, 0.0), (0.5, 0.0), (0.0, -0.5), (0.0, 0.5))
    ]
    solid = np.linalg.norm(np.cross(sides[1] - sides[0], sides[3] - sides[2]), axis=1)
    whole = np.isfinite(solid)
    chosen = chosen[whole]
    inside = np.zeros((camera.height + 2, camera.width + 2), dtype=bool)
    rows, columns = chosen // camera.width, chosen % camera.width
    inside[rows + 1, columns + 1] = True
    around = [inside[rows + 1 + i, columns + 1 + j] for i in (-1, 0, 1) for j in (-1, 0, 1)]
    return BallPixels(rows, columns, directions[chosen], solid[whole], ~np.all(around, axis=0))
