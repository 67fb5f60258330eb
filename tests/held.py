"""For tests that show a hard case of the product: the same judgement as its runner's."""

from __future__ import annotations

from mrbatch.contracts import Measurement
from mrbatch.stability.run import unsound


def holds(measurement: Measurement) -> None:
    """Asserts that the case passed, could have told otherwise, and looked at sound numbers only."""
    assert measurement.passed and measurement.conclusive and not unsound(measurement), measurement
