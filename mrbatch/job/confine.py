"""`--confine DIR`: nothing is read or written outside of one folder, links followed."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from pathlib import Path

from mrbatch.document import shorten
from mrbatch.errors import JobError, JobErrors, MrbatchError, Place
from mrbatch.job.choice import Loc
from mrbatch.job.messages import dotted

HINT = "the job was confined to that folder by --confine"
MOST = 10
"""Files that are named at most."""


def fence_of(folder: str | os.PathLike[str] | None) -> Path | None:
    """The folder with all links resolved, None for none."""
    return None if folder is None else Path(os.path.realpath(folder))


def leads_out(path: Path, fence: Path) -> bool:
    """Whether a path, its links followed as far as they exist, lies outside of the fence."""
    return not Path(os.path.realpath(path)).is_relative_to(fence)


def outside(loc: Loc, value: Path, fence: Path, place: Place | None) -> MrbatchError:
    """The error for a path of a job that leads out, as it was written there."""
    return JobError(
        f"`{dotted(loc)}`: the path `{shorten(value)}` leads out of {fence}", place=place, hint=HINT
    )


def check_confined(files: Sequence[Path], fence: Path | None) -> None:
    """Raises JobErrors that name the files outside of the fence; no fence holds everything."""
    if fence is not None:
        errors = strays(files, fence)
        if errors:
            raise JobErrors(errors)


def strays(files: Iterable[Path], fence: Path, place: Place | None = None) -> list[MrbatchError]:
    """An error for each file outside of the fence, up to `MOST`; `place`: of the key that names them."""
    found = [path for path in dict.fromkeys(files) if leads_out(path, fence)]
    return [
        JobError(
            f"the file {shorten(path, 200)} leads out of {fence}",
            place=place or Place(file=str(path)),
            hint=HINT if len(found) <= MOST else f"{HINT}; {len(found)} files lead out of it",
        )
        for path in found[:MOST]
    ]
