"""What a job says of a surface that is given as a depth map."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, Field, field_validator, model_validator

from mrbatch.quantities import InputPath, Number, Settings
from mrbatch.scene.camera import Camera
from mrbatch.scene.material_settings import PositiveLength, to_tuple
from mrbatch.scene.matrix_settings import Matrix3, Matrix4, check_rotation


class DepthCamera(Settings):
    """The camera that a depth map was taken with, of the map's own size, and where it stood."""

    matrix: Matrix3 = Field(description="Camera matrix, 3 rows, in pixels of the depth map")
    distortion: Annotated[tuple[Number, ...], BeforeValidator(to_tuple)] = Field(
        (), description="OpenCV's k1 k2 p1 p2 [k3 [k4 k5 k6]]: 0, 4, 5 or 8 numbers"
    )
    pixel_centres: Literal["integer", "half"] = Field(
        "integer", description="Where the principal point counts pixel centres; `integer`: OpenCV's way"
    )
    world_from_camera: Matrix4 = Field(
        description="Where it stood: 4x4 by rows, metres; x right, y down, z forward"
    )

    @field_validator("matrix")
    @classmethod
    def _of_a_camera(cls, value: Any) -> Any:
        (fx, s, _), (t, fy, _), last = value
        if fx <= 0.0 or fy <= 0.0 or s != 0.0 or t != 0.0 or last != (0.0, 0.0, 1.0):
            raise ValueError(
                "expected a camera matrix [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], fx and fy above 0"
            )
        return value

    @field_validator("distortion")
    @classmethod
    def _coefficients(cls, value: Any) -> Any:
        if len(value) not in (0, 4, 5, 8):
            raise ValueError(f"{len(value)} distortion coefficients: expected 0, 4, 5 or 8")
        return value

    @field_validator("world_from_camera")
    @classmethod
    def _rigid(cls, value: Any) -> Any:
        if tuple(value[3]) != (0.0, 0.0, 0.0, 1.0):
            raise ValueError("the last row must be 0, 0, 0, 1")
        check_rotation([row[:3] for row in value[:3]])
        return value

    def camera(self, width: int, height: int) -> Camera:
        """For pictures of that size."""
        return Camera.from_opencv(
            width,
            height,
            np.array(self.matrix),
            np.array(self.distortion),
            np.array(self.world_from_camera),
            pixel_centres=self.pixel_centres,
        )


class DepthMap(Settings):
    """A surface as a camera saw it: how far away it is, pixel by pixel."""

    file: InputPath = Field(
        description="The map: 16-bit PNG or TIFF, EXR (the channel Z, or the only one), or NPY"
    )
    measures: Literal["z", "range"] = Field(
        description="What is measured: `z` along the camera's axis, `range` along each pixel's ray"
    )
    unit: PositiveLength = Field(description="Length that the value 1 stands for: `1 mm`, `1 m`")
    frame: int | None = Field(
        None, description="Number of the frame whose camera saw it, pixel for pixel or at another resolution"
    )
    camera: DepthCamera | None = Field(None, description="The camera that saw it; this or `frame` is given")
    edge: Annotated[Number, Field(gt=0.0, le=1.0)] = Field(
        0.03,
        description="Neighbouring pixels are not joined where their depths differ by more than this share of "
        "the smaller one, 0..1, unless they lie on one slope",
    )
    farthest: PositiveLength | None = Field(
        None, description="What is measured farther away than this is no surface; none: all of it is"
    )

    @model_validator(mode="after")
    def _seen_from_somewhere(self) -> DepthMap:
        if (self.frame is None) == (self.camera is None):
            raise ValueError("one of `frame` and `camera` is given")
        return self
