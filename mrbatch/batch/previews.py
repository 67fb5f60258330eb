"""Pictures to look at, made from the finished frames: contact sheet, movie, PNGs, the report's thumbnails."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import numpy as np

from mrbatch.errors import MrbatchError
from mrbatch.film.exr import read_frame
from mrbatch.film.preview import ContactSheet, MoviePreview, preview_codes, write_picture
from mrbatch.job.model import Preview

SHEET, MOVIE = "contact_sheet.png", "preview.mp4"
DEFAULT_RATE = Fraction(25)


def composite_of(path: Path) -> np.ndarray:
    """The finished picture (h, w, 3) of a frame's first view. Raises InputError."""
    view = next(iter(read_frame(path).views.values()))
    return np.stack([view.channels[c] for c in "RGB"], axis=-1)


def make_previews(
    directory: Path,
    title: str,
    frames: Sequence[tuple[int, Path]],
    wanted: Preview,
    *,
    transfer: str,
    rate: Fraction | None,
    again: bool = False,
) -> list[str]:
    """Writes what `wanted` asks for, unless it is there and younger than every frame; `again`: even then.

    Gives what went wrong, in words: a preview that cannot be made is never the end of a job.
    """
    if not wanted.contact_sheet and not wanted.video and not wanted.png:
        return []
    if not frames or not (again or _due(directory, frames, wanted)):
        return []
    sheet = ContactSheet(title)
    try:
        if wanted.video and len(frames) > 1:
            with MoviePreview(directory / MOVIE, rate or DEFAULT_RATE, transfer=transfer) as movie:
                _each(frames, wanted, transfer, sheet, movie)
        else:
            _each(frames, wanted, transfer, sheet, None)
        if wanted.contact_sheet:
            sheet.write(directory / SHEET)
    except (MrbatchError, ValueError) as error:
        return [f"a preview could not be made: {error}"]
    return []


def _due(directory: Path, frames: Sequence[tuple[int, Path]], wanted: Preview) -> bool:
    """Whether a preview that is asked for is absent or older than a frame, by one file system's time."""
    pairs: list[tuple[Path, Sequence[Path]]] = []
    paths = [path for _, path in frames]
    if wanted.contact_sheet:
        pairs.append((directory / SHEET, paths))
    if wanted.video and len(frames) > 1:
        pairs.append((directory / MOVIE, paths))
    if wanted.png:
        pairs += [(path.with_suffix(".png"), [path]) for path in paths]
    try:
        return any(
            not made.is_file() or made.stat().st_mtime_ns < max(p.stat().st_mtime_ns for p in sources)
            for made, sources in pairs
        )
    except OSError:
        return True


def _each(
    frames: Sequence[tuple[int, Path]],
    wanted: Preview,
    transfer: str,
    sheet: ContactSheet,
    movie: MoviePreview | None,
) -> None:
    for number, path in frames:
        codes = preview_codes(composite_of(path), transfer)
        sheet.add(number, codes)
        if movie is not None:
            movie.add(codes)
        if wanted.png:
            write_picture(path.with_suffix(".png"), codes)
