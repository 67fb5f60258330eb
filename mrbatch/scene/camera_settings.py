"""What a job says of the camera beyond its calibration: the width of its lens, and its shutter."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, field_validator, model_validator

from mrbatch.quantities import Duration, Length, Number, Settings
from mrbatch.scene.material_settings import Name, PositiveLength

FractionOfInterval = Annotated[Number, Field(ge=-1.0, le=1.0)]


class LensSettings(Settings):
    """A lens of finite width: what lies before and behind its focus is blurred, as in the footage."""

    aperture: Annotated[Length, Field(ge=0.0)] | None = Field(
        None, description="Diameter of the opening that light comes through, 0 or more: a length"
    )
    f_number: Annotated[Number, Field(gt=0.0)] | None = Field(
        None,
        description="Focal length over that diameter, above 0, in place of `aperture`; with `focal_length` "
        "or `sensor_width`",
    )
    focal_length: PositiveLength | None = Field(
        None, description="Focal length of the lens, not its 35 mm equivalent: a length"
    )
    sensor_width: PositiveLength | None = Field(
        None, description="Width of the sensor's part that a whole picture shows: a length"
    )
    focus_distance: PositiveLength | None = Field(
        None, description="Distance along the optical axis to what is sharp: a length"
    )
    focus_object: Name | None = Field(
        None,
        description="Name of the object that is sharp: the middle of its bounds, wherever it is in a frame; "
        "in place of `focus_distance`",
    )

    @model_validator(mode="after")
    def _one_way(self) -> LensSettings:
        if (self.aperture is None) == (self.f_number is None):
            raise ValueError("one of `aperture` and `f_number` is given")
        scales = [name for name in ("focal_length", "sensor_width") if getattr(self, name) is not None]
        if self.f_number is not None and len(scales) != 1:
            raise ValueError("with `f_number` one of `focal_length` and `sensor_width` is given")
        if self.f_number is None and scales:
            raise ValueError(f"`{scales[0]}` goes with `f_number`: `aperture` is a diameter already")
        if (self.focus_distance is None) == (self.focus_object is None):
            raise ValueError("one of `focus_distance` and `focus_object` is given")
        if self.focus_distance is not None and self.focal_length is not None:
            if self.focus_distance <= self.focal_length:
                raise ValueError("nothing nearer than `focal_length` can be in focus: see `focus_distance`")
        return self


class ShutterSettings(Settings):
    """How long the shutter is open: what moves meanwhile is blurred, as in the footage."""

    open: FractionOfInterval | None = Field(
        None,
        description="When it opens, in frames from the frame's own time, -1..1: a frame's pose is that of "
        "the middle of its exposure, so an exposure of half a frame is from -0.25 to 0.25",
    )
    close: FractionOfInterval | None = Field(None, description="When it closes, likewise, after `open`")
    exposure: Annotated[Duration, Field(ge=0.0)] | None = Field(
        None, description="Exposure time, about the frame's own time, in place of `open` and `close`: a time"
    )
    samples: Annotated[int, Field(ge=1, le=1024)] = Field(
        16,
        description="Moments of an exposure at which scene and camera are looked at, 1..1024; they share "
        "the samples of each half evenly",
    )
    rolling: bool = Field(False, description="Rows exposed one after another: not simulated, so `false`")

    @field_validator("rolling")
    @classmethod
    def _global(cls, value: bool) -> bool:
        if value:
            raise ValueError("a rolling shutter is not simulated: leave it out, and all rows open at once")
        return value

    @model_validator(mode="after")
    def _one_way(self) -> ShutterSettings:
        if self.exposure is not None:
            if self.open is not None or self.close is not None:
                raise ValueError("`exposure` stands alone: leave out `open` and `close`")
        elif self.open is None or self.close is None:
            raise ValueError("`open` and `close`, or `exposure`, are given")
        elif self.close < self.open:
            raise ValueError("`close` comes before `open`")
        return self
