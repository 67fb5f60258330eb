"""How a run's frames come to lie in the folder: staged, then published together with their journal line."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from mrbatch.batch.commit import Staged, stage_file
from mrbatch.batch.directory import held_hash
from mrbatch.batch.history import State, own_state, stage_state
from mrbatch.batch.interrupt import interrupts
from mrbatch.batch.inventory import Inventory
from mrbatch.batch.journal import FrameEntry, JournalWriter
from mrbatch.batch.request import FrameResult, Hold, RunRequest, Verify
from mrbatch.errors import JobError

Done = Callable[[FrameEntry], None]


@dataclass(frozen=True)
class Committer:
    """Puts frames of one run under their final names.

    `owner` names temporary files. A signal between rename and journal line waits until both are done
    and `done(entry)` was called.
    """

    request: RunRequest
    verify: Verify
    owner: str
    inventory: Inventory
    writer: JournalWriter

    def commit(self, frame: int, result: FrameResult, done: Done) -> State | None:
        """A rendered frame; gives the state that it hands on. Raises ResourceError, JobError where another
        job has taken the folder, and what writing and verifying raise."""
        request = self.request
        began = time.perf_counter()
        with contextlib.ExitStack() as undo:
            picture = _undone_by(undo, stage_file(request.path(frame), result.write, self.verify, self.owner))
            written = time.perf_counter() - began
            state = None
            history: Staged | None = None
            if request.history:
                state = own_state(result.history, frame)
                history = _undone_by(undo, stage_state(request.directory, frame, state, self.owner))
            self._check_hold()
            with interrupts.shielded():
                history_hash = history.publish().file_hash if history else ""
                published = picture.publish()
                entry = FrameEntry(
                    job_hash=request.job_hash,
                    frame=frame,
                    file=self.inventory.relative(frame),
                    file_hash=published.file_hash,
                    content_hash=published.content_hash,
                    size=published.size,
                    seconds=float(result.seconds),
                    counters={name: int(count) for name, count in result.counters.items()},
                    details=dict(result.details),
                    write_seconds=written,
                    history_hash=history_hash,
                )
                self.writer.append(entry)
                done(entry)
        return state

    def stand_in(self, frame: int, source: FrameEntry, error: str, hold: Hold, done: Done) -> None:
        """The picture of `source` under the name of `frame`, which failed with `error`; what stands in
        already stays as it is. Raises as `commit` does."""
        request = self.request
        what, there = self.inventory.judge(frame)
        if (
            what == "stand_ins"
            and there is not None
            and (there.held_from, there.error) == (source.frame, error)
        ):
            done(there)
            return

        def write(path: Path) -> None:
            hold(request.directory / source.file, path, frame, source.frame)

        with contextlib.ExitStack() as undo:
            picture = _undone_by(undo, stage_file(request.path(frame), write, self.verify, self.owner))
            self._check_hold()
            with interrupts.shielded():
                published = picture.publish()
                entry = replace(
                    source,
                    frame=frame,
                    file=self.inventory.relative(frame),
                    file_hash=published.file_hash,
                    content_hash=published.content_hash,
                    size=published.size,
                    seconds=0.0,
                    write_seconds=0.0,
                    counters={},
                    history_hash="",
                    held_from=source.frame,
                    error=error,
                )
                self.writer.append(entry)
                done(entry)

    def _check_hold(self) -> None:
        if held_hash(self.request.directory) != self.request.job_hash:
            raise JobError(
                f"`{self.request.directory}` was taken by another job while this one was running",
                hint="choose another folder with --output",
            )


def _undone_by(undo: contextlib.ExitStack, staged: Staged) -> Staged:
    """Whatever happens, the temporary file goes (after `publish` there is none)."""
    undo.callback(staged.discard)
    return staged
