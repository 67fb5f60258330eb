"""The family of user errors: what is wrong, where, what to do, and with which code the process ends.

Anything that a user can cause ends in one of these and is shown without a traceback; any other
exception is a defect of the program.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

EXIT_DONE = 0
EXIT_GATE = 1
EXIT_USAGE = 2
EXIT_INPUT = 3
EXIT_FRAMES = 4
EXIT_RESOURCES = 5
EXIT_INTERNAL = 70
"""A defect of the program (`EX_SOFTWARE` of sysexits.h), none of the codes that scripts act on."""
EXIT_INTERRUPTED = 130


@dataclass(frozen=True)
class Place:
    """Where an error is: a file with line and column (counted from 1), a frame, or a byte offset."""

    file: str | None = None
    line: int | None = None
    column: int | None = None
    frame: int | None = None
    byte: int | None = None
    source: str | None = None
    """The text of the line, so that a caret can be drawn under it."""

    def __str__(self) -> str:
        parts = []
        if self.file is not None:
            at = self.file
            if self.line is not None:
                at += f":{self.line}"
                if self.column is not None:
                    at += f":{self.column}"
            parts.append(at)
        if self.frame is not None:
            parts.append(f"frame {self.frame}")
        if self.byte is not None:
            parts.append(f"byte {self.byte}")
        return ", ".join(parts)


class MrbatchError(Exception):
    """Base of all user errors.

    Parameters: `message`, one sentence that says what is wrong; `place`, where; `hint`, what to do; `named`,
    where a job names the file of `place`.
    """

    exit_code = EXIT_USAGE

    def __init__(
        self,
        message: str,
        *,
        place: Place | None = None,
        hint: str | None = None,
        named: Place | None = None,
    ):
        super().__init__(message)
        self.message = message
        self.place = place
        self.hint = hint
        self.named = named

    def __str__(self) -> str:
        text = f"{self.place}: {self.message}" if self.place else self.message
        if self.place and self.place.source is not None and self.place.column is not None:
            text += f"\n    {self.place.source}\n    {' ' * (self.place.column - 1)}^"
        if self.named:
            text += f"\n  named at {self.named}"
        if self.hint:
            text += f"\n  hint: {self.hint}"
        return text

    def __reduce__(self):
        return _rebuild, (type(self), self.message, self.place, self.hint, self.named)


def _rebuild(kind, message, place, hint, named):
    return kind(message, place=place, hint=hint, named=named)


class GateError(MrbatchError):
    """A gate said no: a target missed, a check or a stability case failed."""

    exit_code = EXIT_GATE


class JobError(MrbatchError):
    """Wrong usage or a wrong job file."""

    exit_code = EXIT_USAGE


class JobErrors(JobError):
    """All errors of one job file, shown together."""

    def __init__(self, errors: Sequence[MrbatchError]):
        super().__init__("\n".join(str(error) for error in errors))
        self.errors = tuple(errors)

    def __reduce__(self):
        return JobErrors, (self.errors,)


class InputError(MrbatchError):
    """Input data that cannot be used: a broken file, a marker never seen, a map with NaN."""

    exit_code = EXIT_INPUT


class FramesError(MrbatchError):
    """Some frames failed; the others are there."""

    exit_code = EXIT_FRAMES


class ResourceError(MrbatchError):
    """Out of disk, memory or rights, or an engine that is not available here."""

    exit_code = EXIT_RESOURCES


def worst_exit_code(codes: Sequence[int]) -> int:
    """The code of a run with several outcomes: the highest of 5, 4, 3, 1 (then 2, then 0)."""
    for code in (EXIT_RESOURCES, EXIT_FRAMES, EXIT_INPUT, EXIT_GATE, EXIT_USAGE):
        if code in codes:
            return code
    return EXIT_DONE
