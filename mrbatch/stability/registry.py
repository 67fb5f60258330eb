"""Which hard cases there are: those of each method, and those of what methods share."""

from __future__ import annotations

from dataclasses import dataclass
from fnmatch import fnmatchcase

from mrbatch.capture.registry import Registry
from mrbatch.contracts import Case
from mrbatch.methods.registry import METHODS, PARTICIPANTS

FAMILIES: Registry[tuple[Case, ...]] = Registry(
    "family of cases",
    {
        "environment": "mrbatch.stability.environment_cases:CASES",
        "file": "mrbatch.stability.file_cases:CASES",
        "ray": "mrbatch.stability.ray_cases:CASES",
        "random": "mrbatch.stability.random_cases:CASES",
        "scattering": "mrbatch.stability.scattering_cases:CASES",
        "sum": "mrbatch.stability.sum_cases:CASES",
        "twin": "mrbatch.stability.twin_cases:CASES",
        "weight": "mrbatch.stability.weight_cases:CASES",
    },
)
"""Cases of what several methods share, by the module that holds them."""


@dataclass(frozen=True)
class Entry:
    """A case and whose it is: a method's or participant's name, or empty."""

    case: Case
    owner: str = ""

    @property
    def label(self) -> str:
        """`DPT-02@one-pass`, or the row alone."""
        return f"{self.case.name}@{self.owner}" if self.owner else self.case.name

    def matches(self, pattern: str) -> bool:
        """Whether the pattern (`MIS-*`, `*@one-pass`) is for the label or any row that the case shows."""
        return any(fnmatchcase(name, pattern) for name in (self.label, self.case.name, *self.case.rows))


def entries() -> tuple[Entry, ...]:
    """All cases: shared ones first, then method by method, each in the order of its list."""
    found = [Entry(case) for name in FAMILIES.names() for case in FAMILIES.get(name)]
    owners: tuple[Registry, ...] = (METHODS, PARTICIPANTS)
    for registry in owners:
        for name in registry.names():
            found += [Entry(case, name) for case in registry.get(name).cases]
    return tuple(found)
