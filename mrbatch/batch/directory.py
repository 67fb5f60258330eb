"""The output folder: which job holds it, where frames lie, what dead processes left.

`job.json` names the job hash and what it was made of; the first process makes it, all others must agree.
"""

from __future__ import annotations

import contextlib
import errno
import json
import os
import string
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from mrbatch.batch.claim import Claims
from mrbatch.batch.commit import as_resource_error, flush_file, flush_folder, leftovers, temporary_name
from mrbatch.batch.differences import differences
from mrbatch.batch.journal import JournalReader
from mrbatch.batch.presence import Presence
from mrbatch.errors import JobError, Place
from mrbatch.report.numbers import short_hash

JOB_FILE = "job.json"


def frame_path(directory: Path, pattern: str, job_name: str, frame: int) -> Path:
    """Where a frame lies. Raises JobError for a pattern that cannot name frames inside the folder."""

    def wrong(why: str) -> JobError:
        return JobError(
            f"the file pattern `{pattern}` {why}",
            place=Place(file="output.pattern"),
            hint="write one like `{job}.{frame:04d}.exr`",
        )

    try:
        fields = [(name, spec) for _, name, spec, _ in string.Formatter().parse(pattern) if name is not None]
        if {name for name, _ in fields} - {"job", "frame"} or any("{" in (spec or "") for _, spec in fields):
            raise wrong("may use {job} and {frame} only")
        if "frame" not in {name for name, _ in fields}:
            raise wrong("does not contain {frame}")
        name = pattern.format(job=job_name, frame=frame)
    except (ValueError, IndexError, KeyError) as error:
        raise wrong(f"cannot be read ({error})") from error
    path = Path(name)
    if path.is_absolute() or path.drive or ".." in path.parts or not path.suffix or "\0" in name:
        raise wrong("must name a file with a suffix inside the output folder")
    return directory / path


def held_record(directory: Path) -> dict[str, Any] | None:
    """What `job.json` says: None if there is no such file, empty if it cannot be read.

    Keys: `job_hash`, `job`, `pattern`, and the facts that the job was made of (see `RunRequest.facts`).
    Raises ResourceError.
    """
    try:
        record = json.loads((directory / JOB_FILE).read_text(encoding="utf-8"))
        return record if isinstance(record, dict) and isinstance(record.get("job_hash"), str) else {}
    except FileNotFoundError:
        return None
    except (ValueError, RecursionError):
        return {}
    except OSError as error:
        raise as_resource_error(error, directory / JOB_FILE) from error


def held_hash(directory: Path) -> str | None:
    """The job hash in `job.json`: None if there is no such file, empty if it cannot be read."""
    record = held_record(directory)
    return None if record is None else record.get("job_hash", "")


def check_writable(directory: Path) -> None:
    """Whether frames can be written there, as far as that shows without writing. Raises ResourceError."""
    place = directory
    while not place.exists() and place != place.parent:
        place = place.parent
    if not place.is_dir():
        raise as_resource_error(OSError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(place)), place)
    if not os.access(place, os.W_OK | os.X_OK):
        read_only = hasattr(os, "statvfs") and os.statvfs(place).f_flag & os.ST_RDONLY
        number = errno.EROFS if read_only else errno.EACCES
        raise as_resource_error(OSError(number, os.strerror(number), str(place)), place)


def check_holder(directory: Path, facts: Mapping[str, Any]) -> None:
    """Refuses a folder that another job holds, as far as some `facts` of this one already tell.

    Raises JobError.
    """
    held = held_record(directory)
    if held and (found := _differences(held, facts)):
        raise _another_job(directory, held["job_hash"], "", found)


def _differences(held: Mapping[str, Any], facts: Mapping[str, Any]) -> list[str]:
    try:
        return differences(held, facts)
    except (TypeError, ValueError):
        return []  # a damaged job.json: its hash alone decides


def check_strangers(targets: Iterable[Path]) -> None:
    """Raises JobError where a file of a frame's name is there that no journal knows."""
    strangers = [path for path in targets if path.exists()]
    if strangers:
        raise JobError(
            f"`{strangers[0]}` is there already, and not from this program's journal"
            + (f" ({len(strangers)} such files)" if len(strangers) > 1 else ""),
            hint="choose another folder with --output, or replace the files with --overwrite",
        )


def _another_job(directory: Path, held: str, job_hash: str, found: list[str]) -> JobError:
    hashes = f"hash {short_hash(held)}" + (f", this one is {short_hash(job_hash)}" if job_hash else "")
    changed = "".join(f"\n    {line}" for line in found)
    return JobError(
        f"`{directory}` holds frames of another job ({hashes})"
        + (f"; what differs, there -> here:{changed}" if changed else ""),
        hint="choose another folder with --output, or replace those frames with --overwrite",
    )


def hold(
    directory: Path,
    *,
    job_name: str,
    job_hash: str,
    pattern: str,
    targets: Iterable[Path],
    overwrite: bool,
    presence: Presence,
    journal: JournalReader,
    facts: Mapping[str, Any] | None = None,
) -> None:
    """Take the folder for this job, or agree with the process that did.

    Raises JobError where the folder belongs to another job, or holds files of the frames' names of
    which nothing is known, unless `overwrite`; and where a living process renders another job into
    it, whatever `overwrite` says. `facts` are kept in `job.json`. Raises ResourceError.
    """
    facts = facts or {}
    record = held_record(directory)
    held = None if record is None else record.get("job_hash", "")
    if held == job_hash:
        return
    known = {entry.job_hash for entries in journal.frames.values() for entry in entries}
    if not overwrite:
        if held or known - {job_hash}:
            other = held or sorted(known - {job_hash})[0]
            found = _differences(record or {}, facts) if held else []
            raise _another_job(directory, other, job_hash, found)
        if held is None and job_hash not in known:
            check_strangers(targets)
    if held:
        rivals = presence.rivals()
        if rivals:
            raise JobError(
                f"`{directory}` is in use: {rivals[0]} renders another job into it",
                hint="wait until it has ended, or choose another folder with --output",
            )
    content = {"schema": 2, "job": job_name, "job_hash": job_hash, "pattern": pattern, **facts}
    _write_job_file(directory, content, presence.owner.name, replace=held is not None)
    if held_hash(directory) != job_hash:
        raise JobError(
            f"`{directory}` was just taken by another job",
            hint="choose another folder with --output",
        )


def _write_job_file(directory: Path, record: Mapping[str, Any], owner: str, *, replace: bool) -> None:
    final = directory / JOB_FILE
    temporary = temporary_name(final, owner)
    try:
        temporary.write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")
        flush_file(temporary)
        if replace:
            os.replace(temporary, final)
        else:
            _rename_if_absent(temporary, final)
        flush_folder(directory)
    except OSError as error:
        raise as_resource_error(error, final) from error
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


def _rename_if_absent(temporary: Path, final: Path) -> None:
    """Give `temporary` the name `final`, whole, unless that exists. Raises OSError."""
    try:
        os.link(temporary, final)
    except FileExistsError:
        return
    except OSError:
        # No hard links here (exFAT, some shares): not atomic, but the reader finds a torn file.
        with contextlib.suppress(FileExistsError), final.open("xb") as file:
            file.write(temporary.read_bytes())
            file.flush()
            os.fsync(file.fileno())


def sweep(folders: Iterable[Path], presence: Presence, claims: Claims) -> int:
    """Remove what dead processes left: temporary files (counted), claims, signs of life."""
    count = 0
    for path, owner in leftovers(folders):
        try:
            if presence.is_alive(owner, path):
                continue
            path.unlink(missing_ok=True)
            count += 1
        except OSError as error:
            raise as_resource_error(error, path) from error
    claims.sweep()
    return count
