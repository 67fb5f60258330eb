"""How a job lays an environment map over the world by directions marked in both."""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from pydantic import BeforeValidator, Field, field_validator

from mrbatch.quantities import Angle, Number, Settings, Vector3
from mrbatch.scene.environment_alignment import EnvironmentAlignment, align, map_direction, pixel_direction
from mrbatch.scene.environment_tables import Rows
from mrbatch.scene.material_settings import to_tuple

Side = Annotated[int, Field(ge=1)]


class MarkedDirection(Settings):
    """One thing far away, where it is in the map and where it is in the world."""

    map: Annotated[tuple[Number, Number], BeforeValidator(to_tuple)] = Field(
        description="Its place in the map: [u, v], 0..1 from the top left; with `size`, pixels [x, y]"
    )
    world: Vector3 = Field(description="Its direction in the world, of any length but 0")

    @field_validator("world")
    @classmethod
    def _some_way(cls, value: Vector3) -> Vector3:
        if not 0.0 < math.hypot(*value) < math.inf:
            raise ValueError("a direction must not have the length 0")
        return value


class Alignment(Settings):
    """A map turned so that marked directions meet."""

    directions: Annotated[tuple[MarkedDirection, ...], BeforeValidator(to_tuple), Field(min_length=2)] = (
        Field(description="Two or more things seen in the map whose directions in the world are known")
    )
    size: Annotated[tuple[Side, Side], BeforeValidator(to_tuple)] | None = Field(
        None,
        description="Width and height of the picture in which `map` counts pixels, the map or a smaller "
        "copy; the first pixel's centre is [0.5, 0.5]",
    )
    tolerance: Annotated[Angle, Field(gt=0)] = Field(
        math.radians(3.0), description="How far any marked direction may be off after the turn"
    )

    def solved(self, rows: Rows) -> EnvironmentAlignment:
        """The rotation. Raises ValueError for marks beyond the map, on one line, or in contradiction."""
        width, height = self.size or (1, 1)
        if self.size and rows == "endpoints" and height < 2:
            raise ValueError("a picture of one row cannot have its rows at the end points")
        marks = []
        for i, mark in enumerate(self.directions):
            x, y = mark.map
            if not (0.0 <= x <= width and 0.0 <= y <= height):
                hint = "" if self.size else "; pixels need the picture's `size`"
                raise ValueError(
                    f"`directions.{i}.map` lies outside of the map, 0..{width} and 0..{height}{hint}"
                )
            marks.append(pixel_direction(x, y, width, height, rows) if self.size else map_direction(x, y))
        found = align(np.array(marks), np.array([mark.world for mark in self.directions]))
        worst = int(np.argmax(found.residuals))
        if found.residuals[worst] > self.tolerance:
            if found.mirrored:
                advice = "a mirror image of the map would fit: was it turned left to right?"
            else:
                advice = "measure again, or raise `tolerance`"
            raise ValueError(
                f"the directions contradict each other: `directions.{worst}` is "
                f"{math.degrees(found.residuals[worst]):.2f} degrees off after the best turn, "
                f"{math.degrees(self.tolerance):.2g} are allowed; {advice}"
            )
        return found
