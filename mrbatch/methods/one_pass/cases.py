"""Hard cases of one-pass differential path tracing, for `mrbatch stability`."""

from __future__ import annotations

from mrbatch.contracts import Case
from mrbatch.methods.invariance_cases import invariance_cases
from mrbatch.methods.light_change_cases import light_change_cases

CASES: tuple[Case, ...] = (
    *light_change_cases("one-pass", quick=False),
    *invariance_cases("one-pass", quick=False),
)
