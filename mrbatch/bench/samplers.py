"""Ways to draw directions from the map, and sequences of random numbers, at equal samples."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass

from mrbatch.bench.variants import Reference, Variants, converged, seconds_in_turns
from mrbatch.metrics.statistics import Interval, paired_ratio

LIGHT_SAMPLERS = ("cdf", "median-cut", "alias", "sample-map")
SEQUENCES = ("owen", "cranley-patterson", "independent")
KINDS = {"light": "method.light_sampler", "numbers": "method.sampler"}
"""The two groups of rows, and the setting that each varies; the other stays as the job has it."""


@dataclass(frozen=True)
class SamplerRow:
    """One sampler. `kind`: `light` or `numbers`. `seconds`: of each rendering, by turn; `ratio`: to those of
    the first of its kind, in pairs.

    `rmse`: against the converged picture on the region of interest; `rmse_real` on what of it is wholly real,
    `rmse_virtual` on what is wholly virtual (NaN where there is none). `counters`: work of one rendering.
    """

    kind: str
    sampler: str
    seconds: tuple[float, ...]
    ratio: Interval
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
    names = [("light", name) for name in LIGHT_SAMPLERS] + [("numbers", name) for name in SEQUENCES]
    with ExitStack() as stack:
        subjects = {
            f"{kind} {name}": stack.enter_context(variants.subject(f"{KINDS[kind]}={name}", threads=threads))
            for kind, name in names
        }
        # The first run also warms caches, and is not timed.
        runs = {name: subject.run() for name, subject in subjects.items()}
        spent = seconds_in_turns(subjects, repeats)
    firsts = {"light": f"light {LIGHT_SAMPLERS[0]}", "numbers": f"numbers {SEQUENCES[0]}"}
    rows = tuple(
        SamplerRow(
            kind=kind,
            sampler=name,
            seconds=tuple(spent[f"{kind} {name}"]),
            ratio=paired_ratio(spent[f"{kind} {name}"], spent[firsts[kind]], seed=1),
            rmse=reference.rmse(runs[f"{kind} {name}"].composite),
            rmse_real=reference.rmse(runs[f"{kind} {name}"].composite, reference.covered == 0.0),
            rmse_virtual=reference.rmse(runs[f"{kind} {name}"].composite, reference.covered == 1.0),
            counters=runs[f"{kind} {name}"].counters,
        )
        for kind, name in names
    )
    return Samplers(rows, variants.job.method_name, reference, variants.frame, variants.spp, threads, repeats)
