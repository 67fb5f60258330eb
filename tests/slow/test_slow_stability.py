"""Every hard case of the product, as `mrbatch stability --set full` runs them."""

from __future__ import annotations

import pytest

from mrbatch.stability.registry import entries
from mrbatch.stability.run import run_case

pytestmark = pytest.mark.slow
ENTRIES = entries()


@pytest.mark.parametrize("entry", ENTRIES, ids=[f"{e.label}-{e.case.title}" for e in ENTRIES])
def test_hard_case_of_the_product(entry):
    found = run_case(entry, 3)
    assert found.passed, found
