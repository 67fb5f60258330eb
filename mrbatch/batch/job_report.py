"""The report of a job, drawn from its folder alone: what every run and process left there.

`job.json` says what the job was made of, `shot/` what was planned, the journal what each frame and run
took. So the report holds all frames that are there, whoever rendered them, and a run that changes
nothing changes no report.
"""

from __future__ import annotations

import contextlib
import platform
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from mrbatch import __version__
from mrbatch.batch.directory import held_record
from mrbatch.batch.journal import FailureEntry, FrameEntry, JournalReader, RunEntry
from mrbatch.batch.previews import MOVIE, SHEET
from mrbatch.batch.shot import Shot, load_shot
from mrbatch.batch.shot_facts import shot_facts, told_by_capture
from mrbatch.contracts import Told
from mrbatch.device.runner import usable_cores
from mrbatch.device.timing import TimingNode, timing_from_dict
from mrbatch.errors import (
    EXIT_FRAMES,
    EXIT_INPUT,
    EXIT_INTERRUPTED,
    InputError,
    JobError,
    Place,
    worst_exit_code,
)
from mrbatch.methods.registry import method as find_method
from mrbatch.methods.registry import participant as find_participant
from mrbatch.metrics.noise import CONFIDENCE
from mrbatch.report.gallery import MAX_FRAMES_SHOWN
from mrbatch.report.model import (
    Effect,
    File,
    Frame,
    NoiseBlocks,
    Note,
    Picture,
    Plan,
    Report,
    Run,
    Totals,
    Value,
)
from mrbatch.report.model import Job as ReportedJob
from mrbatch.report.model import TimingNode as ReportedTiming


@dataclass(frozen=True)
class Holdings:
    """What the journal knows of one job in one folder, as far as the files are still there.

    `frames` that are there, stand-ins included; `failures`: the latest of each frame that is not;
    `undone`: why a frame that was asked for is not there; `runs` in the order of their ends.
    """

    frames: Mapping[int, FrameEntry]
    failures: Mapping[int, FailureEntry]
    undone: Mapping[int, str]
    runs: tuple[RunEntry, ...]

    @property
    def own(self) -> dict[int, FrameEntry]:
        """Frames with a picture of their own."""
        return {number: entry for number, entry in self.frames.items() if entry.held_from is None}


def holdings(
    directory: Path, job_hash: str, journal: JournalReader, *, distrusted: Collection[int] = ()
) -> Holdings:
    """A file counts as there by its size: it is complete under its final name, and whoever renders hashes it.

    `distrusted`: frames known to be corrupt. Raises ResourceError.
    """
    frames: dict[int, FrameEntry] = {}
    for number in sorted(journal.frames):
        there = [e for e in journal.matching(number, job_hash) if _is_there(directory, e)]
        if there and number not in distrusted:
            frames[number] = max(there, key=lambda entry: entry.time)
    failures: dict[int, FailureEntry] = {}
    for number, several in journal.failures.items():
        ours = [entry for entry in several if entry.job_hash == job_hash]
        held = number not in frames or frames[number].held_from is not None
        if ours and held:
            failures[number] = max(ours, key=lambda entry: entry.time)
    runs = sorted((run for run in journal.runs if run.job_hash == job_hash), key=lambda run: run.time)
    undone = {
        number: run.why
        for run in runs
        for number in run.undone
        if number not in frames and number not in failures
    }
    return Holdings(frames, dict(sorted(failures.items())), undone, tuple(runs))


def _is_there(directory: Path, entry: FrameEntry) -> bool:
    try:
        return (directory / entry.file).stat().st_size == entry.size
    except (OSError, ValueError):
        return False


def report_of(
    directory: Path, job_hash: str | None = None, *, distrusted: Collection[int] = ()
) -> Report | None:
    """The report of the job that holds the folder.

    None where no job does, another one than `job_hash`, or one of an older version that did not write down
    what it was made of. Raises ResourceError, InputError where the folder's records are damaged.
    """
    try:
        return _report_of(directory, job_hash, distrusted)
    except (ValueError, TypeError, KeyError, AttributeError, IndexError) as error:
        raise InputError(
            f"the job's records are damaged ({type(error).__name__})",
            place=Place(file=str(directory)),
            hint="render into another folder, or take away job.json, journal/ and shot/ here",
        ) from error


def _report_of(directory: Path, job_hash: str | None, distrusted: Collection[int]) -> Report | None:
    record = held_record(directory)
    if not record or "settings" not in record or job_hash not in (None, record["job_hash"]):
        return None
    held = holdings(directory, record["job_hash"], JournalReader(directory), distrusted=distrusted)
    shot = load_shot(directory, str(record.get("key", "")))
    there = list(held.own.values())
    told = told_by_capture(record, shot)
    frames = tuple(_frames(held, told))
    timing = _timing(str(record.get("job", "")), held)
    busy = sum(entry.seconds for entry in there)
    counters = _added(entry.counters for entry in there)
    rays = sum(count for name, count in counters.items() if name.endswith("rays"))
    last = held.runs[-1] if held.runs else None
    stamps = [run.time for run in held.runs] + [entry.time for entry in there]
    alone = held.runs[0] if len(held.runs) == 1 else None
    return Report(
        job=ReportedJob(
            name=str(record.get("job", "")),
            hash=record["job_hash"],
            method=record.get("method", ""),
            capture=record.get("capture", ""),
            seed=record.get("seed"),
            settings=record["settings"],
        ),
        versions=dict(last.versions) if last else {},
        machine=dict(last.machine) if last else {},
        created=_date(max(stamps, default=0.0)),
        facts=shot_facts(record, shot, there, told),
        files=tuple(File(path=name) for name in (MOVIE, SHEET) if there and (directory / name).is_file()),
        plan=Plan(effects=_effects(record, shot)),
        frames=frames,
        timing=ReportedTiming.model_validate(timing.as_dict()),
        totals=Totals(
            seconds=Value(value=timing.seconds, unit="s", repetitions=1),
            frame_seconds=Value(value=busy, unit="s", repetitions=1),
            predicted_seconds=None
            if alone is None or alone.predicted is None
            else Value(value=alone.predicted, unit="s"),
            frames_done=len(there),
            frames_failed=sum(frame.state == "failed" for frame in frames),
            frames_skipped=sum(frame.state == "skipped" for frame in frames),
            rays_per_second=Value(value=rays / busy, unit="rays/s") if busy > 0 else None,
            counters=counters,
        ),
        runs=tuple(_run(run) for run in held.runs),
        notes=tuple(_notes(record, shot, held)),
        pictures=tuple(_pictures(directory, record.get("layers", ()), held)),
        exit=_exit(held, frames),
    )


def _frames(held: Holdings, told: Told) -> list[Frame]:
    frames = []
    for number in sorted({*held.frames, *held.failures, *held.undone}):
        entry, failure = held.frames.get(number), held.failures.get(number)
        if entry is not None and entry.held_from is None:
            frames.append(_done(entry, told.frames.get(number, {})))
        elif entry is not None or failure is not None:
            frames.append(_failed(number, entry, failure))
        else:
            frames.append(Frame(number=number, state="skipped", message=f"not tried: {held.undone[number]}"))
    return frames


def _error(details: Mapping[str, Any]) -> Value:
    low, high = details.get("error_interval") or (None, None)
    return Value(
        value=float(details.get("error", 0.0)),
        unit="relMSE",
        low=low,
        high=high,
        confidence=None if low is None else CONFIDENCE,
        repetitions=details.get("samples"),
    )


def _done(entry: FrameEntry, measured: Mapping[str, tuple[float, str]]) -> Frame:
    return Frame(
        number=entry.frame,
        state="done",
        outcome=entry.details.get("accuracy", {}).get("outcome", "fixed"),
        time=entry.details.get("time"),
        seconds=Value(value=entry.seconds, unit="s", repetitions=1),
        error=_error(entry.details),
        samples=entry.details.get("samples"),
        numbers={name: Value(value=value, unit=unit) for name, (value, unit) in measured.items()},
        counters=dict(entry.counters),
        flags=tuple(entry.details.get("flags", ())),
        files=(_file(entry),),
    )


def _failed(number: int, entry: FrameEntry | None, failure: FailureEntry | None) -> Frame:
    message = (failure.message or failure.error) if failure else entry.error if entry else ""
    return Frame(
        number=number,
        state="failed",
        message=message,
        hint=failure.hint if failure else "",
        exit=failure.exit_code if failure else EXIT_INPUT,
        flags=() if entry is None else (f"shows frame {entry.held_from}",),
        files=() if entry is None else (_file(entry),),
    )


def _file(entry: FrameEntry) -> File:
    return File(path=entry.file, hash=entry.file_hash, bytes=entry.size)


def _timing(name: str, held: Holdings) -> TimingNode:
    """Where the time of all runs went: their own trees, and the frames' from the frames that are there.

    A run that was killed left no line; of it only the frames count.
    """
    root = TimingNode(name)
    for run in held.runs:
        with contextlib.suppress(KeyError, TypeError, ValueError):
            tree = timing_from_dict(run.timing)
            root.merge(tree)
            root.seconds += run.seconds - tree.seconds
    recorded = {run.run for run in held.runs}
    for entry in held.own.values():
        with contextlib.suppress(KeyError, TypeError, ValueError):
            tree = timing_from_dict(entry.details["timing"])
            tree.name = "frames"
            root.child("frames").merge(tree)
        write = root.child("write frames")
        write.seconds += entry.write_seconds
        write.calls += 1
        if entry.run not in recorded:
            root.seconds += entry.seconds + entry.write_seconds
    return root


def _added(several: Iterable[Mapping[str, int]]) -> dict[str, int]:
    total: dict[str, int] = {}
    for counters in several:
        for name, count in counters.items():
            total[name] = total.get(name, 0) + count
    return total


def _run(run: RunEntry) -> Run:
    return Run(
        created=_date(run.time),
        seconds=Value(value=run.seconds, unit="s", repetitions=1),
        frames=run.rendered,
        predicted_seconds=None if run.predicted is None else Value(value=run.predicted, unit="s"),
        exit=run.exit_code,
        message=run.why,
    )


def _date(seconds: float) -> str:
    return datetime.fromtimestamp(seconds, UTC).isoformat(timespec="seconds") if seconds > 0 else ""


def _effects(record: Mapping[str, Any], shot: Shot | None) -> tuple[Effect, ...]:
    if shot is None:
        return ()
    meanings = _meanings(record)
    return tuple(
        Effect(
            name=name,
            state=v.state,
            why=v.why,
            meaning=meanings.get(name, ""),
            bound=v.bound,
            numbers=dict(v.numbers),
        )
        for name, v in shot.plan.effects.items()
    )


def _meanings(record: Mapping[str, Any]) -> dict[str, str]:
    """What each effect means; nothing for methods that this installation does not have."""
    found: dict[str, str] = {}
    participants = [part.get("type", "") for part in record["settings"].get("participants", ())]
    with contextlib.suppress(JobError):
        for name in participants:
            found |= {rule.effect: rule.meaning for rule in find_participant(name).rules}
        found |= {rule.effect: rule.meaning for rule in find_method(record.get("method", "")).rules}
    return found


def _notes(record: Mapping[str, Any], shot: Shot | None, held: Holdings) -> list[Note]:
    notes = [Note(level="info", text=text) for text in (shot.notes if shot else ())]
    kind = record["settings"].get("output", {}).get("filter", {}).get("kind", "none")
    if kind != "none":
        text = f"the frames went through the filter `{kind}`; noise is told as it was before it"
        notes.append(Note(level="info", text=text))
    if held.runs:
        notes += [Note(level="warning", text=text) for text in held.runs[-1].notes]
    for run in _cut_short(held):
        text = f"{run.error or run.why}" + (f" (hint: {run.hint})" if run.hint else "")
        missing = sum(number in held.undone for number in run.undone)
        notes.append(Note(level="error", text=f"{text}; {missing} of its frames are still missing"))
    return notes


def _cut_short(held: Holdings) -> list[RunEntry]:
    """The latest run of those that left frames undone which nobody has done since."""
    return [run for run in held.runs if any(number in held.undone for number in run.undone)][-1:]


def _exit(held: Holdings, frames: Sequence[Frame]) -> int:
    codes = [run.exit_code for run in _cut_short(held)]
    if EXIT_INTERRUPTED in codes:
        return EXIT_INTERRUPTED
    if any(frame.state == "failed" for frame in frames):
        codes.append(EXIT_FRAMES if held.own else EXIT_INPUT)
    return worst_exit_code(codes)


def _pictures(directory: Path, layers: Collection[str], held: Holdings) -> list[Picture]:
    pictures = []
    there = list(held.own.values())
    if there and (directory / SHEET).is_file():
        count = len(held.frames)
        caption = "1 frame" if count == 1 else f"{count} frames"
        pictures.append(Picture(role="sheet", path=SHEET, caption=caption))
    for entry in _chosen(there):
        number, name = entry.frame, entry.file
        pictures.append(Picture(role="composite", path=name, frame=number))
        if "background" in layers:
            pictures.append(Picture(role="photo", path=name, layer="background", frame=number))
        if "delta" in layers:
            pictures.append(Picture(role="delta", path=name, layer="delta", frame=number))
        for view, about in (entry.details.get("noise") or {}).items():
            with contextlib.suppress(ValidationError):
                blocks = NoiseBlocks.model_validate(about)
                pictures.append(Picture(role="error", path=name, frame=number, view=view, noise=blocks))
                break  # the page shows a frame's first view
    return pictures


def _chosen(there: Sequence[FrameEntry], most: int = MAX_FRAMES_SHOWN) -> list[FrameEntry]:
    """A few frames over the shot, first and last among them."""
    if len(there) <= most:
        return list(there)
    return [there[round(i * (len(there) - 1) / (most - 1))] for i in range(most)]


def machine() -> dict[str, str]:
    """What may differ without changing a pixel."""
    return {
        "system": platform.platform(),
        "processor": platform.processor() or platform.machine(),
        "cores": str(usable_cores()),
    }


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
