"""The list of frames that a person writes: `1001-1100x2,1200`.

Parts are divided by commas: one number, `first-last`, `first-` (to the shot's end), each range with
an optional step `xN`. A range means the frames that there are between its ends; a single number must
be there.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from mrbatch.errors import JobError, Place

_PART = re.compile(r"^(?P<first>[0-9]{1,9})(?P<dash>-(?P<last>[0-9]{1,9})?)?(?:x(?P<step>[0-9]{1,9}))?$")
_SYNTAX = "write numbers and ranges divided by commas, such as `1001-1100x2,1200` or `1001-`"


@dataclass(frozen=True)
class FrameRange:
    """Frames `first`, `first + step`, ... up to `last` (included; None: to the shot's end).

    `single`: written as one number, which must be there. `column` (from 1) and `text`: where it was
    written and how, for messages.
    """

    first: int
    last: int | None
    step: int
    single: bool
    column: int
    text: str

    def __contains__(self, frame: int) -> bool:
        within = frame >= self.first and (self.last is None or frame <= self.last)
        return within and (frame - self.first) % self.step == 0


@dataclass(frozen=True)
class FrameSet:
    """A parsed list of frames; `text` as it was written."""

    ranges: tuple[FrameRange, ...]
    text: str

    def select(self, available: Sequence[int]) -> list[int]:
        """The frames of `available` that are asked for, sorted, each once.

        Raises JobError where a number or the end of a range lies outside what there is, or where a
        range holds no frame at all.
        """
        if not available:
            raise JobError(
                "there are no frames to choose from",
                place=Place(file="--frames", source=self.text, column=1),
                hint="look at the capture: no frame of it is usable",
            )
        known = set(available)
        lowest, highest = min(known), max(known)
        chosen: set[int] = set()
        for part in self.ranges:
            if part.single and part.first not in known:
                raise self._unknown(part, f"there is no frame {part.first}", available)
            for end in (part.first, part.last):
                if end is not None and not lowest <= end <= highest:
                    raise self._unknown(part, f"frame {end} lies outside the shot", available)
            # The set is walked, never the range: `1-999999999` costs nothing.
            frames = [frame for frame in known if frame in part]
            if not frames:
                raise self._unknown(part, f"no frame lies in `{part.text}`", available)
            chosen.update(frames)
        return sorted(chosen)

    def _unknown(self, part: FrameRange, message: str, available: Sequence[int]) -> JobError:
        return JobError(
            message,
            place=Place(file="--frames", source=self.text, column=part.column),
            hint=f"the shot has {describe_frames(sorted(set(available)))}",
        )


def parse_frames(text: str) -> FrameSet:
    """`1001-1100x2,1200` to a FrameSet. Raises JobError with the column of what cannot be read."""
    ranges = []
    column = 1
    for piece in text.split(","):
        part = piece.strip()
        at = column + len(piece) - len(piece.lstrip())
        column += len(piece) + 1
        place = Place(file="--frames", source=text, column=at)
        if not part:
            raise JobError("an empty part in the list of frames", place=place, hint=_SYNTAX)
        match = _PART.match(part)
        if not match:
            raise JobError(f"cannot read `{part}` as frames", place=place, hint=_SYNTAX)
        first = int(match["first"])
        single = match["dash"] is None
        last = first if single else (int(match["last"]) if match["last"] else None)
        step = int(match["step"] or 1)
        if step == 0:
            raise JobError(f"the step of `{part}` is 0", place=place, hint="write a step of 1 or more")
        if single and match["step"]:
            raise JobError(f"`{part}` has a step but no range", place=place, hint=_SYNTAX)
        if last is not None and last < first:
            raise JobError(
                f"the range `{part}` ends before it starts", place=place, hint=f"write `{last}-{first}`"
            )
        ranges.append(FrameRange(first, last, step, single, at, part))
    return FrameSet(tuple(ranges), text)


def describe_frames(frames: Sequence[int]) -> str:
    """Sorted frame numbers in few words: `frames 1-10, 12, 20-30` (at most five runs are named)."""
    if not frames:
        return "no frames"
    runs: list[list[int]] = []
    for frame in frames:
        if runs and frame == runs[-1][1] + 1:
            runs[-1][1] = frame
        else:
            runs.append([frame, frame])
    words = [str(a) if a == b else f"{a}-{b}" for a, b in runs[:5]]
    if len(runs) > 5:
        words.append(f"... ({len(frames)} in all, the last is {frames[-1]})")
    return ("frame " if len(frames) == 1 else "frames ") + ", ".join(words)
