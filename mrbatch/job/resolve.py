"""A job as plain data: whole, to be stored and read again; and the part that pixels depend on."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pydantic import BaseModel

from mrbatch.document import Document
from mrbatch.errors import Place
from mrbatch.job.choice import Loc
from mrbatch.job.loader import settle
from mrbatch.job.model import Job
from mrbatch.job.paths import map_paths


def resolved(job: Job) -> dict[str, Any]:
    """JSON-ready, every default filled in, keys in the models' order; itself a valid job.

    Quantities carry base units (`0.06 m`) and read back to the same bits. Paths below the job's
    folder are relative to it, with forward slashes, so the same job reads the same everywhere.
    """
    return _relative(job).model_dump(mode="json")


def pixel_relevant(job: Job) -> dict[str, Any]:
    """The part of `resolved` that can change a pixel: the job's share of the job hash.

    Left out, by their mark in the models: names, places and previews, the frames chosen, and
    `engine` (what it resolved to belongs to the hash, and is known in `prepare`). Files below the job's
    folder have their relative path, all others their name alone: where folders lie is no part of a picture,
    and what is in the files is hashed apart.
    """
    part = _pixels(job, _placeless(job).model_dump(mode="json"))
    # A frame that takes the place of a broken one is another picture; stopping or skipping is not.
    part["hold_last"] = job.on_error == "hold-last"
    return part


def rebuild(
    data: dict[str, Any], file: Path | None, folder: Path, places: dict[Loc, Place], fence: Path | None = None
) -> Job:
    """The job that `resolved` was made from. Raises ValidationError."""
    job = Job.model_validate(data, context=data)
    return settle(job, Document(data, {}, places), file, folder, confine=fence)


def _relative(job: Job) -> Job:
    def relative(path: Path, loc: Any) -> Path:
        return path.relative_to(job.folder) if path.is_relative_to(job.folder) else path

    return map_paths(job, relative)


def _placeless(job: Job) -> Job:
    return map_paths(job, lambda path, loc: Path(placeless(path, job.folder)))


def placeless(path: Path, folder: Path) -> str:
    """How hashes and files name an input: its path below `folder` with forward slashes, else its name."""
    return path.relative_to(folder).as_posix() if path.is_relative_to(folder) else path.name


def _pixels(value: Any, data: Any) -> Any:
    if isinstance(value, BaseModel):
        result = {}
        for name, field in type(value).model_fields.items():
            extra = field.json_schema_extra
            if not (isinstance(extra, dict) and extra.get("x-pixels") is False):
                result[name] = _pixels(getattr(value, name), data[name])
        return result
    if isinstance(value, (tuple, list)):
        return [_pixels(item, part) for item, part in zip(value, data)]
    if isinstance(value, dict):
        return {str(key): _pixels(value[key], data[key]) for key in sorted(value)}
    return data
