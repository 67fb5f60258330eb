"""Settings of the toy."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from mrbatch.quantities import Reflectance, Settings


class ToyShadeSettings(Settings):
    """Takes a random share of the light away."""

    name: Literal["toy-shade"] = Field("toy-shade", description="The method")
    spp: Annotated[int, Field(ge=2, multiple_of=2)] = Field(8, description="Samples a pixel")
    darkness: Reflectance = Field(0.5, description="Largest share of the light that is taken away, 0..1")
    batch: Annotated[int, Field(ge=1)] = Field(3, description="Samples a step")
