"""How a file comes to be: written aside, read back, flushed, renamed. Under its final name it is complete.

The name aside (`.tmp-<owner>~<n><suffix>`) lies in the same folder, so that the rename never crosses
a file system; it tells its owner, so that what a dead process left can be swept away.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import itertools
import os
import re
import shutil
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from mrbatch.errors import ResourceError

_TEMPORARY = re.compile(r"^\.tmp-(?P<owner>.+)~\d+(?:\..*)?$")
_counter = itertools.count()

_DISK_FULL = {errno.ENOSPC, errno.EFBIG, getattr(errno, "EDQUOT", errno.ENOSPC)}
_UNWRITABLE = {errno.EACCES, errno.EPERM, errno.EROFS}
_SCARCE = {errno.EMFILE, errno.ENFILE, errno.ENOMEM}
# Writers of other libraries fail without an errno; with less than this free, the disk is the reason.
_NO_SPACE_BYTES = 64 * 1024


@dataclass(frozen=True)
class Committed:
    """A file in place: `file_hash` of its bytes, `content_hash` as `verify` gave it, size in bytes."""

    path: Path
    file_hash: str
    content_hash: str
    size: int


def hash_file(path: Path) -> str:
    """SHA-256 of a file's bytes, as `sha256:<hex>`. Raises OSError."""
    with path.open("rb") as file:
        return "sha256:" + hashlib.file_digest(file, "sha256").hexdigest()


def temporary_name(final: Path, owner: str) -> Path:
    """A name beside `final` that nobody else uses, with its suffix (writers choose the format by it)."""
    return final.with_name(f".tmp-{owner}~{next(_counter)}{final.suffix}")


def owner_of_temporary(name: str) -> str | None:
    """The owner of a temporary file by its name, or None for any other file."""
    match = _TEMPORARY.match(name)
    return match["owner"] if match else None


def commit_file(
    final: Path, write: Callable[[Path], None], verify: Callable[[Path], str] | None, owner: str
) -> Committed:
    """Write, read back, flush and rename one file.

    `write(path)` makes the file, `verify(path)` reads it back and gives its content hash (or raises).
    Whatever goes wrong, nothing is left behind and an older file under `final` is untouched.
    Raises ResourceError for disk, rights and handles; what `write` and `verify` raise otherwise.
    """
    staged = stage_file(final, write, verify, owner)
    return staged.publish()


@dataclass(frozen=True)
class Staged:
    """A file that is written, verified and flushed, but still under its temporary name."""

    temporary: Path
    result: Committed

    def publish(self) -> Committed:
        """Give it its final name. Raises ResourceError."""
        try:
            os.replace(self.temporary, self.result.path)
            flush_folder(self.result.path.parent)
        except OSError as error:
            self.discard()
            raise as_resource_error(error, self.result.path) from error
        return self.result

    def discard(self) -> None:
        with contextlib.suppress(OSError):
            self.temporary.unlink()


def stage_file(
    final: Path, write: Callable[[Path], None], verify: Callable[[Path], str] | None, owner: str
) -> Staged:
    """The first half of `commit_file`: everything but the rename. Raises as it does."""
    temporary = temporary_name(final, owner)
    try:
        write(temporary)
        content_hash = verify(temporary) if verify else ""
        flush_file(temporary)
        file_hash = hash_file(temporary)
        size = temporary.stat().st_size
    except BaseException as error:
        reason = _resource_reason(error, final)
        with contextlib.suppress(OSError):
            temporary.unlink()
        if reason is not None:
            raise reason from error
        raise
    return Staged(temporary, Committed(final, file_hash, content_hash or file_hash, size))


def commit_bytes(final: Path, data: bytes, owner: str) -> Committed:
    """Put `data` under `final`, whole or not at all. Raises ResourceError."""

    def write(path: Path) -> None:
        path.write_bytes(data)

    return commit_file(final, write, None, owner)


def flush_file(path: Path) -> None:
    """Have the file's bytes on the disk (Windows wants a writable handle)."""
    handle = os.open(path, os.O_RDWR | getattr(os, "O_BINARY", 0))
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def flush_folder(folder: Path) -> None:
    """Have a rename on the disk, where the system can (Windows and some network shares cannot)."""
    try:
        handle = os.open(folder, os.O_RDONLY)
    except OSError:
        return
    try:
        with contextlib.suppress(OSError):
            os.fsync(handle)
    finally:
        os.close(handle)


def as_resource_error(error: OSError, path: Path) -> ResourceError:
    """What an OSError met while writing `path` means to a person."""
    where = error.filename or path
    if error.errno in _DISK_FULL:
        return ResourceError(
            f"disk full: cannot write `{where}`",
            hint="free some space and run the same command again: finished frames are kept",
        )
    if error.errno in _UNWRITABLE:
        return ResourceError(
            f"unwritable: `{where}` ({_words(error)})",
            hint="check the rights of the folder, or choose another with --output",
        )
    if error.errno in _SCARCE:
        return ResourceError(
            f"the system is out of handles or memory ({_words(error)}) at `{where}`",
            hint="close other programs or raise the limit (`ulimit -n`), then run the same command again",
        )
    return ResourceError(
        f"cannot write `{where}` ({_words(error)})",
        hint="check the folder and run the same command again: finished frames are kept",
    )


def resource_reason(error: BaseException, path: Path) -> ResourceError | None:
    """The ResourceError behind an exception of a renderer, or None if it is something else.

    An OSError counts only where its kind cannot come from reading input.
    """
    if isinstance(error, ResourceError):
        return error
    if isinstance(error, MemoryError):
        return ResourceError(
            f"out of memory{': ' + str(error) if str(error) else ''}",
            hint="render at a smaller --scale or with fewer layers, or use a machine with more memory",
        )
    known = _DISK_FULL | _UNWRITABLE | _SCARCE
    if isinstance(error, OSError) and error.errno in known:
        return as_resource_error(error, path)
    return None


def _resource_reason(error: BaseException, final: Path) -> ResourceError | None:
    """As `resource_reason`, for what writing and reading back raise: there every OSError counts."""
    if isinstance(error, OSError):
        return as_resource_error(error, final)
    known = resource_reason(error, final)
    if known is not None or not isinstance(error, Exception):
        return known
    try:
        free = shutil.disk_usage(final.parent).free
    except OSError as gone:
        return as_resource_error(gone, final.parent)
    if free < _NO_SPACE_BYTES:
        return as_resource_error(OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)), final)
    return None


def _words(error: OSError) -> str:
    return error.strerror or str(error)


def leftovers(folders: Iterable[Path]) -> list[tuple[Path, str]]:
    """Temporary files under the given folders (not below them) with their owners' names."""
    found = []
    for folder in dict.fromkeys(folders):
        try:
            with os.scandir(folder) as entries:
                for entry in entries:
                    owner = owner_of_temporary(entry.name)
                    if owner is not None:
                        found.append((Path(entry.path), owner))
        except FileNotFoundError:
            continue
        except OSError as error:
            raise as_resource_error(error, folder) from error
    return sorted(found)
