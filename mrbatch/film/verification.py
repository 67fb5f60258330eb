"""Reading back a frame that was just written: is all of it there, and is every number one?"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from mrbatch.errors import InputError, Place
from mrbatch.film.exr import open_parts
from mrbatch.scene.file_kind import unreadable
from mrbatch.scene.picture_library import library_error

ROWS = 64
"""Rows that are in memory at a time: a multiple of every compression's block, so each is unpacked once."""


def verify_frame(
    path: Path, channels: Iterable[str] | None = None, views: Sequence[str] | None = None
) -> str:
    """Reads a written frame back to its end and gives the SHA-256 of the file in hexadecimal.

    `channels`: names that every view must have; `views`: names of the parts, in order (mono: `""`).
    A frame of any size is read, a few rows at a time. Raises InputError where the file cannot be read to
    its end, a view or a channel is missing, or a number is NaN or infinite.
    """
    place = Place(file=str(path))
    wanted = set(channels or ())
    found: list[str] = []
    for source, index, spec, attributes in open_parts(path):
        found.append(attributes.get("view", ""))
        missing = sorted(wanted - set(spec.channelnames))
        if missing:
            raise InputError(f"channels {', '.join(missing)} are missing", place=place)
        for first in range(spec.y, spec.y + spec.height, ROWS):
            last = min(first + ROWS, spec.y + spec.height)
            rows = source.read_scanlines(index, 0, first, last, 0, 0, spec.nchannels, "float")
            if library_error(source) or rows is None:
                raise unreadable(path, "an EXR frame", ("EXR",))
            if not np.isfinite(rows).all():
                raise InputError("a channel holds NaN or infinity", place=place)
    if views is not None and found != list(views):
        raise InputError(f"the views are {found}, expected {list(views)}", place=place)
    with Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
