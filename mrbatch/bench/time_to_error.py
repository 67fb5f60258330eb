"""Seconds until a picture is as good as asked: the absolute time that a share of rays says nothing about."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mrbatch.bench.subject import Run
from mrbatch.bench.variants import Reference, Variants, converged
from mrbatch.metrics.errors import image_errors

STEPS = 5
CLOSE = 0.1
"""The search ends this near to the error asked for."""


@dataclass(frozen=True)
class TimeToError:
    """`spp` samples a pixel bring the region of interest to `relmse`, near `target`, in `seconds` (of the
    refining passes, by turn). `tried`: (samples a pixel, relMSE) on the way; the last one is the result.
    `reference_relmse`: of the reference itself, which nothing below can be told apart from."""

    target: float
    spp: int
    relmse: float
    seconds: tuple[float, ...]
    tried: tuple[tuple[int, float], ...]
    reference_relmse: float
    reference: Reference
    frame: int
    threads: int


def time_to_error(
    variants: Variants,
    target: float,
    *,
    repeats: int = 5,
    reference_spp: int = 4096,
    threads: int = 1,
    said: Callable[[str], None] = lambda text: None,
) -> TimeToError:
    """Looks for the samples a pixel at which relMSE on the region of interest is `target`, then times them.

    The error of a step is that of its picture, not what a slope foresees. Raises ValueError where virtual
    objects change nothing, or the reference is not four times better than what is asked for.
    """
    said(f"reference, {reference_spp} samples a pixel")
    reference = converged(variants, reference_spp, threads=threads)
    if not reference.changed.any():
        raise ValueError("virtual objects change nothing in this frame")
    own = _relmse(reference.picture + reference.noise, reference)
    if own > target / 4:
        raise ValueError(f"a reference of {reference_spp} samples a pixel has relMSE {own:.2g}: give it more")

    def error_of(spp: int) -> float:
        error = _relmse(_render(variants, spp, threads).composite, reference)
        said(f"{spp} samples a pixel: relMSE {error:.3g}")
        return error

    tried = samples_to_reach(target, variants.spp, error_of)
    spp = tried[-1][0]
    with variants.subject(f"method.spp={spp}", threads=threads) as subject:
        subject.run()
        seconds = tuple(subject.run().seconds for _ in range(repeats))
    return TimeToError(
        target, spp, tried[-1][1], seconds, tuple(tried), own, reference, variants.frame, threads
    )


def samples_to_reach(
    target: float, first: int, error_of: Callable[[int], float], *, most: int = 1 << 20
) -> list[tuple[int, float]]:
    """(samples a pixel, error) on the way to where `error_of` gives `target`, from `first` on."""
    spp = max(2, first)
    tried: list[tuple[int, float]] = []
    while True:
        tried.append((spp, error_of(spp)))
        wanted = min(most, max(2, 2 * round(spp * _samples_for(tried, target) / 2)))
        if len(tried) == STEPS or abs(tried[-1][1] / target - 1.0) <= CLOSE or wanted == spp:
            return tried
        spp = wanted


def _render(variants: Variants, spp: int, threads: int) -> Run:
    with variants.subject(f"method.spp={spp}", threads=threads) as subject:
        return subject.run()


def _relmse(picture: np.ndarray, reference: Reference) -> float:
    found = image_errors(picture, reference.picture, region=reference.changed, flip=False)
    assert found.region is not None
    return found.region.relmse


def _samples_for(tried: list[tuple[int, float]], target: float) -> float:
    """By how much to multiply the last number of samples; error ~ 1 / samples, or as it fell so far."""
    spp, error = tried[-1]
    if error == 0.0:
        return 1.0
    slope = 1.0
    if len(tried) > 1 and tried[-2][0] != spp and tried[-2][1] > 0.0:
        measured = -np.log(error / tried[-2][1]) / np.log(spp / tried[-2][0])
        slope = float(np.clip(measured, 0.5, 3.0))
    return float((error / target) ** (1.0 / slope))
