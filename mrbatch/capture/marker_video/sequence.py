"""Picture sequences: which files are which frames, and how their values become light.

Integer pictures keep their codes; half and float pictures their values.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from math import gcd
from pathlib import Path

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
from mrbatch.scene.stored_picture import (
    StoredPicture,
    check_finite,
    colour_channels,
    primaries_of,
    read_stored,
)

PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg", ".jpe", ".tif", ".tiff", ".exr", ".bmp", ".tga", ".hdr", ".ppm")
_PATTERN = re.compile(r"(#+|%0?(\d*)d|\*)")


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
    if settings.primaries == "auto":
        primaries, matrix, unknown = primaries_of(stored, place)
        if unknown:
            notes.append(
                f"colour profile `{unknown}` is not applied: {transfer} with Rec.709 primaries assumed"
            )
    else:
        primaries, matrix = settings.primaries, rec709_from_primaries(settings.primaries)
    bits = 8 * stored.values.dtype.itemsize
    return Colour(transfer, bits, primaries, rows_of(matrix)), tuple(notes)


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
