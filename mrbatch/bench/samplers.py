"""Ways to draw directions from the map, and sequences of random numbers, at equal samples.

And among how many directions each is chosen (`light_candidates`), for methods that choose.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass

from mrbatch.bench.variants import Reference, Variants, converged, seconds_in_turns
from mrbatch.metrics.statistics import Interval, paired_ratio

KINDS = {
    "light": ("method.light_sampler", ("cdf", "median-cut", "alias", "sample-map")),
    "numbers": ("method.sampler", ("owen", "cranley-patterson", "independent")),
    "candidates": ("method.light_candidates", ("1", "2", "4", "8")),
}
"""Groups of rows: the setting that each varies, and its values; others stay as the job has them."""


@dataclass(frozen=True)
class SamplerRow:
    """One sampler. `kind`: its group. `seconds`: of each rendering, by turn; `ratio`: to those of the first
    of its group, in pairs. `cost`: seconds for an error squared, as a ratio to the first of its group.

    `rmse`: against the converged picture on the region of interest; `rmse_real` on what of it is wholly real,
    `rmse_virtual` on what is wholly virtual (NaN where there is none). `counters`: work of one rendering.
    """

    kind: str
    sampler: str
    seconds: tuple[float, ...]
    ratio: Interval
    cost: float
    rmse: float
    rmse_real: float
    rmse_virtual: float
    counters: dict[str, int]


@dataclass(frozen=True)
class Samplers:
    rows: tuple[SamplerRow, ...]
    method: str
    reference: Reference
    frame: int
    spp: int
    threads: int
    repeats: int


def samplers(
    variants: Variants,
    *,
    repeats: int = 9,
    reference_spp: int = 4096,
    threads: int = 1,
    said: Callable[[str], None] = lambda text: None,
) -> Samplers:
    """Renders the frame with each sampler, in turns. `said`: hears of progress.

    The reference draws the map's light by `cdf` and takes `owen`'s numbers. Raises JobError for a method
    without these settings.
    """
    said(f"reference, {reference_spp} samples a pixel")
    reference = converged(
        variants, reference_spp, "method.light_sampler=cdf", "method.sampler=owen", threads=threads
    )
    said("samplers")
    kinds = {
        kind: (setting, values)
        for kind, (setting, values) in KINDS.items()
        if kind != "candidates" or hasattr(variants.job.method, "light_candidates")
    }
    rows: list[SamplerRow] = []
    with ExitStack() as stack:
        subjects = {
            f"{kind} {value}": stack.enter_context(variants.subject(f"{setting}={value}", threads=threads))
            for kind, (setting, values) in kinds.items()
            for value in values
        }
        # The first run also warms caches, and is not timed.
        runs = {name: subject.run() for name, subject in subjects.items()}
        spent = seconds_in_turns(subjects, repeats)
    for kind, (_, values) in kinds.items():
        first = f"{kind} {values[0]}"
        for value in values:
            name = f"{kind} {value}"
            picture = runs[name].composite
            ratio = paired_ratio(spent[name], spent[first], seed=1)
            rmse = reference.rmse(picture)
            rows.append(
                SamplerRow(
                    kind=kind,
                    sampler=value,
                    seconds=tuple(spent[name]),
                    ratio=ratio,
                    cost=ratio.value * (rmse / reference.rmse(runs[first].composite)) ** 2,
                    rmse=rmse,
                    rmse_real=reference.rmse(picture, reference.covered == 0.0),
                    rmse_virtual=reference.rmse(picture, reference.covered == 1.0),
                    counters=runs[name].counters,
                )
            )
    return Samplers(
        tuple(rows), variants.job.method_name, reference, variants.frame, variants.spp, threads, repeats
    )
