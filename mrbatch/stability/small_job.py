"""Small jobs made of plain numbers, rendered in memory: what fuzzing draws, and what it looks at."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from mrbatch.contracts import Measurement
from mrbatch.film.composite import composite
from mrbatch.methods.estimate import estimate
from mrbatch.methods.registry import method as find_method
from mrbatch.metrics.judging import none
from mrbatch.scene.closed_forms import look_at, real
from mrbatch.scene.environment import Environment
from mrbatch.scene.mesh import Mesh, box, icosphere, plane, uv_sphere
from mrbatch.scene.scene import Material, Scene, SceneObject, centre

Family = Literal["matt", "mixed", "glass"]
Shape = Literal["ball", "smooth ball", "box", "card", "sliver"]
Light = Literal["black", "even", "lamp", "wild", "one texel"]
SHAPES: tuple[Shape, ...] = ("ball", "smooth ball", "box", "card", "sliver")
LIGHTS: tuple[Light, ...] = ("black", "even", "lamp", "wild", "one texel")
SIZES = ((1, 1), (1, 37), (61, 1), (17, 13), (16, 16), (33, 15), (128, 3), (3, 67))
FAMILIES: tuple[tuple[str, Family], ...] = (
    ("delta-path-tracing", "matt"),
    ("delta-path-tracing", "mixed"),
    ("delta-path-tracing", "glass"),
    ("one-pass", "matt"),
    ("two-pass", "matt"),
    ("image-based-lighting", "mixed"),
)
"""Methods with kinds of materials: few, for each takes kernels of its own."""


@dataclass(frozen=True)
class Thing:
    """A virtual object: its shape, place (3,) and size in units of the scene's scale, and its looks."""

    shape: Shape
    place: tuple[float, float, float]
    size: float
    reflectance: tuple[float, float, float]
    alpha: float
    metalness: float
    emission: float


@dataclass(frozen=True)
class SmallJob:
    """A small job: `scale` 1e-4..1e4 m, `offset` 0..1e6 m along a diagonal, pose by angles and distance."""

    family: int
    seed: int
    scale: float
    offset: float
    size: tuple[int, int]
    azimuth: float
    elevation: float
    distance: float
    focal: float
    light: Light
    strength: float
    floor: tuple[float, float, float]
    things: tuple[Thing, ...]
    spp: int
    max_depth: int | None
    gain: float
    photo: float


def random_job(seed: int) -> SmallJob:
    """The job of a seed: the same on every machine."""
    r = np.random.default_rng(seed)

    def rgb() -> tuple[float, float, float]:
        a, b, c = (float(v) for v in (r.integers(0, 2, 3) if r.random() < 0.2 else r.random(3)))
        return a, b, c

    things = []
    for _ in range(int(r.integers(2, 4))):
        x, y, z = (float(v) for v in r.uniform(-1.5, 1.5, 3))
        things.append(
            Thing(
                shape=SHAPES[int(r.integers(len(SHAPES)))],
                # Now and then on the floor, or half in it.
                place=(x, y, 0.0 if r.random() < 0.3 else abs(z)),
                size=float(10.0 ** r.uniform(-3, 0.5)),
                reflectance=rgb(),
                alpha=float(r.choice([0.0, 1e-4, r.random(), 1.0])),
                metalness=float(r.choice([0.0, r.random(), 1.0])),
                emission=float(10.0 ** r.uniform(-6, 4)),
            )
        )
    return SmallJob(
        family=int(r.choice(len(FAMILIES), p=[0.35, 0.25, 0.2, 0.07, 0.07, 0.06])),
        seed=int(r.integers(2**31)),
        scale=float(10.0 ** r.uniform(-4, 4)),
        offset=0.0 if r.random() < 0.3 else float(10.0 ** r.uniform(0, 6)),
        size=SIZES[int(r.integers(len(SIZES)))],
        azimuth=float(r.uniform(0, 2 * np.pi)),
        elevation=float(r.choice([r.uniform(-0.2, 1.5), 1e-3, 0.0, np.pi / 2])),
        distance=float(10.0 ** r.uniform(-1, 1)),
        focal=float(10.0 ** r.uniform(-0.5, 2)),
        light=LIGHTS[int(r.integers(len(LIGHTS)))],
        strength=float(10.0 ** r.uniform(-4, 6)),
        floor=rgb(),
        things=tuple(things),
        spp=2 * int(r.integers(1, 3)),
        max_depth=None if r.random() < 0.5 else int(r.integers(2, 20)),
        gain=float(10.0 ** r.uniform(-3, 3)),
        photo=float(r.choice([0.0, 1.0, 10.0 ** r.uniform(-3, 3)])),
    )


def _mesh(thing: Thing) -> Mesh:
    s = thing.size
    if thing.shape == "ball":
        return icosphere(s, subdivisions=2, centre=thing.place)
    if thing.shape == "smooth ball":
        return uv_sphere(s, segments=12, rings=6, centre=thing.place)
    if thing.shape == "box":
        return box((s, 0.7 * s, 1.3 * s), centre=thing.place)
    if thing.shape == "card":
        return plane(s, s, centre=thing.place)
    return box((s, 1e-5 * s, 1e-3 * s), centre=thing.place)


def _material(family: Family, number: int, thing: Thing) -> Material:
    emission = (thing.emission,) * 3 if family == "mixed" else (0.0,) * 3
    if family == "glass" and number == 0:
        return Material("dielectric", (1.0,) * 3, thing.alpha, ior=1.0 + 1.5 * thing.metalness + 1e-3)
    if family == "mixed" and number < 2:
        kind = ("conductor", "principled")[number]
        return Material(
            kind,
            thing.reflectance,
            thing.alpha,
            metalness=thing.metalness if kind == "principled" else 0.0,
            f0=0.04 if kind == "principled" else 0.0,
            emission=emission,
        )
    return Material(reflectance=thing.reflectance, emission=emission)


def _light(job: SmallJob) -> Environment:
    if job.light == "black":
        return Environment(np.zeros((4, 8, 3), np.float32))
    if job.light == "even":
        return Environment(np.full((4, 8, 3), job.strength, np.float32))
    if job.light == "one texel":
        return Environment(np.full((1, 1, 3), job.strength, np.float32))
    image = np.full((16, 32, 3), 1e-3, np.float32)
    if job.light == "lamp":
        image[4, 7] = job.strength
    else:
        image = (10.0 ** np.random.default_rng(job.seed).uniform(-4, 5, (16, 32, 3))).astype(np.float32)
        image[:3] = 0.0
    return Environment(image)


def render(job: SmallJob) -> Any:
    """`Estimated` of the job, and its composite (h, w, 3)."""
    name, family = FAMILIES[job.family]
    shift = np.full(3, job.offset) * [1, -1, 1]
    matrix = np.diag([job.scale, job.scale, job.scale, 1.0])
    matrix[:3, 3] = shift
    objects = [real("floor", plane(8.0, 8.0), job.floor)]
    for number, thing in enumerate(job.things):
        looks = _material(family, number, thing)
        closed = thing.shape not in ("card",) or looks.kind != "dielectric"
        mesh = _mesh(thing) if closed else box((thing.size,) * 3, centre=thing.place)
        objects.append(SceneObject(f"thing {number}", mesh, looks, True))
    placed = [SceneObject(o.name, o.mesh.transformed(matrix), o.material, o.virtual) for o in objects]
    c, s = np.cos(job.elevation), np.sin(job.elevation)
    eye = np.array([c * np.cos(job.azimuth), c * np.sin(job.azimuth), s]) * job.distance + [0, 0, 0.1]
    width, height = job.size
    target = np.array([0.0, 0.0, 0.1])
    view = look_at(
        eye * job.scale + shift,
        target * job.scale + shift,
        width=width,
        height=height,
        focal=job.focal * max(width, height),
    )
    photo = np.full((height, width, 3), job.photo, np.float32)
    settings = {} if name == "image-based-lighting" else {"max_depth": job.max_depth}
    found = estimate(
        find_method(name),
        Scene(tuple(placed), _light(job), centre(placed)),
        view,
        settings=settings,
        spp=job.spp,
        seed=job.seed,
        background=photo,
        gain=(job.gain,) * 3,
        threads=1,
    )
    d = found.developed
    return found, composite(d.P, d.a, photo, d.D)


def measure(job: SmallJob) -> Measurement:
    """Whether all layers are numbers, light and coverage not negative, coverage at most 1."""
    found, whole = render(job)
    d = found.developed
    return Measurement(
        passed=bool(np.all(d.a <= 1.0)),
        measured=none(d.a > 1.0, "pixels covered more than once").measured,
        oracle="0",
        tolerance="exact",
        radiance=(d.P, d.a, d.variance, whole),
        signed=(d.D, d.halves),
    )
