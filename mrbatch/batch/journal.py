"""The journal: what was finished, one line of JSON a frame, flushed before the next frame begins.

A last line says what the run cost beside its frames and how it ended.

Every process writes a file of its own, `journal/<host>-<pid>-<random>.jsonl`, so that processes on a
shared folder never interleave; a reader merges them. A line that a power cut tore is passed over and
counted. Times, hosts and seconds stand here and never in a frame file, whose bytes depend on job,
seed and input alone.
"""

from __future__ import annotations

import contextlib
import functools
import json
import os
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from mrbatch.batch.commit import as_resource_error, flush_folder
from mrbatch.batch.presence import Owner
from mrbatch.errors import EXIT_INPUT

FOLDER = "journal"


@dataclass(frozen=True)
class FrameEntry:
    """A committed frame.

    `file`: relative to the output folder, with forward slashes. `file_hash` of its bytes;
    `content_hash` as the verifier gave it; `size` in bytes; `seconds` of rendering; `write_seconds`: of
    writing, reading back and flushing; `counters` of work; `details`: JSON-ready, from the renderer;
    `history_hash`: of `history/<frame>.npz`, empty without history; `held_from`: the frame whose picture
    stands in for this one, with `error`, why.
    `run`: name of the run's journal file, without suffix. `time`: UTC seconds of the writing machine, to
    read, never to judge by.
    """

    job_hash: str
    frame: int
    file: str
    file_hash: str
    content_hash: str
    size: int
    seconds: float
    counters: Mapping[str, int] = field(default_factory=dict)
    details: Mapping[str, Any] = field(default_factory=dict)
    history_hash: str = ""
    held_from: int | None = None
    error: str = ""
    write_seconds: float = 0.0
    run: str = ""
    host: str = ""
    pid: int = 0
    time: float = 0.0


@dataclass(frozen=True)
class FailureEntry:
    """A frame that could not be rendered from its input. `error`: the whole text; `message` and `hint`: its
    parts; `exit_code` it stands for."""

    job_hash: str
    frame: int
    error: str
    message: str = ""
    hint: str = ""
    exit_code: int = EXIT_INPUT
    run: str = ""
    host: str = ""
    pid: int = 0
    time: float = 0.0


@dataclass(frozen=True)
class RunEntry:
    """A run that rendered something or ended early.

    `seconds`: wall time of the whole command. `rendered`: how many frames. `undone`: frames it did not
    reach, and `why`; `error` and `hint`: what ended it early. `predicted`: seconds said before the first
    frame. `timing`: the tree of all it did, frames left out (`TimingNode.as_dict`). `machine` and
    `versions` as the report shows them; `notes` for it.
    """

    job_hash: str
    seconds: float
    rendered: int = 0
    undone: tuple[int, ...] = ()
    why: str = ""
    error: str = ""
    hint: str = ""
    exit_code: int = 0
    predicted: float | None = None
    timing: Mapping[str, Any] = field(default_factory=dict)
    machine: Mapping[str, str] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    run: str = ""
    host: str = ""
    pid: int = 0
    time: float = 0.0


Entry = FrameEntry | FailureEntry | RunEntry
_KINDS: dict[type, str] = {FrameEntry: "frame", FailureEntry: "failed", RunEntry: "run"}


class JournalWriter:
    """Appends to this process's own file; each line is on the disk when `append` returns."""

    def __init__(self, directory: Path, owner: Owner):
        self.path = directory / FOLDER / f"{owner.name}.jsonl"
        self.owner = owner
        self._file: Any = None
        self._size = 0

    def append(self, entry: Entry) -> None:
        """Add one line. Raises ResourceError; the file then ends where it ended before."""
        about = {"run": self.owner.name, "host": self.owner.host, "pid": self.owner.pid, "time": time.time()}
        record = {"kind": _KINDS[type(entry)]} | asdict(entry) | about
        line = json.dumps(record, separators=(",", ":"), allow_nan=False).encode() + b"\n"
        try:
            if self._file is None:
                self.path.parent.mkdir(parents=True, exist_ok=True)
                # Unbuffered: a line is never kept back, and a failed write leaves nothing to flush later.
                self._file = self.path.open("ab", buffering=0)
                self._size = self._file.seek(0, os.SEEK_END)
                flush_folder(self.path.parent)
            written = 0
            while written < len(line):
                written += self._file.write(line[written:])
            os.fsync(self._file.fileno())
            self._size += len(line)
        except OSError as error:
            if self._file is not None:
                with contextlib.suppress(OSError):
                    self._file.truncate(self._size)
                    self._file.seek(self._size)
            raise as_resource_error(error, self.path) from error

    def close(self) -> None:
        if self._file is not None:
            with contextlib.suppress(OSError):
                self._file.close()
            self._file = None


class JournalReader:
    """All journal files of a directory, merged. `refresh` reads only what was added since.

    `frames[n]`: entries of frame n, those of one file in their order. `failures[n]`: the same of
    failures. `runs`: of runs that ended in order. `torn`: lines that could not be read, by file name.
    """

    def __init__(self, directory: Path):
        self.folder = directory / FOLDER
        self.frames: dict[int, list[FrameEntry]] = {}
        self.failures: dict[int, list[FailureEntry]] = {}
        self.runs: list[RunEntry] = []
        self.torn: dict[str, int] = {}
        self._offsets: dict[str, int] = {}
        self._torn_tails: dict[str, bytes] = {}
        self.refresh()

    def refresh(self) -> None:
        """Take in what was appended meanwhile. Raises ResourceError."""
        try:
            paths = sorted(self.folder.glob("*.jsonl"))
            for path in paths:
                offset = self._offsets.get(path.name, 0)
                with path.open("rb") as file:
                    file.seek(offset)
                    data = file.read()
                end = data.rfind(b"\n") + 1
                self._offsets[path.name] = offset + end
                self._torn_tails[path.name] = data[end:]
                for line in data[:end].splitlines():
                    self._take(path.name, line)
        except FileNotFoundError:
            return
        except OSError as error:
            raise as_resource_error(error, self.folder) from error

    def torn_lines(self, is_alive: Callable[[str], bool] = lambda owner: False) -> int:
        """Lines that could not be read, an unfinished last one included unless its writer is alive."""
        tails = [Path(name).stem for name, tail in self._torn_tails.items() if tail.strip(b"\0 ")]
        return sum(self.torn.values()) + sum(1 for owner in tails if not is_alive(owner))

    def matching(self, frame: int, job_hash: str) -> list[FrameEntry]:
        """Entries of `frame` under `job_hash`, the latest of each file last."""
        return [entry for entry in self.frames.get(frame, ()) if entry.job_hash == job_hash]

    def _take(self, name: str, line: bytes) -> None:
        if not line.strip():
            return
        try:
            kind = json.loads(line)["kind"]
            if kind not in _KINDS.values():
                return  # of a newer version
            # Fields that this version does not know are left out; one of another type costs the line.
            entry = _reader(kind).validate_json(line, strict=True)
        except (ValueError, TypeError, KeyError, RecursionError):
            self.torn[name] = self.torn.get(name, 0) + 1
            return
        if isinstance(entry, FrameEntry):
            self.frames.setdefault(entry.frame, []).append(entry)
        elif isinstance(entry, FailureEntry):
            self.failures.setdefault(entry.frame, []).append(entry)
        else:
            self.runs.append(entry)


@functools.cache
def _reader(kind: str) -> TypeAdapter[Entry]:
    return TypeAdapter(next(entry for entry, name in _KINDS.items() if name == kind))
