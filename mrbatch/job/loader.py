"""Reads a job file: YAML, changes from the command line, models, paths; all errors at once."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path

from pydantic import ValidationError

from mrbatch.document import MAX_BYTES, Document, read_document
from mrbatch.errors import JobError, JobErrors, MrbatchError, Place
from mrbatch.job.choice import Loc
from mrbatch.job.confine import fence_of, leads_out, outside
from mrbatch.job.files import missing_files, near
from mrbatch.job.messages import dotted, job_errors
from mrbatch.job.model import Job
from mrbatch.job.overrides import Override, apply_overrides
from mrbatch.job.paths import map_paths

_START = """a job begins like this (`mrbatch schema --manual` explains every key):
    capture: {kind: marker-video, frames: footage.mp4, camera: calibration.yaml, ...}
    virtual: [{name: bunny, mesh: bunny.ply}]
    method: {name: delta-path-tracing}
    output: {directory: out}"""


def load_job(
    path: str | os.PathLike[str],
    overrides: Sequence[Override] = (),
    *,
    confine: str | os.PathLike[str] | None = None,
    files: bool = False,
) -> Job:
    """The job in the file `path`, with `overrides` such as `"virtual.bunny.material.roughness=0.2"`.

    Relative paths in the job count from the file's folder, those of overrides too. With `confine`,
    paths that lead out of that folder (links resolved) are refused. Whether the files are there is
    for `check_files`; with `files`, a job that has errors names its missing files beside them. Raises
    JobErrors with everything that is wrong.
    """
    file = Path(os.path.abspath(path))
    return parse_job(_read(file, Path(path)), file, overrides, confine=confine, files=files, shown=str(path))


def parse_job(
    text: str,
    file: Path,
    overrides: Sequence[Override] = (),
    *,
    confine: str | os.PathLike[str] | None = None,
    files: bool = False,
    shown: str | None = None,
) -> Job:
    """The job in `text`, as if it stood in `file` (absolute). Raises JobErrors."""
    document = read_document(text, shown or str(file))
    if document.data in (None, {}):
        raise JobErrors([JobError("the job is empty", place=Place(file=shown or str(file)), hint=_START)])
    apply_overrides(document, overrides)
    if isinstance(document.data, dict) and "name" not in document.data:
        document.data["name"] = _name_from(file)
    try:
        job = Job.model_validate(document.data, context=document.data)
    except ValidationError as error:
        errors: list[MrbatchError] = [*job_errors(error, document, Job)]
        if files:
            errors += missing_files(document, file.parent, fence_of(confine))
        raise JobErrors(sorted(errors, key=_position)) from None
    return settle(job, document, file, file.parent, confine=confine)


def _position(error: MrbatchError) -> tuple[int, int]:
    place = error.place or Place()
    return place.line or 0, place.column or 0


def settle(
    job: Job,
    document: Document,
    file: Path | None,
    folder: Path,
    *,
    confine: str | os.PathLike[str] | None = None,
) -> Job:
    """Makes all paths absolute, checks them against `confine`, and notes where things stood."""
    errors: list[MrbatchError] = []
    fence = fence_of(confine)

    def absolute(value: Path, loc: Loc) -> Path:
        if any(not c.isprintable() for c in str(value)):
            errors.append(
                JobError(f"`{dotted(loc)}`: control characters in a path", place=document.place(loc))
            )
            return value
        result = Path(os.path.abspath(folder / value))
        if fence is not None and leads_out(result, fence):
            errors.append(outside(loc, value, fence, document.place(loc)))
        return result

    job = map_paths(job, absolute)
    if errors:
        raise JobErrors(errors)
    job._file = file
    job._folder = folder
    job._fence = fence
    job._places = {**document.keys, **document.values}
    return job


def _read(file: Path, shown: Path) -> str:
    place = Place(file=str(shown))
    try:
        if file.is_dir():
            raise JobErrors([JobError("this is a folder, not a job file", place=place)])
        with file.open("rb") as stream:
            raw = stream.read(MAX_BYTES + 1)
    except FileNotFoundError:
        raise JobErrors([JobError("there is no such job file", place=place, hint=near(file))]) from None
    except OSError as error:
        raise JobErrors([JobError(f"cannot read the job file: {error.strerror}", place=place)]) from None
    if len(raw) > MAX_BYTES:
        raise JobErrors([JobError(f"the job file is larger than {MAX_BYTES >> 10} KiB", place=place)])
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        where = Place(file=str(shown), byte=error.start)
        raise JobErrors([JobError("the job file is not UTF-8 text", place=where)]) from None


def _name_from(file: Path) -> str:
    name = re.sub(r"[^\w .+-]", "_", file.stem)[:100]
    return name if re.match(r"\w", name) else f"job{name}"
