"""Whether the files that a job reads are there, and what stands where one was looked for."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path

from mrbatch.document import Document
from mrbatch.errors import JobError, JobErrors, MrbatchError, Place
from mrbatch.job.choice import Loc
from mrbatch.job.confine import leads_out, outside, strays
from mrbatch.job.messages import dotted
from mrbatch.job.model import Job
from mrbatch.job.paths import input_paths, job_paths


def check_files(job: Job) -> None:
    """Whether every file that the job reads is there. Raises JobErrors that name all that are not."""
    errors: list[MrbatchError] = []
    for loc, path, written in job_paths(job):
        place = job.place(*loc)
        if not written:
            errors += _wrong(loc, path, place, job.fence)
        elif path.exists() and not path.is_dir():
            errors.append(JobError(f"`{dotted(loc)}`: {path} is a file, not a folder", place=place))
    if errors:
        raise JobErrors(errors)


def missing_files(document: Document, folder: Path, fence: Path | None) -> list[MrbatchError]:
    """The same for the plain data of a job that has other errors, as far as its paths can be told."""
    errors: list[MrbatchError] = []
    for loc, value in input_paths(document.data):
        place = document.place(loc)
        path = Path(os.path.abspath(folder / value))
        if not str(value).isprintable():
            continue
        if fence is not None and leads_out(path, fence):
            errors.append(outside(loc, value, fence, place))
        else:
            errors += _wrong(loc, path, place, fence)
    return errors


def _wrong(loc: Loc, path: Path, place: Place | None, fence: Path | None) -> Iterator[MrbatchError]:
    found = there(path)
    if not found:
        yield JobError(f"`{dotted(loc)}`: there is no file {path}", place=place, hint=near(path))
    elif path.exists() and not os.access(path, os.R_OK):
        yield JobError(f"`{dotted(loc)}`: the file {path} may not be read", place=place)
    elif fence is not None:
        yield from strays(found, fence, place)


_PATTERN = re.compile(r"\{[^{}]*\}|%0?\d*d|#+|\*|\?")


def there(path: Path) -> list[Path]:
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


def near(path: Path) -> str | None:
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
