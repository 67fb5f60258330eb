"""What light of further bounces costs and gives, by method: the tables of Xu et al., from this machine.

A path of B bounces has B vertices after the camera's, at each of which light is gathered: `max_depth` B + 1.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass

from mrbatch.bench.variants import Reference, Variants, converged, seconds_in_turns
from mrbatch.metrics.statistics import Interval, paired_ratio

OURS = "delta-path-tracing"
METHODS = (OURS, "one-pass", "two-pass")


@dataclass(frozen=True)
class BounceRow:
    """One method at one number of bounces.

    `seconds`: of each rendering, by turn; `ratio`: to those of delta path tracing, in pairs. `rmse`: on the
    region of interest, against the converged picture with all bounces. `counters`: work of one rendering.
    """

    bounces: int
    method: str
    seconds: tuple[float, ...]
    ratio: Interval
    rmse: float
    counters: dict[str, int]


@dataclass(frozen=True)
class Bounces:
    """`same`: delta path tracing over itself, which tells the noise of the clock."""

    rows: tuple[BounceRow, ...]
    same: Interval
    reference: Reference
    frame: int
    spp: int
    threads: int
    repeats: int


def bounces(
    variants: Variants,
    counts: Sequence[int],
    *,
    repeats: int = 9,
    reference_spp: int = 4096,
    threads: int = 1,
    said: Callable[[str], None] = lambda text: None,
) -> Bounces:
    """Renders the frame by each method at each of `counts` bounces, in turns. `said`: hears of progress."""
    said(f"reference, {reference_spp} samples a pixel")
    reference = converged(
        variants, reference_spp, f"method.name={OURS}", "method.max_depth=null", threads=threads
    )
    rows: list[BounceRow] = []
    same: Interval | None = None
    for count in counts:
        said(f"{count} bounces")
        names = list(METHODS) if same is not None else [*METHODS, "again"]
        with ExitStack() as stack:
            subjects = {
                name: stack.enter_context(
                    variants.subject(
                        f"method.name={OURS if name == 'again' else name}",
                        f"method.max_depth={count + 1}",
                        threads=threads,
                    )
                )
                for name in names
            }
            # The first run also warms caches, and is not timed.
            runs = {name: subject.run() for name, subject in subjects.items()}
            spent = seconds_in_turns(subjects, repeats)
        if same is None:
            same = paired_ratio(spent["again"], spent[OURS], seed=1)
        for name in METHODS:
            rows.append(
                BounceRow(
                    bounces=count,
                    method=name,
                    seconds=tuple(spent[name]),
                    ratio=paired_ratio(spent[name], spent[OURS], seed=1),
                    rmse=reference.rmse(runs[name].composite),
                    counters=runs[name].counters,
                )
            )
    if same is None:
        raise ValueError("no number of bounces is asked for")
    return Bounces(tuple(rows), same, reference, variants.frame, variants.spp, threads, repeats)
