"""Hard cases of rays (GEO): slivers, grazing angles, closed balls, by the engine that this machine takes."""

from __future__ import annotations

import numpy as np

from mrbatch.contracts import Case, Measurement
from mrbatch.device.rays import Engine, RayMesh, resolve_engine
from mrbatch.metrics.judging import none, together, within
from mrbatch.scene.mesh import icosphere
from mrbatch.stability.ray_draws import cast

STRIPS, THIN = 2000, 1e-6


def slivers() -> RayMesh:
    """The square -1 <= x, y <= 1 in z = 0: 2000 strips 2 m long and a micrometre wide along x = 0, each of
    two triangles, and a wide one on either side."""
    x = np.concatenate([[-1.0], (np.arange(STRIPS + 1) - STRIPS / 2) * THIN, [1.0]]).astype(np.float32)
    low = np.stack([x, np.full_like(x, -1), np.zeros_like(x)], axis=1)
    high = low * [1, -1, 1]
    n, k = len(x), np.arange(len(x) - 1)
    faces = np.concatenate([np.stack([k, k + 1, k + 1 + n], 1), np.stack([k, k + 1 + n, k + n], 1)])
    return RayMesh(0, np.concatenate([low, high]).astype(np.float32), faces.astype(np.int32), 0)


def between_slivers(seed: int, engine: Engine | None = None, n: int = 1_000_000) -> Measurement:
    """GEO-02: rays at slivers a million times as long as wide: all hit; t is that of the plane."""
    random = np.random.default_rng(seed + 1)
    o = random.uniform([-1, -1, 0.5], [1, 1, 2], (n, 3)).astype(np.float32)
    target = random.uniform(-0.99, 0.99, (n, 3))
    target[: n // 2, 0] = random.uniform(-0.5, 0.5, n // 2) * STRIPS * THIN
    target[:, 2] = 0.0
    d = (target - o).astype(np.float32)
    t, _, triangle, blocked = cast(engine or resolve_engine("auto"), [slivers()], o, d)
    strip = triangle[: n // 2] % (STRIPS + 2)
    truth = o[:, 2].astype(np.float64) / -d[:, 2].astype(np.float64)
    return together(
        none((triangle < 0) | (blocked == 0), "rays that slip through"),
        within(np.where(triangle < 0, truth, t), truth, 1e-5, relative=True, what="distance"),
        none(np.mean((strip != 0) & (strip != STRIPS + 1)) < 0.9, "sets of rays that miss the slivers"),
    )


def grazing(seed: int, engine: Engine | None = None, angles: tuple[float, ...] | None = None) -> Measurement:
    """GEO-03: a plane h below, met at angle a: t = h / sin a to 2^-22 / a, whichever way the ray runs."""
    n, random, judged = 20_000, np.random.default_rng(seed + 2), []
    for angle in angles or tuple(10.0**-k for k in range(1, 6)):
        size = np.float32(4.0 / angle)
        corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float32) * size
        mesh = RayMesh(0, corners, np.array([[0, 1, 2], [0, 2, 3]], np.int32), 0)
        azimuth = random.uniform(0, 2 * np.pi, n)
        h = random.uniform(0.25, 1.0, n).astype(np.float32)
        o = np.stack([np.zeros(n), np.zeros(n), h], axis=1).astype(np.float32)
        c, s = np.cos(angle), np.sin(angle)
        d = np.stack([c * np.cos(azimuth), c * np.sin(azimuth), np.full(n, -s)], axis=1).astype(np.float32)
        t, _, triangle, _ = cast(engine or resolve_engine("auto"), [mesh], o, d)
        truth = h.astype(np.float64) / -d[:, 2].astype(np.float64)
        judged += [
            none(triangle < 0, "rays that miss"),
            within(t, truth, 2.0**-22 / angle, relative=True, what=f"at {angle:g}"),
        ]
    return together(*judged)


def aimed(kind: str, n: int, seed: int) -> tuple[RayMesh, np.ndarray, np.ndarray]:
    """Rays from inside a closed ball, aimed exactly (in float32) at its corners or edges, or anywhere."""
    ball = icosphere(1.0, subdivisions=3)
    vertices = ball.vertices.astype(np.float32)
    random = np.random.default_rng(seed + 3)
    o = random.uniform(-0.4, 0.4, (n, 3)).astype(np.float32)
    if kind == "anywhere":
        d: np.ndarray = random.normal(size=(n, 3))
    elif kind == "corners":
        d = vertices[random.integers(0, len(vertices), n)] - o
    else:
        face, side = random.integers(0, len(ball.faces), n), random.integers(0, 3, n)
        a, b = (vertices[ball.faces[face, (side + k) % 3]].astype(np.float64) for k in (0, 1))
        d = (a + random.random((n, 1)) * (b - a)).astype(np.float32) - o
    return RayMesh(0, vertices, ball.faces, 0), o, d.astype(np.float32)


def escapes(seed: int, kind: str, engine: Engine | None = None, n: int = 1_000_000) -> Measurement:
    """Rays of one kind from inside a closed ball: none escapes."""
    mesh, o, d = aimed(kind, n, seed)
    _, _, triangle, blocked = cast(engine or resolve_engine("auto"), [mesh], o, d)
    return none(
        (triangle < 0) | (blocked == 0), f"rays aimed {'at ' if kind != 'anywhere' else ''}{kind}, out"
    )


def closed_ball(seed: int) -> Measurement:
    """GEO-05, at edges and anywhere. Of rays aimed exactly at a corner a few in 10,000 pass."""
    return together(*(escapes(seed, kind) for kind in ("edges", "anywhere")))


CASES: tuple[Case, ...] = (
    Case(
        "GEO-02",
        "no ray slips between slivers",
        between_slivers,
        setup="square with 2000 slivers 1e6 : 1, a million rays",
    ),
    Case(
        "GEO-03",
        "distances at grazing angles",
        grazing,
        setup="plane met at .1 to 1e-5 rad, 20,000 rays each",
    ),
    Case(
        "GEO-05",
        "no ray leaves a closed ball",
        closed_ball,
        setup="a million rays at edges, a million anywhere",
    ),
)
