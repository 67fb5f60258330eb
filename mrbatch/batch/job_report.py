"""The report of a job: frames, plan, timing and pictures, as the pages show them."""

from __future__ import annotations

import platform
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from mrbatch import __version__
from mrbatch.batch.prepare import Prepared
from mrbatch.batch.previews import make_previews
from mrbatch.batch.request import RunRequest, RunResult
from mrbatch.contracts import Method, Participant
from mrbatch.device.runner import usable_cores
from mrbatch.device.timing import TimingNode
from mrbatch.job.model import Job
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
)
from mrbatch.report.model import Job as ReportedJob
from mrbatch.report.model import TimingNode as ReportedTiming


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
