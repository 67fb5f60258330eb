"""Hard cases of the product that no other test calls."""

from __future__ import annotations

import pytest

from mrbatch.stability.registry import entries
from mrbatch.stability.run import run_case

pytestmark = pytest.mark.slow
NAMES = ("BSDF-10", "DPT-02", "DPT-04", "DPT-15", "GEO-01", "MC-01")
ENTRIES = [e for e in entries() if e.owner and e.case.name in NAMES]


@pytest.mark.parametrize("entry", ENTRIES, ids=[f"{e.label}-{e.case.title}" for e in ENTRIES])
def test_hard_case_of_the_product(entry):
    found = run_case(entry, 3)
    assert found.passed, found
