"""A whole job: prepare, frames, previews, report."""

from __future__ import annotations

import functools
import threading
import time
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from mrbatch.batch import events as tell
from mrbatch.batch.directory import (
    check_holder,
    check_strangers,
    check_writable,
    frame_path,
    held_record,
)
from mrbatch.batch.job_report import holdings, machine, report_of, versions
from mrbatch.batch.journal import JournalReader, JournalWriter, RunEntry
from mrbatch.batch.prepare import Prepared, look_at, no_progress, open_capture, own_facts, prepare
from mrbatch.batch.presence import Owner
from mrbatch.batch.previews import make_previews
from mrbatch.batch.render import RenderedFrame, ShotRenderer
from mrbatch.batch.request import RunRequest, RunResult
from mrbatch.batch.run import run
from mrbatch.batch.shot import commit_shot
from mrbatch.batch.stand_in import write_stand_in
from mrbatch.batch.time_limit import Allowance, Recorded, Referee
from mrbatch.contracts import Progress
from mrbatch.device.timing import TimingNode
from mrbatch.errors import EXIT_GATE, InputError, JobError, MrbatchError, Place, worst_exit_code
from mrbatch.film.layers import empty
from mrbatch.film.verification import verify_frame
from mrbatch.job import select_frames
from mrbatch.job.frames import beyond
from mrbatch.job.model import Job
from mrbatch.report.html import write_html
from mrbatch.report.model import Report, save_report

REPORT, PAGE = "report.json", "report.html"
MOST_AGAIN = 4
"""How often report and previews are made at most, while other processes add to the folder."""


@dataclass(frozen=True)
class JobOutcome:
    """How a job ended: the run's result, the report of all that is in the folder (None where it could not be
    made), and the exit code of the command."""

    result: RunResult
    report: Report | None
    directory: Path
    exit_code: int


def render_job(
    job: Job,
    *,
    threads: int | None = None,
    units_per_launch: int | None = None,
    overwrite: bool = False,
    events: tell.EventSink = tell.ignore,
    stop: threading.Event | None = None,
    report: bool = True,
    began: float | None = None,
    replay: Path | None = None,
) -> JobOutcome:
    """Renders the frames of a job that are not there yet, then previews and report.

    `replay`: a folder of the same job whose frames a limit of time has ended: theirs get the same samples.
    `began`: when the command did, by `time.perf_counter`. Raises JobError, InputError or ResourceError for
    what makes the whole job impossible; what happens to single frames stands in the outcome.
    """
    now = time.perf_counter()
    began = now if began is None else began
    timing = TimingNode(job.name)
    timing.child("start").merge(TimingNode("start", now - began, calls=1))
    directory = job.output.directory
    check_writable(directory)
    if not overwrite:
        check_holder(directory, own_facts(job))
    with timing.measure("prepare") as node:
        prepared, facts = _prepare(job, node, overwrite, events)
    for text in prepared.shot.notes:
        events(tell.Note(text))
    numbers = sorted({*prepared.shot.frames, *prepared.absent})
    chosen = select_frames(job.frames, numbers, place=job.place("frames"))
    if text := beyond(job.frames, numbers):
        events(tell.Note(text))
    request = RunRequest(
        directory=directory,
        pattern=job.output.pattern,
        job_name=job.name,
        job_hash=prepared.job_hash,
        frames=tuple(n for n in chosen if n not in prepared.absent),
        overwrite=overwrite,
        on_error=job.on_error,
        history=False,
        segments=prepared.shot.segments,
        absent={n: error for n, error in prepared.absent.items() if n in chosen},
        facts=facts,
    )
    views = tuple(prepared.display) if len(prepared.display) > 1 else ("",)
    verify = functools.partial(verify_frame, channels=tuple(empty(prepared.layers, 1, 1)), views=views)
    forecast = tell.Forecast()
    referee = _referee(prepared, replay, began, forecast, report)
    with _Renderer(prepared, timing, threads, units_per_launch, events, forecast, referee) as render:
        request = render.with_history(request)
        result = run(
            request,
            render,
            verify,
            events=events,
            stop=stop,
            forecast=forecast,
            hold=write_stand_in,
            announce_end=False,
        )
    return _finish(job, prepared, result, timing, began, events, report)


def _referee(
    prepared: Prepared, replay: Path | None, began: float, forecast: tell.Forecast, report: bool
) -> Callable[[int], Referee] | None:
    """Who ends frames, where the job has a limit of time. Raises JobError where nothing can be replayed."""
    limit = prepared.job.accuracy.time_limit
    if replay is not None:
        found = {
            number: entry.details["accuracy"]
            for number, entries in JournalReader(replay).frames.items()
            for entry in entries
            if entry.job_hash == prepared.job_hash and "accuracy" in entry.details
        }
        if limit is None or not found:
            why = (
                "the job has no `accuracy.time_limit`" if limit is None else f"{replay} holds no frame of it"
            )
            raise JobError(f"nothing can be replayed: {why}", hint="give the folder of the same job's frames")

        def repeat(number: int) -> Referee:
            if number not in found:
                raise InputError("no record of how this frame ended", place=Place(frame=number))
            return Recorded(found[number]["rounds"], found[number]["samples"])

        return repeat
    if limit is None:
        return None
    pixels = sum(window.pixels for window in prepared.windows.values())
    allowance = Allowance(
        began + limit, lambda: forecast.frames_left, megapixels=pixels / 1e6, closing=report
    )
    return lambda number: allowance.begin()


def _prepare(
    job: Job, timing: TimingNode, overwrite: bool, events: tell.EventSink
) -> tuple[Prepared, dict[str, Any]]:
    """The prepared job and what it was made of; refuses what it can before anything slow is done."""

    def progress(step: str, done: int, total: int, detail: str = "") -> None:
        events(tell.Preparing(step, done, total, detail))

    directory = job.output.directory
    capture, numbers = open_capture(job, timing)
    chosen = select_frames(job.frames, numbers, place=job.place("frames"))
    if not overwrite and held_record(directory) is None and not JournalReader(directory).frames:
        check_strangers(frame_path(directory, job.output.pattern, job.name, n) for n in chosen)
    opened = look_at(job, capture, timing, progress)
    if not overwrite:
        check_holder(directory, opened.facts)
    there = directory if directory.is_dir() else None
    prepared = prepare(job, timing, directory=there, opened=opened, progress=progress)
    rate = prepared.facts.frame_rate
    facts = {
        **opened.facts,
        "key": opened.key,
        "method": job.method_name,
        "capture": job.capture_kind,
        "seed": job.seed,
        "layers": list(prepared.layers),
        "transfer": prepared.facts.transfer,
        "frame_rate": None if rate is None else str(rate),
    }
    return prepared, facts


def _finish(
    job: Job,
    prepared: Prepared,
    result: RunResult,
    timing: TimingNode,
    began: float,
    events: tell.EventSink,
    report: bool,
) -> JobOutcome:
    """Previews, the run's line in the journal, the report, the last event."""
    directory = job.output.directory
    distrusted = set(result.findings.corrupt) - set(result.rendered)
    notes: list[str] = []
    made: Report | None = None
    missed = missed_targets(result)
    for text in missed:
        events(tell.Note(text))
    exit_code = result.exit_code or (EXIT_GATE if missed else 0)
    try:
        if report and not result.interrupted:
            with timing.measure("previews"):
                notes = _previews(job, prepared, distrusted)
            for text in notes:
                events(tell.Note(text))
        seconds = time.perf_counter() - began
        if result.owner is not None and (result.rendered or result.undone):
            timing.seconds, timing.calls = seconds, 1
            _record(directory, _entry(prepared, result, timing, notes), result.owner)
        for _ in range(MOST_AGAIN):
            made = report_of(directory, prepared.job_hash, distrusted=distrusted)
            if not report or made is None or not _write_report(made, directory):
                break
    except MrbatchError as error:
        exit_code = worst_exit_code([exit_code, error.exit_code])
        events(tell.Note(f"the report could not be written: {error}"))
    except KeyboardInterrupt:
        result = replace(result, interrupted=True)
        exit_code = result.exit_code
    events(replace(result.last_event(time.perf_counter() - began), exit_code=exit_code))
    return JobOutcome(result, made, directory, exit_code)


def missed_targets(result: RunResult) -> list[str]:
    """Of frames that are there but not as good as the job asks for: a sentence each."""
    found = []
    for number, entry in sorted(result.entries.items()):
        told = entry.details.get("accuracy", {})
        if "target" in told and told["outcome"] != "reached":
            spp, relmse, _ = told["steps"][-1]
            why = {
                "limit": f"at the limit, {spp:.0f} samples a pixel on average",
                "converged-floor": "and more samples do not help: what is left is no noise",
            }[told["outcome"]]
            found.append(f"frame {number}: relMSE {relmse:.2g} in place of {told['target']:.2g}, {why}")
    return found


def _entry(prepared: Prepared, result: RunResult, timing: TimingNode, notes: list[str]) -> RunEntry:
    tree = timing.as_dict()
    # The frames' own lines say what they took.
    tree["children"] = [child for child in tree["children"] if child["name"] != "frames"]
    return RunEntry(
        job_hash=prepared.job_hash,
        seconds=timing.seconds,
        rendered=len(result.rendered),
        undone=result.undone,
        why=result.why_undone,
        error=str(result.error.message) if result.error else "",
        hint=(result.error.hint or "") if result.error else "",
        exit_code=result.exit_code,
        predicted=result.predicted,
        timing=tree,
        machine=machine(),
        versions=versions(),
        notes=tuple(notes),
    )


def _record(directory: Path, entry: RunEntry, owner: Owner) -> None:
    writer = JournalWriter(directory, owner)
    try:
        writer.append(entry)
    finally:
        writer.close()


def _previews(job: Job, prepared: Prepared, distrusted: Collection[int]) -> list[str]:
    """Of all frames that are there; gives what went wrong. Made again where another process has finished a
    frame meanwhile, so that whoever ends last leaves them whole."""
    directory = job.output.directory
    notes: list[str] = []
    seen: dict[int, str] | None = None
    for _ in range(MOST_AGAIN):
        held = holdings(directory, prepared.job_hash, JournalReader(directory), distrusted=distrusted)
        there = {number: entry.file_hash for number, entry in held.frames.items()}
        if there == seen:
            break
        notes = make_previews(
            directory,
            job.name,
            [(number, directory / entry.file) for number, entry in held.frames.items()],
            job.output.preview,
            transfer=prepared.facts.transfer,
            rate=prepared.facts.frame_rate,
            again=seen is not None,
        )
        seen = there
    return notes


def _write_report(made: Report, directory: Path) -> bool:
    """Writes it where it differs from the one that is there; says whether."""
    path, page = directory / REPORT, directory / PAGE
    try:
        if path.read_text(encoding="utf-8") == made.to_json() and page.is_file():
            return False
    except (OSError, UnicodeDecodeError):
        pass
    save_report(made, path)
    write_html(made, page, folder=directory)
    return True


class _Renderer:
    """`render(number, history)` of the run; the scene goes to the device at the first frame that needs it."""

    def __init__(
        self,
        prepared: Prepared,
        timing: TimingNode,
        threads: int | None,
        units_per_launch: int | None,
        events: tell.EventSink,
        forecast: tell.Forecast,
        referee: Callable[[int], Referee] | None = None,
    ) -> None:
        self._referee = referee
        self._prepared = prepared
        self._timing = timing
        self._threads = threads
        self._units = units_per_launch
        self._events = events
        self._forecast = forecast
        self._shot: ShotRenderer | None = None
        self._committed = False
        self._began = self._sampled = 0.0

    def __enter__(self) -> _Renderer:
        return self

    def __exit__(self, *_: object) -> None:
        if self._shot is not None:
            self._shot.close()

    def with_history(self, request: RunRequest) -> RunRequest:
        """The request, told whether frames hand on a state."""
        job = self._prepared.job
        if not (job.method_object.history or any(p.history for p in job.participant_objects)):
            return request
        return replace(request, history=self._renderer().has_history)

    def _renderer(self) -> ShotRenderer:
        if self._shot is None:
            self._events(tell.Note("building scene and kernels"))
            self._shot = ShotRenderer(
                self._prepared,
                self._timing,
                threads=self._threads,
                units_per_launch=self._units,
                progress=self._progress,
                referee=self._referee,
            )
        return self._shot

    def _progress(self, number: int, share: float) -> None:
        """Tells how far a frame is, and after its first samples how long the frames will take."""
        now = time.monotonic()
        if share == 0.0:
            self._sampled = now
            return
        self._events(tell.FrameProgress(number, share))
        whole = self._sampled - self._began + (now - self._sampled) / share
        prediction = self._forecast.foresee(whole, now - self._began)
        if prediction is not None:
            self._events(prediction)

    def __call__(self, number: int, history: Any) -> RenderedFrame:
        if not self._committed:
            commit_shot(self._prepared.job.output.directory, self._prepared.shot, Owner.here().name)
            self._committed = True
        shot = self._renderer()
        self._began = time.monotonic()
        return shot.render(number, history)


def plan_job(job: Job, *, progress: Progress = no_progress) -> Prepared:
    """Opens, solves and plans a job without rendering or writing anything."""
    return prepare(job, TimingNode(job.name), write=False, progress=progress)
