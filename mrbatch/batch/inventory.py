"""What is there already: every frame's file against what the journal recorded of it."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from mrbatch.batch.commit import as_resource_error, hash_file
from mrbatch.batch.journal import FrameEntry, JournalReader

What = Literal["finished", "corrupt", "missing", "unrecorded", "stand_ins", "fresh"]


@dataclass(frozen=True)
class Findings:
    """What a run found when it started.

    `finished`: frames that are kept. `corrupt`: files that differ from what the journal recorded.
    `missing`: recorded, but gone. `unrecorded`: there, but not in the journal (the process died
    between rename and record): rendered again. `stand_ins`: frames held from another after an
    error: tried again. `leftovers`: temporary files of dead processes, removed. `claims`: of dead
    processes, removed. `torn`: journal lines that could not be read. `foreign`: frames of another
    job that stay in the folder.
    """

    finished: tuple[int, ...] = ()
    corrupt: tuple[int, ...] = ()
    missing: tuple[int, ...] = ()
    unrecorded: tuple[int, ...] = ()
    stand_ins: tuple[int, ...] = ()
    leftovers: int = 0
    claims: int = 0
    torn: int = 0
    foreign: tuple[int, ...] = ()

    def summary(self) -> str:
        """`found 3 finished, 1 corrupt, 2 leftovers`, or an empty text for a fresh folder."""
        parts = [
            (len(self.finished), "finished"),
            (len(self.corrupt), "corrupt"),
            (len(self.missing), "missing"),
            (len(self.unrecorded), "unrecorded"),
            (len(self.stand_ins), "stand-in" if len(self.stand_ins) == 1 else "stand-ins"),
            (self.leftovers, "leftover" if self.leftovers == 1 else "leftovers"),
            (self.claims, "dead claim" if self.claims == 1 else "dead claims"),
            (self.torn, "torn journal line" if self.torn == 1 else "torn journal lines"),
            (len(self.foreign), "of another job"),
        ]
        words = [f"{count} {what}" for count, what in parts if count]
        return "found " + ", ".join(words) if words else ""


class Inventory:
    """Judges frames of one job in one folder; `path(frame)` is where a frame lies."""

    def __init__(self, directory: Path, job_hash: str, path: Callable[[int], Path], journal: JournalReader):
        self.directory = directory
        self.job_hash = job_hash
        self.path = path
        self.journal = journal

    def relative(self, frame: int) -> str:
        return self.path(frame).relative_to(self.directory).as_posix()

    def judge(self, frame: int) -> tuple[What, FrameEntry | None]:
        """Which of the kinds of `Findings` a frame is, with its entry if it is finished or a stand-in.

        `fresh`: there is nothing, or only a file that another job recorded. Raises ResourceError.
        """
        path = self.path(frame)
        name = self.relative(frame)
        entries = [entry for entry in self.journal.matching(frame, self.job_hash) if entry.file == name]
        try:
            if not path.exists():
                return ("missing" if entries else "fresh"), None
            if not entries:
                foreign = any(entry.file == name for entry in self.journal.frames.get(frame, ()))
                return ("fresh" if foreign else "unrecorded"), None
            found = hash_file(path)
        except OSError as error:
            if entries:
                # A sector that cannot be read is as good as a wrong one.
                return "corrupt", None
            raise as_resource_error(error, path) from error
        agreeing = [entry for entry in entries if entry.file_hash == found]
        own = [entry for entry in agreeing if entry.held_from is None]
        if own:
            return "finished", own[-1]
        return ("stand_ins", agreeing[-1]) if agreeing else ("corrupt", None)

    def foreign(self, asked: Collection[int]) -> tuple[int, ...]:
        """Frames of another job that lie in the folder and are not among those asked for."""
        asked = set(asked)
        found = []
        for frame, entries in self.journal.frames.items():
            if frame in asked or any(entry.job_hash == self.job_hash for entry in entries):
                continue
            if any((self.directory / entry.file).is_file() for entry in entries):
                found.append(frame)
        return tuple(sorted(found))
