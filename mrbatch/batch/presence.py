"""Which processes work in a directory, and whether one of them is still alive.

Each process keeps one small file, `claims/<owner>.alive`, and touches it every few seconds. A process
of this machine is judged by its pid; any other by the age of that file, told by the file system's
own time (the time stamp of a file touched just now), never by two machines' clocks.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import re
import secrets
import socket
import sys
import threading
import uuid
from dataclasses import asdict, dataclass
from pathlib import Path

import psutil

from mrbatch.batch.commit import as_resource_error

FOLDER = "claims"
HEARTBEAT = 5.0
"""Seconds between two touches."""
STALE_AFTER = 60.0
"""Seconds without a touch after which a process of another machine counts as dead."""
# A pid can be given again; a start time that differs by more than this tells. Wide, because the
# system computes start times from its clock, which may be set meanwhile.
_SAME_START = 60.0


@dataclass(frozen=True)
class Owner:
    """A process (more exactly: one run in it). `name`: `<host>-<pid>-<random>`.

    `machine`: equal only where a pid means the same process: same boot, same pid namespace.
    """

    name: str
    host: str
    machine: str
    pid: int
    started: float

    @staticmethod
    def here() -> Owner:
        host = re.sub(r"[^A-Za-z0-9_.]+", "_", socket.gethostname())[:40] or "host"
        pid = os.getpid()
        name = f"{host}-{pid}-{secrets.token_hex(4)}"
        return Owner(name, host, machine_identity(), pid, psutil.Process(pid).create_time())


def machine_identity() -> str:
    """A short hash that names this boot of this machine and this pid namespace.

    Two containers of one machine may have the same host name and the same pids.
    """
    parts = [socket.gethostname()]
    if sys.platform == "linux":
        with contextlib.suppress(OSError):
            parts.append(Path("/proc/sys/kernel/random/boot_id").read_text().strip())
        with contextlib.suppress(OSError):
            parts.append(os.readlink("/proc/self/ns/pid"))
    else:
        parts.append(f"{uuid.getnode():x}")
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:16]


class FileSystemClock:
    """Time as the shared file system stamps it."""

    def __init__(self, folder: Path, owner: Owner):
        self._probe = folder / f".probe-{owner.name}"

    def now(self) -> float:
        """Seconds, comparable with `modified` of files beside. Raises OSError."""
        # A fresh file: the stamp is the server's, and no attribute cache can hold an older one.
        with contextlib.suppress(FileNotFoundError):
            self._probe.unlink()
        handle = os.open(self._probe, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666)
        try:
            os.write(handle, b".")
            os.fsync(handle)
            return os.fstat(handle).st_mtime
        finally:
            os.close(handle)
            with contextlib.suppress(OSError):
                self._probe.unlink()


def modified(path: Path) -> float:
    """Time stamp of a file; opened first, because network file systems then ask the server again."""
    handle = os.open(path, os.O_RDONLY)
    try:
        return os.fstat(handle).st_mtime
    finally:
        os.close(handle)


class Presence:
    """This process's sign of life, and its judgement of the others'. Use as a context manager.

    `stale_after` and `heartbeat` in seconds. Raises ResourceError where the folder cannot be written.
    """

    def __init__(
        self,
        directory: Path,
        owner: Owner,
        job_hash: str = "",
        *,
        stale_after: float = STALE_AFTER,
        heartbeat: float = HEARTBEAT,
    ):
        self.folder = directory / FOLDER
        self.owner = owner
        self.job_hash = job_hash
        self.stale_after = stale_after
        self.heartbeat = min(heartbeat, stale_after / 4)
        self.path = self.folder / f"{owner.name}.alive"
        self.clock = FileSystemClock(self.folder, owner)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._beat, name="mrbatch-heartbeat", daemon=True)

    def __enter__(self) -> Presence:
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            self._sign()
        except OSError as error:
            with contextlib.suppress(OSError):
                self.path.unlink()
            raise as_resource_error(error, self.folder) from error
        self._thread.start()
        return self

    def __exit__(self, *_) -> None:
        self._ended.set()
        self._thread.join()
        with contextlib.suppress(OSError):
            self.path.unlink()

    def _sign(self) -> None:
        with self.path.open("w", encoding="utf-8") as file:
            json.dump({"owner": asdict(self.owner), "job_hash": self.job_hash}, file)

    def _beat(self) -> None:
        while not self._ended.wait(self.heartbeat):
            # With no times given the server sets its own. A share that is away for a moment is no
            # reason to end: at worst another process does a frame twice, with the same bits.
            with contextlib.suppress(OSError):
                try:
                    os.utime(self.path)
                except FileNotFoundError:
                    # This machine slept so long that another process took it for dead.
                    self._sign()

    def is_alive(self, name: str, claimed: Path | None = None) -> bool:
        """Whether the process called `name` is still at work.

        `claimed`: a file it wrote; its age judges where the process left no sign of life.
        """
        if name == self.owner.name:
            return True
        path = self.folder / f"{name}.alive"
        other, _ = _read_sign(path)
        if other is not None and other.machine == self.owner.machine:
            verdict = _process_lives(other)
            if verdict is not None:
                return verdict
        stamps = []
        for file in (path, claimed):
            if file is not None:
                with contextlib.suppress(OSError):
                    stamps.append(modified(file))
        if not stamps:
            return False
        return self.clock.now() - max(stamps) <= self.stale_after

    def others(self) -> list[str]:
        """Names of the other processes that left a sign of life here, alive or not."""
        return sorted(path.stem for path in self.folder.glob("*.alive") if path.stem != self.owner.name)

    def rivals(self) -> list[str]:
        """Names of living processes that render another job into the same folder."""
        return [
            name
            for name in self.others()
            if _read_sign(self.folder / f"{name}.alive")[1] != self.job_hash and self.is_alive(name)
        ]

    def forget(self, name: str) -> None:
        """Remove the sign of a dead process."""
        for path in (self.folder / f"{name}.alive", self.folder / f".probe-{name}"):
            with contextlib.suppress(OSError):
                path.unlink()


def _read_sign(path: Path) -> tuple[Owner | None, str]:
    """Owner and job hash of a sign of life; (None, "") where it cannot be read."""
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
        return Owner(**record["owner"]), str(record["job_hash"])
    except (OSError, ValueError, TypeError, KeyError):
        return None, ""


def _process_lives(other: Owner) -> bool | None:
    """Whether a process of this machine lives; None where that cannot be told."""
    try:
        process = psutil.Process(other.pid)
        if process.status() == psutil.STATUS_ZOMBIE:
            return False
        # Another start time is another process, or a clock that was set: the heartbeat decides.
        return True if abs(process.create_time() - other.started) <= _SAME_START else None
    except psutil.NoSuchProcess:
        return False
    except psutil.Error:
        return None
