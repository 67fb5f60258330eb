"""Picture sequences: which files are which frames, and their pixels through OpenImageIO.

OpenImageIO is asked for stored values only: no premultiplication, no photometric conversion, no
colour management. Integer pictures keep their codes; half and float pictures their values.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from math import gcd
from pathlib import Path
from typing import Any

import numpy as np

from mrbatch.capture.marker_video.colour import (
    Colour,
    Picture,
    linear_from_codes,
    linear_from_light,
    rows_of,
)
from mrbatch.capture.marker_video.settings import ColourSettings
from mrbatch.errors import InputError, Place
from mrbatch.kernels.transfer import rec709_from_primaries

PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg", ".jpe", ".tif", ".tiff", ".exr", ".bmp", ".tga", ".hdr", ".ppm")
MAX_PIXELS = 2**27
"""A picture that claims more is refused before memory is asked for."""
_PATTERN = re.compile(r"(#+|%0?(\d*)d|\*)")
_CHANNELS = {1: (("Y",), ("R",), ("I",), ("L",)), 3: (("R", "G", "B"),)}


@dataclass(frozen=True)
class ImageSequence:
    """Numbered picture files. `numbers` strictly increase; `missing` are gaps between them."""

    numbers: tuple[int, ...]
    paths: tuple[Path, ...]
    missing: tuple[int, ...] = ()

    def path(self, number: int) -> Path:
        """The file of one frame. Raises InputError where there is none."""
        try:
            return self.paths[self.numbers.index(number)]
        except ValueError:
            raise InputError(
                "there is no picture for the frame", place=Place(file=str(self.paths[0].parent), frame=number)
            ) from None


def is_pattern(path: Path) -> bool:
    """Whether a file name stands for many: `photo_####.png`, `photo_%04d.png`, `photo_*.png`."""
    return bool(_PATTERN.search(path.name))


def find_sequence(frames: Sequence[Path], start_frame: int | None = None) -> ImageSequence:
    """The files of a sequence: one pattern, one file, or a list in the order of the shot.

    Numbers come from the names: the digits that the pattern stands for, for `*` the last digits of
    what it stands for, for a list the last digits of each name if these increase (else 0, 1, 2, ...).
    `start_frame` renumbers so that the first file gets it and gaps stay. Raises InputError: nothing
    found, one number twice, a missing file.
    """
    if len(frames) == 1 and is_pattern(frames[0]):
        found = _matching(frames[0])
    else:
        found = _listed(frames)
    numbers = [number for number, _ in found]
    if start_frame is not None:
        numbers = [number - numbers[0] + start_frame for number in numbers]
    # A sequence on every third number has step 3; what that step skips is missing.
    step = reduce(gcd, (b - a for a, b in zip(numbers, numbers[1:])), 0) or 1
    there = set(numbers)
    spread = (numbers[-1] - numbers[0]) // step + 1
    missing: tuple[int, ...] = ()
    if spread <= 100 * len(numbers):  # names with dates in them are no count of frames
        missing = tuple(n for n in range(numbers[0], numbers[-1], step) if n not in there)
    return ImageSequence(tuple(numbers), tuple(path for _, path in found), missing)


def _matching(pattern: Path) -> list[tuple[int, Path]]:
    place = Place(file=str(pattern))
    marks = list(_PATTERN.finditer(pattern.name))
    if len(marks) > 1:
        raise InputError("the file name holds more than one place for the number", place=place)
    mark = marks[0]
    before, after = re.escape(pattern.name[: mark.start()]), re.escape(pattern.name[mark.end() :])
    text = mark.group()
    if text == "*":
        middle = r"(?P<text>.*)"
    else:
        width = len(text) if text[0] == "#" else int(mark.group(2) or 0)
        # Zero-padded to the width; numbers that need more digits have more, without padding.
        middle = rf"(?P<text>\d{{{width}}}|[1-9]\d{{{width},}})" if width else r"(?P<text>0|[1-9]\d*)"
    wanted = re.compile(before + middle + after)
    if not pattern.parent.is_dir():
        raise InputError("there is no such folder", place=Place(file=str(pattern.parent)))
    found: dict[int, Path] = {}
    for path in sorted(pattern.parent.iterdir()):
        match = wanted.fullmatch(path.name)
        if not match or not path.is_file():
            continue
        digits = re.findall(r"\d+", match.group("text"))
        if not digits:
            if text == "*":
                raise InputError(
                    "the file matches the pattern but has no number where `*` stands",
                    place=Place(file=str(path)),
                    hint="give a list of files, or a narrower pattern",
                )
            continue
        number = int(digits[-1])
        if number in found:
            raise InputError(f"{found[number].name} and {path.name} have one number, {number}", place=place)
        found[number] = path
    if not found:
        raise InputError(
            "no file matches the pattern", place=place, hint="`####` stands for at least four digits"
        )
    return sorted(found.items())


def _listed(frames: Sequence[Path]) -> list[tuple[int, Path]]:
    for path in frames:
        if is_pattern(path) and not path.is_file():
            raise InputError("a list of frames holds files, no patterns", place=Place(file=str(path)))
        if not path.is_file():
            raise InputError("there is no such picture", place=Place(file=str(path)))
    digits = [re.findall(r"\d+", path.stem) for path in frames]
    numbers = [int(found[-1]) for found in digits if found]
    if len(numbers) != len(frames) or any(b <= a for a, b in zip(numbers, numbers[1:])):
        numbers = list(range(len(frames)))
    return list(zip(numbers, frames))


@dataclass(frozen=True)
class StoredPicture:
    """A file's own values, upright. `values` (height, width, channels): uint8, uint16, half or float.

    `names` of the channels; `about`: the file's colour tags, for `picture_colour`.
    """

    values: np.ndarray
    names: tuple[str, ...]
    about: dict[str, Any]
    flags: tuple[str, ...] = ()


def read_stored(path: Path, frame: int | None = None) -> StoredPicture:
    """Reads one picture. Raises InputError: missing, damaged, cut short, too large, odd number type.

    EXIF orientation is applied as viewers do. An EXR's data window is laid into its display window.
    """
    place = Place(file=str(path), frame=frame)
    if not path.is_file():
        raise InputError("there is no such picture", place=place)
    try:
        return _read_stored(path, place)
    except (UnicodeDecodeError, ValueError, RuntimeError, MemoryError) as error:
        # A damaged header can even make OpenImageIO's own messages and names unreadable.
        raise InputError(
            f"cannot read the picture: its header is damaged ({type(error).__name__})", place=place
        ) from None


def _read_stored(path: Path, place: Place) -> StoredPicture:
    import OpenImageIO as oiio

    config = oiio.ImageSpec()
    config.attribute("oiio:UnassociatedAlpha", 1)
    config.attribute("oiio:RawColor", 1)
    source = oiio.ImageInput.open(str(path), config)
    if source is None:
        reason = _first_line(oiio.geterror())
        raise InputError(f"cannot read the picture: {reason}", place=place, hint="is the file complete?")
    try:
        spec = source.spec()
        _check_header(spec, place)
        values = source.read_image(0, 0, 0, spec.nchannels, spec.format)
        reason = source.geterror()
        # A decoder that got to the end of a cut file hands out grey with its complaint.
        if values is None or reason:
            raise InputError(
                f"cannot read the picture: {_first_line(reason)}", place=place, hint="is the file complete?"
            )
        values = values.reshape(spec.height, spec.width, spec.nchannels)
        flags = []
        window = (spec.full_x, spec.full_y, spec.full_width, spec.full_height)
        if window[2] > 0 and window[3] > 0 and window != (spec.x, spec.y, spec.width, spec.height):
            values = _in_display_window(values, spec)
            flags.append("data-window-differs")
        orientation = spec.get_int_attribute("Orientation", 1)
        if orientation in range(2, 9):
            values = _upright(values, orientation)
            flags.append("turned-by-exif")
        about = {
            "space": spec.get_string_attribute("oiio:ColorSpace"),
            "profile": spec.get_string_attribute("ICCProfile:profile_description"),
            "chromaticities": spec.getattribute("chromaticities"),
        }
        return StoredPicture(values, tuple(spec.channelnames), about, tuple(flags))
    finally:
        source.close()


def _check_header(spec: Any, place: Place) -> None:
    """Raises InputError for sizes and number types that are not read, before memory is asked for."""
    kind = str(spec.format)
    if max(spec.width * spec.height, spec.full_width * spec.full_height) > MAX_PIXELS or spec.nchannels > 64:
        raise InputError(
            f"the picture claims {spec.width}x{spec.height} pixels of {spec.nchannels} channels", place=place
        )
    if kind not in ("uint8", "uint16", "half", "float") or spec.deep or spec.depth > 1:
        what = "deep pixels" if spec.deep else f"{kind} pixels"
        raise InputError(f"{what} are not supported", place=place, hint="write 8 or 16 bits, half or float")


def _first_line(text: str) -> str:
    return text.strip().splitlines()[0] if text and text.strip() else "the file is damaged"


def _in_display_window(values: np.ndarray, spec: Any) -> np.ndarray:
    """Cut to the display window; black where it has no data, as OpenEXR defines."""
    result = np.zeros((spec.full_height, spec.full_width, values.shape[2]), values.dtype)
    x, y = spec.x - spec.full_x, spec.y - spec.full_y
    left, top = max(x, 0), max(y, 0)
    right, bottom = min(x + spec.width, spec.full_width), min(y + spec.height, spec.full_height)
    if right > left and bottom > top:
        result[top:bottom, left:right] = values[top - y : bottom - y, left - x : right - x]
    return result


def _upright(values: np.ndarray, orientation: int) -> np.ndarray:
    """By the eight orientations of EXIF 2.3 (tag 274): a transposition from 5 on, then flips."""
    if orientation >= 5:
        values = values.transpose(1, 0, 2)
    if orientation in (2, 3, 6, 7):
        values = values[:, ::-1]
    if orientation in (3, 4, 7, 8):
        values = values[::-1]
    return np.ascontiguousarray(values)


def picture_colour(
    stored: StoredPicture, settings: ColourSettings, place: Place
) -> tuple[Colour, tuple[str, ...]]:
    """How a sequence like this picture is read, with notes on what was assumed or left out.

    Integer files are sRGB unless tagged linear, float files linear. Primaries: EXR chromaticities, a
    profile named Display P3, else Rec.709. Raises InputError: a curve asked for float files.
    """
    notes = []
    floating = stored.values.dtype.kind == "f"
    transfer: str = settings.transfer
    if floating:
        if transfer not in ("auto", "linear"):
            raise InputError(
                f"float pictures are scene-linear, but `capture.colour.transfer` is {transfer}",
                place=place,
                hint="leave it out, or write the pictures as integers",
            )
        transfer = "linear"
    elif transfer == "auto":
        space = (stored.about["space"] or "").lower()
        transfer = "linear" if space.startswith("lin") else "gamma22" if space.startswith("g22") else "srgb"
    primaries: str = "bt709" if settings.primaries == "auto" else settings.primaries
    matrix = rec709_from_primaries(primaries)
    if settings.primaries == "auto":
        profile = stored.about["profile"] or ""
        if stored.about["chromaticities"] is not None:
            try:
                matrix = rec709_from_primaries(np.reshape(stored.about["chromaticities"], (4, 2)))
            except ValueError as error:
                raise InputError(f"the file's chromaticities cannot be used: {error}", place=place) from None
            primaries = "bt709" if np.array_equal(matrix, np.eye(3)) else "file"
        elif "Display P3" in profile:
            primaries, matrix = "p3", rec709_from_primaries("p3")
        elif profile and "srgb" not in profile.lower():
            notes.append(
                f"colour profile `{profile}` is not applied: {transfer} with Rec.709 primaries assumed"
            )
    bits = 8 * stored.values.dtype.itemsize
    return Colour(transfer, bits, primaries, rows_of(matrix)), tuple(notes)


def colour_channels(stored: StoredPicture, place: Place) -> tuple[np.ndarray, tuple[str, ...]]:
    """(height, width, 3) in the order R, G, B, grey repeated; flags. Raises InputError for others."""
    names = [name.upper() for name in stored.names]
    if len(names) == len(set(names)) and {"R", "G", "B"} <= set(names):
        values = stored.values[..., [names.index(c) for c in "RGB"]]
    elif names[0] in ("Y", "L", "I", "GRAY") or len(names) == 1:
        values = np.repeat(stored.values[..., :1], 3, axis=2)
    else:
        raise InputError(
            f"the picture has the channels {', '.join(stored.names[:8])}; expected R, G, B or grey",
            place=place,
        )
    flags = ("alpha-ignored",) if "A" in names else ()
    return np.ascontiguousarray(values), flags


def check_finite(values: np.ndarray, place: Place) -> None:
    """Raises InputError with the number and the first place of NaN or infinite pixels (h, w, c)."""
    if values.dtype.kind != "f":
        return
    bad = ~np.isfinite(values)
    if bad.any():
        row, column, channel = (int(i) for i in np.argwhere(bad)[0])
        raise InputError(
            f"{int(bad.any(axis=-1).sum())} pixels hold NaN or infinity, the first at x {column}, y {row} "
            f"(channel {channel})",
            place=place,
            hint="repair the picture: such a value would spread into everything it lights",
        )


def read_picture(path: Path, colour: Colour, settings: ColourSettings, frame: int | None = None) -> Picture:
    """One picture, scene-linear Rec.709, with its codes where it has them.

    Raises InputError with the frame: unreadable, NaN, encoded otherwise than `colour` says.
    """
    place = Place(file=str(path), frame=frame)
    stored = read_stored(path, frame)
    own, _ = picture_colour(stored, settings, place)
    if own != colour:
        raise InputError(
            "the picture is encoded otherwise than the first: "
            f"{own.bits} bits {own.transfer} {own.primaries}, "
            f"not {colour.bits} bits {colour.transfer} {colour.primaries}",
            place=place,
            hint="write all pictures of a sequence alike",
        )
    values, flags = colour_channels(stored, place)
    check_finite(values, place)
    picture = (
        linear_from_light(values, colour) if values.dtype.kind == "f" else linear_from_codes(values, colour)
    )
    return Picture(picture.linear, picture.codes, (*stored.flags, *flags, *picture.flags))
