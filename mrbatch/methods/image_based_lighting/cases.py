"""Hard cases of image-based lighting, for `mrbatch stability`."""

from __future__ import annotations

from mrbatch.contracts import Case

CASES: tuple[Case, ...] = ()
