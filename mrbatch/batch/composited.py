"""What method and participants estimated, laid over each other and over the photo."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from mrbatch.batch.error_target import Judged
from mrbatch.film.accumulator import A, D, Developed, P
from mrbatch.film.composite import Contribution, behind_matte, composite, over


def laid_over(sources: Mapping[str, Developed], matte: np.ndarray | None) -> Contribution:
    """Participants laid over the method, and all of it behind what stands in front."""

    def contribution(developed: Developed) -> Contribution:
        return Contribution(developed.P, developed.a, developed.D, developed.indirect)

    laid = contribution(sources["method"])
    for name, other in sources.items():
        if name != "method":
            laid = over(contribution(other), laid)
    return behind_matte(laid, matte)


@dataclass(frozen=True)
class Composited:
    """The composite `picture` of all samples, and those of the two `halves` (h, w, 3); `changed` (h, w) bool:
    where something virtual is in it."""

    picture: np.ndarray
    halves: tuple[np.ndarray, np.ndarray]
    changed: np.ndarray


def composited(
    background: np.ndarray, matte: np.ndarray | None, sources: Mapping[str, Developed]
) -> Composited:
    """All sources over the photo `background` (h, w, 3)."""

    def half(number: int) -> np.ndarray:
        def part(developed: Developed) -> Developed:
            mean = developed.halves[number]
            return replace(
                developed, P=mean[..., P : P + 3], a=mean[..., A], D=mean[..., D : D + 3], indirect=None
            )

        laid = laid_over({name: part(developed) for name, developed in sources.items()}, matte)
        return composite(laid.P, laid.a, background, laid.D)

    laid = laid_over(sources, matte)
    return Composited(
        composite(laid.P, laid.a, background, laid.D),
        (half(0), half(1)),
        (laid.a > 0) | np.any(laid.D != 0, axis=-1),
    )


def variance_of(
    sources: Mapping[str, Developed],
    matte: np.ndarray | None,
    of: Callable[[Developed], tuple[np.ndarray, np.ndarray]],
) -> np.ndarray:
    """Of what is composited, from each source's own: `of` gives a source's variance (..., h, w, 3) and
    coverage (..., h, w)."""
    variance, _ = of(sources["method"])
    for name, other in sources.items():
        if name != "method":
            own, coverage = of(other)
            variance = own + ((1 - coverage)[..., None] ** 2) * variance
    return variance if matte is None else variance * ((1 - matte)[..., None] ** 2)


def judged(background: np.ndarray, matte: np.ndarray | None, sources: Mapping[str, Developed]) -> Judged:
    """What an error target looks at; the sources have their `scatter`."""

    def scatter(developed: Developed) -> tuple[np.ndarray, np.ndarray]:
        assert developed.scatter is not None
        return developed.scatter, developed.halves[..., A]

    made = composited(background, matte, sources)
    return Judged(made.picture, made.halves, background, variance_of(sources, matte, scatter), made.changed)
