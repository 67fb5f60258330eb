"""What a job says of the walls that an environment map is projected onto."""

from __future__ import annotations

from typing import Annotated

from pydantic import BeforeValidator, Field, model_validator

from mrbatch.quantities import Position, Settings
from mrbatch.scene.material_settings import PositiveLength, to_tuple


class SphereProxy(Settings):
    """All light comes from a sphere."""

    centre: Position = Field(description="Its middle: lengths")
    radius: PositiveLength = Field(description="Its radius: a length above 0")


class BoxProxy(Settings):
    """All light comes from the walls, floor and ceiling of a room along the world's axes."""

    centre: Position = Field(description="Its middle: lengths")
    size: Annotated[tuple[PositiveLength, PositiveLength, PositiveLength], BeforeValidator(to_tuple)] = Field(
        description="Extent along x, y and z: lengths above 0"
    )


class DomeProxy(Settings):
    """All light comes from a half sphere on a floor, and from the floor."""

    centre: Position = Field(description="Its middle, on the floor: lengths")
    radius: PositiveLength = Field(description="Its radius: a length above 0")


class Proxy(Settings):
    """Walls that stand for what the map shows. One of `sphere`, `box` and `dome` is given."""

    sphere: SphereProxy | None = Field(None, description="A sphere")
    box: BoxProxy | None = Field(None, description="A room along the world's axes")
    dome: DomeProxy | None = Field(None, description="A half sphere, +Z up, on its floor")

    @model_validator(mode="after")
    def _one_shape(self) -> Proxy:
        if sum(given is not None for given in (self.sphere, self.box, self.dome)) != 1:
            raise ValueError("one of `sphere`, `box` and `dome` is given")
        return self
