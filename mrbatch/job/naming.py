"""Where a job names the file that turned out to be wrong."""

from __future__ import annotations

import functools
import os
from collections.abc import Callable
from typing import Concatenate, ParamSpec, TypeVar

from mrbatch.errors import InputError, Place
from mrbatch.job.model import Job
from mrbatch.job.paths import job_paths

P = ParamSpec("P")
T = TypeVar("T")


def place_of_file(job: Job, file: str) -> Place | None:
    """Where the job names `file` for reading; links resolved. None where it does not."""
    wanted = os.path.realpath(file)
    for loc, path, written in job_paths(job):
        if not written and os.path.realpath(path) == wanted:
            return job.place(*loc)
    return None


def tells_where_named(function: Callable[Concatenate[Job, P], T]) -> Callable[Concatenate[Job, P], T]:
    """For functions of a job that read its files: their InputErrors also say where the job names the file."""

    @functools.wraps(function)
    def telling(job: Job, /, *args: P.args, **options: P.kwargs) -> T:
        try:
            return function(job, *args, **options)
        except InputError as error:
            if error.named is None and error.place is not None and error.place.file is not None:
                error.named = place_of_file(job, error.place.file)
            raise

    return telling
