"""Stand-ins: a finished frame written once more under the number of a frame that could not be rendered."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from mrbatch.film.exr import read_frame, write_frame


def write_stand_in(source: Path, target: Path, frame: int, held_from: int) -> None:
    """The picture and metadata of `source`, with its own `frame` number and `held_from`.

    Raises InputError where `source` cannot be read, ResourceError where `target` cannot be written.
    """
    image = read_frame(source)
    write_frame(target, replace(image, number=frame, metadata={**image.metadata, "held_from": held_from}))
