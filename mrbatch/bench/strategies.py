"""Ways to sample the map's light, at equal samples: by the map, by the surface, or both weighted (MIS)."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass

from mrbatch.bench.variants import Reference, Variants, converged, seconds_in_turns
from mrbatch.metrics.statistics import Interval, paired_ratio

STRATEGIES = ("mis", "environment", "bsdf")


@dataclass(frozen=True)
class StrategyRow:
    """One strategy. `seconds`: of each rendering, by turn; `ratio`: to those of `mis`, in pairs.

    `rmse`: against the converged picture on the region of interest; `rmse_real` on what of it is wholly real,
    `rmse_virtual` on what is wholly virtual (NaN where there is none). `counters`: work of one rendering.
    """

    strategy: str
    seconds: tuple[float, ...]
    ratio: Interval
    rmse: float
    rmse_real: float
    rmse_virtual: float
    counters: dict[str, int]


@dataclass(frozen=True)
class Strategies:
    rows: tuple[StrategyRow, ...]
    method: str
    reference: Reference
    frame: int
    spp: int
    threads: int
    repeats: int


def strategies(
    variants: Variants,
    *,
    repeats: int = 9,
    reference_spp: int = 4096,
    threads: int = 1,
    said: Callable[[str], None] = lambda text: None,
) -> Strategies:
    """Renders the frame with each strategy, in turns, by the job's method. `said`: hears of progress."""
    said(f"reference, {reference_spp} samples a pixel")
    reference = converged(variants, reference_spp, "method.strategy=mis", threads=threads)
    said("strategies")
    with ExitStack() as stack:
        subjects = {
            name: stack.enter_context(variants.subject(f"method.strategy={name}", threads=threads))
            for name in STRATEGIES
        }
        # The first run also warms caches, and is not timed.
        runs = {name: subject.run() for name, subject in subjects.items()}
        spent = seconds_in_turns(subjects, repeats)
    rows = tuple(
        StrategyRow(
            strategy=name,
            seconds=tuple(spent[name]),
            ratio=paired_ratio(spent[name], spent["mis"], seed=1),
            rmse=reference.rmse(runs[name].composite),
            rmse_real=reference.rmse(runs[name].composite, reference.covered == 0.0),
            rmse_virtual=reference.rmse(runs[name].composite, reference.covered == 1.0),
            counters=runs[name].counters,
        )
        for name in STRATEGIES
    )
    return Strategies(
        rows, variants.job.method_name, reference, variants.frame, variants.spp, threads, repeats
    )
