"""What a method shows of one point of a surface, held against a number that is known.

The picture is 8x8 and so narrow that all pixels see the same thing: 64 independent estimates, whose mean and
standard error are held against a closed form. Objects that stand in the way are not seen by the camera (their
switch `camera`), so points under them can be looked at from above.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mrbatch.contracts import Measurement, Method
from mrbatch.methods.estimate import estimate
from mrbatch.scene.closed_forms import look_at
from mrbatch.scene.scene import Scene

SIDE = 8
SIGMAS = 4.0
CONFIDENCE = 0.99
POWER = 0.01
"""Share of the oracle that a measurement must be able to tell, where a case does not say another."""
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
    found: np.ndarray | float,
    error: np.ndarray | float,
    oracle: np.ndarray | float,
    tolerance: float,
    *,
    sees: float | None = None,
    probes: Sequence[Probe] = (),
    observations: int = SIDE * SIDE,
) -> Measurement:
    """Whether |found - oracle| stays within the tolerance plus four standard errors, everywhere.

    And whether that could have told a difference of `sees` (an amount; by default 1 % of the oracle, but at
    least the tolerance): the 99 % interval of the difference must lie within it, else the measurement is
    inconclusive. `observations`: how many independent ones each error is of. `probes`: what was looked at.
    """
    found, error, oracle = np.broadcast_arrays(
        *(np.atleast_1d(np.asarray(x, dtype=np.float64)) for x in (found, error, oracle))
    )
    finite = np.isfinite(found) & np.isfinite(error)
    difference = np.where(finite, found - oracle, np.inf)
    excess = np.abs(difference) - tolerance - SIGMAS * np.where(finite, error, 0.0)
    span = np.maximum(tolerance, POWER * np.abs(oracle) if sees is None else np.full(oracle.shape, sees))
    blind = np.abs(difference) + _quantile(observations) * np.where(finite, error, 0.0) - span
    passed, conclusive = bool(np.all(excess <= 0.0)), bool(np.all(blind <= 0.0))
    worst = int(np.argmax(blind if passed else excess))
    told = f"{tolerance:g} + {SIGMAS:g} SE"
    return Measurement(
        passed=passed,
        measured=f"{found.flat[worst]:+.6f} (SE {error.flat[worst]:.1e})",
        oracle=f"{oracle.flat[worst]:+.6f}",
        tolerance=f"{told}; tells {span.flat[worst]:.2g}" if np.any(error > 0) else f"{tolerance:g}",
        conclusive=conclusive,
        radiance=tuple(p.seen for p in probes),
        signed=tuple(p.pixels for p in probes),
    )


@functools.cache
def _quantile(observations: int) -> float:
    """Student's quantile of a two-sided interval of 99 %."""
    from scipy.stats import t

    return float(t.isf(0.5 * (1.0 - CONFIDENCE), observations - 1))
