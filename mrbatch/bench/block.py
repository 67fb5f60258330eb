"""The values of one axis, rendered in turns on one machine: seconds, errors, and work for each."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field

import numpy as np

from mrbatch.bench.axes import Choice
from mrbatch.bench.subject import Subject
from mrbatch.bench.truth import Truth
from mrbatch.bench.variants import Variants, turn
from mrbatch.errors import JobErrors, MrbatchError
from mrbatch.metrics.claims import noise_of_pairs, turns_for
from mrbatch.metrics.errors import ImageErrors

OWN = "as the job has it"
AGAIN = "again"
MOST = 3
"""A noisy machine gets at most so many times the fewest turns."""
_STEP = 7_919
"""Between seeds of turns."""


@dataclass
class Measured:
    """Of one value, by turn: `seconds` of a frame, `pass_seconds` of its refining passes, `errors` (without
    FLIP), `differences` to the truth. `picture`, `counters`: of the untimed run by the job's own seed;
    `repeats_bits`: the first turn, by the same seed, gave the same picture and counters."""

    seconds: list[float] = field(default_factory=list)
    pass_seconds: list[float] = field(default_factory=list)
    errors: list[ImageErrors] = field(default_factory=list)
    differences: list[np.ndarray] = field(default_factory=list)
    picture: np.ndarray = field(default_factory=lambda: np.zeros((0, 0, 3)))
    counters: dict[str, int] = field(default_factory=dict)
    samples: int = 0
    repeats_bits: bool = True

    @property
    def relmse(self) -> list[float]:
        """Of the region of interest, by turn."""
        return [e.region.relmse for e in self.errors if e.region is not None]


@dataclass(frozen=True)
class Block:
    """`found`: by name, `OWN` first. `again`: seconds of the job's own settings on a second renderer."""

    found: Mapping[str, Measured]
    again: tuple[float, ...]
    left_out: Mapping[str, str]


def run_block(
    variants: Variants,
    choices: Sequence[Choice],
    truth: Truth,
    *,
    threads: int,
    claims: int,
    repeats: int | None = None,
    order: np.random.Generator,
    said: Callable[[str], None] = lambda text: None,
) -> Block:
    """Renders the job's own settings and every choice in turns, each in random order by a seed of its own.

    `claims`: size of the family that the figures are for; it and the noise of the machine, as magnitudes of
    the own settings over themselves show it, tell how many turns there are, unless `repeats` does. A choice
    that the job, the scene or the machine cannot do is left out with the reason.
    """
    seed = variants.job.seed
    found: dict[str, Measured] = {}
    left_out: dict[str, str] = {}
    with ExitStack() as stack:
        subjects: dict[str, Subject] = {}

        def begin(name: str, label: str, settings: Sequence[str], count: int) -> None:
            try:
                subject = stack.enter_context(variants.subject(*settings, threads=count))
                # The first run also loads kernels and warms caches, and is not timed.
                run = subject.run(seed)
            except MrbatchError as error:
                if name in (OWN, AGAIN):
                    raise
                first = error.errors[0] if isinstance(error, JobErrors) else error
                left_out[label] = first.message
                return
            subjects[name] = subject
            if name != AGAIN:
                samples = subject.renderer.samples
                found[name] = Measured(picture=run.composite, counters=run.counters, samples=samples)

        begin(OWN, "", (), threads)
        begin(AGAIN, "", (), threads)
        for one in choices:
            begin(one.name, one.label, one.settings, one.threads)
        names = list(subjects)
        again: list[float] = []
        turns = repeats or turns_for(0.0, claims)
        done = 0
        while done < turns:
            by = (seed + _STEP * done) % (1 << 32)
            for name in turn(names, order):
                run = subjects[name].run(by)
                if name == AGAIN:
                    again.append(run.frame_seconds)
                    continue
                one_found = found[name]
                one_found.seconds.append(run.frame_seconds)
                one_found.pass_seconds.append(run.seconds)
                one_found.errors.append(truth.errors(run.composite))
                one_found.differences.append(truth.difference(run.composite))
                if done == 0:
                    same = np.array_equal(run.composite, one_found.picture)
                    one_found.repeats_bits = same and run.counters == one_found.counters
            done += 1
            said(f"turn {done} of {turns}")
            if repeats is None and done == turns:
                noise = noise_of_pairs(found[OWN].seconds, again)
                turns = max(done, min(MOST * turns_for(0.0, claims), turns_for(noise, claims)))
    return Block(found, tuple(again), left_out)
