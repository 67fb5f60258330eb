"""Hard cases of delta path tracing, for `mrbatch stability`: small scenes whose answer is known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mrbatch.contracts import Case, Measurement
from mrbatch.methods.delta_path_tracing import (
    glass_cases,
    mesh_cases,
    noise_cases,
    picture_cases,
    shadow_cases,
)
from mrbatch.methods.delta_path_tracing.delta_probe import delta_probe
from mrbatch.methods.invariance_cases import invariance_cases
from mrbatch.methods.light_change_cases import light_change_cases
from mrbatch.methods.probe import judge
from mrbatch.scene.closed_forms import ball, corner, floor, real, scaled, scene_of, virtual


def scale_measurement(seed: int) -> Measurement:
    """GEO-01: a scene scaled by powers of two gives the same bits; by others, the same within the noise."""
    objects = [*corner(0.5, size=64.0), virtual("ball", ball(0.5, at=(0.8, 0, 0.5)), 0.7, camera=False)]
    scene = scene_of(objects)
    point = np.array([0.4, 0.2, 0.0])
    base = delta_probe(scene, point, seed=seed, spp=256)
    same = [
        np.array_equal(
            delta_probe(scaled(scene, f), point * f, distance=f, seed=seed, spp=256).pixels, base.pixels
        )
        for f in (2.0**-13, 2.0**13)
    ]
    others = [
        delta_probe(scaled(scene, f), point * f, distance=f, seed=seed + 1 + k, spp=256)
        for k, f in enumerate((1e-4, 1e4))
    ]
    outcome = judge(
        np.array([o.delta[0] for o in others]),
        np.hypot(base.delta_error[0], [o.delta_error[0] for o in others]),
        base.delta[0],
        1e-4,
        sees=0.01,
        probes=[base, *others],
    )
    return replace(
        outcome,
        passed=outcome.passed and all(same),
        measured=f"bits equal at 2^-13 and 2^13: {same}; {outcome.measured}",
        oracle=f"the same bits; {outcome.oracle}",
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
    exact = np.mean([delta_probe(scene, (s, 0, 0), spp=4096, seed=seed + 77777).delta[0]])
    errors = []
    for count in counts:
        parts = [
            delta_probe(scene, (s, 0, 0), spp=count, seed=seed + 1000 * count + k, settings=many).pixels[:, 0]
            for k in range(runs)
        ]
        errors.append(np.mean((np.concatenate(parts) - exact) ** 2))
    return np.array(errors)


CASES: tuple[Case, ...] = (
    *light_change_cases("delta-path-tracing"),
    *shadow_cases.CASES,
    *picture_cases.CASES,
    *mesh_cases.CASES,
    *glass_cases.CASES,
    *noise_cases.CASES,
    *invariance_cases("delta-path-tracing"),
    Case(
        "GEO-01",
        "a picture does not depend on the scene's scale",
        scale_measurement,
        setup="ball in a corner, scaled by 2^-13, 2^13, 1e-4 and 1e4",
        rows=("DPT-19", "TRAP-1k"),
        statistical=True,
    ),
    Case(
        "MC-01",
        "the mean squared error falls as 1 / spp",
        slope_measurement,
        quick=False,
        setup="black ball on a floor, independent numbers, 4 to 256 samples",
        statistical=True,
    ),
)
