"""Hard cases of delta path tracing at single points, with closed forms: what blocks, bleeds and mirrors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mrbatch.contracts import Case, Measurement
from mrbatch.methods.delta_path_tracing.delta_probe import delta_probe
from mrbatch.methods.probe import judge_change, unchanged
from mrbatch.metrics.judging import none, together, within
from mrbatch.scene.closed_forms import (
    ball,
    ball_share,
    corner,
    floor,
    lamp_sky,
    placed,
    real,
    scene_of,
    sunk_ball_share,
    upright_share,
    virtual,
)
from mrbatch.scene.mesh import Mesh, box, icosphere, plane
from mrbatch.scene.scene import Material, SceneObject

BIG = 2.0**12
LEVEL = 0.005
"""A difference that must be told: 1 % of what an open floor of reflectance .5 shows."""


def half_sunk(seed: int, *, distances: Sequence[float] = (1.2, 2.0, 4.0)) -> Measurement:
    """DPT-03: the horizon cuts a ball whose middle lies in the plane."""
    scene = scene_of([real("floor", floor()), virtual("ball", ball(at=(0, 0, 0)), 0.0, camera=False)])
    found = [delta_probe(scene, (q, 0, 0), spp=1024, seed=seed) for q in distances]
    oracle = -0.5 * sunk_ball_share(np.array(distances))
    return judge_change(found, oracle[:, None], 1e-3 * float(-oracle.min()), sees=LEVEL)


def contact(seed: int, *, gaps: Sequence[float] = (0.0, 1e-6, 1e-3)) -> Measurement:
    """GEO-08: right under a ball that touches the plane no light is left."""
    found = []
    for gap in gaps:
        item = virtual("ball", ball(at=(0, 0, 1 + gap)), 0.0, camera=False)
        scene = scene_of([real("floor", floor()), item])
        found.append(delta_probe(scene, (0.01, 0, 0), spp=256, distance=2.0**-4, seed=seed))
    oracle = np.array([[-0.5 * float(ball_share(1, 1 + gap, 0.01))] for gap in gaps])
    return judge_change(found, oracle, 1e-4)


def union(seed: int) -> Measurement:
    """DPT-13: what hides what is a union: two balls in line, and one mesh twice."""
    near, far = ball(0.5, at=(0, 0, 2)), ball(1.0, at=(0, 0, 6))
    found = []
    for pair in ([near, far], [near, near]):
        items = [virtual(f"b{k}", m, 0.0, camera=False) for k, m in enumerate(pair)]
        found.append(delta_probe(scene_of([real("floor", floor()), *items]), (0, 0, 0), spp=2048, seed=seed))
    oracle = -0.5 * (0.5 / 2) ** 2
    return judge_change(found, oracle, 1e-3 * abs(oracle), sees=0.02 * abs(oracle))


def roulette(seed: int) -> Measurement:
    """MC-03: roulette early or late, or paths of a hundred edges, among white surfaces: no change."""
    objects = [real("floor", floor(), 1.0), virtual("ball", ball(subdivisions=5), 1.0, camera=False)]
    ways = ({"roulette_depth": 2}, {"roulette_depth": 12}, {"max_depth": 100})
    scene = scene_of(objects)
    found = [delta_probe(scene, (0.7, 0, 0), spp=4096, seed=seed + k, settings=w) for k, w in enumerate(ways)]
    return judge_change(found, 0.0, 1e-3, sees=2 * LEVEL)


def hollow(radius: float, at: Sequence[float]) -> Mesh:
    """A ball with three deep dents, so that light goes to and fro in them."""
    mesh = icosphere(1.0, subdivisions=4)
    depth = np.exp(10.0 * (mesh.vertices @ np.eye(3) - 1.0)).sum(axis=1)
    vertices = mesh.vertices * (radius * (1 - 0.6 * depth))[:, None] + np.asarray(at)
    return replace(mesh, vertices=vertices, normals=None)


def white_things() -> dict[str, Mesh]:
    """Meshes by name for `white_meshes`."""
    return {
        "box": box((1.0, 0.6, 0.8), centre=(0, 0, 0.4)),
        "half in the floor": box((0.8, 0.8, 0.8), centre=(0, 0, 0.1)),
        "hollow": hollow(0.6, (0, 0, 0.7)),
        "card": placed(plane(1.0, 1.0), at=(-0.2, 0, 0.5), normal=(1, 0, 0)),
    }


def white_meshes(seed: int, *, names: Sequence[str] = ("half in the floor", "hollow")) -> Measurement:
    """DPT-04: any white thing on a white floor under the sky changes nothing."""
    found = []
    for name in names:
        thing = virtual("thing", white_things()[name], 1.0, camera=False)
        scene = scene_of([real("floor", floor(), 1.0), thing])
        found += [delta_probe(scene, at, spp=4096, seed=seed) for at in ((0.8, 0.1, 0), (0.2, 0.9, 0))]
    return judge_change(found, 0.0, 1e-3, sees=2 * LEVEL)


def bleeding(
    seed: int, *, reflectances: Sequence[tuple[float, float]] = ((0.5, 0.5), (0.8, 0.2))
) -> Measurement:
    """DPT-05: radiosity of two half-planes, each seeing the other with form factor 1/2; the wall's hue."""
    wall = placed(plane(BIG, BIG), at=(0, 0, BIG / 2), normal=(1, 0, 0))
    found, oracle = [], []
    for rr, rv in reflectances:
        colours = np.array([rv, 0.0, 1.0])
        oracle.append(rr * (0.5 + colours / 4) / (1 - rr * colours / 4) - rr)
        scene = scene_of([real("floor", floor(), rr), virtual("wall", wall, tuple(colours), camera=False)])
        found.append(delta_probe(scene, (1, 0, 0), spp=2048, seed=seed))
    hues = [p.delta[1] < p.delta[0] < p.delta[2] for p in found]
    return together(
        judge_change(found, np.array(oracle), 1e-3, sees=LEVEL),
        none(~np.array(hues), "walls of another hue"),
    )


def hidden_wall(seed: int, *, reflectances: Sequence[float] = (0.2, 0.5, 0.8)) -> Measurement:
    """DPT-21: before a whole real wall, what is lost is what that wall sent, not the sky behind it."""
    hide = placed(plane(BIG, BIG), at=(2.0**-10, 0, BIG / 2), normal=(1, 0, 0))
    black = virtual("black", hide, 0.0, camera=False)
    found = [
        delta_probe(scene_of([*corner(rho), black]), (1, 0, 0), spp=2048, seed=seed) for rho in reflectances
    ]
    oracle = np.array([[-(rho**2) / (2 * (2 - rho))] for rho in reflectances])
    return judge_change(found, oracle, 1e-3 * min(reflectances), sees=LEVEL)


def before_black_wall(seed: int) -> Measurement:
    """DPT-08: a black ball wholly before a black real wall takes nothing: to the bit."""
    wall = placed(plane(BIG, BIG), at=(-2, 0, BIG / 2), normal=(1, 0, 0))
    objects = [real("floor", floor()), real("wall", wall, 0.0)]
    item = virtual("b", ball(0.3, at=(-1, 0, 1)), 0.0, camera=False)
    return unchanged([delta_probe(scene_of([*objects, item]), (0, 0, 0), spp=128, seed=seed)])


def behind_the_wall(seed: int) -> Measurement:
    """DPT-01, DPT-07: an object behind a real wall: everything is traced, and every contribution is 0."""
    hidden = virtual("hidden", ball(0.5, at=(-3, 0, 1)), 0.9)
    found = delta_probe(scene_of([*corner(0.5), hidden]), (1, 0, 0), spp=64, seed=seed)
    return together(
        unchanged([found]),
        none(found.counters["scatter rays"] == 0, "probes that trace nothing"),
        within(found.counters["lookups"], 0, 0, what="look-ups of the map"),
    )


def closed_box(seed: int) -> Measurement:
    """DPT-07: a glowing white ball inside six real walls: not a bit changes outside, no look-up."""
    inside = virtual("ball", ball(0.3, at=(0, 0, 0.5)), 0.9)
    glowing = replace(inside, material=replace(inside.material, emission=(5.0, 5.0, 5.0)))
    objects = [real("floor", floor(), 0.5), real("box", box((0.8, 0.8, 0.8), centre=(0, 0, 0.5))), glowing]
    scene = scene_of(objects, lamp_sky())
    found = [
        delta_probe(scene, at, normal=normal, spp=256, seed=seed)
        for at, normal in (((0.6, 0.1, 0), (0, 0, 1)), ((0.4, 0.1, 0.5), (1, 0, 0)))
    ]
    return together(
        unchanged(found),
        none(np.array([p.counters["scatter rays"] == 0 for p in found]), "probes that trace nothing"),
        within([p.counters["lookups"] for p in found], 0, 0, what="look-ups of the map"),
    )


def upright_mirror(seed: int, *, reflectances: Sequence[float] = (0.4, 1.0)) -> Measurement:
    """DPT-06: -rr F (1 - R): whatever leaves the floor for the mirror ends in the sky above it; at R = 1 what
    is taken off a ray and what is put on it are one number."""
    a, b, c = 1.0, 1.0, 0.5
    card = placed(plane(b, a), at=(0, b / 2, a / 2), normal=(1, 0, 0))
    judged, found, oracle = [], [], []
    for reflectance in reflectances:
        look = Material("conductor", (reflectance,) * 3, 0.0)
        item = SceneObject("mirror", card, look, True, camera=False)
        scene = scene_of([real("floor", floor(), 0.5), item])
        found.append(delta_probe(scene, (c, 0, 0), spp=2048, seed=seed))
        oracle.append(-0.5 * upright_share(a, b, c) * (1 - reflectance))
        if reflectance == 1.0:
            exact = delta_probe(scene, (c, 0, 0), spp=256, seed=seed, settings={"strategy": "bsdf"})
            judged.append(within(exact.pixels, 0.0, 1e-6, what="scattered rays alone, R = 1"))
    return together(judge_change(found, np.array(oracle)[:, None], 1e-6, sees=LEVEL), *judged)


def lamp_and_blocker(seed: int) -> Measurement:
    """DPT-18: a virtual lamp behind, beside and before a virtual blocker: what is behind takes no part."""
    e, rr = 5.0, 0.5
    glow = Material(reflectance=(0.0,) * 3, emission=(e,) * 3)
    found, oracle = [], []
    for lamp, blocker in (((0, 0, 6), (0, 0, 2)), ((0, 3, 4), (2, 0, 2)), ((0, 0, 2), (0, 0, 8))):
        objects = [
            real("floor", floor(), rr),
            SceneObject("lamp", ball(0.6, at=lamp), glow, True, camera=False),
            virtual("black", ball(0.5, at=blocker), 0.0, camera=False),
        ]
        found.append(delta_probe(scene_of(objects), (0, 0, 0), spp=4096, seed=seed))
        of_lamp, of_black = (
            float(ball_share(r, at[2], np.hypot(at[0], at[1]))) for r, at in ((0.6, lamp), (0.5, blocker))
        )
        part = {6: -rr * of_black, 4: rr * (of_lamp * (e - 1) - of_black), 2: rr * of_lamp * (e - 1)}
        oracle.append(part[lamp[2]])
    return judge_change(found, np.array(oracle)[:, None], 1e-3 * min(map(abs, oracle)), sees=LEVEL)


CASES: tuple[Case, ...] = (
    Case(
        "DPT-03",
        "the horizon cuts a ball half in the floor",
        half_sunk,
        setup="black ball of radius 1 in a floor of .5; 1.2, 2 and 4 radii off",
        statistical=True,
    ),
    Case(
        "DPT-04",
        "any white thing on a white floor changes nothing",
        white_meshes,
        setup="box half in the floor, dented ball; two points each",
        statistical=True,
    ),
    Case(
        "DPT-05",
        "an endless wall bleeds its colour",
        bleeding,
        setup="virtual wall of three reflectances on floors of .5 and .8",
        statistical=True,
    ),
    Case(
        "DPT-06",
        "an upright mirror takes what it does not mirror",
        upright_mirror,
        quick=False,
        setup="mirror 1 m high and wide, half a metre off, reflectance .4 and 1",
        statistical=True,
    ),
    Case(
        "DPT-07",
        "what lies behind a real wall changes nothing",
        behind_the_wall,
        setup="ball behind a wall of a corner",
        rows=("DPT-01",),
    ),
    Case(
        "DPT-07",
        "nor what stands in a closed real box",
        closed_box,
        quick=False,
        setup="glowing ball inside six walls",
    ),
    Case(
        "DPT-08",
        "a black ball before a black wall takes nothing",
        before_black_wall,
        quick=False,
        setup="ball of .3 wholly before an endless black wall",
        rows=("TRAP-1c",),
    ),
    Case(
        "DPT-13",
        "what hides what is a union",
        union,
        setup="two balls in line; one ball twice",
        statistical=True,
    ),
    Case(
        "DPT-18",
        "a lamp behind a blocker lights nothing",
        lamp_and_blocker,
        setup="virtual lamp behind, beside and before a virtual ball",
        statistical=True,
    ),
    Case(
        "DPT-21",
        "a hidden wall takes its own light away, not the sky's",
        hidden_wall,
        setup="black wall before a whole real wall of .2, .5, .8",
        statistical=True,
    ),
    Case(
        "GEO-08",
        "no light leaks where a ball touches the floor",
        contact,
        setup="ball touching, a millionth and a thousandth above; a hundredth of its radius off",
        rows=("TRAP-1k",),
        statistical=True,
    ),
    Case(
        "MC-03",
        "roulette has no bias, however it is set",
        roulette,
        setup="white ball on a white floor, three settings",
        statistical=True,
    ),
)
