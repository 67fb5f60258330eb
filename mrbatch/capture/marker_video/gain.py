"""The gain between photo and radiance: photo = gain x radiance, for each frame and channel.

It is what exposure, sensitivity and white balance of the camera make of the environment map's units.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mrbatch.capture.data_file import parse_json, read_text
from mrbatch.capture.marker_video.colour import Picture
from mrbatch.capture.marker_video.settings import PatchSettings
from mrbatch.document import shorten
from mrbatch.errors import InputError, Place

Gain = tuple[float, float, float]
WHAT = "gain file"
_WHOLE = re.compile(r"[-+]?[0-9]{1,18}")
CLIPPED_SHARE = 0.01
"""A patch with more clipped pixels than this measures the camera's ceiling, not its gain."""


def checked_gain(value: Any, place: Place) -> Gain:
    """One gain or three, as three. Raises InputError unless all are finite numbers above 0."""
    values = list(value) if isinstance(value, Sequence) and not isinstance(value, str) else [value] * 3
    numbers = [float(v) for v in values if isinstance(v, (int, float)) and not isinstance(v, bool)]
    if len(numbers) != len(values) or len(numbers) != 3:
        raise InputError(f"the gain is {shorten(value)}, expected a number or three", place=place)
    if not all(math.isfinite(v) and v > 0.0 for v in numbers):
        raise InputError(
            f"the gain is {shorten(value)}, expected finite numbers above 0",
            place=place,
            hint="photo = gain x radiance: 0 or less would say that the camera saw no light",
        )
    return numbers[0], numbers[1], numbers[2]


def load_gains(path: Path) -> dict[int, Gain]:
    """Gains by frame number from a file.

    JSON: `{"1001": 0.5, "1002": [0.5, 0.5, 0.6]}`, or a list of `{"frame": 1001, "gain": ...}`; CSV with
    the header `frame,gain` or `frame,r,g,b`. Raises InputError: unreadable, a frame twice, no gain.
    """
    place = Place(file=str(path))
    text = read_text(path, WHAT)
    if path.suffix.lower() == ".csv":
        rows = _from_csv(text, place)
    else:
        rows = _from_json(parse_json(text, WHAT, place), place)
    gains: dict[int, Gain] = {}
    for number, value in rows:
        at = Place(file=str(path), frame=number)
        if number in gains:
            raise InputError("the frame has two gains", place=at)
        gains[number] = checked_gain(value, at)
    if not gains:
        raise InputError("the file holds no gain", place=place)
    return gains


def _from_json(content: Any, place: Place) -> list[tuple[int, Any]]:
    if isinstance(content, Mapping):
        return [(_frame_number(key, place), value) for key, value in content.items()]
    if isinstance(content, list) and all(
        isinstance(e, Mapping) and {"frame", "gain"} <= set(e) for e in content
    ):
        return [(_frame_number(entry["frame"], place), entry["gain"]) for entry in content]
    raise InputError("expected a mapping of frame numbers to gains, or a list of {frame, gain}", place=place)


def _from_csv(text: str, place: Place) -> list[tuple[int, Any]]:
    try:
        rows = [row for row in csv.reader(text.splitlines(), skipinitialspace=True) if any(row)]
    except csv.Error as error:
        raise InputError(f"the {WHAT} cannot be read ({error})", place=place) from None
    header = [name.strip() for name in rows[0]] if rows else []
    if header not in (["frame", "gain"], ["frame", "r", "g", "b"]):
        raise InputError("expected the header `frame,gain` or `frame,r,g,b`", place=place)
    found: list[tuple[int, Any]] = []
    for cells in rows[1:]:
        number = _frame_number(cells[0], place)
        try:
            values = [float(cell) for cell in cells[1:]]
        except ValueError:
            values = []
        if len(cells) != len(header) or not values:
            raise InputError(
                f"expected {len(header) - 1} numbers after the frame, got `{shorten(','.join(cells[1:]))}`",
                place=Place(file=place.file, frame=number),
            )
        found.append((number, values if len(values) == 3 else values[0]))
    return found


def _frame_number(value: Any, place: Place) -> int:
    """A whole number, as such or as text. Raises InputError."""
    text = value.strip() if isinstance(value, str) else ""
    if isinstance(value, int) and not isinstance(value, bool):
        return value
    if _WHOLE.fullmatch(text):
        return int(text)
    raise InputError(f"`{shorten(value)}` is no frame number", place=place)


def patch_gain(picture: Picture, patch: PatchSettings, place: Place, *, ceiling: float | None) -> Gain:
    """Mean linear value of the patch in the photo over its known radiance, for each channel.

    `ceiling`: linear value at which the picture clips, None where it does not. Raises InputError: a
    rectangle outside of the picture, clipped pixels, a black patch.
    """
    x, y, width, height = patch.rectangle
    rows, columns = picture.linear.shape[:2]
    if x + width > columns or y + height > rows:
        raise InputError(
            f"the patch {list(patch.rectangle)} reaches beyond the picture of {columns}x{rows}", place=place
        )
    values = picture.linear[y : y + height, x : x + width].reshape(-1, 3).astype(np.float64)
    if ceiling is not None:
        share = float((values >= ceiling).any(axis=1).mean())
        if share > CLIPPED_SHARE:
            raise InputError(
                f"{100 * share:.0f} % of the patch's pixels are clipped",
                place=place,
                hint="measure a patch or a frame that is not overexposed",
            )
    return checked_gain([float(m) / k for m, k in zip(values.mean(axis=0), patch.known())], place)
