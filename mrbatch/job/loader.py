"""Reads a job file: YAML, changes from the command line, models, paths; all errors at once."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from mrbatch.document import MAX_BYTES, Document, read_document, shorten
from mrbatch.errors import JobError, JobErrors, MrbatchError, Place
from mrbatch.job.choice import Loc
from mrbatch.job.confine import HINT, fence_of, leads_out, strays
from mrbatch.job.messages import dotted, job_errors
from mrbatch.job.model import Job
from mrbatch.job.overrides import Override, apply_overrides

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
) -> Job:
    """The job in the file `path`, with `overrides` such as `"virtual.bunny.material.roughness=0.2"`.

    Relative paths in the job count from the file's folder, those of overrides too. With `confine`,
    paths that lead out of that folder (links resolved) are refused. Whether the files are there is
    for `check_files`. Raises JobErrors with everything that is wrong.
    """
    file = Path(os.path.abspath(path))
    return parse_job(_read(file, Path(path)), file, overrides, confine=confine, shown=str(path))


def parse_job(
    text: str,
    file: Path,
    overrides: Sequence[Override] = (),
    *,
    confine: str | os.PathLike[str] | None = None,
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
        raise JobErrors(job_errors(error, document, Job)) from None
    return settle(job, document, file, file.parent, confine=confine)


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
            errors.append(
                JobError(
                    f"`{dotted(loc)}`: the path `{shorten(value)}` leads out of {fence}",
                    place=document.place(loc),
                    hint=HINT,
                )
            )
        return result

    job = map_paths(job, absolute)
    if errors:
        raise JobErrors(errors)
    job._file = file
    job._folder = folder
    job._fence = fence
    job._places = {**document.keys, **document.values}
    return job


def check_files(job: Job) -> None:
    """Whether every file that the job reads is there. Raises JobErrors that name all that are not."""
    errors: list[MrbatchError] = []
    for loc, path, written in job_paths(job):
        place = job.place(*loc)
        if written:
            if path.exists() and not path.is_dir():
                errors.append(JobError(f"`{dotted(loc)}`: {path} is a file, not a folder", place=place))
        elif not _there(path):
            errors.append(
                JobError(f"`{dotted(loc)}`: there is no file {path}", place=place, hint=_near(path))
            )
        elif path.exists() and not os.access(path, os.R_OK):
            errors.append(JobError(f"`{dotted(loc)}`: the file {path} may not be read", place=place))
        elif job.fence is not None:
            errors += strays(_there(path), job.fence, place)
    if errors:
        raise JobErrors(errors)


def job_paths(job: Job) -> Iterator[tuple[Loc, Path, bool]]:
    """Every path in the job: its place, the path, and whether it is written rather than read."""
    found: list[tuple[Loc, Path]] = []

    def note(value: Path, loc: Loc) -> Path:
        found.append((loc, value))
        return value

    map_paths(job, note)
    for loc, path in found:
        yield loc, path, loc == ("output", "directory")


def map_paths(value: Any, change: Callable[[Path, Loc], Path], loc: Loc = ()) -> Any:
    """`value` with `change` applied to every path in it, however deep."""
    if isinstance(value, Path):
        return change(value, loc)
    if isinstance(value, BaseModel):
        update = {}
        for name in type(value).model_fields:
            old = getattr(value, name)
            new = map_paths(old, change, (*loc, name))
            if new is not old:
                update[name] = new
        return value.model_copy(update=update) if update else value
    if isinstance(value, (tuple, list)):
        items = [map_paths(item, change, (*loc, i)) for i, item in enumerate(value)]
        return type(value)(items) if any(a is not b for a, b in zip(items, value)) else value
    if isinstance(value, dict):
        pairs = {key: map_paths(item, change, (*loc, key)) for key, item in value.items()}
        return pairs if any(pairs[key] is not value[key] for key in value) else value
    return value


def _read(file: Path, shown: Path) -> str:
    place = Place(file=str(shown))
    try:
        if file.is_dir():
            raise JobErrors([JobError("this is a folder, not a job file", place=place)])
        with file.open("rb") as stream:
            raw = stream.read(MAX_BYTES + 1)
    except FileNotFoundError:
        raise JobErrors([JobError("there is no such job file", place=place, hint=_near(file))]) from None
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


_PATTERN = re.compile(r"\{[^{}]*\}|%0?\d*d|#+|\*|\?")


def _there(path: Path) -> list[Path]:
    """The file of a path, or those of a pattern such as `photo_{frame:04d}.png`."""
    if path.exists():
        return [path]
    if not _PATTERN.search(path.name) or not path.parent.is_dir():
        return []
    wanted = re.compile(
        "".join(
            ".*" if _PATTERN.fullmatch(part) else re.escape(part)
            for part in re.split(f"({_PATTERN.pattern})", path.name)
        )
    )
    return [path.parent / name for name in sorted(os.listdir(path.parent)) if wanted.fullmatch(name)]


def _near(path: Path) -> str | None:
    """What stands where a missing file was looked for."""
    import difflib

    folder = path.parent
    if not folder.is_dir():
        return f"there is no folder {folder} either"
    try:
        names = os.listdir(folder)
    except OSError:
        return None
    near = difflib.get_close_matches(path.name, names, n=1)
    return f"did you mean `{near[0]}`?" if near else None
