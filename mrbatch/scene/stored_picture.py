"""A picture file's own values through OpenImageIO: frames, mattes, textures and environment maps.

OpenImageIO is asked for stored values only: no premultiplication, no photometric conversion, no
colour management. Headers are checked before memory is asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mrbatch.errors import InputError, Place
from mrbatch.kernels.transfer import rec709_from_primaries
from mrbatch.scene.file_kind import PICTURES, unreadable
from mrbatch.scene.picture_library import library_error

MAX_PIXELS = 2**27
"""A picture that claims more is refused before memory is asked for."""
MAX_CHANNELS = 1024
KINDS = ("uint8", "uint16", "half", "float")
_READ = 4
"""Channels that are read at most, whatever else a file holds."""


@dataclass(frozen=True)
class StoredPicture:
    """A file's own values, upright. `values` (height, width, channels): uint8, uint16, half or float.

    `names` of the channels read: R, G, B where the file has them (and A), else its first ones.
    `about`: the file's colour tags, for `primaries_of`.
    """

    values: np.ndarray
    names: tuple[str, ...]
    about: dict[str, Any]
    flags: tuple[str, ...] = ()


def read_stored(
    path: Path,
    frame: int | None = None,
    *,
    what: str = "picture",
    kinds: Collection[str] = PICTURES,
    check: Callable[[Any, Place], None] | None = None,
    upright: bool = True,
    only: Collection[str] = (),
) -> StoredPicture:
    """Reads one picture. Raises InputError: missing, damaged, cut short, too large, odd number type.

    `what` it is called in messages, `kinds` of files that these name as read here (`file_kind`).
    `check` looks at the header (an `ImageSpec`) first and may raise. `upright`: EXIF orientation is
    applied as viewers do. An EXR's data window is laid into its display window. A file of doubles is
    read as float. `only`: names of channels; the first one that the file has is read alone.
    """
    place = Place(file=str(path), frame=frame)
    if not path.is_file():
        raise InputError(f"there is no such {what}", place=place)
    try:
        return _read_stored(path, place, what, kinds, check, upright, only)
    except (UnicodeDecodeError, ValueError, RuntimeError, SystemError, MemoryError) as error:
        # A damaged header can even make OpenImageIO's own messages and names unreadable.
        raise InputError(
            f"cannot read the {what}: its header is damaged ({type(error).__name__})", place=place
        ) from None


def _read_stored(
    path: Path,
    place: Place,
    what: str,
    kinds: Collection[str],
    check: Callable[[Any, Place], None] | None,
    upright: bool,
    only: Collection[str],
) -> StoredPicture:
    import OpenImageIO as oiio

    wanted = f"{'an' if what[0] in 'aeiou' else 'a'} {what}"
    config = oiio.ImageSpec()
    config.attribute("oiio:UnassociatedAlpha", 1)
    config.attribute("oiio:RawColor", 1)
    source = oiio.ImageInput.open(str(path), config)
    if source is None:
        library_error(oiio)
        raise unreadable(path, wanted, kinds, place=place)
    try:
        spec = source.spec()
        names = tuple(spec.channelnames)
        _check_header(spec, place, what)
        if check is not None:
            check(spec, place)
        values, names = _pixels(
            source, spec, names, only, lambda: unreadable(path, wanted, kinds, place=place)
        )
        flags = []
        window = (spec.full_x, spec.full_y, spec.full_width, spec.full_height)
        if window[2] > 0 and window[3] > 0 and window != (spec.x, spec.y, spec.width, spec.height):
            values = _in_display_window(values, spec)
            flags.append("data-window-differs")
        orientation = spec.get_int_attribute("Orientation", 1)
        if upright and orientation in range(2, 9):
            values = _upright(values, orientation)
            flags.append("turned-by-exif")
        about = {
            "space": spec.get_string_attribute("oiio:ColorSpace"),
            "profile": spec.get_string_attribute("ICCProfile:profile_description"),
            "chromaticities": spec.getattribute("chromaticities"),
        }
        return StoredPicture(values, names, about, tuple(flags))
    finally:
        source.close()


def _check_header(spec: Any, place: Place, what: str) -> None:
    """Raises InputError for sizes and number types that are not read, before memory is asked for."""
    kind = str(spec.format)
    pixels = max(spec.width * spec.height, spec.full_width * spec.full_height)
    if pixels > MAX_PIXELS or not 0 < spec.nchannels <= MAX_CHANNELS:
        raise InputError(
            f"the {what} claims {spec.width}x{spec.height} pixels of {spec.nchannels} channels", place=place
        )
    if kind not in (*KINDS, "double") or spec.deep or spec.depth > 1:
        found = "deep pixels" if spec.deep else f"{kind} pixels"
        raise InputError(f"{found} are not supported", place=place, hint="write 8 or 16 bits, half or float")


def _pixels(
    source: Any, spec: Any, names: tuple[str, ...], only: Collection[str], failure: Callable[[], InputError]
) -> tuple[np.ndarray, tuple[str, ...]]:
    """The channels that anybody here looks at, and their names. Raises `failure()` where reading fails."""
    upper = [name.upper() for name in names]
    alone = [upper.index(name.upper()) for name in only if name.upper() in upper]
    if alone:
        wanted = alone[:1]
    elif all(upper.count(c) == 1 for c in "RGB"):
        wanted = [upper.index(c) for c in "RGB"]
        wanted += [upper.index("A")] if "A" in upper else []
    else:
        wanted = list(range(min(len(names), _READ)))
    runs = [[wanted[0], wanted[0] + 1]]
    for channel in wanted[1:]:
        if channel == runs[-1][1]:
            runs[-1][1] += 1
        else:
            runs.append([channel, channel + 1])
    kind = "float" if str(spec.format) == "double" else spec.format
    parts = []
    for first, last in runs:
        part = source.read_image(0, 0, first, last, kind)
        # A decoder that got to the end of a cut file hands out grey with its complaint.
        if library_error(source) or part is None:
            raise failure()
        parts.append(part.reshape(spec.height, spec.width, last - first))
    values = parts[0] if len(parts) == 1 else np.concatenate(parts, axis=2)
    return values, tuple(names[channel] for channel in wanted)


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


def primaries_of(stored: StoredPicture, place: Place) -> tuple[str, np.ndarray, str | None]:
    """The file's primaries by its own word: name, (3, 3) rec709_from_file, and its profile if not applied.

    EXR chromaticities (`file`), a profile named Display P3 (`p3`), else `bt709`. Raises InputError for
    chromaticities that cannot be.
    """
    profile = stored.about["profile"] or ""
    if stored.about["chromaticities"] is not None:
        try:
            matrix = rec709_from_primaries(np.reshape(stored.about["chromaticities"], (4, 2)))
        except ValueError as error:
            raise InputError(f"the file's chromaticities cannot be used: {error}", place=place) from None
        return ("bt709" if np.array_equal(matrix, np.eye(3)) else "file"), matrix, None
    if "Display P3" in profile:
        return "p3", rec709_from_primaries("p3"), None
    unknown = profile if profile and "srgb" not in profile.lower() else None
    return "bt709", rec709_from_primaries("bt709"), unknown


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
