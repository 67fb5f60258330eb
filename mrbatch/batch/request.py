"""What goes into a run and what comes out: the request, a frame's result, the run's result."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np

from mrbatch.batch.directory import frame_path
from mrbatch.batch.events import Done
from mrbatch.batch.history import Segment, State
from mrbatch.batch.inventory import Findings
from mrbatch.batch.journal import FrameEntry
from mrbatch.batch.presence import Owner
from mrbatch.errors import (
    EXIT_FRAMES,
    EXIT_INPUT,
    EXIT_INTERRUPTED,
    InputError,
    MrbatchError,
    worst_exit_code,
)

OnError = Literal["stop", "skip", "hold-last"]


class FrameResult(Protocol):
    """A rendered frame. `write(path)` makes its file (the suffix tells the format).

    `seconds` of rendering; `history`: named arrays for the next frame, or None; `details`: JSON-ready.
    """

    @property
    def counters(self) -> Mapping[str, int]: ...

    @property
    def seconds(self) -> float: ...

    @property
    def history(self) -> Mapping[str, np.ndarray] | None: ...

    @property
    def details(self) -> Mapping[str, Any]: ...

    def write(self, path: Path) -> None: ...


class Stopped(Exception):
    """A renderer raises this when it sees that the run is to stop; nothing of the frame is kept."""


Render = Callable[[int, State | None], FrameResult]
"""`render(frame, state)`: a pure function of job, shot, frame and the state that the frame before left.

Raises InputError where the frame's input cannot be used.
"""
Hold = Callable[[Path, Path, int, int], None]
"""`hold(source, target, frame, held_from)`: writes the finished file `source` of `held_from` once more, to
stand in for `frame`."""
Verify = Callable[[Path], str]
"""Reads a written file back and gives the hash of its content; raises where it is not as it must be."""


@dataclass(frozen=True)
class RunRequest:
    """What to do.

    `frames`, rendered in this order; `pattern` names their files inside `directory`. `on_error`, where
    a frame's input cannot be used: `stop` the run, `skip` the frame, or `hold-last`: at the end of the
    run its file shows the nearest earlier finished frame. `overwrite`: take a folder that another job
    holds; finished frames of this job are kept even then. `segments` must cover `frames` where there is
    `history`. `absent`: frames of the shot that cannot be rendered at all, with the reason; they fail,
    and end no run. `facts`: JSON-ready, what the job was made of, kept in `job.json` (`settings`,
    `inputs`, ...).
    """

    directory: Path
    pattern: str
    job_name: str
    job_hash: str
    frames: tuple[int, ...]
    overwrite: bool = False
    on_error: OnError = "stop"
    history: bool = False
    segments: tuple[Segment, ...] = ()
    absent: Mapping[int, InputError] = field(default_factory=dict)
    facts: Mapping[str, Any] = field(default_factory=dict)

    def path(self, frame: int) -> Path:
        return frame_path(self.directory, self.pattern, self.job_name, frame)


@dataclass(frozen=True)
class FailedFrame:
    """A frame without a picture of its own; `held_from`: the frame whose copy stands in, or None."""

    frame: int
    error: InputError
    held_from: int | None = None


@dataclass(frozen=True)
class RunResult:
    """How a run ended.

    `rendered` by this run; `kept` from earlier runs or other processes; `failed`; `undone`: not reached.
    `entries`: the journal's record of every frame that is there, kept ones included. `error`: what
    ended the run early. `predicted`: seconds that were announced first. `seconds` of the whole run.
    `owner`: of its journal file.
    """

    rendered: tuple[int, ...]
    kept: tuple[int, ...]
    failed: tuple[FailedFrame, ...]
    undone: tuple[int, ...]
    findings: Findings
    entries: Mapping[int, FrameEntry] = field(default_factory=dict)
    error: MrbatchError | None = None
    interrupted: bool = False
    seconds: float = 0.0
    predicted: float | None = None
    owner: Owner | None = None

    @property
    def why_undone(self) -> str:
        """Why frames were not reached; empty where all were."""
        if not self.undone:
            return ""
        if self.interrupted:
            return "the run was interrupted"
        if self.error is not None:
            return f"the run ended: {self.error.message}"
        stopped = [f.frame for f in self.failed if f.held_from is None]
        return f"the run stopped at frame {stopped[-1]}" if stopped else "the run ended"

    def last_event(self, seconds: float) -> Done:
        """`seconds` of the whole command."""
        message = str(self.error) if self.error else ""
        if self.interrupted:
            there = len(self.rendered) + len(self.kept)
            asked = there + len(self.failed) + len(self.undone)
            message = f"interrupted: the same command goes on; {there} of {asked} frames are there"
        return Done(
            len(self.rendered),
            len(self.kept),
            len(self.failed),
            seconds,
            self.predicted,
            self.exit_code,
            message,
            self.seconds,
        )

    @property
    def exit_code(self) -> int:
        """130 interrupted; else the worst of: the error's code, 4 some frames failed, 3 none is there, 0."""
        if self.interrupted:
            return EXIT_INTERRUPTED
        codes = []
        if self.error is not None:
            codes.append(self.error.exit_code)
        if self.failed:
            codes.append(EXIT_FRAMES if self.rendered or self.kept else EXIT_INPUT)
        return worst_exit_code(codes)
