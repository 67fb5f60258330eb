"""Settings of a marker video: the footage, its colour, the camera, the target, gain and mattes.

Settings that have a short form (a number, a list, a file name) are models that take it in place of
their mapping, so that an error always has one place and a schema names every form.
"""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Annotated, Any, ClassVar, Literal, get_args

import numpy as np
from pydantic import BeforeValidator, Field, PlainSerializer, WithJsonSchema, model_validator

from mrbatch.capture.marker_video.target_settings import TargetSettings
from mrbatch.quantities import (
    Angle,
    Colour,
    Duration,
    InputPath,
    Length,
    Number,
    Position,
    Reflectance,
    Rotation,
    Settings,
)

Transfer = Literal["auto", "linear", "srgb", "bt709", "bt1886", "gamma22", "gamma28", "pq", "hlg"]
Range = Literal["auto", "limited", "full"]
Matrix = Literal["auto", "bt601", "bt709", "bt2020", "fcc", "smpte240m"]
Primaries = Literal["auto", "bt709", "bt601-625", "bt601-525", "bt2020", "p3"]
ChromaSiting = Literal["auto", "left", "centre", "top-left", "top", "bottom-left", "bottom"]
LostPolicy = Literal["stop", "skip", "hold-last", "interpolate"]

_NTSC = {"23.976": (24000, 1001), "23.98": (24000, 1001), "29.97": (30000, 1001), "59.94": (60000, 1001)}


def _to_frame_rate(value: Any) -> Any:
    if isinstance(value, (bool, Fraction)) or not isinstance(value, (int, float, str)):
        return value
    text = str(value).strip()
    try:
        rate = Fraction(*_NTSC[text]) if text in _NTSC else Fraction(text)
    except (ValueError, ZeroDivisionError):
        raise ValueError(
            f"cannot read `{value}`: expected frames per second, such as 25 or 24000/1001"
        ) from None
    if not 0 < rate <= 100_000:
        raise ValueError(f"{text} frames per second: expected more than 0 and at most 100000")
    return rate


FrameRate = Annotated[
    Fraction,
    BeforeValidator(_to_frame_rate),
    PlainSerializer(str, return_type=str, when_used="json"),
    WithJsonSchema(
        {
            "anyOf": [
                {"type": "number", "exclusiveMinimum": 0},
                {"type": "string", "pattern": r"^\s*\d+(\.\d+)?(/\d+)?\s*$"},
            ]
        }
    ),
]
"""Frames per second, exactly: 25, 24000/1001; 23.976, 29.97 and 59.94 mean the NTSC fractions."""


def _to_tuple(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


def _to_rows(value: Any) -> Any:
    return tuple(_to_tuple(row) for row in value) if isinstance(value, (list, tuple)) else value


def _to_paths(value: Any) -> Any:
    return _to_tuple(value) if isinstance(value, (list, tuple)) else (value,)


_STRINGS = {"anyOf": [{"type": "string"}, {"type": "array", "items": {"type": "string"}, "minItems": 1}]}
InputPaths = Annotated[
    tuple[InputPath, ...], BeforeValidator(_to_paths), Field(min_length=1), WithJsonSchema(_STRINGS)
]
Row3 = Annotated[tuple[Number, Number, Number], BeforeValidator(_to_tuple)]
Row4 = Annotated[tuple[Number, Number, Number, Number], BeforeValidator(_to_tuple)]


class ShortSettings(Settings):
    """A model that also takes a short form in place of its mapping.

    `short_forms`: the JSON Schemas of the short forms. `expand` turns one into the mapping.
    """

    short_forms: ClassVar[tuple[dict[str, Any], ...]] = ()

    @classmethod
    def expand(cls, value: Any) -> Any:
        raise NotImplementedError

    @model_validator(mode="before")
    @classmethod
    def _expand(cls, value: Any) -> Any:
        return value if isinstance(value, (dict, cls)) else cls.expand(value)

    @classmethod
    def __get_pydantic_json_schema__(cls, core_schema, handler):
        schema = handler.resolve_ref_schema(handler(core_schema))
        return {"anyOf": [*cls.short_forms, schema]}


class ColourSettings(Settings):
    """How the footage's code values are read; `auto` follows the file's tags."""

    transfer: Transfer = Field("auto", description="Transfer function that the codes were written with.")
    range: Range = Field("auto", description="Code range of video: limited (16 to 235) or full.")
    matrix: Matrix = Field("auto", description="Y'CbCr matrix of video.")
    primaries: Primaries = Field("auto", description="Primaries; others than bt709 are converted.")
    chroma: ChromaSiting = Field("auto", description="Where chroma samples lie in subsampled video.")


class CameraSettings(ShortSettings):
    """The camera: a calibration `file`, or matrix and size in place."""

    short_forms = ({"type": "string", "description": "Calibration file (OpenCV YAML, JSON, NPY, NPZ)."},)

    file: InputPath | None = Field(None, description="Calibration file (OpenCV YAML, JSON, NPY, NPZ).")
    matrix: Annotated[tuple[Row3, Row3, Row3], BeforeValidator(_to_rows)] | None = Field(
        None, description="Camera matrix, 3 rows, in pixels."
    )
    distortion: Annotated[tuple[Number, ...], BeforeValidator(_to_tuple)] = Field(
        (), description="OpenCV's k1 k2 p1 p2 [k3 [k4 k5 k6]]: 0, 4, 5 or 8 numbers."
    )
    width: Annotated[int, Field(ge=1)] | None = Field(None, description="Width of the pictures in pixels.")
    height: Annotated[int, Field(ge=1)] | None = Field(None, description="Height of the pictures in pixels.")
    pixel_centres: Literal["integer", "half"] | None = Field(
        None,
        description="Where the principal point counts pixel centres; left out: as the calibration file says, "
        "else integer, OpenCV's way.",
    )
    section: str | None = Field(None, description="Part of a file that holds several calibrations.")

    @classmethod
    def expand(cls, value: Any) -> Any:
        return {"file": value}

    @model_validator(mode="after")
    def _one(self):
        if (self.file is None) == (self.matrix is None):
            raise ValueError("expected either `file` or `matrix` with `width` and `height`")
        if self.matrix is not None:
            if self.width is None or self.height is None:
                raise ValueError("`matrix` needs `width` and `height`, the size that it was calibrated for")
            if len(self.distortion) not in (0, 4, 5, 8):
                raise ValueError(f"{len(self.distortion)} distortion coefficients: expected 0, 4, 5 or 8")
            rows = np.array(self.matrix)
            if rows[0, 0] <= 0 or rows[1, 1] <= 0 or abs(np.linalg.det(rows)) == 0.0:
                raise ValueError("the camera matrix is singular: focal lengths must be above 0")
            if tuple(rows[2]) != (0.0, 0.0, 1.0) or rows[0, 1] != 0.0 or rows[1, 0] != 0.0:
                raise ValueError("expected a camera matrix [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]")
        return self


class TransformSettings(ShortSettings):
    """A rigid motion: a 4x4 `matrix`, or `position` and `rotation` (about x, then y, then z)."""

    short_forms = (
        {
            "type": "array",
            "items": {"type": "array", "items": {"type": "number"}, "minItems": 4, "maxItems": 4},
            "minItems": 4,
            "maxItems": 4,
        },
    )

    matrix: Annotated[tuple[Row4, Row4, Row4, Row4], BeforeValidator(_to_rows)] | None = Field(
        None, description="4 rows of 4 numbers, translation in metres."
    )
    position: Position = Field((0.0, 0.0, 0.0), description="Translation, with units.")
    rotation: Rotation = Field((0.0, 0.0, 0.0), description="Angles about x, then y, then z, with units.")

    @classmethod
    def expand(cls, value: Any) -> Any:
        return {"matrix": value}

    @model_validator(mode="after")
    def _rigid(self):
        if self.matrix is None:
            return self
        if any(self.position) or any(self.rotation):
            raise ValueError("expected either `matrix` or `position` and `rotation`, not both")
        m = np.array(self.matrix)
        r = m[:3, :3]
        # Matrices are typed or printed with few digits; a scale or shear is far beyond this.
        if np.abs(r @ r.T - np.eye(3)).max() > 1e-4 or np.linalg.det(r) < 0 or tuple(m[3]) != (0, 0, 0, 1):
            raise ValueError("expected a rigid motion: a rotation, a translation, and the last row 0 0 0 1")
        return self

    def array(self) -> np.ndarray:
        """(4, 4) float64, its rotation orthonormal to rounding."""
        result = np.eye(4)
        if self.matrix is not None:
            m = np.array(self.matrix)
            u, _, vt = np.linalg.svd(m[:3, :3])
            exact = np.array_equal(m[:3, :3] @ m[:3, :3].T, np.eye(3))
            result[:3, :3] = m[:3, :3] if exact else u @ vt
            result[:3, 3] = m[:3, 3]
            return result
        (ax, ay, az), c, s = self.rotation, math.cos, math.sin
        rx = np.array([[1, 0, 0], [0, c(ax), -s(ax)], [0, s(ax), c(ax)]])
        ry = np.array([[c(ay), 0, s(ay)], [0, 1, 0], [-s(ay), 0, c(ay)]])
        rz = np.array([[c(az), -s(az), 0], [s(az), c(az), 0], [0, 0, 1]])
        result[:3, :3] = rz @ ry @ rx
        result[:3, 3] = self.position
        return result


class PatchSettings(Settings):
    """A diffuse patch seen by the camera, of known radiance in the environment's units."""

    frame: int = Field(description="Number of the frame in which the patch is measured.")
    rectangle: Annotated[
        tuple[
            Annotated[int, Field(ge=0)],
            Annotated[int, Field(ge=0)],
            Annotated[int, Field(ge=1)],
            Annotated[int, Field(ge=1)],
        ],
        BeforeValidator(_to_tuple),
    ] = Field(description="x, y, width, height of the patch in pixels.")
    radiance: Colour | None = Field(None, description="The patch's radiance, if known as such.")
    reflectance: Reflectance | None = Field(None, description="Its diffuse reflectance, with `irradiance`.")
    irradiance: Colour | None = Field(None, description="Irradiance on the patch, with `reflectance`.")

    @model_validator(mode="after")
    def _one(self):
        if (self.radiance is None) == (self.reflectance is None or self.irradiance is None):
            raise ValueError("expected either `radiance`, or `reflectance` and `irradiance`")
        if min(self.known()) <= 0.0:
            raise ValueError("the patch's radiance must be above 0 in every channel")
        return self

    def known(self) -> tuple[float, float, float]:
        """The patch's radiance: given, or reflectance times irradiance over pi."""
        if self.radiance is not None:
            return self.radiance
        assert self.reflectance is not None and self.irradiance is not None
        return tuple(self.reflectance * e / math.pi for e in self.irradiance)  # type: ignore[return-value]


class GainSettings(ShortSettings):
    """photo = gain x radiance: a constant, a file with a row a frame, or a patch of known radiance."""

    short_forms = (
        {"type": "number", "exclusiveMinimum": 0},
        {"type": "array", "items": {"type": "number", "exclusiveMinimum": 0}, "minItems": 3, "maxItems": 3},
        {"type": "string", "description": "JSON or CSV file with a gain for each frame."},
    )

    value: Colour | None = Field(None, description="One gain, or one for each of red, green, blue.")
    file: InputPath | None = Field(None, description="JSON or CSV file with a gain for each frame.")
    patch: PatchSettings | None = Field(None, description="A patch that the gain is measured from.")

    @classmethod
    def expand(cls, value: Any) -> Any:
        return {"file": value} if isinstance(value, str) else {"value": value}

    @model_validator(mode="after")
    def _one(self):
        if sum(x is not None for x in (self.value, self.file, self.patch)) != 1:
            raise ValueError("expected exactly one of `value`, `file`, `patch`")
        if self.value is not None and min(self.value) <= 0.0:
            raise ValueError("a gain must be above 0")
        return self


class MatteSettings(ShortSettings):
    """Pictures of what passes in front of the virtual objects: 1 covers, 0 does not."""

    short_forms = (_STRINGS,)

    frames: InputPaths = Field(description="Picture sequence; its numbers are those of the shot's frames.")
    invert: bool = Field(False, description="True where the mattes are white for what is behind.")
    start_frame: int | None = Field(None, description="Number of the frame that the first matte belongs to.")

    @classmethod
    def expand(cls, value: Any) -> Any:
        return {"frames": value}


class SubsetSettings(Settings):
    """Which frames of the footage are used, by number and by time (both ends of `first`..`last` count)."""

    first: int | None = Field(None, description="First frame number.")
    last: int | None = Field(None, description="Last frame number.")
    step: Annotated[int, Field(ge=1)] = Field(1, description="Every how manyth frame, from the first.")
    from_time: Duration | None = Field(None, description="Frames at this time or later.")
    to_time: Duration | None = Field(None, description="Frames before this time.")


SmoothingModel = Literal["constant-velocity", "constant-acceleration"]


class SmoothingSettings(ShortSettings):
    """Poses smoothed over time, without lag, each weighed by its covariance."""

    short_forms = ({"enum": list(get_args(SmoothingModel))},)

    model: SmoothingModel = Field(
        "constant-velocity",
        description="What a camera keeps to until something pushes it; how much it is pushed is estimated "
        "from the shot.",
    )
    sigma_angle: Annotated[Angle, Field(ge=1e-9, le=math.pi)] | None = Field(
        None,
        description="Standard deviation of given `poses` about each axis of the camera, 1e-9 rad to 180 deg.",
    )
    sigma_place: Annotated[Length, Field(ge=1e-9, le=1e3)] | None = Field(
        None, description="Standard deviation of given `poses` along each axis of the world, 1 nm to 1 km."
    )

    @classmethod
    def expand(cls, value: Any) -> Any:
        return {"model": value}

    @model_validator(mode="after")
    def _both(self):
        if (self.sigma_angle is None) != (self.sigma_place is None):
            raise ValueError("`sigma_angle` and `sigma_place` go together")
        return self

    @property
    def order(self) -> int:
        """How often the noise that pushes the camera is integrated: 2 or 3."""
        return 2 if self.model == "constant-velocity" else 3


class MarkerVideoSettings(Settings):
    """A video or picture sequence in which a printed target fixes the world."""

    kind: Literal["marker-video"] = "marker-video"
    frames: InputPaths = Field(
        description="A video, a picture, a pattern (photo_####.png, photo_%04d.png, photo_*.jpg) or a list."
    )
    frame_rate: FrameRate | None = Field(
        None, description="Frames per second of a sequence (24 if left out); conforms a video to it."
    )
    start_frame: int | None = Field(
        None, description="Number of the first frame; else as in the file names, 0 for a video."
    )
    subset: SubsetSettings = Field(SubsetSettings(), description="Which frames are used.")
    colour: ColourSettings = Field(ColourSettings(), description="How code values are read.")
    camera: CameraSettings = Field(description="Calibration file, or matrix and size.")
    target: TargetSettings | None = Field(None, description="The printed target that gives the poses.")
    poses: InputPath | None = Field(None, description="File of camera poses, in place of a target.")
    world_from_marker: TransformSettings = Field(
        TransformSettings(), description="Where the target's frame lies in the world."
    )
    gain: GainSettings = Field(GainSettings(value=(1.0, 1.0, 1.0)), description="photo = gain x radiance.")
    mattes: MatteSettings | None = Field(None, description="What passes in front of the virtual objects.")
    lost: LostPolicy = Field("stop", description="What happens to frames for which no pose is found.")
    smoothing: SmoothingSettings | None = Field(
        None, description="How poses are smoothed over time; none: they stay as they are found."
    )

    @model_validator(mode="after")
    def _posed(self):
        if (self.target is None) == (self.poses is None):
            raise ValueError("expected either `target` (poses are found) or `poses` (they are given)")
        if self.smoothing is not None and (self.poses is None) != (self.smoothing.sigma_angle is None):
            raise ValueError(
                "`smoothing` of given `poses` needs `sigma_angle` and `sigma_place`: a file has no covariance"
                if self.poses is not None
                else "`smoothing` takes the covariance of poses that are found: leave out its `sigma_angle` "
                "and `sigma_place`"
            )
        return self
