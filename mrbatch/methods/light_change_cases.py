"""Hard cases of every method that gives the light change on real surfaces: its value is the same for all."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from mrbatch.contracts import Case, Measurement, Method
from mrbatch.methods.probe import judge, judge_change, probe
from mrbatch.methods.registry import method as find_method
from mrbatch.scene.closed_forms import (
    ball,
    ball_share,
    corner,
    everything_virtual,
    floor,
    real,
    scene_of,
    virtual,
)
from mrbatch.scene.scene import Material, SceneObject, centre

LEVEL = 0.005
"""A difference that must be told: 1 % of what the open floor shows."""


def black_ball(method: Method, seed: int) -> Measurement:
    """DPT-02: a black ball resting on a plane under the sky takes rho F."""
    distances = (0.25, 1.0, 4.0)
    scene = scene_of([real("floor", floor()), virtual("ball", ball(), 0.0, camera=False)])
    found = [probe(method, scene, (s, 0, 0), spp=1024, seed=seed) for s in distances]
    oracle = -0.5 * ball_share(1.0, 1.0, np.array(distances))
    return judge_change(found, oracle[:, None], 1e-3 * 0.5, sees=LEVEL)


def white_furnace(method: Method, seed: int) -> Measurement:
    """DPT-04: among white surfaces under the sky everything shows 1, so nothing changes."""
    scene = scene_of([real("floor", floor(), 1.0), virtual("ball", ball(subdivisions=5), 1.0, camera=False)])
    found = [probe(method, scene, (s, 0, 0), spp=4096, seed=seed) for s in (0.5, 1.5)]
    return judge_change(found, 0.0, 1e-3, sees=LEVEL)


def glowing_ball(
    method: Method,
    seed: int,
    *,
    emissions: Sequence[float] = (1.0, 5.0),
    distances: Sequence[float] = (0.5, 1.5),
) -> Measurement:
    """DPT-09: rho F (L_e - 1) of a black ball that glows; one as bright as the sky cannot be told from it."""
    found, oracle = [], []
    for emission in emissions:
        glow = Material(reflectance=(0.0,) * 3, emission=(emission,) * 3)
        scene = scene_of([real("floor", floor()), SceneObject("lamp", ball(), glow, True, camera=False)])
        for s in distances:
            found.append(probe(method, scene, (s, 0, 0), spp=2048, seed=seed))
            oracle.append(0.5 * float(ball_share(1.0, 1.0, s)) * (emission - 1.0))
    return judge_change(found, np.array(oracle)[:, None], 1e-3, sees=2 * LEVEL)


def corner_ball(method: Method, seed: int) -> Measurement:
    """DPT-15: a ball in a corner against two full path traces, with and without it."""
    objects = [*corner(0.5), virtual("ball", ball(0.5, at=(0.8, 0, 0.5)), (0.2, 0.5, 0.8), camera=False)]
    found, error, oracle, probes = [], [], [], []
    for number, s in enumerate((0.4, 1.2)):
        ours = probe(method, scene_of(objects), (s, 0, 0), seed=seed)
        traces = [
            probe(
                method,
                scene_of(everything_virtual(objects, with_virtual=there), origin=centre(objects)),
                (s, 0, 0),
                spp=512,
                seed=seed + k,
            )
            for k, there in ((1000 + number, True), (2000 + number, False))
        ]
        probes += [ours, *traces]
        found.append(ours.delta)
        oracle.append(traces[0].virtual - traces[1].virtual)
        error.append(
            np.sqrt(ours.delta_error**2 + traces[0].virtual_error ** 2 + traces[1].virtual_error ** 2)
        )
    return judge(np.ravel(found), np.ravel(error), np.ravel(oracle), 1e-4, sees=LEVEL, probes=probes)


def light_change_cases(name: str, *, quick: bool = True) -> tuple[Case, ...]:
    """The cases for the method of this name in the registry; `quick`: in the quick set."""

    def of(measure: Callable[[Method, int], Measurement]) -> Callable[[int], Measurement]:
        return lambda seed: measure(find_method(name), seed)

    return (
        Case(
            "DPT-02",
            "a black ball on a plane blocks its form factor",
            of(black_ball),
            quick,
            setup="floor .5 under the sky; ball of radius 1; a quarter, one and four radii from its foot",
            statistical=True,
        ),
        Case(
            "DPT-04",
            "nothing changes among white surfaces",
            of(white_furnace),
            quick,
            setup="white ball on a white floor under the sky, two points",
            rows=("TRAP-1e",),
            statistical=True,
        ),
        Case(
            "DPT-09",
            "a glowing ball lights what it hides",
            of(glowing_ball),
            quick=False,
            setup="black ball on a floor of .5 under the sky, as bright as the sky and five times so",
            rows=("TRAP-1f",),
            statistical=True,
        ),
        Case(
            "DPT-15",
            "a ball in a corner equals two full path traces",
            of(corner_ball),
            quick,
            setup="coloured ball in a corner of .5 under the sky, two points",
            rows=("TRAP-1b", "TRAP-1d"),
            statistical=True,
        ),
    )
