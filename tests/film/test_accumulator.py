"""Sums of very many samples."""

from __future__ import annotations

import numpy as np
import pytest
from held import holds

from mrbatch.stability import sum_cases


@pytest.mark.case("MC-06")
def test_a_million_samples_are_added_without_drift():
    holds(sum_cases.drift(0))
    naive = np.cumsum(np.full(1_000_000, 0.1, np.float32), dtype=np.float32)[-1]
    assert naive == pytest.approx(100958.34, abs=0.01), "a running sum in float32"
