"""A path tracer in float64 NumPy for balls and infinite planes under a sky: the oracle of other tests.

It shares nothing with the project: quadratic intersection, cosine sampling from Philox, no light
sampling, no roulette. Light is followed from one point until it escapes or has met `depth` surfaces.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Ball:
    centre: tuple[float, float, float]
    radius: float
    albedo: float


@dataclass(frozen=True)
class Plane:
    """Points x with normal . x = offset; `normal` faces the room."""

    normal: tuple[float, float, float]
    offset: float
    albedo: float


def hit(items, o, d):
    """Nearest t > 0, normals facing the ray, index of the item (-1: none) for rays (n, 3)."""
    best = np.full(len(o), np.inf)
    which = np.full(len(o), -1)
    normal = np.zeros_like(o)
    for k, item in enumerate(items):
        if isinstance(item, Plane):
            n = np.asarray(item.normal, float)
            with np.errstate(divide="ignore", invalid="ignore"):
                t = (item.offset - o @ n) / (d @ n)
            at = np.broadcast_to(n, o.shape)
        else:
            m = o - np.asarray(item.centre)
            b = (m * d).sum(-1)
            c = (m * m).sum(-1) - item.radius**2
            root = b * b - c
            s = np.sqrt(np.maximum(root, 0))
            near, far = -b - s, -b + s
            t = np.where(near > 1e-9, near, far)
            t = np.where(root > 0, t, np.inf)
            with np.errstate(invalid="ignore"):
                at = (m + t[:, None] * d) / item.radius
        closer = (t > 1e-9) & (t < best)
        best = np.where(closer, t, best)
        which = np.where(closer, k, which)
        normal = np.where(closer[:, None], at, normal)
    flip = (normal * d).sum(-1) > 0
    normal[flip] *= -1
    return best, normal, which


def cosine_direction(n, rng):
    a = np.where(np.abs(n[:, 2:3]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    t = np.cross(a, n)
    t /= np.linalg.norm(t, axis=-1, keepdims=True)
    b = np.cross(n, t)
    u, phi = rng.random(len(n)), 2 * np.pi * rng.random(len(n))
    r = np.sqrt(u)[:, None]
    return t * r * np.cos(phi)[:, None] + b * r * np.sin(phi)[:, None] + n * np.sqrt(1 - u)[:, None]


def radiance(items, point, normal, albedo, paths, seed, *, sky=lambda d: np.ones(len(d)), depth=64):
    """Mean and standard error of the radiance that leaves a diffuse point."""
    rng = np.random.Generator(np.random.Philox(seed))
    o = np.tile(np.asarray(point, float), (paths, 1))
    n = np.tile(np.asarray(normal, float), (paths, 1))
    weight = np.full(paths, float(albedo))
    result = np.zeros(paths)
    alive = np.arange(paths)
    albedos = np.array([item.albedo for item in items])
    for _ in range(depth):
        d = cosine_direction(n, rng)
        t, n, which = hit(items, o, d)
        free = which < 0
        result[alive[free]] = weight[free] * sky(d[free])
        keep = ~free
        alive, n = alive[keep], n[keep]
        o = o[keep] + t[keep, None] * d[keep]
        weight = weight[keep] * albedos[which[keep]]
        going = weight > 0
        alive, n, o, weight = alive[going], n[going], o[going], weight[going]
        if len(alive) == 0:
            break
    return result.mean(), result.std() / np.sqrt(paths)
