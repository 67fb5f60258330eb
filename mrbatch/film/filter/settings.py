"""The job's word on a filter."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from mrbatch.quantities import Settings

RADII = {"bilateral": 2, "variance": 4}
"""Pixels to each side, where the job names no number; the kinds that are not here have none to choose."""


class Filter(Settings):
    """A filter takes noise out of a finished frame, and adds a bias of its own: see docs/filter.md."""

    kind: Literal["none", "bilateral", "variance", "oidn"] = Field(
        "none",
        description="`none`; `bilateral`: mean of neighbours on the same surface, as far as noise hides what "
        "it blurs; `variance`: mean of neighbours that noise alone tells apart; `oidn`: Intel Open Image "
        "Denoise, a neural network (`pip install 'mrbatch[denoise]'`)",
    )
    radius: int | None = Field(
        None,
        ge=1,
        le=8,
        description="Pixels averaged to each side, 1..8; if absent 2 for `bilateral`, 4 for `variance`",
    )

    @property
    def on(self) -> bool:
        return self.kind != "none"

    @property
    def reach(self) -> int:
        """`radius`, or the kind's own."""
        return self.radius or RADII.get(self.kind, 0)

    @model_validator(mode="after")
    def _radius(self) -> Self:
        if self.radius is not None and self.kind not in RADII:
            raise ValueError(f"the filter `{self.kind}` has no `radius` to choose")
        return self
