"""What method and participants estimated, laid over each other and over the photo."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

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


def half_composite(
    half: int, background: np.ndarray, matte: np.ndarray | None, sources: Mapping[str, Developed]
) -> np.ndarray:
    """The composite (h, w, 3) of one half of the samples; `background` (h, w, 3)."""

    def part(developed: Developed) -> Developed:
        mean = developed.halves[half]
        return replace(
            developed, P=mean[..., P : P + 3], a=mean[..., A], D=mean[..., D : D + 3], indirect=None
        )

    laid = laid_over({name: part(developed) for name, developed in sources.items()}, matte)
    return composite(laid.P, laid.a, background, laid.D)


def judged(background: np.ndarray, matte: np.ndarray | None, sources: Mapping[str, Developed]) -> Judged:
    """What an error target looks at; the sources have their `scatter`."""
    scatter = _scatter(sources["method"])
    for name, other in sources.items():
        if name != "method":
            scatter = _scatter(other) + ((1 - other.halves[..., A, None]) ** 2) * scatter
    if matte is not None:
        scatter = scatter * ((1 - matte)[..., None] ** 2)
    laid = laid_over(sources, matte)
    return Judged(
        composite(laid.P, laid.a, background, laid.D),
        (half_composite(0, background, matte, sources), half_composite(1, background, matte, sources)),
        background,
        scatter,
        (laid.a > 0) | np.any(laid.D != 0, axis=-1),
    )


def _scatter(developed: Developed) -> np.ndarray:
    assert developed.scatter is not None
    return developed.scatter
