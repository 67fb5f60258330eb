"""How a job lays an environment map over the world by directions marked in both."""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from pydantic import BeforeValidator, Field, field_validator, model_validator

from mrbatch.quantities import Angle, Number, Position, Settings, Vector3
from mrbatch.scene.camera import Camera
from mrbatch.scene.environment_alignment import EnvironmentAlignment, align, map_direction, pixel_direction
from mrbatch.scene.environment_tables import Rows
from mrbatch.scene.material_settings import PositiveLength, to_tuple
from mrbatch.scene.mirror_ball import BallView, ball_from_circle, ball_from_outline, ball_from_world

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


Pixel = Annotated[tuple[Number, Number], BeforeValidator(to_tuple)]


class Circle(Settings):
    """A circle in a picture; pixel centres at half integers from the top left."""

    centre: Pixel = Field(description="[x, y] in pixels")
    radius: Annotated[Number, Field(gt=0.0)] = Field(description="Radius in pixels")


class Ball(Settings):
    """A ball in the world."""

    centre: Position = Field(description="Its middle: lengths")
    radius: PositiveLength = Field(description="Its radius: a length above 0")


class Probe(Settings):
    """A mirror ball in one of the frames. One of `outline`, `circle` and `ball` says where."""

    frame: int = Field(description="Number of the frame")
    outline: Annotated[tuple[Pixel, ...], BeforeValidator(to_tuple), Field(min_length=3)] | None = Field(
        None, description="Three or more pixels [x, y] on the ball's outline, all round it"
    )
    circle: Circle | None = Field(
        None, description="The ball's outline as a circle; only near the middle of the picture is it one"
    )
    ball: Ball | None = Field(None, description="The ball's place in the world and its radius")
    upright: bool = Field(
        False,
        description="Whether the map stands upright (its top is the world's +Z): one lamp is then enough",
    )

    @model_validator(mode="after")
    def _one_place(self) -> Probe:
        if sum(given is not None for given in (self.outline, self.circle, self.ball)) != 1:
            raise ValueError("one of `outline`, `circle` and `ball` is given")
        return self

    def view(self, camera: Camera) -> BallView:
        """The ball as the frame's camera sees it. Raises ValueError."""
        if self.outline is not None:
            return ball_from_outline(camera, np.array(self.outline))
        if self.circle is not None:
            return ball_from_circle(camera, *self.circle.centre, self.circle.radius)
        assert self.ball is not None
        return ball_from_world(camera, np.array(self.ball.centre), self.ball.radius)


class Alignment(Settings):
    """A map turned so that marked directions meet, or lamps that a mirror ball shows."""

    directions: (
        Annotated[tuple[MarkedDirection, ...], BeforeValidator(to_tuple), Field(min_length=2)] | None
    ) = Field(None, description="Two or more things seen in the map whose directions in the world are known")
    probe: Probe | None = Field(
        None, description="A mirror ball in the picture that shows the map's lamps; instead of `directions`"
    )
    size: Annotated[tuple[Side, Side], BeforeValidator(to_tuple)] | None = Field(
        None,
        description="Width and height of the picture in which `map` counts pixels, the map or a smaller "
        "copy; the first pixel's centre is [0.5, 0.5]",
    )
    tolerance: Annotated[Angle, Field(gt=0)] = Field(
        math.radians(3.0), description="How far any marked direction, or lamp, may be off after the turn"
    )

    @model_validator(mode="after")
    def _one_way(self) -> Alignment:
        if (self.directions is None) == (self.probe is None):
            raise ValueError("one of `directions` and `probe` is given")
        return self

    def solved(self, rows: Rows) -> EnvironmentAlignment:
        """The rotation of `directions`. Raises ValueError for marks beyond the map, on one line, or in
        contradiction."""
        assert self.directions is not None
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
