"""A whole job: prepare, frames, previews, report."""

from __future__ import annotations

import platform
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from mrbatch import __version__
from mrbatch.batch import events as tell
from mrbatch.batch.prepare import Prepared, prepare
from mrbatch.batch.presence import Owner
from mrbatch.batch.previews import make_previews
from mrbatch.batch.render import RenderedFrame, ShotRenderer
from mrbatch.batch.request import RunRequest, RunResult
from mrbatch.batch.run import run
from mrbatch.batch.shot import commit_shot
from mrbatch.contracts import Method, Participant
from mrbatch.device.runner import usable_cores
from mrbatch.device.timing import TimingNode
from mrbatch.errors import MrbatchError, worst_exit_code
from mrbatch.film.exr import verify_frame
from mrbatch.job import select_frames
from mrbatch.job.model import Job
from mrbatch.report.html import write_html
from mrbatch.report.model import (
    Effect,
    File,
    Frame,
    Note,
    Picture,
    Plan,
    Report,
    Totals,
    Value,
    save_report,
)
from mrbatch.report.model import Job as ReportedJob
from mrbatch.report.model import TimingNode as ReportedTiming

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


def make_report(
    job: Job,
    prepared: Prepared,
    request: RunRequest,
    result: RunResult,
    timing: TimingNode,
    *,
    report: bool = True,
) -> Report:
    """The report of a run; with `report` the previews are made too."""
    directory = request.directory
    frames: list[Frame] = []
    notes = [Note(level="info", text=text) for text in prepared.shot.notes]
    failed = {f.frame: f for f in result.failed}
    for number in request.frames:
        if number in failed:
            broken = failed[number]
            frames.append(
                Frame(
                    number=number,
                    state="failed",
                    message=broken.error.message,
                    hint=broken.error.hint or "",
                    exit=broken.error.exit_code,
                )
            )
            continue
        entry = result.entries.get(number)
        if entry is None:
            frames.append(Frame(number=number, state="skipped", message="not reached"))
            continue
        frames.append(
            Frame(
                number=number,
                state="kept" if number in result.kept else "done",
                outcome="fixed",
                time=entry.details.get("time"),
                seconds=Value(value=entry.seconds, unit="s", repetitions=1),
                error=Value(value=float(entry.details.get("error", 0.0)), unit="relMSE"),
                counters=dict(entry.counters),
                flags=tuple(entry.details.get("flags", ())),
                files=(File(path=entry.file, hash=entry.file_hash, bytes=entry.size),),
            )
        )
    there = [(f.number, request.path(f.number)) for f in frames if f.state in ("done", "kept")]
    pictures: list[Picture] = []
    if report and there:
        with timing.measure("previews"):
            pictures, more = make_previews(
                directory,
                job.name,
                there,
                job.output.preview,
                transfer=prepared.facts.transfer,
                rate=prepared.facts.frame_rate,
            )
        notes += more
        for number, path in _chosen(there):
            name = path.relative_to(directory).as_posix()
            pictures.append(Picture(role="composite", path=name, frame=number))
            if "background" in prepared.layers:
                pictures.append(Picture(role="photo", path=name, layer="background", frame=number))
            if "delta" in prepared.layers:
                pictures.append(Picture(role="delta", path=name, layer="delta", frame=number))
            if "variance" in prepared.layers:
                pictures.append(Picture(role="error", path=name, layer="variance", frame=number))
    counters: dict[str, int] = {}
    for frame in frames:
        for name, count in frame.counters.items():
            counters[name] = counters.get(name, 0) + count
    rays = sum(count for name, count in timing.total_counters().items() if name.endswith("rays"))
    busy = sum(entry.seconds for n, entry in result.entries.items() if n in result.rendered)
    timing.seconds, timing.calls = result.seconds, 1
    owners: list[Method | Participant] = [*job.participant_objects, job.method_object]
    rules = [rule for owner in owners for rule in owner.rules]
    meanings = {rule.effect: rule.meaning for rule in rules}
    return Report(
        job=ReportedJob(
            name=job.name,
            hash=prepared.job_hash,
            method=job.method_name,
            capture=job.capture_kind,
            seed=job.seed,
            settings=_settings(job),
        ),
        versions=versions(),
        machine={
            "system": platform.platform(),
            "processor": platform.processor() or platform.machine(),
            "cores": str(usable_cores()),
        },
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        plan=Plan(
            effects=tuple(
                Effect(
                    name=name,
                    state=v.state,
                    why=v.why,
                    meaning=meanings.get(name, ""),
                    bound=v.bound,
                    numbers=dict(v.numbers),
                )
                for name, v in prepared.shot.plan.effects.items()
            )
        ),
        frames=tuple(frames),
        timing=ReportedTiming.model_validate(timing.as_dict()),
        totals=Totals(
            seconds=Value(value=result.seconds, unit="s", repetitions=1),
            predicted_seconds=None if result.predicted is None else Value(value=result.predicted, unit="s"),
            frames_done=len(result.rendered),
            frames_kept=len(result.kept),
            frames_failed=len(result.failed),
            frames_skipped=len(result.undone),
            rays_per_second=Value(value=rays / busy, unit="rays/s") if busy > 0 else None,
            counters=counters,
        ),
        notes=tuple(notes),
        pictures=tuple(pictures),
        exit=result.exit_code,
    )


def _settings(job: Job) -> dict[str, Any]:
    from mrbatch.job.resolve import pixel_relevant

    return pixel_relevant(job)


def _chosen(there: Sequence[tuple[int, Path]], most: int = 4) -> list[tuple[int, Path]]:
    """A few frames over the shot, first and last among them."""
    if len(there) <= most:
        return list(there)
    return [there[round(i * (len(there) - 1) / (most - 1))] for i in range(most)]


def versions() -> dict[str, str]:
    """Of this program and of the libraries that pixels pass through."""
    from importlib.metadata import PackageNotFoundError, version

    found = {"mrbatch": __version__, "python": platform.python_version()}
    for name in ("warp-lang", "embreex", "numpy", "OpenImageIO", "opencv-contrib-python-headless", "av"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "absent"
    return found


def plan_job(job: Job) -> Prepared:
    """Opens, solves and plans a job without rendering or writing anything."""
    return prepare(job, TimingNode(job.name), write=False)
