"""Mattes: how much of each pixel something real in front covers (a hand), as a picture sequence."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from mrbatch.capture.marker_video.sequence import find_sequence
from mrbatch.capture.marker_video.settings import MatteSettings
from mrbatch.errors import InputError, Place
from mrbatch.scene.stored_picture import check_finite, read_stored


class Mattes:
    """The mattes of a shot, numbered as its frames. Raises InputError where no file is found."""

    def __init__(self, settings: MatteSettings):
        self.invert = settings.invert
        self.sequence = find_sequence(settings.frames, settings.start_frame)

    def lacking(self, numbers: Sequence[int]) -> list[int]:
        """Which of these frames have no matte. Raises InputError where none has one."""
        missing = sorted(set(numbers) - set(self.sequence.numbers))
        if len(missing) == len(set(numbers)):
            raise InputError(
                f"none of the {len(missing)} frames has a matte, from {missing[0]} to {missing[-1]}",
                place=Place(file=str(self.sequence.paths[0].parent), frame=missing[0]),
                hint="mattes carry the numbers of the frames; `mattes.start_frame` renumbers them",
            )
        return missing

    def path(self, number: int) -> Path:
        return self.sequence.path(number)

    def read(self, number: int, width: int, height: int) -> np.ndarray:
        """(height, width) float32 in 0..1, 1 where something in front covers all.

        Stored values are the coverage itself, whatever transfer function a viewer would apply. Raises
        InputError: unreadable, another size (mattes are never resampled), colour, values beyond 0..1.
        """
        path = self.path(number)
        place = Place(file=str(path), frame=number)
        values = read_stored(path, number, what="matte").values
        if values.shape[:2] != (height, width):
            raise InputError(
                f"the matte is {values.shape[1]}x{values.shape[0]}, the frame {width}x{height}",
                place=place,
                hint="mattes are not resampled: write them at the frame's size",
            )
        coverage = values[..., 0]
        if values.shape[2] >= 3:
            if any(not np.array_equal(values[..., c], coverage) for c in (1, 2)):
                raise InputError(
                    "the matte is a colour picture", place=place, hint="write coverage as one grey channel"
                )
        check_finite(coverage[..., None], place)
        if coverage.dtype.kind == "f":
            matte = coverage.astype(np.float32)
            if matte.min() < 0.0 or matte.max() > 1.0:
                raise InputError(
                    f"the matte's values reach from {matte.min():g} to {matte.max():g}, expected 0 to 1",
                    place=place,
                )
        else:
            matte = coverage.astype(np.float32) / np.float32(np.iinfo(coverage.dtype).max)
        return np.ascontiguousarray(np.float32(1.0) - matte if self.invert else matte)
