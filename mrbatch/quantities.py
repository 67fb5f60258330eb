"""Settings that come from people: the strict base model and numbers with units.

Lengths are metres, angles radians, times seconds inside the program. A job must name the unit of
a quantity (`60 mm`, `30 deg`); a bare number is refused, because it is the commonest silent error.
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, PlainSerializer, WithJsonSchema

LENGTH_UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "km": 1e3, "in": 0.0254, "ft": 0.3048}
ANGLE_UNITS = {"deg": math.pi / 180.0, "rad": 1.0, "turn": 2.0 * math.pi}
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "min": 60.0, "h": 3600.0}

_QUANTITY = re.compile(r"^\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*([A-Za-z°]*)\s*$")


class Settings(BaseModel):
    """Base of all models of a job: strict, frozen, unknown keys refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, arbitrary_types_allowed=True)


def parse_quantity(value: Any, units: dict[str, float], what: str) -> float:
    """`60 mm` to 0.06: a finite float in the base unit. Raises ValueError with what is wrong."""
    example = f"{what} with a unit, such as `1.5 {next(iter(units))}`"
    if isinstance(value, bool):
        raise ValueError(f"expected {example}")
    if isinstance(value, (int, float)):
        if value == 0:
            return 0.0
        raise ValueError(f"unit missing: expected {example} (units: {', '.join(units)})")
    if not isinstance(value, str):
        raise ValueError(f"expected {example}")
    match = _QUANTITY.match(value)
    if not match:
        raise ValueError(f"cannot read `{value}`: expected {example}")
    number, unit = match.groups()
    if not unit:
        if float(number) == 0.0:
            return 0.0
        raise ValueError(f"unit missing: expected {example} (units: {', '.join(units)})")
    if unit not in units:
        raise ValueError(f"unknown unit `{unit}`: expected one of {', '.join(units)}")
    result = float(number) * units[unit]
    if not math.isfinite(result):
        raise ValueError(f"`{value}` is not a finite number")
    return result


def _quantity(units: dict[str, float], what: str):
    base = next(unit for unit, factor in units.items() if factor == 1.0)
    pattern = r"^\s*[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?\s*(" + "|".join(units) + r")\s*$"
    return (
        BeforeValidator(lambda value: parse_quantity(value, units, what)),
        # `0.06 m`: what is written to JSON reads back to the same bits.
        PlainSerializer(lambda value: f"{float(value)!r} {base}", return_type=str, when_used="json"),
        WithJsonSchema(
            {
                "anyOf": [{"type": "string", "pattern": pattern}, {"const": 0}],
                "description": f"{what} with a unit: {', '.join(units)}",
            }
        ),
    )


Length = Annotated[float, *_quantity(LENGTH_UNITS, "a length")]
Angle = Annotated[float, *_quantity(ANGLE_UNITS, "an angle")]
Duration = Annotated[float, *_quantity(TIME_UNITS, "a time")]


def _to_tuple(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


def _to_float(value: Any) -> Any:
    if isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    return value


Number = Annotated[float, Field(allow_inf_nan=False), BeforeValidator(_to_float)]
"""A finite number without unit; whole numbers are taken too."""
Vector3 = Annotated[tuple[Number, Number, Number], BeforeValidator(_to_tuple)]
Position = Annotated[tuple[Length, Length, Length], BeforeValidator(_to_tuple)]
Rotation = Annotated[tuple[Angle, Angle, Angle], BeforeValidator(_to_tuple)]
Reflectance = Annotated[float, Field(ge=0.0, le=1.0, allow_inf_nan=False), BeforeValidator(_to_float)]


def _to_colour(value: Any) -> Any:
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return (float(value),) * 3
    return _to_tuple(value)


def _colour_schema(limits: dict[str, float]) -> WithJsonSchema:
    number = {"type": "number", **limits}
    array = {"type": "array", "prefixItems": [number] * 3, "minItems": 3, "maxItems": 3}
    return WithJsonSchema({"anyOf": [number, array]})


Albedo = Annotated[
    tuple[Reflectance, Reflectance, Reflectance],
    BeforeValidator(_to_colour),
    _colour_schema({"minimum": 0.0, "maximum": 1.0}),
]
"""Linear Rec.709 reflectance in 0..1; one number stands for grey."""
Positive = Annotated[float, Field(ge=0.0, allow_inf_nan=False), BeforeValidator(_to_float)]
Colour = Annotated[
    tuple[Positive, Positive, Positive], BeforeValidator(_to_colour), _colour_schema({"minimum": 0.0})
]
"""Linear Rec.709 radiance or gain, not negative; one number stands for grey."""


INPUT_PATH = "input-path"
"""Marks a field whose relative path counts from the job file; loaders look for it in the metadata."""


def _to_path(value: Any) -> Any:
    if not isinstance(value, str):
        return value
    if not value.strip():
        raise ValueError("expected the path of a file")
    return Path(value)


_to_posix = PlainSerializer(lambda path: path.as_posix(), return_type=str, when_used="json")
InputPath = Annotated[Path, BeforeValidator(_to_path), _to_posix, INPUT_PATH]
"""A file or file pattern that is read; relative paths count from the job file."""
OutputPath = Annotated[Path, BeforeValidator(_to_path), _to_posix]
"""A file or folder that is written; relative paths count from the job file."""
