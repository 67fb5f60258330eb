"""`mrbatch sweep`: what accuracy costs in time, one setting at a time from the job's own values."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mrbatch.bench.axes import Choice, Chosen, choose
from mrbatch.bench.block import Block, run_block
from mrbatch.bench.sweep_pictures import Detail, details
from mrbatch.bench.sweep_report import GRID, Outcome, report_of
from mrbatch.bench.sweep_targets import targets_of
from mrbatch.bench.truth import Truth, rendered_truth, stored_truth
from mrbatch.bench.variants import Variants
from mrbatch.errors import JobError
from mrbatch.metrics.claims import fewest_turns
from mrbatch.report.model import Report

REFERENCE = (64, 1024, 16384)
"""A truth that is rendered has so many times the job's samples a pixel, at least and at most."""


@dataclass(frozen=True)
class SweepRequest:
    """How a sweep is made. `axes`: words as `mrbatch.bench.axes.choose` takes them; `grid`: two of them.

    `repeats`: turns of each axis; None: as many as the claims and the noise of the machine ask for. `truth`,
    `deviation`: pictures of the whole frame and of its standard deviation; without them the truth is rendered
    with full settings and `reference_spp` samples a pixel. `target`: relMSE that times are told for, measured
    for estimators; None: that of the job's own settings, foreseen. `pictures`: for the page.
    """

    settings: tuple[str, ...] = ()
    axes: tuple[str, ...] = ()
    grid: tuple[str, ...] = ()
    frame: int | None = None
    threads: int = 1
    repeats: int | None = None
    truth: Path | None = None
    deviation: Path | None = None
    reference_spp: int | None = None
    target: float | None = None
    pictures: bool = False
    confine: Path | None = None


def sweep(
    path: Path, request: SweepRequest | None = None, *, said: Callable[[str], None] = lambda text: None
) -> tuple[Report, dict[str, np.ndarray]]:
    """Measures the job's first frame (or another) in its own and in other settings.

    Gives the report, whose `sweep` holds everything, and its pictures (uint8 RGB by path), if asked for.
    Raises JobErrors or InputError where the job, an axis or the truth cannot be used.
    """
    request = request or SweepRequest()
    if len(request.grid) not in (0, 2):
        raise JobError("a grid is of two axes", hint="give `--grid` twice")
    began = time.perf_counter()
    variants = Variants(path, request.settings, frame=request.frame, confine=request.confine)
    threads = request.threads
    chosen = choose(variants.job, request.axes, threads) if request.axes or not request.grid else ()
    gridded = choose(variants.job, request.grid, threads) if request.grid else ()
    claims = 2 * (sum(_pairs(len(c.choices)) for c in chosen) + len(_grid(gridded, threads)))
    truth = _truth(variants, request, said)
    order = np.random.default_rng(time.time_ns() % (1 << 32))
    blocks: dict[str, Block] = {}
    wanted: list[tuple[str, Sequence[Choice]]] = [(c.axis.name, c.choices) for c in chosen]
    if gridded:
        wanted.append((GRID, _grid(gridded, threads)))
    for name, choices in wanted:
        if not choices:
            continue
        said(f"{name}: {', '.join(c.label for c in choices)} ({fewest_turns(max(1, claims))} turns or more)")
        blocks[name] = run_block(
            variants,
            choices,
            truth,
            threads=threads,
            claims=claims,
            repeats=request.repeats,
            order=order,
            said=lambda text, name=name: said(f"{name}: {text}"),  # type: ignore[misc]
        )
    if not blocks:
        raise JobError(
            "there is nothing to measure", hint="give an axis with values other than the job's own"
        )
    outcome = Outcome(
        variants=variants,
        truth=truth,
        chosen=chosen,
        choices={c.name: c for _, choices in wanted for c in choices},
        gridded=gridded,
        blocks=blocks,
        threads=threads,
    )
    report = report_of(outcome)
    said("time to the target")
    report = targets_of(outcome, report, request.target)
    images: dict[str, np.ndarray] = {}
    if request.pictures:
        said("pictures")
        found: Detail = details(outcome, report)
        report, images = found.report, found.images
    assert report.sweep is not None
    seconds = report.sweep.seconds.model_copy(update={"value": time.perf_counter() - began})
    totals = report.totals.model_copy(update={"seconds": seconds})
    told = report.sweep.model_copy(update={"seconds": seconds})
    return report.model_copy(update={"sweep": told, "totals": totals}), images


def _pairs(others: int) -> int:
    return (others + 1) * others // 2


def _grid(axes: Sequence[Chosen], threads: int) -> tuple[Choice, ...]:
    """All combinations of two axes' values, the job's own among them, but for both own."""
    if not axes:
        return ()
    if any(len(a.choices) == 0 for a in axes):
        raise JobError("an axis of the grid has no value beside the job's own")
    rows: list[list[Choice | None]] = [[None, *a.choices] for a in axes]
    found = []
    for one, two in itertools.product(*rows):
        if one is None and two is None:
            continue
        settings = (*(one.settings if one else ()), *(two.settings if two else ()))
        count = next((c.threads for c in (one, two) if c is not None and c.threads != threads), threads)
        values: Mapping[str, str] = {
            axes[0].axis.name: one.label if one else axes[0].own,
            axes[1].axis.name: two.label if two else axes[1].own,
        }
        found.append(Choice(GRID, " x ".join(values.values()), settings, count, values))
    return tuple(found)


def _truth(variants: Variants, request: SweepRequest, said: Callable[[str], None]) -> Truth:
    if request.truth is not None:
        return stored_truth(variants, request.truth, request.deviation)
    times, least, most = REFERENCE
    spp = request.reference_spp or min(most, max(least, times * variants.spp))
    said(f"truth: full settings, {spp} samples a pixel")
    return rendered_truth(variants, spp, threads=request.threads)
