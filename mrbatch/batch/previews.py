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
from mrbatch.report.model import Note, Picture

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
) -> tuple[list[Picture], list[Note]]:
    """Writes what `wanted` asks for; a preview that cannot be made is a note, never the end of a job."""
    pictures: list[Picture] = []
    notes: list[Note] = []
    if not frames or not (wanted.contact_sheet or wanted.video or wanted.png):
        return pictures, notes
    sheet = ContactSheet(title)
    try:
        if wanted.video and len(frames) > 1:
            with MoviePreview(directory / MOVIE, rate or DEFAULT_RATE, transfer=transfer) as movie:
                _each(frames, wanted, transfer, sheet, movie)
        else:
            _each(frames, wanted, transfer, sheet, None)
        if wanted.contact_sheet:
            sheet.write(directory / SHEET)
            pictures.append(Picture(role="sheet", path=SHEET, caption=f"{len(frames)} frames"))
    except (MrbatchError, ValueError) as error:
        notes.append(Note(level="warning", text=f"a preview could not be made: {error}"))
    return pictures, notes


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
