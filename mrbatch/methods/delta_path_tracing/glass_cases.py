"""Hard cases of delta path tracing through glass and on steep normal maps: what passes, bends, leaks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from mrbatch.contracts import Case, Measurement
from mrbatch.methods.delta_path_tracing.delta_probe import delta_probe
from mrbatch.methods.delta_path_tracing.picture_cases import delta_estimate, shown
from mrbatch.methods.probe import judge_change, judge_seen
from mrbatch.metrics.judging import none, together, within
from mrbatch.scene import settings as given
from mrbatch.scene.build import build_scene
from mrbatch.scene.closed_forms import ball, floor, lamp_sky, look_at, real, scene_of, sky, virtual
from mrbatch.scene.environment import Environment
from mrbatch.scene.mesh import Mesh, box, plane
from mrbatch.scene.scene import Material, SceneObject, Texture

GLASS = Material("dielectric", (1.0,) * 3, 0.0, ior=1.5, priority=2)
WATER = replace(GLASS, ior=1.33, priority=1)
SLAB = (1 - 0.04) / (1 + 0.04)
"""What a slab of index 1.5 lets through, all ways to and fro added up: (1 - R) / (1 + R) = 0.92308."""


def clear(mesh: Mesh, material: Material = GLASS, name: str = "glass", **switches: Any) -> SceneObject:
    return SceneObject(name, mesh, material, True, **switches)


def halves(upper: float, lower: float) -> Environment:
    """A map with one radiance above the horizon and another below."""
    radiance = np.empty((64, 8, 3), np.float32)
    radiance[:32], radiance[32:] = upper, lower
    return Environment(radiance)


def slab(seed: int) -> Measurement:
    """BSDF-07: a slab lets .92308 of the light below pass, and mirrors .07692 of that above."""
    glass = clear(box((8.0, 8.0, 0.01)))
    found = [
        delta_probe(scene_of([glass], light), (0, 0, 0), distance=4.0, spp=4096, seed=seed)
        for light in (halves(0.0, 1.0), halves(1.0, 0.0))
    ]
    return judge_seen(found, np.array([[SLAB], [1 - SLAB]]), 1e-4, sees=0.01)


def glass_ball(seed: int) -> Measurement:
    """BSDF-08: a ball of glass under an even sky shows the sky: what is divided by the index squared on the
    way in is multiplied on the way out. No ray is drawn to the light (MIS-02)."""
    scene = scene_of([clear(ball(at=(0, 0, 0)))], sky())
    points = ((0, 0, 1.0), (0.4, 0, 0.9), (0.9, 0, 0.4))
    settings = {"roulette_depth": 64}
    found = [delta_probe(scene, p, distance=3.0, spp=256, seed=seed, settings=settings) for p in points]
    under = scene_of([real("floor", floor(), 1.0), clear(ball(at=(0, 0, 1.001)))])
    change = delta_probe(under, (0.5, 0, 0), spp=4096, distance=1e-3, seed=seed)
    return together(
        judge_seen(found, 1.0, 1e-4, sees=0.01),
        within([p.counters["shadow rays"] for p in found], 0, 0, what="rays to the light"),
        judge_change([change], 0.0, 1e-3, sees=0.02),
    )


def snells_way(seed: int, *, gaps: Sequence[float] = (-1e-5, 1e-5)) -> Measurement:
    """BSDF-09: water between two panes, ending a hundredth of a millimetre before them or reaching as far
    into both: at 60 degrees an edge below is where Snell's law puts it, to 1e-5 of half a metre."""
    at = np.radians(60)
    eye = np.array([0.0, -np.sin(at), np.cos(at)]) * 0.5
    # All 64 pixels lie within a micrometre.
    view = look_at(eye, (0, 0, 0), width=8, height=8, focal=8 * 2.0**19)
    black = virtual("black", box((9.0, 9.0, 0.001), centre=(0.0, 0.0, -0.102)), 0.0)
    means, oracle, pictures = [], [], []
    for gap in gaps:
        tops = {"upper": (0.02, 0.01), "water": (0.01 + gap, -0.01 - gap), "lower": (-0.01, -0.02)}
        layers = [
            clear(
                box((2.0, 2.0, top - bottom), centre=(0, 0, 0.5 * (top + bottom))),
                WATER if name == "water" else GLASS,
                name,
            )
            for name, (top, bottom) in tops.items()
        ]
        # What is there from top to bottom: glass beats the water that reaches into it.
        edges = [0.02, 0.01, min(0.01, 0.01 + gap), -min(0.01, 0.01 + gap), -0.01, -0.02, -0.1]
        y = -edges[0] * np.tan(at)
        for top, bottom, n in zip(edges[:-1], edges[1:], (1.5, 1.0, 1.33, 1.0, 1.5, 1.0), strict=True):
            y += (top - bottom) * np.tan(np.arcsin(np.sin(at) / n))
        for side, white in ((-5e-6, 0.0), (5e-6, 1.0)):
            strip = virtual("strip", box((4.0, 4.0, 0.001), centre=(0.0, y + side - 2.0, -0.1005)), 1.0)
            d = delta_estimate(scene_of([*layers, strip, black], sky()), view, spp=256, seed=seed).developed
            means.append(d.P.mean())
            oracle.append(white)
            pictures.append(d)
    wrong = (np.array(means) > 0.5) != (np.array(oracle) > 0.5)
    return together(none(wrong, "sides of an edge that look like the other"), shown(*pictures))


def slab_shift(seed: int) -> Measurement:
    """DPT-12: 10 mm of index 1.5 at 60 degrees shift the view: d sin i (1 - cos i / (n cos t))."""
    at = np.radians(60)
    eye = np.array([0.0, -np.sin(at), np.cos(at)]) * 0.5
    glass = clear(box((2.0, 2.0, 0.010)))
    black = virtual("black", box((9.0, 9.0, 0.001), centre=(0.0, 0.0, -0.102)), 0.0)
    shift = 0.010 * np.sin(at) * (1 - np.cos(at) / (1.5 * np.cos(np.arcsin(np.sin(at) / 1.5))))
    view = look_at(eye, (0, 0, 0), width=8, height=8, focal=8 * 2.0**12)
    means, pictures = [], []
    # A white strip below; its edge lies a fifth of a millimetre on either side of where it must be seen.
    for side in (-2e-4, 2e-4):
        edge = np.tan(at) * 0.1 - shift / np.cos(at) + side
        strip = virtual("strip", box((4.0, 4.0, 0.001), centre=(0.0, edge - 2.0, -0.1005)), 1.0)
        d = delta_estimate(scene_of([glass, strip, black], sky()), view, spp=256, seed=seed).developed
        means.append(d.P[..., 0].mean())
        pictures.append(d)
    wrong = (np.array(means) > 0.5) != np.array([False, True])
    return together(
        within(shift * 1000, 5.125, 1e-3, what="shift, mm"),
        none(wrong, "sides of an edge that look like the other"),
        shown(*pictures),
    )


def index_of_air(seed: int) -> Measurement:
    """DPT-16: what is clear with the index of air changes no bit."""
    item = {"name": "bubble", "sphere": {"radius": "0.5 m"}, "material": {"type": "dielectric", "ior": 1.0}}
    table = {"name": "table", "plane": {"size": ["4 m", "4 m"]}, "reflectance": 0.5}
    objects = given.RealObject.model_validate(table), given.VirtualObject.model_validate(item)
    scene = replace(build_scene(None, [objects[0]], [objects[1]]), environment=lamp_sky())
    view = look_at((2, 0, 2), (0, 0, 0), width=16, height=16, focal=16)
    d = delta_estimate(scene, view, spp=16, seed=seed).developed
    every = np.concatenate([d.P.ravel(), d.a.ravel(), d.D.ravel()])
    return together(within(every, 0.0, 0.0, what="P, a and D"), shown(d))


def leaning(degrees: float) -> Texture:
    """A normal map that is even, that many degrees from the surface's normal."""
    t = np.radians(degrees)
    return Texture(np.array([[[np.sin(t), 0, np.cos(t)]]], np.float32))


def steep_map(seed: int, *, degrees: Sequence[float] = (60.0, 85.0)) -> Measurement:
    """BSDF-10: normals at 60 degrees see 30 degrees below the card: lit from below alone, with no shadow of
    its own, it is black to the bit; white under the sky it sends at most what comes."""
    image = np.zeros((64, 8, 3), np.float32)
    image[33:] = 1.0
    below = Environment(image, interpolation="nearest")
    view = look_at((0.5, -1.0, 3.0), (0, 0, 0), width=8, height=8, focal=32)
    looks = (
        Material(reflectance=(1.0,) * 3, normal_texture=leaning(60.0)),
        Material("conductor", (1.0,) * 3, 0.4, normal_texture=leaning(60.0)),
        Material("principled", (1.0,) * 3, 0.4, f0=0.04, normal_texture=leaning(60.0)),
    )
    dark = []
    for look in looks:
        card = SceneObject("card", plane(4.0, 4.0), look, True, cast_shadow=False)
        dark.append(delta_estimate(scene_of([card], below), view, spp=64, seed=seed).developed)
    gains, pictures = [], list(dark)
    for angle in degrees:
        white = Material(reflectance=(1.0,) * 3, normal_texture=leaning(angle))
        for eye in ((0, -1.0, 4.0), (3.0, 0, 1.0), (-3.0, 0.5, 0.7)):
            card = SceneObject("card", plane(2.0, 2.0), white, True)
            camera = look_at(eye, (0, 0, 0), width=16, height=16, focal=40)
            d = delta_estimate(scene_of([card], sky()), camera, spp=256, seed=seed).developed
            inside = d.P[d.a == 1][:, 0]
            gains.append(inside.mean() > 1.0 + 4 * inside.std() / np.sqrt(len(inside)))
            # Bent only as far as it can be seen.
            gains.append(inside.mean() < 0.2)
            pictures.append(d)
    return together(
        within(np.concatenate([d.P.ravel() for d in dark]), 0.0, 0.0, what="light from below"),
        none(np.array(gains), "cards that gain light or are black"),
        shown(*pictures),
    )


CASES: tuple[Case, ...] = (
    Case(
        "BSDF-07",
        "a slab lets through what Fresnel says",
        slab,
        quick=False,
        setup="slab of glass seen from above, light below or above alone",
        statistical=True,
    ),
    Case(
        "BSDF-08",
        "glass under an even sky shows the sky",
        glass_ball,
        setup="ball of glass, three points; its change on a white floor",
        rows=("MIS-02",),
        statistical=True,
    ),
    Case(
        "BSDF-09",
        "the way through glass, water and glass is Snell's",
        snells_way,
        setup="water that ends .01 mm before two panes, or reaches into them; at 60 degrees",
    ),
    Case(
        "BSDF-10",
        "steep normal maps leak and gain nothing",
        steep_map,
        False,
        setup="cards with normals at 60 and 85 degrees, matt, metal, lacquer",
        statistical=True,
    ),
    Case("DPT-12", "a slab shifts what lies behind it", slab_shift, setup="10 mm of index 1.5 at 60 degrees"),
    Case("DPT-16", "what has the index of air changes no bit", index_of_air, setup="clear ball over a table"),
)
