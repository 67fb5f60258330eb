"""The run: frames as tasks. Claims each frame, renders it, commits it, and keeps what is there already.

What a run guarantees: a file under its final name is complete; a frame in the journal is on the disk;
whatever ends the process costs at most the frame in work; the next run says what it found.
"""

from __future__ import annotations

import contextlib
import shutil
import threading
import time
from dataclasses import replace
from pathlib import Path

from mrbatch.batch import events as tell
from mrbatch.batch.claim import Claims
from mrbatch.batch.commit import as_resource_error, leftovers, resource_reason
from mrbatch.batch.committer import Committer
from mrbatch.batch.directory import hold as take_hold
from mrbatch.batch.directory import sweep
from mrbatch.batch.history import FOLDER as HISTORY_FOLDER
from mrbatch.batch.history import Chain, State
from mrbatch.batch.interrupt import interrupts
from mrbatch.batch.inventory import Findings, Inventory
from mrbatch.batch.journal import FailureEntry, FrameEntry, JournalReader, JournalWriter
from mrbatch.batch.presence import FOLDER as CLAIMS_FOLDER
from mrbatch.batch.presence import STALE_AFTER, Owner, Presence
from mrbatch.batch.request import (
    FailedFrame,
    Hold,
    Render,
    RunRequest,
    RunResult,
    Stopped,
    Verify,
)
from mrbatch.errors import InputError, JobError, MrbatchError, Place


def run(
    request: RunRequest,
    render: Render,
    verify: Verify,
    *,
    events: tell.EventSink = tell.ignore,
    stop: threading.Event | None = None,
    expected_seconds: float | None = None,
    forecast: tell.Forecast | None = None,
    stale_after: float = STALE_AFTER,
    poll: float = 0.5,
    hold: Hold | None = None,
    announce_end: bool = True,
) -> RunResult:
    """Render the frames of `request` that are not there yet.

    Other processes may work on the same job in the same folder. When this returns without error,
    every frame asked for is there or in `failed`; frames that others have claimed are waited for
    (looked at every `poll` seconds) and taken over where their process died (other machines: no sign
    of life for `stale_after` seconds). `stop` ends the run at the next chance. `expected_seconds` a
    frame is the prediction until the first is done; or give a `forecast`, which the renderer may feed.
    `hold` makes the file of a stand-in (by default a copy). `announce_end`: whether the run tells `Done`.

    Raises JobError where the folder belongs to another job, ResourceError where it cannot be written
    at all. What goes wrong later stands in the result, so that the report can be written.
    """
    if request.history:
        covered = {frame for segment in request.segments for frame in segment.frames}
        if not set(request.frames) <= covered:
            raise ValueError("the segments do not cover the frames")
    paths = [request.path(frame) for frame in request.frames]
    if len(set(paths)) != len(set(request.frames)):
        raise JobError(
            f"the file pattern `{request.pattern}` gives two frames the same name",
            place=Place(file="output.pattern"),
            hint="write one like `{job}.{frame:04d}.exr`",
        )
    try:
        request.directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise as_resource_error(error, request.directory) from error
    owner = Owner.here()
    try:
        with Presence(request.directory, owner, request.job_hash, stale_after=stale_after) as presence:
            work = _Run(request, render, verify, presence, events, stop or threading.Event(), poll)
            work.forecast = forecast or tell.Forecast(expected_seconds)
            work.hold = hold or _copy
            work.announce_end = announce_end
            return work.run()
    except JobError:
        # A folder that belongs to somebody else is left as it was.
        with contextlib.suppress(OSError):
            (request.directory / CLAIMS_FOLDER).rmdir()
        raise


class _Run:
    """One run; holds what changes while it goes on."""

    def __init__(
        self,
        request: RunRequest,
        render: Render,
        verify: Verify,
        presence: Presence,
        events: tell.EventSink,
        stop: threading.Event,
        poll: float,
    ):
        self.request = request
        self.render = render
        self.verify = verify
        self.presence = presence
        self.owner = presence.owner
        self.stop = stop
        self.poll = poll
        self.forecast = tell.Forecast()
        self.hold: Hold = _copy
        self.announce_end = True
        self.claims = Claims(presence)
        self.journal = JournalReader(request.directory)
        self.writer = JournalWriter(request.directory, presence.owner)
        self.rendered: list[int] = []
        self.kept: list[int] = []
        self.failed: dict[int, FailedFrame] = {}
        self.entries: dict[int, FrameEntry] = {}
        self.pending: list[int] = []
        self.findings = Findings()
        self._events = events
        self.inventory = Inventory(request.directory, request.job_hash, request.path, self.journal)
        self.committer = Committer(request, verify, presence.owner.name, self.inventory, self.writer)
        self.chain = Chain(
            request.directory,
            request.job_hash,
            request.segments if request.history else (),
            self.journal,
            lambda frame, before: render(frame, before).history,
            before_each=self._check_stop,
        )

    def run(self) -> RunResult:
        began = time.monotonic()
        request = self.request
        take_hold(
            request.directory,
            job_name=request.job_name,
            job_hash=request.job_hash,
            pattern=request.pattern,
            targets=[request.path(frame) for frame in request.frames],
            overwrite=request.overwrite,
            presence=self.presence,
            journal=self.journal,
            facts=request.facts,
        )
        error: MrbatchError | None = None
        interrupted = False
        try:
            for folder in {request.path(frame).parent for frame in request.frames}:
                try:
                    folder.mkdir(parents=True, exist_ok=True)
                except OSError as refused:
                    raise as_resource_error(refused, folder) from refused
            self._look()
            self._announce()
            for frame, absence in request.absent.items():
                self._note_failure(frame, absence)
            self._work()
            if request.on_error == "hold-last":
                self._hold_last()
        except (KeyboardInterrupt, Stopped):
            interrupted = True
        except Exception as raised:
            error = raised if isinstance(raised, MrbatchError) else resource_reason(raised, request.directory)
            if error is None:
                raise
        finally:
            # A signal in here would leave claims behind; a second one ends the process anyway.
            with contextlib.suppress(KeyboardInterrupt), interrupts.shielded():
                self.claims.release_all()
                self.writer.close()
                if interrupted or error is not None:
                    self._clean()
        finished = {*self.rendered, *self.kept, *self.failed}
        result = RunResult(
            rendered=tuple(self.rendered),
            kept=tuple(sorted(self.kept)),
            failed=tuple(self.failed[frame] for frame in sorted(self.failed)),
            undone=tuple(frame for frame in self.pending if frame not in finished),
            findings=self.findings,
            entries=self.entries,
            error=error,
            interrupted=interrupted,
            seconds=time.monotonic() - began,
            predicted=self.forecast.first,
            owner=self.owner,
        )
        if self.announce_end:
            self._tell(result.last_event(result.seconds))
        return result

    # --- what is there already -------------------------------------------------------------------

    def _look(self) -> None:
        """Sweep what dead processes left, then sort the frames into kept and pending."""
        request = self.request
        swept = sweep(self._folders(), self.presence, self.claims)
        found: dict[str, list[int]] = {
            name: [] for name in ("finished", "corrupt", "missing", "unrecorded", "stand_ins", "fresh")
        }
        for frame in dict.fromkeys(request.frames):
            self._check_stop()
            what, entry = self.inventory.judge(frame)
            found[what].append(frame)
            if what == "finished" and entry is not None:
                self.kept.append(frame)
                self.entries[frame] = entry
            else:
                self.pending.append(frame)
        del found["fresh"]
        self.findings = Findings(
            **{name: tuple(frames) for name, frames in found.items()},
            leftovers=swept,
            claims=self.claims.taken_over,
            torn=self.journal.torn_lines(self.presence.is_alive),
            foreign=self.inventory.foreign(request.frames),
        )

    def _announce(self) -> None:
        request, findings = self.request, self.findings
        self._tell(
            tell.Started(
                request.job_name,
                str(request.directory),
                len(request.frames) + len(request.absent),
                len(self.kept),
                findings.summary(),
            )
        )
        for frame in findings.corrupt:
            self._tell(tell.Note(f"`{request.path(frame)}` is corrupt: rendered again", frame))
        for frame in findings.missing:
            self._tell(tell.Note(f"`{request.path(frame)}` is gone: rendered again", frame))
        for frame in self.kept:
            self._tell(tell.FrameKept(frame, str(request.path(frame))))
        self._predict()

    # --- the frames ------------------------------------------------------------------------------

    def _work(self) -> None:
        waiting = False
        while self.pending:
            advanced = False
            busy: set[int] = set()
            for frame in tuple(self.pending):
                self._check_stop()
                segment = self.chain.segment_number(frame)
                if segment in busy:
                    continue
                if self.chain.is_busy(frame, self.claims.holder):
                    busy.add(segment)
                    continue
                with interrupts.shielded():
                    ours = self.claims.acquire(frame)
                if not ours:
                    continue
                self.forecast.frames_left = len(self.pending)
                try:
                    self._do(frame)
                finally:
                    self.claims.release(frame)
                self.pending.remove(frame)
                advanced, waiting = True, False
                if frame in self.failed and self.request.on_error == "stop":
                    self._tell_stop(frame)
                    return
                self._predict()
            if self.pending and not advanced:
                if not waiting:
                    holders = [self.claims.holder(frame) for frame in self.pending]
                    names = sorted({name for name in holders if name})
                    self._tell(tell.Waiting(len(self.pending), ", ".join(names)))
                    waiting = True
                self.stop.wait(self.poll)

    def _do(self, frame: int) -> None:
        """Render and commit one claimed frame, unless another process has finished it meanwhile."""
        self.journal.refresh()
        what, entry = self.inventory.judge(frame)
        if what == "finished" and entry is not None:
            self.kept.append(frame)
            self.entries[frame] = entry
            self._tell(tell.FrameKept(frame, str(self.request.path(frame)), entry.host or "another process"))
            return
        self._tell(tell.FrameStarted(frame))
        began = time.monotonic()
        state: State | None = None
        try:
            state = self.chain.state_before(frame)
            result = self.render(frame, state)
            state_after = self.committer.commit(frame, result, self._note_rendered)
        except InputError as error:
            self._fail(frame, error, state)
            return
        self.chain.remember(frame, state_after)
        self.forecast.add(time.monotonic() - began)
        path = str(self.request.path(frame))
        self._tell(tell.FrameDone(frame, path, float(result.seconds), dict(result.counters)))

    def _note_rendered(self, entry: FrameEntry) -> None:
        self.entries[entry.frame] = entry
        self.rendered.append(entry.frame)

    def _fail(self, frame: int, error: InputError, state: State | None) -> None:
        # A broken frame hands on the state that it got.
        self.chain.remember(frame, state)
        self._note_failure(frame, error)

    def _note_failure(self, frame: int, error: InputError) -> None:
        place = error.place or Place()
        error.place = place if place.frame is not None else replace(place, frame=frame)
        self.failed[frame] = FailedFrame(frame, error)
        job_hash, text = self.request.job_hash, str(error)
        known = self.journal.failures.get(frame, ())
        # A frame that fails again as it did before is no news.
        if not any(entry.job_hash == job_hash and entry.error == text for entry in known):
            file = f"{Path(place.file).name}: " if place.file else ""
            message = file + error.message
            self.writer.append(
                FailureEntry(job_hash, frame, text, message, error.hint or "", error.exit_code)
            )
        self._tell(tell.FrameFailed(frame, text))

    def _tell_stop(self, frame: int) -> None:
        count = len(self.pending)
        if count:
            were = "1 frame was" if count == 1 else f"{count} frames were"
            self._tell(tell.Note(f"the run stops here: {were} not tried (see `on_error`)", frame))

    def _hold_last(self) -> None:
        """Give each failed frame the picture of the nearest earlier finished one, at the end of the run."""
        for frame in sorted(self.failed):
            self._check_stop()
            self.journal.refresh()
            for source in sorted((f for f in self.journal.frames if f < frame), reverse=True):
                what, entry = self.inventory.judge(source)
                if what == "finished" and entry is not None:
                    self._hold_from(frame, entry)
                    break
            else:
                self._tell(tell.Note("no earlier frame to hold: the frame is missing", frame))

    def _hold_from(self, frame: int, source: FrameEntry) -> None:
        """Have the picture of `source` stand in for `frame`."""
        failed = self.failed[frame]

        def done(entry: FrameEntry) -> None:
            self.entries[frame] = entry

        self.committer.stand_in(frame, source, str(failed.error), self.hold, done)
        self.failed[frame] = replace(failed, held_from=source.frame)
        self._tell(tell.FrameFailed(frame, str(failed.error), source.frame))

    # --- small things ----------------------------------------------------------------------------

    def _folders(self) -> set[Path]:
        """Where temporary files of this program may lie."""
        request = self.request
        folders = {request.directory / name for name in ("", HISTORY_FOLDER, "shot")}
        return folders | {request.path(frame).parent for frame in request.frames}

    def _clean(self) -> None:
        """Remove what a signal between two lines may have left of our own."""
        with contextlib.suppress(MrbatchError):
            for path, owner in leftovers(self._folders()):
                if owner == self.owner.name:
                    with contextlib.suppress(OSError):
                        path.unlink()

    def _check_stop(self) -> None:
        if self.stop.is_set():
            raise Stopped

    def _predict(self) -> None:
        if self.pending:
            prediction = self.forecast.predict(len(self.pending))
            if prediction is not None:
                self._tell(prediction)

    def _tell(self, event: tell.Event) -> None:
        try:
            self._events(event)
        except Exception:
            # Who listens must not cost a frame.
            self._events = tell.ignore


def _copy(source: Path, target: Path, frame: int, held_from: int) -> None:
    shutil.copyfile(source, target)
