"""Footage: a video or a picture sequence behind one interface, its frames by the shot's numbers."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any, Protocol

from mrbatch.capture.marker_video.colour import Colour, Picture
from mrbatch.capture.marker_video.sequence import (
    PICTURE_SUFFIXES,
    find_sequence,
    is_pattern,
    picture_colour,
    read_picture,
)
from mrbatch.capture.marker_video.settings import MarkerVideoSettings
from mrbatch.capture.marker_video.video import FrameTable, VideoInfo, VideoReader, build_frame_table
from mrbatch.errors import InputError, Place
from mrbatch.scene.stored_picture import colour_channels, read_stored

SEQUENCE_RATE = Fraction(24)
"""Frames per second of a picture sequence for which none is given."""


class Footage(Protocol):
    """Frames by number. `about`, from `describe`, is JSON-ready and enough to read any frame alike."""

    numbers: tuple[int, ...]
    missing: tuple[int, ...]
    rate: Fraction | None

    def time(self, number: int) -> Fraction:
        """Seconds."""

    def describe(self) -> dict[str, Any]:
        """Keys `width`, `height`, `float`, `colour`, `notes`, and what the kind needs. Raises InputError."""

    def picture(self, number: int, about: Mapping[str, Any]) -> Picture:
        """One frame. May be called from any thread. Raises InputError with the frame."""

    def paths(self, numbers: tuple[int, ...]) -> list[Path]:
        """Files that these frames are read from."""

    def close(self) -> None:
        """Lets go of open files; reading opens them again."""


def open_footage(settings: MarkerVideoSettings, about: Mapping[str, Any] | None = None) -> Footage:
    """The footage of a job; with `about`, what `describe` found is not looked for again.

    One path that is no pattern and has no picture's suffix is a video. Raises InputError.
    """
    frames = settings.frames
    if len(frames) == 1 and not is_pattern(frames[0]) and frames[0].suffix.lower() not in PICTURE_SUFFIXES:
        table = FrameTable.from_json(about["frame_table"]) if about is not None else None
        return VideoFootage(settings, table)
    return SequenceFootage(settings)


class SequenceFootage:
    """Numbered pictures; times follow from the numbers."""

    def __init__(self, settings: MarkerVideoSettings):
        self._colour_settings = settings.colour
        self._sequence = find_sequence(settings.frames, settings.start_frame)
        self._paths = dict(zip(self._sequence.numbers, self._sequence.paths))
        self._rate_given = settings.frame_rate is not None
        self.numbers = self._sequence.numbers
        self.missing = self._sequence.missing
        self.rate: Fraction | None = settings.frame_rate or SEQUENCE_RATE

    def time(self, number: int) -> Fraction:
        assert self.rate is not None
        return (number - self.numbers[0]) / self.rate

    def describe(self) -> dict[str, Any]:
        """From the first picture that can be read."""
        error: InputError | None = None
        for number in self.numbers[:10]:
            try:
                stored = read_stored(self._path(number), number)
                break
            except InputError as caught:
                error = error or caught
        else:
            assert error is not None
            raise error
        place = Place(file=str(self._path(number)), frame=number)
        colour_channels(stored, place)
        colour, notes = picture_colour(stored, self._colour_settings, place)
        if not self._rate_given and len(self.numbers) > 1:
            notes = (*notes, f"no `frame_rate` given: {SEQUENCE_RATE} frames per second assumed")
        return {
            "kind": "sequence",
            "width": stored.values.shape[1],
            "height": stored.values.shape[0],
            "float": stored.values.dtype.kind == "f",
            "colour": colour.as_json(),
            "notes": list(notes),
        }

    def _path(self, number: int) -> Path:
        return self._paths[number] if number in self._paths else self._sequence.path(number)

    def picture(self, number: int, about: Mapping[str, Any]) -> Picture:
        colour = Colour.from_json(about["colour"])
        return read_picture(self._path(number), colour, self._colour_settings, number)

    def paths(self, numbers: tuple[int, ...]) -> list[Path]:
        return [self._path(number) for number in numbers]

    def close(self) -> None:
        pass


class VideoFootage:
    """A video; its frames count from `start_frame` (0) in the order a player shows them."""

    def __init__(self, settings: MarkerVideoSettings, table: FrameTable | None = None):
        self._path = settings.frames[0]
        self._colour_settings = settings.colour
        self._table = table if table is not None else build_frame_table(self._path)
        self._reader = VideoReader(self._path, self._table)
        self._lock = threading.Lock()
        self._conformed = settings.frame_rate
        self._first = settings.start_frame or 0
        self.numbers = tuple(range(self._first, self._first + len(self._table)))
        # What the file's index names beyond what is in the file: its end is cut off.
        end = self._first + len(self._table)
        cut = max(0, self._table.announced - self._table.packets)
        self.missing: tuple[int, ...] = tuple(range(end, end + cut))
        self.rate = settings.frame_rate or self._table.rate

    def time(self, number: int) -> Fraction:
        if self._conformed is not None:
            return (number - self._first) / self._conformed
        index, last = number - self._first, len(self._table) - 1
        if index > last:  # missing: where it would be
            return self._table.time(last) + (index - last) / (self._table.rate or SEQUENCE_RATE)
        return self._table.time(index)

    def describe(self) -> dict[str, Any]:
        with self._lock:
            info = self._reader.probe(self._colour_settings)
        notes = list(info.notes)
        if self._conformed is not None:
            notes.append(f"the video's own times give way to {self._conformed} frames per second")
        return {
            "kind": "video",
            "width": info.width,
            "height": info.height,
            "float": False,
            "colour": info.colour.as_json(),
            "notes": notes,
            "frame_table": self._table.as_json(),
            "info": info.as_json(),
        }

    def picture(self, number: int, about: Mapping[str, Any]) -> Picture:
        index = number - self._first
        if not 0 <= index < len(self._table):
            raise InputError("the video has no such frame", place=Place(file=str(self._path), frame=number))
        info = VideoInfo.from_json(about["info"])
        try:
            with self._lock:
                frame = self._reader.frame(index)
            return self._reader.convert(frame, index, info)
        except InputError as error:
            # The reader counts from 0, the shot from `start_frame`.
            raise InputError(
                error.message, place=Place(file=str(self._path), frame=number), hint=error.hint
            ) from None

    def paths(self, numbers: tuple[int, ...]) -> list[Path]:
        return [self._path]

    def close(self) -> None:
        with self._lock:
            self._reader.close()
