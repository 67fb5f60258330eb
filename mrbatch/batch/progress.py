"""Progress for people and programs: a bar on a terminal, plain lines in a log, JSON lines on request."""

from __future__ import annotations

import contextlib
import json
import os
import sys
import time
from collections.abc import Callable, Iterator
from datetime import timedelta
from typing import IO, Literal

from mrbatch.batch import events as tell

Mode = Literal["auto", "bar", "plain", "json", "none"]
REDRAWS_PER_SECOND = 4
"""Of the bar; more only fills a recorded terminal."""


@contextlib.contextmanager
def progress(
    mode: Mode = "auto", stream: IO[str] | None = None, *, clock: Callable[[], float] = time.monotonic
) -> Iterator[tell.EventSink]:
    """A sink that shows events on `stream` (standard error by default). Use as a context manager.

    `auto`: a bar where the stream is a terminal, else plain lines. `json`: one object a line, keys
    `event` and what the event carries. Writing happens on a thread of its own: a reader that stops
    reading, or goes away, holds up nothing.
    """
    with _own_stderr() if stream is None else contextlib.nullcontext(stream) as out:
        if mode == "auto":
            mode = "bar" if _is_terminal(out) else "plain"
        if mode == "none":
            yield tell.ignore
        elif mode == "bar":
            with _bar(out) as sink, tell.Background(sink) as background:
                yield background
        else:
            lines: tell.EventSink = JsonLines(out) if mode == "json" else PlainLines(out, clock)
            with tell.Background(lines) as background:
                yield background


@contextlib.contextmanager
def _own_stderr() -> Iterator[IO[str]]:
    """Standard error under a handle of its own: descriptor 2 is shut for a moment while Warp starts, and what
    another thread writes there meanwhile would be lost."""
    try:
        sys.stderr.flush()
        handle = os.dup(sys.stderr.fileno())
    except (OSError, ValueError, AttributeError):
        yield sys.stderr
        return
    stream = open(handle, "w", encoding=sys.stderr.encoding or "utf-8", errors="backslashreplace")  # noqa: SIM115
    try:
        yield stream
    finally:
        with contextlib.suppress(OSError):
            stream.close()


class JsonLines:
    """One JSON object a line, flushed."""

    def __init__(self, stream: IO[str]):
        self._stream = stream

    def __call__(self, event: tell.Event) -> None:
        self._stream.write(json.dumps(event.record(), separators=(",", ":"), default=str) + "\n")
        self._stream.flush()


class PlainLines:
    """A line for what a person looks for in a log; kept frames and remaining time are not repeated
    more than every `QUIET` seconds."""

    QUIET = 10.0

    def __init__(self, stream: IO[str], clock: Callable[[], float] = time.monotonic):
        self._stream = stream
        self._clock = clock
        self._total = 0
        self._done = 0
        # The time left is told at once, preparing only where it takes long.
        self._told: dict[type[tell.Event], float] = {tell.Preparing: clock()}

    def __call__(self, event: tell.Event) -> None:
        match event:
            case tell.Started():
                self._total = event.frames
                self._line(f"{event.job}: {counted(event.frames, 'frame')} to `{event.directory}`")
                if event.found:
                    self._line(event.found)
            case tell.FrameKept():
                self._done += 1
            case tell.FrameDone():
                self._done += 1
                self._line(f"frame {event.frame} done in {event.seconds:.2f} s ({self._done}/{self._total})")
            case tell.Prediction():
                self._now_and_then(event, prediction_text(event))
            case tell.Preparing():
                self._now_and_then(event, f"{_step(event)}: {event.done} of {event.total}")
            case _:
                text = event_text(event)
                if text:
                    self._line(text)

    def _now_and_then(self, event: tell.Event, text: str) -> None:
        now = self._clock()
        if now - self._told.get(type(event), float("-inf")) >= self.QUIET:
            self._told[type(event)] = now
            self._line(text)

    def _line(self, text: str) -> None:
        self._stream.write(text + "\n")
        self._stream.flush()


def event_text(event: tell.Event) -> str:
    """Words for the rarer events; empty for those that need none."""
    match event:
        case tell.Failed():
            return ""  # told as the command's error
        case tell.Note():
            return (f"frame {event.frame}: " if event.frame is not None else "") + event.message
        case tell.FrameFailed():
            if event.held_from is not None:
                return f"frame {event.frame}: shows frame {event.held_from} instead"
            message = event.message.removeprefix(f"frame {event.frame}: ")
            return f"frame {event.frame} failed: {message}"
        case tell.Waiting():
            frames = "frame is" if event.frames == 1 else "frames are"
            return f"waiting: {event.frames} {frames} with {event.holder or 'other processes'}"
        case tell.Done():
            parts = [f"{event.rendered} rendered", f"{event.kept} kept", f"{event.failed} failed"]
            parts = [part for part in parts if not part.startswith("0 ")]
            if event.exit_code == 0 and not parts:
                parts = ["nothing to do"]
            text = f"{', '.join(parts) or 'ended'} in {event.seconds:.1f} s"
            if event.predicted is not None and event.rendered and event.frame_seconds is not None:
                text += f" (frames: {event.frame_seconds:.1f} s, predicted {event.predicted:.1f} s)"
            return text
    return ""


def _step(event: tell.Preparing) -> str:
    return f"{event.step}, {event.detail}" if event.detail else event.step


def counted(count: int, noun: str) -> str:
    """`1 frame`, `2 frames`."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def prediction_text(event: tell.Prediction) -> str:
    return f"about {duration_text(event.seconds_left)} left (from {event.basis})"


def duration_text(seconds: float) -> str:
    """`0:01:05`; under ten seconds with one digit, `3.2 s`."""
    if seconds < 10.0:
        return f"{max(0.0, seconds):.1f} s"
    return str(timedelta(seconds=round(seconds)))


@contextlib.contextmanager
def _bar(stream: IO[str]) -> Iterator[tell.EventSink]:
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

    console = Console(file=stream)
    bar = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("{task.fields[left]}"),
        console=console,
        refresh_per_second=REDRAWS_PER_SECOND,
        # The terminal belongs to the person; the output of other libraries is not captured.
        redirect_stdout=False,
        redirect_stderr=False,
    )
    task = bar.add_task("starting", total=None, left="")
    step: TaskID | None = None
    done = 0.0

    def say(text: str) -> None:
        console.print(text, markup=False, highlight=False, soft_wrap=True)

    def sink(event: tell.Event) -> None:
        nonlocal done, step
        match event:
            case tell.Preparing():
                # A line of its own: a task that was full once has no clock any more.
                step = step if step is not None else bar.add_task("", left="")
                text = escape(_step(event))
                bar.update(step, total=event.total, completed=event.done, description=text)
            case tell.Started():
                if step is not None:
                    bar.remove_task(step)
                    step = None
                bar.update(task, total=event.frames, description=escape(event.job))
                if event.found:
                    say(event.found)
            case tell.FrameStarted():
                bar.update(task, description=f"frame {event.frame}")
            case tell.FrameProgress():
                bar.update(task, completed=done + min(max(event.fraction, 0.0), 1.0))
            case tell.FrameDone() | tell.FrameKept():
                done += 1
                bar.update(task, completed=done)
            case tell.Prediction():
                bar.update(task, left=prediction_text(event))
            case _:
                if isinstance(event, tell.FrameFailed) and event.held_from is None:
                    done += 1
                    bar.update(task, completed=done)
                if isinstance(event, tell.Done):
                    bar.update(task, description="done" if event.exit_code == 0 else "ended", left="")
                text = event_text(event)
                if text:
                    say(text)

    with bar:
        yield sink


def _is_terminal(stream: IO[str]) -> bool:
    try:
        return stream.isatty()
    except (AttributeError, ValueError):
        return False
