"""The sample's light: a furnished room with two windows, drawn as an equirectangular map of radiance.

Every texel looks from the desk along its direction to the wall, floor or ceiling of a box-shaped room
and takes its colour there. Directions follow the product's rule: +x in the middle of the map, +z up.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

WIDTH, HEIGHT = 512, 256
SUPERSAMPLES = 6

LOW, HIGH = np.array([-2.1, -2.6, -0.75]), np.array([2.9, 2.3, 2.35])
"""Corners of the room around the marker, metres."""
SUN_THROUGH = np.array([-2.1, 1.02, 1.62])
"""Where on the left wall the sun is seen from the desk."""
SUN_RADIUS = np.radians(1.5)
SUN_RADIANCE = np.array([1.0, 0.85, 0.66]) * 3200.0
EXPOSURE = 0.97
WARM_WHITE = np.array([0.80, 0.76, 0.68])


def _within(a: np.ndarray, low: float, high: float) -> np.ndarray:
    return (a >= low) & (a <= high)


def _window(u: np.ndarray, v: np.ndarray, frame: tuple[float, float, float, float], panes: tuple[int, int]):
    """Masks (glass, bars) of a window u0, u1, v0, v1 with its frame and glazing bars."""
    u0, u1, v0, v1 = frame
    inside = _within(u, u0, u1) & _within(v, v0, v1)
    bar = 0.045
    a = np.mod((u - u0) * panes[0] / (u1 - u0), 1.0) * (u1 - u0) / panes[0]
    b = np.mod((v - v0) * panes[1] / (v1 - v0), 1.0) * (v1 - v0) / panes[1]
    glass = inside & _within(a, bar, (u1 - u0) / panes[0]) & _within(b, bar, (v1 - v0) / panes[1])
    rim = _within(u, u0 - 0.08, u1 + 0.08) & _within(v, v0 - 0.08, v1 + 0.08)
    return glass, rim & ~glass


def _outside(d: np.ndarray) -> np.ndarray:
    """Sky above, trees below the horizon's haze."""
    up = d[:, 2:3]
    sky = np.array([0.55, 0.78, 1.15]) * 4.2 + np.array([1.2, 1.0, 0.7]) * 2.6 * np.exp(-6.0 * np.abs(up))
    leaves = np.array([0.16, 0.30, 0.09]) * 2.0
    wave = 0.09 + 0.05 * np.sin(31.0 * np.arctan2(d[:, 1], d[:, 0]))[:, None]
    return np.where(up < wave, leaves, sky)


def radiance(d: np.ndarray) -> np.ndarray:
    """Radiance (n, 3) from unit directions (n, 3), without the sun."""
    with np.errstate(divide="ignore"):
        reach = np.where(d > 0, HIGH / d, LOW / d)
    wall = np.argmin(reach, axis=1)
    p = d * reach[np.arange(len(d)), wall][:, None]
    x, y, z = p.T
    left, right = (wall == 0) & (x < 0), (wall == 0) & (x > 0)
    front, back = (wall == 1) & (y < 0), (wall == 1) & (y > 0)
    floor, ceiling = (wall == 2) & (z < 0), (wall == 2) & (z > 0)

    # Walls are brighter towards the windows, ceiling and floor fall off to the far corner.
    near = np.exp(-0.28 * np.linalg.norm(p - np.array([-2.1, 0.6, 0.9]), axis=1))[:, None]
    light = 0.13 + 0.75 * near
    colour = np.tile(WARM_WHITE, (len(d), 1))
    colour[back] = (0.24, 0.42, 0.45)
    colour[front] = (0.78, 0.72, 0.62)
    colour[ceiling] = 0.88
    planks = 0.75 + 0.25 * np.sin(17.0 * np.floor(x / 0.14)) ** 2
    colour[floor] = (np.array([0.34, 0.21, 0.12]) * planks[:, None])[floor]
    out = colour * light

    # Back wall: three pictures and a shelf of books.
    for centre, size, inner in (
        ((-0.75, 1.15), (0.38, 0.52), (0.85, 0.42, 0.20)),
        ((0.15, 1.25), (0.52, 0.38), (0.88, 0.80, 0.55)),
        ((0.95, 1.12), (0.32, 0.46), (0.35, 0.50, 0.75)),
    ):
        du, dv = np.abs(x - centre[0]), np.abs(z - centre[1])
        board = back & (du < size[0] / 2) & (dv < size[1] / 2)
        mat = board & (du < size[0] / 2 - 0.03) & (dv < size[1] / 2 - 0.03)
        art = board & (du < size[0] / 2 - 0.09) & (dv < size[1] / 2 - 0.09)
        out[board], out[mat] = (0.03, 0.025, 0.02), (0.75, 0.73, 0.68)
        out[art] = inner
    shelf = back & _within(x, 1.35, 2.7) & _within(z, -0.6, 1.7)
    row = np.mod(z + 0.6, 0.38)
    book = np.floor(x / 0.055 + 7.3 * np.floor((z + 0.6) / 0.38))
    hue = 0.5 + 0.5 * np.cos(2.399963 * book[:, None] + np.array([0.0, 2.1, 4.2]))
    tall = 0.24 + 0.08 * np.cos(5.1 * book)
    books = np.where((row > 0.04) & (row < tall), 1.0, 0.0)[:, None] * (0.04 + 0.36 * hue)
    boards = np.where(row <= 0.04, 1.0, 0.0)[:, None] * np.array([0.30, 0.19, 0.10])
    out[shelf] = (books + boards)[shelf] + 0.015

    # A door in the right wall, and a floor lamp's shade before it.
    door = right & _within(y, -1.9, -1.0) & (z < 1.3)
    out[door] = (0.30, 0.22, 0.15)
    shade = (np.hypot(x - 2.6, 0.0) < 0.4) & _within(y, 0.45, 0.95) & _within(z, 0.75, 1.2)
    glow = np.exp(-(((y - 0.7) / 0.3) ** 2))[:, None]
    out[shade] = (np.array([1.0, 0.70, 0.38]) * 7.0 * glow)[shade]

    # Windows: a tall one on the left, which lets the sun in, and a wide one in front, behind the camera.
    for where, u, frame, panes, factor in (
        (left, y, (-0.25, 1.85, 0.0, 2.05), (3, 2), 1.0),
        (front, x, (-1.7, 0.5, 0.35, 1.85), (3, 1), 0.75),
    ):
        glass, bars = _window(u, z, frame, panes)
        out[where & bars] = (1.25, 1.22, 1.15)
        out = np.where((where & glass)[:, None], _outside(d) * factor, out)
    # Linen curtains beside the tall window glow with what comes through.
    curtain = left & (_within(y, -0.75, -0.33) | _within(y, 1.93, 2.25)) & _within(z, -0.7, 2.2)
    folds = 0.75 + 0.25 * np.sin(60.0 * y)
    out[curtain] = (np.array([2.1, 1.85, 1.45]) * folds[:, None])[curtain]
    # What lies below the table top is in its shade: the table hides it, so no samples should go there.
    out[d[:, 2] < 0.0] *= 0.25
    return out


def draw() -> np.ndarray:
    """The map (HEIGHT, WIDTH, 3) float32."""
    n = SUPERSAMPLES
    towards = SUN_THROUGH / np.linalg.norm(SUN_THROUGH)
    total = np.zeros((HEIGHT, WIDTH, 3))
    for i in range(n):
        for j in range(n):
            v = np.pi * (np.arange(HEIGHT) + (i + 0.5) / n) / HEIGHT
            u = np.pi - 2.0 * np.pi * (np.arange(WIDTH) + (j + 0.5) / n) / WIDTH
            d = np.stack(
                [
                    np.sin(v)[:, None] * np.cos(u),
                    np.sin(v)[:, None] * np.sin(u),
                    np.broadcast_to(np.cos(v)[:, None], (HEIGHT, WIDTH)),
                ],
                axis=-1,
            ).reshape(-1, 3)
            part = radiance(d)
            part[d @ towards > np.cos(SUN_RADIUS)] = SUN_RADIANCE
            total += part.reshape(HEIGHT, WIDTH, 3)
    return (EXPOSURE * total / n**2).astype(np.float32)


def write_room(path: Path) -> None:
    """The map as half-float EXR."""
    import OpenImageIO as oiio

    picture = draw()
    spec = oiio.ImageSpec(WIDTH, HEIGHT, 3, oiio.HALF)
    spec.attribute("compression", "piz")
    out = oiio.ImageOutput.create(str(path))
    if not out or not out.open(str(path), spec) or not out.write_image(picture):
        raise OSError(f"cannot write {path}: {oiio.geterror()}")
    out.close()
