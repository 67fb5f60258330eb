"""A whole job: prepare, frames, previews, report."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from mrbatch.batch import events as tell
from mrbatch.batch.job_report import make_report
from mrbatch.batch.prepare import Prepared, prepare
from mrbatch.batch.presence import Owner
from mrbatch.batch.render import RenderedFrame, ShotRenderer
from mrbatch.batch.request import RunRequest, RunResult
from mrbatch.batch.run import run
from mrbatch.batch.shot import commit_shot
from mrbatch.device.timing import TimingNode
from mrbatch.errors import MrbatchError, worst_exit_code
from mrbatch.film.exr import verify_frame
from mrbatch.job import select_frames
from mrbatch.job.model import Job
from mrbatch.report.html import write_html
from mrbatch.report.model import Report, save_report

REPORT, PAGE = "report.json", "report.html"


@dataclass(frozen=True)
class JobOutcome:
    """How a job ended: the run's result, the report, and the exit code of the command."""

    result: RunResult
    report: Report
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
) -> JobOutcome:
    """Renders the frames of a job that are not there yet, then previews and report.

    Raises JobError, InputError or ResourceError for what makes the whole job impossible; what happens
    to single frames stands in the outcome.
    """
    timing = TimingNode(job.name)
    directory = job.output.directory
    with timing.measure("prepare") as node:
        prepared = prepare(job, node, directory=None if not directory.is_dir() else directory, write=False)
    frames = select_frames(job.frames, prepared.shot.frames, place=job.place("frames"))
    request = RunRequest(
        directory=directory,
        pattern=job.output.pattern,
        job_name=job.name,
        job_hash=prepared.job_hash,
        frames=frames,
        overwrite=overwrite,
        on_error=job.on_error,
        history=False,
        segments=prepared.shot.segments,
    )
    forecast = tell.Forecast()
    with _Renderer(prepared, timing, threads, units_per_launch, events, forecast) as render:
        request = render.with_history(request)
        result = run(request, render, verify_frame, events=events, stop=stop, forecast=forecast)
    exit_code = result.exit_code
    made = make_report(job, prepared, request, result, timing, report=report)
    if report:
        try:
            save_report(made, directory / REPORT)
            write_html(made, directory / PAGE, folder=directory)
        except MrbatchError as error:
            exit_code = worst_exit_code([exit_code, error.exit_code])
            events(tell.Note(f"the report could not be written: {error}"))
    return JobOutcome(result, made, directory, exit_code)


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
    ) -> None:
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


def plan_job(job: Job) -> Prepared:
    """Opens, solves and plans a job without rendering or writing anything."""
    return prepare(job, TimingNode(job.name), write=False)
