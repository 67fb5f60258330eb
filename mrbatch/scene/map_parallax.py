"""An environment map seen from elsewhere than where it was made.

A map tells light by direction, as if all of it came from far away. What is o away from where it was made,
under a lamp at distance h, gets that lamp's light from a direction that is off by atan(o / h): 14 degrees for
half a metre under a lamp at 2 m; highlights and shadows move alike. With walls (a proxy) that stand for what
the map shows, each direction d from the virtual objects' middle c meets a wall at y, and shows what the map
has in the direction y - p from its own place p. The map is drawn anew so, once a shot, and is then right at
c; kernels, samplers and bounds do not know. At s from c it is still off by atan(s / h): the objects' own size
takes the place of the map's distance.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mrbatch.errors import InputError, Place
from mrbatch.scene.environment import Environment
from mrbatch.scene.proxy_settings import Proxy

SIDES = (4, 2)
"""A texel is the mean of so many directions squared, equal in solid angle, so that no lamp of one texel is
missed: of maps up to 1024 wide, and of wider ones, where a lamp is several texels."""
CHUNK = 2**16
"""Texels that are drawn at a time."""


def _hit(proxy: Proxy, origin: np.ndarray, d: np.ndarray) -> np.ndarray:
    """(n,) distances at which rays from inside, directions (n, 3) unit, meet the proxy."""
    if proxy.box is not None:
        half = 0.5 * np.array(proxy.box.size)
        o = origin - np.array(proxy.box.centre)
        with np.errstate(divide="ignore"):
            wall: np.ndarray = (np.where(d >= 0.0, half, -half) - o) / np.where(d == 0.0, np.nan, d)
        nearest: np.ndarray = np.nanmin(wall, axis=1)
        return nearest
    ball = proxy.sphere or proxy.dome
    assert ball is not None
    o = origin - np.array(ball.centre)
    b = np.einsum("nk,k->n", d, o)
    far: np.ndarray = -b + np.sqrt(b**2 + (ball.radius**2 - o @ o))
    if proxy.dome is not None:
        with np.errstate(divide="ignore"):
            far = np.where(d[:, 2] < 0.0, np.minimum(far, o[2] / np.abs(d[:, 2])), far)
    return far


def _inside(proxy: Proxy, point: np.ndarray) -> bool:
    if proxy.box is not None:
        return bool(np.all(np.abs(point - np.array(proxy.box.centre)) < 0.5 * np.array(proxy.box.size)))
    ball = proxy.sphere or proxy.dome
    assert ball is not None
    o = point - np.array(ball.centre)
    return bool(np.linalg.norm(o) < ball.radius and (proxy.dome is None or o[2] > 0.0))


def _read(environment: Environment, d: np.ndarray) -> np.ndarray:
    """(n, 3) radiance of directions (n, 3) of any length in the map's frame, as kernels read it."""
    height, width = environment.height, environment.width
    u = 0.5 - np.arctan2(d[:, 1], d[:, 0]) / (2.0 * np.pi)
    v = np.arctan2(np.hypot(d[:, 0], d[:, 1]), d[:, 2]) / np.pi
    row = v * height - 0.5 if environment.rows == "centres" else v * (height - 1)
    column = u * width - 0.5
    if environment.interpolation == "nearest":
        row, column = np.round(row), np.round(column)
    left, top = np.floor(column).astype(int), np.floor(row).astype(int)
    fx, fy = (column - left)[:, None], (row - top)[:, None]
    low, high = top.clip(0, height - 1), (top + 1).clip(0, height - 1)
    left, right = left % width, (left + 1) % width
    texels = environment.radiance
    above = texels[low, left] * (1.0 - fx) + texels[low, right] * fx
    below = texels[high, left] * (1.0 - fx) + texels[high, right] * fx
    mixed: np.ndarray = above * (1.0 - fy) + below * fy
    return mixed


def seen_from(
    environment: Environment, position: np.ndarray, proxy: Proxy, middle: np.ndarray, size: float
) -> tuple[Environment, str]:
    """The map as it looks from `middle` (3,), and what a report says of it. `position` (3,): where it was
    made; world, metres. `size`: of what stands round the middle.

    Raises InputError where either place lies outside of the proxy.
    """
    place = Place(file=environment.source) if environment.source else None
    for point, what in ((position, "the map was made"), (middle, "the virtual objects stand")):
        if not _inside(proxy, point):
            at = ", ".join(f"{x:.3g}" for x in point)
            raise InputError(
                f"{what} outside of the environment's proxy, at ({at}) m",
                place=place,
                hint="`proxy` stands for the walls round both",
            )
    height, width = environment.height, environment.width
    turn = environment.world_from_map
    radiance = np.empty((height, width, 3), np.float32)
    side = SIDES[width > 1024]
    rows = max(1, CHUNK // width)
    moved, nearest = 0.0, np.inf
    for first in range(0, height, rows):
        count = min(rows, height - first)
        total = np.zeros((count * width, 3))
        # Directions of equal solid angle: even in z within a row.
        edges = np.cos(np.pi * np.arange(first, first + count + 1) / height)
        for i in range(side):
            z = edges[:-1] + (edges[1:] - edges[:-1]) * (i + 0.5) / side
            ring = np.sqrt(np.maximum(1.0 - z**2, 0.0))
            for j in range(side):
                azimuth = 2.0 * np.pi * (0.5 - (np.arange(width) + (j + 0.5) / side) / width)
                d = np.stack(
                    [
                        ring[:, None] * np.cos(azimuth),
                        ring[:, None] * np.sin(azimuth),
                        np.broadcast_to(z[:, None], (count, width)),
                    ],
                    axis=-1,
                ).reshape(-1, 3)
                out = np.einsum("nk,jk->nj", d, turn)  # not by BLAS, whose bits are the machine's
                along = _hit(proxy, middle, out)
                seen = middle + along[:, None] * out - position
                total += _read(environment, np.einsum("nk,kj->nj", seen, turn))
                if i == j == 0:
                    cosine = np.einsum("nk,nk->n", seen, out) / np.linalg.norm(seen, axis=1)
                    moved = max(moved, float(np.arccos(np.clip(cosine.min(), -1.0, 1.0))))
                nearest = min(nearest, float(along.min()))
        radiance[first : first + count] = (total / side**2).reshape(count, width, 3)
    away = float(np.linalg.norm(middle - position))
    left = np.degrees(np.arctan2(0.5 * size, nearest))
    note = (
        f"the environment map, made {away:.3g} m away, is drawn as it looks from the middle of the virtual "
        f"objects: its light moves by up to {np.degrees(moved):.1f} degrees, and is right within {left:.1f} "
        "degrees all over them"
    )
    return replace(environment, radiance=radiance, rows="centres"), note


def parallax_warning(position: np.ndarray, middle: np.ndarray) -> str:
    """What a report says of a map that was made elsewhere, where no proxy is given."""
    away = float(np.linalg.norm(middle - position))
    off = ", ".join(
        f"{np.degrees(np.arctan2(away, h)):.1f} degrees for a lamp at {h:g} m" for h in (2.0, 5.0, 20.0)
    )
    return (
        f"the environment map was made {away:.3g} m away from the virtual objects: the directions of its "
        f"light, so shadows and highlights, are off by up to {off}; give `environment.proxy`"
    )
