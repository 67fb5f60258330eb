"""Hard cases of delta path tracing, for `mrbatch stability`."""

from __future__ import annotations

from mrbatch.contracts import Case

CASES: tuple[Case, ...] = ()
