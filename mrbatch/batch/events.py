"""What a run tells while it works: small frozen events for whoever listens.

A sink is any callable that takes one event. A slow or broken listener must not hold up rendering:
`Background` passes events on from a thread of its own.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, ClassVar


@dataclass(frozen=True)
class Event:
    """Base of all events; `kind` is its name in JSON."""

    kind: ClassVar[str] = "event"

    def record(self) -> dict[str, Any]:
        """JSON-ready, the kind under `event`."""
        return {"event": self.kind} | asdict(self)


@dataclass(frozen=True)
class Started(Event):
    """The run begins; `found`: what earlier runs left, in words (empty for a fresh folder)."""

    kind: ClassVar[str] = "start"
    job: str
    directory: str
    frames: int
    kept: int
    found: str


@dataclass(frozen=True)
class Preparing(Event):
    """Before the run: `done` of `total` parts of a step are through; `detail`: more about it, in words."""

    kind: ClassVar[str] = "prepare"
    step: str
    done: int
    total: int
    detail: str = ""


@dataclass(frozen=True)
class Note(Event):
    """Something a person should read once, such as a corrupt file that will be rendered again."""

    kind: ClassVar[str] = "note"
    message: str
    frame: int | None = None


@dataclass(frozen=True)
class FrameStarted(Event):
    kind: ClassVar[str] = "frame-started"
    frame: int


@dataclass(frozen=True)
class FrameProgress(Event):
    """`fraction` of the frame in work that is done, 0..1; renderers may tell it."""

    kind: ClassVar[str] = "frame-progress"
    frame: int
    fraction: float


@dataclass(frozen=True)
class FrameDone(Event):
    """A frame is committed; `seconds` of rendering."""

    kind: ClassVar[str] = "frame-done"
    frame: int
    file: str
    seconds: float
    counters: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class FrameKept(Event):
    """A frame was there already, from an earlier run or (`by`) from another process."""

    kind: ClassVar[str] = "frame-kept"
    frame: int
    file: str
    by: str = ""


@dataclass(frozen=True)
class FrameFailed(Event):
    """A frame's input cannot be used. `held_from`: the frame whose picture stands in, if any."""

    kind: ClassVar[str] = "frame-failed"
    frame: int
    message: str
    held_from: int | None = None


@dataclass(frozen=True)
class Waiting(Event):
    """All frames left are being rendered by other processes."""

    kind: ClassVar[str] = "waiting"
    frames: int
    holder: str


@dataclass(frozen=True)
class Prediction(Event):
    """`seconds_left` of this process; `basis`: what it rests on (`first samples`, `3 frames`)."""

    kind: ClassVar[str] = "prediction"
    seconds_left: float
    seconds_per_frame: float
    basis: str


@dataclass(frozen=True)
class Done(Event):
    """The run has ended. `seconds` of the whole command, of which the frames took `frame_seconds`;
    `predicted`: what was said of these before the first frame was done, or None. `message`: what ended
    it early."""

    kind: ClassVar[str] = "done"
    rendered: int
    kept: int
    failed: int
    seconds: float
    predicted: float | None
    exit_code: int
    message: str = ""
    frame_seconds: float | None = None


@dataclass(frozen=True)
class Failed(Event):
    """There is no run at all: the job or its input cannot be used."""

    kind: ClassVar[str] = "error"
    message: str
    exit_code: int


EventSink = Callable[[Event], None]


def ignore(event: Event) -> None:
    """The sink for those who do not listen."""


class Background:
    """Passes events to `sink` from a daemon thread, in order. Use as a context manager and a sink.

    Where the sink is so slow that `limit` events wait, further ones of `FrameProgress` are dropped
    first and then any other; a sink that raises is not called again. Closing waits `patience` seconds.
    """

    def __init__(self, sink: EventSink, *, limit: int = 10_000, patience: float = 2.0):
        self._sink = sink
        self._patience = patience
        self._limit = limit
        self._queue: queue.SimpleQueue[Event | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._work, name="mrbatch-events", daemon=True)
        self.dropped = 0

    def __enter__(self) -> Background:
        self._thread.start()
        return self

    def __exit__(self, *_) -> None:
        self._queue.put(None)
        self._thread.join(self._patience)

    def __call__(self, event: Event) -> None:
        room = self._limit // 2 if isinstance(event, FrameProgress) else self._limit
        if self._queue.qsize() >= room:
            self.dropped += 1
        else:
            self._queue.put(event)

    def _work(self) -> None:
        broken = False
        while (event := self._queue.get()) is not None:
            if not broken:
                try:
                    self._sink(event)
                except Exception:
                    # A closed pipe or terminal: the pictures matter, the listener has gone.
                    broken = True


class Forecast:
    """Remaining time from the frames done so far: their mean, the latest half weighing double.

    `expected`: seconds a frame from a price list, used until a frame is done. `frames_left`: what the
    run has still to do, the frame in work included.
    """

    def __init__(self, expected: float | None = None):
        self._expected = expected
        self._seconds: list[float] = []
        self._began = time.monotonic()
        self.first: float | None = None
        self.frames_left = 0

    def add(self, seconds: float) -> None:
        self._seconds.append(seconds)

    def foresee(self, seconds: float, spent: float) -> Prediction | None:
        """From the first samples of the first frame: it takes `seconds`, of which `spent` are over. None
        where a prediction was made already."""
        if self.first is not None or self._seconds:
            return None
        left = max(0.0, seconds * max(1, self.frames_left) - spent)
        self.first = time.monotonic() - self._began + left
        return Prediction(left, seconds, "first samples")

    def predict(self, frames_left: int) -> Prediction | None:
        """None while nothing is known. `first` keeps the first prediction made, to be checked later."""
        if self._seconds:
            latest = self._seconds[len(self._seconds) // 2 :]
            values = self._seconds + latest
            each = sum(values) / len(values)
            count = len(self._seconds)
            basis = f"{count} frame{'s' if count > 1 else ''}"
        elif self._expected is not None:
            each, basis = self._expected, "price list"
        else:
            return None
        if self.first is None:
            self.first = sum(self._seconds) + each * frames_left
        return Prediction(each * frames_left, each, basis)
