"""Hard cases of delta path tracing's noise: means of every way of drawing, intervals, units and turns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from mrbatch.contracts import Case, Measurement
from mrbatch.methods.delta_path_tracing.delta_probe import delta_probe
from mrbatch.methods.delta_path_tracing.picture_cases import delta_estimate, shown
from mrbatch.methods.probe import judge, judge_seen
from mrbatch.metrics.judging import mean_within, none, same_bits, together, within
from mrbatch.scene.closed_forms import (
    ball,
    ball_share,
    corner,
    floor,
    lamp_sky,
    look_at,
    real,
    scene_of,
    sky,
    virtual,
)
from mrbatch.scene.environment import Environment, rotation_from_yaw
from mrbatch.scene.mesh import plane
from mrbatch.scene.scene import Scene, centre

INDEPENDENT = {"sampler": "independent"}
WAYS: tuple[dict[str, Any], ...] = (
    {"strategy": "mis"},
    {"strategy": "environment"},
    {"strategy": "bsdf"},
    {"strategy": "mis", "light_samples": 64},
)


def maps() -> dict[str, Environment]:
    """Four maps by name for `ways_of_drawing`."""
    halves = [[[2.0] * 3] * 8] * 8 + [[[0.1] * 3] * 8] * 8
    many = np.random.default_rng(4).random((24, 48, 3)) ** 8 * 20
    return {
        "even": sky(),
        "lamp": lamp_sky(),
        "halves": Environment(np.array(halves, np.float32)),
        "many": Environment(many.astype(np.float32)),
    }


def ways_of_drawing(seed: int, *, names: Sequence[str] = ("even", "lamp", "halves", "many")) -> Measurement:
    """MIS-05: scattered directions alone, drawn ones alone, both, and 64 drawn for one scattered: pair by
    pair the same mean."""
    thing = virtual("ball", ball(0.6, at=(0.5, 0, 0.6)), (0.7, 0.4, 0.2), camera=False)
    judged = []
    for name in names:
        scene = scene_of([*corner(0.5), thing], maps()[name])
        found = [
            delta_probe(
                scene,
                (0.3, 0.1, 0),
                # Scattered rays alone seldom find a lamp.
                spp={"environment": 2048, "bsdf": 8192}.get(way["strategy"], 64 if len(way) > 1 else 2048),
                seed=seed + k,
                settings=way,
            )
            for k, way in enumerate(WAYS)
        ]
        size = float(np.abs(found[0].delta).min())
        for i, one in enumerate(found):
            for other in found[:i]:
                error = np.hypot(one.delta_error, other.delta_error)
                judged.append(
                    judge(one.delta, error, other.delta, 0.0, sees=0.15 * size, probes=[one, other])
                )
    return together(*judged)


def blocked_light(seed: int, side: int = 256) -> tuple[np.ndarray, float]:
    """(n,) what is left of the photo's light under a lid, by two samples each, and that light itself."""
    lid = virtual("lid", plane(2.0**12, 2.0**12, centre=(0, 0, 0.25)), 0.0, camera=False)
    scene = scene_of([real("floor", floor(), 0.5), lid], lamp_sky(4.0))
    photo = float(0.5 / np.pi * lamp_sky(4.0).irradiance(np.array([[0, 0, 1.0]]))[0, 0])
    view = look_at((0, 0, 2.0**-3), (0, 0, 0), width=side, height=side, focal=side * 2.0**12)
    d = delta_estimate(scene, view, spp=2, seed=seed, settings=INDEPENDENT).developed
    return photo + d.D[..., 0].ravel(), photo


def nothing_left(seed: int) -> Measurement:
    """MC-02: a table whose light is all blocked is black in the mean: nothing is clamped sample by sample."""
    left, photo = blocked_light(seed)
    error = left.std() / np.sqrt(len(left))
    return together(
        mean_within(left.mean(), error, 0.0, 2e-4 * photo, sees=0.02 * photo, observations=len(left)),
        # Without noise the case would prove nothing.
        none(left.std() < 0.02 * photo, "set-ups without noise"),
    )


def seldom_found(seed: int, *, runs: int = 4) -> Measurement:
    """MC-08: by scattered rays alone a lamp that one ray in 70,000 finds lights a card as its solid angle
    says: by Poisson's law of some 250 rays of 16.8 million."""
    height, width, row, column = 384, 544, 96, 200
    image = np.zeros((height, width, 3), np.float32)
    image[row, column] = 1e5
    light = Environment(image, interpolation="nearest")
    edges = np.pi * np.array([row, row + 1]) / height
    share = float(np.diff(np.sin(edges) ** 2)[0]) / width
    scene = scene_of([virtual("card", plane(1.0, 1.0), 0.8)], light)
    found = [
        delta_probe(scene, (0, 0, 0), spp=1 << 16, seed=seed + k, settings=INDEPENDENT | {"strategy": "bsdf"})
        for k in range(runs)
    ]
    hits = share * runs * 64 * (1 << 16)
    relative = float(np.mean([f.virtual[0] for f in found])) / (0.8 * 1e5 * share)
    return mean_within(relative, 1 / np.sqrt(hits), 1.0, 0.0, sees=0.3, observations=int(hits))


def coverage(seed: int, light: Environment | None, truth: float, *, runs: int = 16, **settings: str) -> float:
    """Share of 64 times `runs` estimates whose own 95 % interval holds the truth."""
    view = look_at((1.0, 0, 1), (1.0, 0, 0), width=8, height=8, focal=8 * 2**12)
    scene = scene_of([real("floor", floor()), virtual("ball", ball(), 0.0, camera=False)], light)
    inside = []
    for k in range(runs):
        d = delta_estimate(scene, view, spp=64, seed=seed + k, settings=INDEPENDENT | settings).developed
        inside.append(np.abs(d.D[..., 0] - truth) < 1.96 * np.sqrt(d.variance[..., 0]))
    return float(np.mean(inside))


def intervals(seed: int) -> Measurement:
    """MC-05: the film's 95 % interval of 1024 estimates under the sky holds the truth in 93 to 97 %."""
    share = coverage(seed, None, -0.5 * float(ball_share(1.0, 1.0, 1.0)))
    return within(share, 0.95, 0.02, what="coverage")


def units(seed: int) -> Measurement:
    """DPT-19: a map four times as bright under a quarter of the gain gives the same bits; half the gain and
    half the photo give half the change."""
    item = virtual("ball", ball(0.4, at=(0.6, 0, 0.4), subdivisions=3), 0.6)
    objects = [*corner(0.5, size=16.0), item]
    view = look_at((3, -2, 2), (0.4, 0, 0.2), width=24, height=20, focal=30)
    photo = np.random.default_rng(2).uniform(0.1, 0.8, (20, 24, 3)).astype(np.float32)
    light = lamp_sky().radiance
    ways = ((light, 0.5, photo), (4 * light, 0.125, photo), (light, 0.25, 0.5 * photo))
    base, bright, half = (
        delta_estimate(
            scene_of(objects, Environment(radiance)), view, spp=8, seed=seed, background=b, gain=(gain,) * 3
        ).developed
        for radiance, gain, b in ways
    )
    return together(
        same_bits([base.P, base.D, base.variance], [bright.P, bright.D, bright.variance]),
        same_bits([0.5 * base.P, 0.5 * base.D], [half.P, half.D]),
        none(not (base.D.any() and base.P.any()), "empty pictures"),
        shown(base, bright, half),
    )


def turned_scene(seed: int) -> Measurement:
    """DPT-19, ENV-07: scene and map turned together, and the objects in another order."""
    item = virtual("ball", ball(0.5, at=(0.8, 0, 0.5), subdivisions=4), (0.7, 0.4, 0.2), camera=False)
    home = scene_of([*corner(0.5, size=64.0), item], lamp_sky())
    point, yaw = np.array([0.6, 0.1, 0.0]), 0.65
    matrix = np.eye(4)
    matrix[:3, :3] = rotation_from_yaw(yaw)
    objects = tuple(replace(o, mesh=o.mesh.transformed(matrix)) for o in home.objects)
    light = Environment(home.environment.radiance, world_from_map=rotation_from_yaw(yaw))
    scenes = (
        (home, point),
        (Scene(objects, light, centre(objects)), matrix[:3, :3] @ point),
        (Scene(home.objects[::-1], home.environment, home.origin), point),
    )
    base, *others = (delta_probe(s, p, spp=2048, seed=seed + k) for k, (s, p) in enumerate(scenes))
    size = float(np.abs(base.delta).max())
    return together(
        *(
            judge(
                other.delta,
                np.hypot(other.delta_error, base.delta_error),
                base.delta,
                0.0,
                sees=0.02 * size,
                probes=[base, other],
            )
            for other in others
        )
    )


def pole_texel(seed: int) -> Measurement:
    """ENV-03: through sampler, paths and film: E = L (pi / W) sin^2(pi / H) of a texel in row 0."""
    height, width = 32, 48
    image = np.zeros((height, width, 3), np.float32)
    image[0, 5] = 1e4
    scene = scene_of([virtual("card", plane(1.0, 1.0), 0.8)], Environment(image, interpolation="nearest"))
    found = delta_probe(scene, (0.1, 0.05, 0), spp=512, seed=seed, settings={"strategy": "environment"})
    oracle = 0.8 / np.pi * 1e4 * np.pi / width * np.sin(np.pi / height) ** 2
    return judge_seen([found], oracle, 1e-3 * oracle)


CASES: tuple[Case, ...] = (
    Case(
        "DPT-19",
        "units of map and photo meet in the gain",
        units,
        setup="map times 4 under a quarter of the gain; half the exposure",
        rows=("TRAP-3a",),
    ),
    Case(
        "DPT-19",
        "a turned scene has the same change",
        turned_scene,
        quick=False,
        setup="ball in a corner under a lamp, all turned by .65 rad; objects in another order",
        rows=("ENV-07",),
        statistical=True,
    ),
    Case(
        "ENV-03",
        "a texel at the pole lights a card",
        pole_texel,
        quick=False,
        setup="one texel in row 0 of 48 x 32, drawn directions alone",
        statistical=True,
    ),
    Case(
        "MC-02",
        "where all light is blocked the mean is black",
        nothing_left,
        quick=False,
        setup="lid over a floor under a lamp, 65,536 estimates of two samples",
        statistical=True,
    ),
    Case(
        "MC-05",
        "intervals hold the truth as often as they say",
        intervals,
        False,
        setup="black ball under the sky, 1024 estimates of 64 samples",
        statistical=True,
    ),
    Case(
        "MC-08",
        "a lamp that hardly any ray finds keeps its mean",
        seldom_found,
        False,
        setup="lamp of 6.7e-5 sr, scattered rays alone, 16.8 million samples",
        rows=("TRAP-1g",),
        statistical=True,
    ),
    Case(
        "MIS-05",
        "every way of drawing has the same mean",
        ways_of_drawing,
        False,
        setup="ball in a corner, four maps; scattered, drawn, both, 64 drawn for one scattered",
        statistical=True,
    ),
)
