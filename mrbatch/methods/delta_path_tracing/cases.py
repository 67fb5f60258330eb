"""Hard cases of delta path tracing, for `mrbatch stability`: small scenes whose answer is known.

A case looks at one point of a real surface through an 8x8 picture so narrow that all pixels see the
same thing: 64 independent estimates, whose mean and standard error are held against a closed form.
Objects that stand in the way are not seen by the camera (their switch `camera`), so points under them
can be looked at from above. Sky: radiance 1 from everywhere, so an open diffuse surface of reflectance
rho sends rho, and a body that covers the share F of its cosine-weighted hemisphere takes rho F.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mrbatch.contracts import Case, Measurement
from mrbatch.scene.camera import Camera
from mrbatch.scene.environment import Environment
from mrbatch.scene.mesh import Mesh, icosphere, plane
from mrbatch.scene.scene import Material, Scene, SceneObject, centre

SIDE = 8
SIGMAS = 4.0
_NARROW = 2.0**-12
"""Width of the picture relative to the distance: what it shows varies by less than the noise."""


def sky(radiance: float | Sequence[float] = 1.0) -> Environment:
    """The same radiance from everywhere."""
    return Environment(np.broadcast_to(np.asarray(radiance, np.float32), (4, 8, 3)).copy())


def lamp_sky(strength: float = 40.0) -> Environment:
    """A dim sky with a lamp of some degrees high on the +x side, which surfaces sample badly."""
    radiance = np.full((32, 64, 3), 0.2, np.float32)
    radiance[6:8, 30:33] = strength
    return Environment(radiance)


def placed(mesh: Mesh, *, at: Sequence[float] = (0, 0, 0), normal: Sequence[float] = (0, 0, 1)) -> Mesh:
    """The mesh with its z axis turned to `normal` (an axis) and its origin moved to `at`, in metres."""
    n = np.asarray(normal, dtype=np.float64)
    matrix = np.eye(4)
    if abs(n[2]) < 0.5:
        matrix[:3, 0], matrix[:3, 1] = np.cross([0, 0, 1.0], n), [0, 0, 1.0]
        matrix[:3, 2] = n
    elif n[2] < 0:
        matrix[:3, :3] = np.diag([1.0, -1.0, -1.0])
    matrix[:3, 3] = at
    return mesh.transformed(matrix)


def real(name: str, mesh: Mesh, reflectance: float | Sequence[float] = 0.5, **switches: Any) -> SceneObject:
    return SceneObject(name, mesh, Material(reflectance=_rgb(reflectance)), False, **switches)


def virtual(
    name: str, mesh: Mesh, reflectance: float | Sequence[float] = 0.5, **switches: Any
) -> SceneObject:
    return SceneObject(name, mesh, Material(reflectance=_rgb(reflectance)), True, **switches)


def _rgb(value: float | Sequence[float]) -> tuple[float, float, float]:
    r, g, b = np.broadcast_to(np.asarray(value, dtype=np.float64), (3,))
    return float(r), float(g), float(b)


def ball(radius: float = 1.0, *, at: Sequence[float] = (0, 0, 1), subdivisions: int = 6) -> Mesh:
    """A faceted ball; at the default its silhouette is smaller than the sphere's by 4e-5."""
    return replace(icosphere(radius, subdivisions=subdivisions, centre=at), normals=None)


def floor(size: float = 2.0**12) -> Mesh:
    return plane(size, size)


def look_at(
    eye: Sequence[float] | np.ndarray,
    target: Sequence[float] | np.ndarray,
    *,
    width: int,
    height: int,
    focal: float,
) -> Camera:
    """A pinhole at `eye` whose middle pixel looks at `target`; x of the picture is horizontal."""
    e, t = np.asarray(eye, dtype=np.float64), np.asarray(target, dtype=np.float64)
    forward = (t - e) / np.linalg.norm(t - e)
    up = np.array([0.0, 0.0, 1.0]) if abs(forward[2]) < 0.999 else np.array([0.0, 1.0, 0.0])
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2], pose[:3, 3] = right, np.cross(forward, right), forward, e
    matrix = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]])
    return Camera(width, height, matrix, np.zeros(8), pose)


def scene_of(
    objects: Sequence[SceneObject], environment: Environment | None = None, origin: np.ndarray | None = None
) -> Scene:
    return Scene(tuple(objects), environment or sky(), centre(objects) if origin is None else origin)


@dataclass(frozen=True)
class Probe:
    """64 estimates of what one point shows: mean and standard error (3,), and the work they took.

    `delta`: D; `virtual`: P. `pixels` (64, 3): the estimates of D themselves.
    """

    delta: np.ndarray
    delta_error: np.ndarray
    virtual: np.ndarray
    virtual_error: np.ndarray
    pixels: np.ndarray
    counters: Mapping[str, int]


def probe(
    scene: Scene,
    point: Sequence[float] | np.ndarray,
    *,
    normal: Sequence[float] = (0, 0, 1),
    distance: float = 1.0,
    spp: int = 256,
    seed: int = 0,
    settings: Mapping[str, Any] | None = None,
    **options: Any,
) -> Probe:
    """What the camera sees of `point` from `distance` along `normal`; `options` go to `estimate`."""
    from mrbatch.methods.delta_path_tracing import METHOD
    from mrbatch.methods.estimate import estimate

    p = np.asarray(point, dtype=np.float64)
    eye = p + np.asarray(normal, dtype=np.float64) * distance
    camera = look_at(eye, p, width=SIDE, height=SIDE, focal=SIDE / _NARROW)
    result = estimate(METHOD, scene, camera, settings=settings, spp=spp, seed=seed, threads=1, **options)
    delta, seen = result.developed.D.reshape(-1, 3), result.developed.P.reshape(-1, 3)
    count = np.sqrt(len(delta))
    return Probe(
        delta.mean(axis=0),
        delta.std(axis=0, ddof=1) / count,
        seen.mean(axis=0),
        seen.std(axis=0, ddof=1) / count,
        delta,
        result.counters,
    )


def everything_virtual(objects: Sequence[SceneObject], *, with_virtual: bool = True) -> list[SceneObject]:
    """The objects as virtual ones, with or without those that were: P is then a plain path tracer's."""
    return [replace(o, virtual=True) for o in objects if with_virtual or not o.virtual]


def ball_share(radius: float, height: float, s: float | np.ndarray) -> np.ndarray:
    """Form factor of a ball above the horizon: r^2 h / (s^2 + h^2)^1.5 at s from its foot."""
    return radius**2 * height / (np.asarray(s) ** 2 + height**2) ** 1.5


def sunk_ball_share(q: float | np.ndarray) -> np.ndarray:
    """Form factor of a ball half under the plane, q radii off: (atan(1/g) - g/q^2) / pi, g^2 = q^2 - 1."""
    h = np.asarray(q, dtype=np.float64)
    g = np.sqrt(h * h - 1)
    return (np.arctan(1 / g) - g / h**2) / np.pi


def judge(found: np.ndarray, error: np.ndarray, oracle: np.ndarray, tolerance: float) -> Measurement:
    """Whether |found - oracle| stays within the tolerance plus four standard errors, everywhere."""
    found, error, oracle = (np.atleast_1d(np.asarray(x, dtype=np.float64)) for x in (found, error, oracle))
    room = tolerance + SIGMAS * error
    excess = np.abs(found - oracle) - room
    worst = int(np.argmax(excess))
    return Measurement(
        passed=bool(np.all(np.isfinite(found)) and np.all(excess <= 0.0)),
        measured=f"{found.flat[worst]:+.6f} (standard error {error.flat[worst]:.1e})",
        oracle=f"{np.broadcast_to(oracle, found.shape).flat[worst]:+.6f}",
        tolerance=f"{tolerance:g} + {SIGMAS:g} standard errors",
    )


def black_ball_measurement(seed: int) -> Measurement:
    """DPT-02: a black ball resting on a plane under the sky takes rho F."""
    distances = (0.25, 0.5, 1.0, 2.0, 4.0)
    scene = scene_of([real("floor", floor()), virtual("ball", ball(), 0.0, camera=False)])
    found = [probe(scene, (s, 0, 0), seed=seed) for s in distances]
    oracle = -0.5 * ball_share(1.0, 1.0, np.array(distances))
    return judge(
        np.array([f.delta[0] for f in found]), np.array([f.delta_error[0] for f in found]), oracle, 1e-3 * 0.5
    )


def white_furnace_measurement(seed: int) -> Measurement:
    """DPT-04: among white surfaces under the sky everything shows 1, so nothing changes."""
    scene = scene_of([real("floor", floor(), 1.0), virtual("ball", ball(), 1.0, camera=False)])
    found = [probe(scene, (s, 0, 0), seed=seed) for s in (0.5, 1.0, 2.0)]
    return judge(
        np.array([f.delta[0] for f in found]), np.array([f.delta_error[0] for f in found]), np.zeros(3), 1e-3
    )


def corner(reflectance: float = 0.5, *, size: float = 2.0**12) -> list[SceneObject]:
    """A floor (z = 0) and a wall (x = 0), both large; the open corner is where x and z are positive."""
    half = size / 2
    return [
        real("floor", placed(plane(size, size), at=(half, 0, 0)), reflectance),
        real("wall", placed(plane(size, size), at=(0, 0, half), normal=(1, 0, 0)), reflectance),
    ]


def corner_ball_measurement(seed: int) -> Measurement:
    """DPT-15: a ball in a corner against two full path traces, with and without it."""
    objects = [*corner(0.5), virtual("ball", ball(0.5, at=(0.8, 0, 0.5)), (0.2, 0.5, 0.8), camera=False)]
    found, error, oracle = [], [], []
    for number, s in enumerate((0.4, 0.9, 1.6)):
        ours = probe(scene_of(objects), (s, 0, 0), seed=seed)
        traces = [
            probe(
                scene_of(everything_virtual(objects, with_virtual=there), origin=centre(objects)),
                (s, 0, 0),
                spp=512,
                seed=seed + k,
            )
            for k, there in ((1000 + number, True), (2000 + number, False))
        ]
        found.append(ours.delta)
        oracle.append(traces[0].virtual - traces[1].virtual)
        error.append(
            np.sqrt(ours.delta_error**2 + traces[0].virtual_error ** 2 + traces[1].virtual_error ** 2)
        )
    return judge(np.ravel(found), np.ravel(error), np.ravel(oracle), 1e-4)


def scaled(scene: Scene, factor: float) -> Scene:
    """The scene times `factor`, its origin too."""
    matrix = np.diag([factor, factor, factor, 1.0])
    objects = tuple(replace(o, mesh=o.mesh.transformed(matrix)) for o in scene.objects)
    return Scene(objects, scene.environment, scene.origin * factor)


def scale_measurement(seed: int) -> Measurement:
    """GEO-01: a scene scaled by powers of two gives the same bits; by others, the same within the noise."""
    objects = [*corner(0.5, size=64.0), virtual("ball", ball(0.5, at=(0.8, 0, 0.5)), 0.7, camera=False)]
    scene = scene_of(objects)
    point = np.array([0.4, 0.2, 0.0])
    base = probe(scene, point, seed=seed, spp=64)
    same = [
        np.array_equal(probe(scaled(scene, f), point * f, distance=f, seed=seed, spp=64).pixels, base.pixels)
        for f in (2.0**-13, 2.0**13)
    ]
    others = [
        probe(scaled(scene, f), point * f, distance=f, seed=seed + 1 + k, spp=64)
        for k, f in enumerate((1e-4, 1e4))
    ]
    outcome = judge(
        np.array([o.delta[0] for o in others]),
        np.hypot(base.delta_error[0], [o.delta_error[0] for o in others]),
        base.delta[0],
        1e-4,
    )
    return Measurement(
        passed=outcome.passed and all(same),
        measured=f"bits equal at 2^-13 and 2^13: {same}; {outcome.measured}",
        oracle=outcome.oracle,
        tolerance=f"bits; {outcome.tolerance}",
    )


def slope_measurement(seed: int, *, runs: int = 24, sampler: str = "independent") -> Measurement:
    """MC-01: with independent numbers the mean squared error falls as 1 / spp."""
    slope = error_slope(seed, runs=runs, sampler=sampler)
    return Measurement(
        passed=abs(slope + 1.0) <= 0.05,
        measured=f"slope {slope:+.3f}",
        oracle="-1",
        tolerance="0.05",
    )


def error_slope(
    seed: int, *, runs: int, sampler: str, counts: Sequence[int] = (4, 16, 64, 256), s: float = 1.0
) -> float:
    """Slope of log mean squared error over log spp, against the closed form of the black ball."""
    return float(np.polyfit(np.log(counts), np.log(squared_errors(seed, runs, sampler, counts, s)), 1)[0])


def squared_errors(seed: int, runs: int, sampler: str, counts: Sequence[int], s: float = 1.0) -> np.ndarray:
    """Mean squared error at each number of samples, over 64 pixels of `runs` seeds."""
    scene = scene_of([real("floor", floor()), virtual("ball", ball(subdivisions=5), 0.0, camera=False)])
    many = {"sampler": sampler}
    exact = np.mean([probe(scene, (s, 0, 0), spp=4096, seed=seed + 77777).delta[0]])
    errors = []
    for count in counts:
        parts = [
            probe(scene, (s, 0, 0), spp=count, seed=seed + 1000 * count + k, settings=many).pixels[:, 0]
            for k in range(runs)
        ]
        errors.append(np.mean((np.concatenate(parts) - exact) ** 2))
    return np.array(errors)


CASES: tuple[Case, ...] = (
    Case("DPT-02", "a black ball on a plane blocks its form factor", black_ball_measurement),
    Case("DPT-04", "nothing changes among white surfaces", white_furnace_measurement),
    Case("DPT-15", "a ball in a corner equals two full path traces", corner_ball_measurement),
    Case("GEO-01", "a picture does not depend on the scene's scale", scale_measurement),
    Case("MC-01", "the mean squared error falls as 1 / spp", slope_measurement, quick=False),
)
