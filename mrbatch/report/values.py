"""What all parts of the report model are made of: a strict base, and numbers with unit and interval."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict


class Model(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", ser_json_inf_nan="strings")


class Value(Model):
    """A measured number with its unit, its interval and the repetitions behind it, where they exist."""

    value: float
    unit: str
    low: float | None = None
    high: float | None = None
    confidence: float | None = None
    repetitions: int | None = None


Scope = Literal["frame", "region", "tile"]
"""The whole frame, the region of interest, the worst 16x16 tile."""


class Score(Model):
    """An image error against a reference, for one part of the frame."""

    metric: str
    scope: Scope
    value: Value
    at: tuple[int, int] | None = None
    """First pixel (x, y) of the worst tile."""
