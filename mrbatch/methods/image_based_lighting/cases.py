"""Hard cases of image-based lighting, for `mrbatch stability`."""

from __future__ import annotations

from mrbatch.contracts import Case
from mrbatch.methods.invariance_cases import invariance_cases

CASES: tuple[Case, ...] = invariance_cases("image-based-lighting", quick=False)
