"""What a method shows of one point of a surface, held against a number that is known.

The picture is 8x8 and so narrow that all pixels see the same thing: 64 independent estimates, whose mean and
standard error are held against a closed form. Objects that stand in the way are not seen by the camera (their
switch `camera`), so points under them can be looked at from above.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mrbatch.contracts import Measurement, Method
from mrbatch.methods.estimate import estimate
from mrbatch.metrics.judging import Numbers, mean_within, none
from mrbatch.scene.closed_forms import look_at
from mrbatch.scene.scene import Scene

SIDE = 8
_NARROW = 2.0**-12
"""Width of the picture relative to the distance: what it shows varies by less than the noise."""


@dataclass(frozen=True)
class Probe:
    """64 estimates of what one point shows: mean and standard error (3,), and the work they took.

    `delta`: D; `virtual`: P. `pixels` (64, 3): the estimates of D themselves, `seen` (64, 3) those of P.
    """

    delta: np.ndarray
    delta_error: np.ndarray
    virtual: np.ndarray
    virtual_error: np.ndarray
    pixels: np.ndarray
    seen: np.ndarray
    counters: Mapping[str, int]


def probe(
    method: Method,
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
    p = np.asarray(point, dtype=np.float64)
    eye = p + np.asarray(normal, dtype=np.float64) * distance
    camera = look_at(eye, p, width=SIDE, height=SIDE, focal=SIDE / _NARROW)
    result = estimate(method, scene, camera, settings=settings, spp=spp, seed=seed, threads=1, **options)
    delta, seen = result.developed.D.reshape(-1, 3), result.developed.P.reshape(-1, 3)
    count = np.sqrt(len(delta))
    return Probe(
        delta.mean(axis=0),
        delta.std(axis=0, ddof=1) / count,
        seen.mean(axis=0),
        seen.std(axis=0, ddof=1) / count,
        delta,
        seen,
        result.counters,
    )


def judge(
    found: Numbers,
    error: Numbers,
    oracle: Numbers,
    tolerance: float,
    *,
    sees: float | None = None,
    probes: Sequence[Probe] = (),
) -> Measurement:
    """`mean_within` of what probes measured; `probes`: which, so that no value in them is overlooked."""
    return mean_within(
        found,
        error,
        oracle,
        tolerance,
        sees=sees,
        observations=SIDE * SIDE,
        radiance=tuple(p.seen for p in probes),
        signed=tuple(p.pixels for p in probes),
    )


def judge_change(
    found: Sequence[Probe], oracle: Numbers, tolerance: float, *, sees: float | None = None
) -> Measurement:
    """`judge` of the light change of several probes; `oracle`: a number, (n, 1) or (n, 3)."""
    means, errors = np.array([p.delta for p in found]), np.array([p.delta_error for p in found])
    return judge(means, errors, oracle, tolerance, sees=sees, probes=found)


def judge_seen(
    found: Sequence[Probe], oracle: Numbers, tolerance: float, *, sees: float | None = None
) -> Measurement:
    """`judge` of what several probes see of virtual surfaces; `oracle` as for `judge_change`."""
    means, errors = np.array([p.virtual for p in found]), np.array([p.virtual_error for p in found])
    return judge(means, errors, oracle, tolerance, sees=sees, probes=found)


def unchanged(found: Sequence[Probe]) -> Measurement:
    """Whether every estimate of the light change is 0, to the bit."""
    pixels = np.concatenate([p.pixels for p in found])
    told = none(pixels != 0, "estimates that are not 0")
    return replace(told, radiance=tuple(p.seen for p in found), signed=(pixels,))
