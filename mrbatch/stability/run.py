"""Runs hard cases: judges the arrays behind a measurement, tries chance again, goes on after a crash."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from fnmatch import fnmatchcase
from typing import Any, Literal

import numpy as np

from mrbatch import __version__
from mrbatch.contracts import Case, Measurement
from mrbatch.errors import EXIT_DONE, EXIT_GATE, JobError
from mrbatch.report.model import Attempt, HardCase, Job, Report, Totals, Value
from mrbatch.stability.catalogue import elsewhere
from mrbatch.stability.registry import Entry, entries

CaseSet = Literal["quick", "full"]
RETRY = 1_000_003
"""What is added to the seed for the second attempt of a case whose verdict has a chance to be wrong."""


def unsound(measurement: Measurement) -> str:
    """What is wrong with the arrays behind a measurement, in words; empty where nothing is."""
    told = []
    for name, arrays in (("radiance", measurement.radiance), ("signed", measurement.signed)):
        for array in arrays:
            values = np.asarray(array)
            bad = int(np.size(values) - np.isfinite(values).sum())
            if bad:
                told.append(f"{bad} of {values.size} {name} values are no finite numbers")
            negative = int((values < 0).sum()) if name == "radiance" else 0
            if negative:
                told.append(f"{negative} of {values.size} radiance values are negative")
    return "; ".join(told)


def attempt(case: Case, seed: int) -> tuple[Attempt, Measurement | None, str]:
    """One run of a case: how it went, what was measured, and why it did not pass.

    Whatever is raised inside a case is a failure of that case alone.
    """
    try:
        found = case.run(seed)
    except Exception as error:
        text = " ".join(f"{type(error).__name__}: {error}".split())
        return Attempt(seed=seed, outcome="failed", measured=f"raised {text}"), None, f"raised {text}"
    wrong = unsound(found)
    if wrong:
        return Attempt(seed=seed, outcome="failed", measured=found.measured), found, wrong
    if not found.passed:
        why = "what was measured is not what must come out"
        return Attempt(seed=seed, outcome="failed", measured=found.measured), found, why
    if not found.conclusive:
        why = "the interval is too wide to tell"
        return Attempt(seed=seed, outcome="inconclusive", measured=found.measured), found, why
    return Attempt(seed=seed, outcome="passed", measured=found.measured), found, ""


def run_case(entry: Entry, seed: int) -> HardCase:
    """Runs a case; where chance may have failed it, once more on other numbers. Both attempts are told."""
    case, began = entry.case, time.perf_counter()
    one, found, why = attempt(case, seed)
    attempts = [one]
    chance = found is not None and not unsound(found)
    if one.outcome != "passed" and case.statistical and chance:
        one, found, why = attempt(case, seed + RETRY)
        attempts.append(one)
    if why and len(attempts) > 1:
        why = f"{why}, on two seeds"
    return _told(
        entry,
        one.outcome,
        measured=one.measured,
        oracle=found.oracle if found else "",
        tolerance=found.tolerance if found else "",
        reason=why,
        seconds=Value(value=time.perf_counter() - began, unit="s"),
        attempts=tuple(attempts),
    )


def check_stability(
    patterns: Sequence[str] = (),
    *,
    cases: CaseSet = "quick",
    seed: int = 0,
    told: Callable[[HardCase], None] = lambda case: None,
) -> Report:
    """Runs the hard cases whose label or rows match any of the patterns (all where there are none).

    `cases`: the quick set, or all. `told` is called with each case as soon as it is judged. Rows that the
    test suite holds stand in the report as skipped, with reason and tests. The report's `exit` is 1 where a
    case failed or could not tell. Raises JobError where a pattern is for no case and no row.
    """
    known, held = entries(), elsewhere()
    for pattern in patterns:
        if not any(e.matches(pattern) for e in known) and not any(_names(row, pattern) for row in held):
            rows = ", ".join(dict.fromkeys(e.case.name.partition("-")[0] for e in known))
            raise JobError(f"no case matches `{pattern}`", hint=f"there are {rows}; such as `MIS-*`")
    chosen = [e for e in known if not patterns or any(e.matches(p) for p in patterns)]
    rest = [row for row in held if not patterns or any(_names(row, p) for p in patterns)]
    began = time.perf_counter()
    found = list(_judged(chosen, cases, seed, told))
    report = Report(
        kind="stability",
        job=Job(
            name=f"Hard cases, {cases} set",
            seed=seed,
            settings={"set": cases, "cases": list(patterns) or ["all"]},
        ),
        versions=_versions(),
        totals=Totals(seconds=Value(value=time.perf_counter() - began, unit="s")),
        cases=(*found, *rest),
    )
    return report.model_copy(update={"exit": EXIT_DONE if report.passed else EXIT_GATE})


def _judged(
    chosen: Iterable[Entry], cases: CaseSet, seed: int, told: Callable[[HardCase], None]
) -> Iterable[HardCase]:
    for entry in chosen:
        if cases == "quick" and not entry.case.quick:
            yield _told(entry, "skipped", reason="takes long: in the full set (`--set full`)")
            continue
        one = run_case(entry, seed)
        told(one)
        yield one


def _told(entry: Entry, outcome: Any, **more: Any) -> HardCase:
    case = entry.case
    return HardCase(
        name=case.name,
        owner=entry.owner,
        title=case.title,
        setup=case.setup,
        rows=case.rows,
        outcome=outcome,
        **more,
    )


def _names(row: HardCase, pattern: str) -> bool:
    return fnmatchcase(row.name, pattern)


def _versions() -> dict[str, str]:
    import warp as wp

    return {"mrbatch": __version__, "numpy": np.__version__, "warp": wp.config.version}
