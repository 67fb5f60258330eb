"""Claims: which process does which frame, so that several share a directory.

A claim is `claims/<frame>.claim`, made with O_CREAT | O_EXCL, and holds its owner's name. Claims save
work; they do not make the pictures right: should two processes ever do one frame, both commit the
same bytes, because a frame is a pure function of job, shot and number.
"""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

from mrbatch.batch.commit import as_resource_error
from mrbatch.batch.presence import Presence


class Claims:
    """The claims of one process. Raises ResourceError where the folder cannot be written."""

    def __init__(self, presence: Presence):
        self.presence = presence
        self.folder = presence.folder
        self.taken_over = 0
        self._held: set[int] = set()

    def path(self, frame: int) -> Path:
        return self.folder / f"{frame}.claim"

    def acquire(self, frame: int) -> bool:
        """Claim a frame; False where a living process has it. A dead one's claim is taken over."""
        try:
            if self._create(frame):
                return True
            return self._remove_stale(frame) and self._create(frame)
        except OSError as error:
            raise as_resource_error(error, self.path(frame)) from error

    def release(self, frame: int) -> None:
        """Give a frame back. A claim that somebody took over meanwhile is theirs and stays."""
        if frame in self._held:
            path = self.path(frame)
            if read_claim(path) == self.presence.owner.name:
                with contextlib.suppress(OSError):
                    path.unlink()
            # Only now: a signal before this line leaves it to release_all.
            self._held.discard(frame)

    def release_all(self) -> None:
        for frame in sorted(self._held):
            self.release(frame)

    def holder(self, frame: int) -> str | None:
        """Name of the other living process that has the frame, or None."""
        path = self.path(frame)
        name = read_claim(path)
        if name is None or name == self.presence.owner.name:
            return None
        try:
            return name if self.presence.is_alive(name, path) else None
        except OSError as error:
            raise as_resource_error(error, path) from error

    def sweep(self) -> None:
        """Remove the claims and signs of dead processes; `taken_over` counts the claims."""
        try:
            for path in sorted(self.folder.glob("*.claim")):
                if path.stem.isdigit():
                    self._remove_stale(int(path.stem))
            for path in sorted(self.folder.glob(".stale-*")):
                # Between rename and removal a taker was killed; the claim in it was dead already.
                with contextlib.suppress(OSError):
                    if not self.presence.is_alive("", path):
                        path.unlink()
            for name in self.presence.others():
                if not self.presence.is_alive(name):
                    self.presence.forget(name)
        except OSError as error:
            raise as_resource_error(error, self.folder) from error

    def _create(self, frame: int) -> bool:
        path = self.path(frame)
        try:
            handle = os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666)
        except FileExistsError:
            return False
        # Held from here on: whatever happens next, release_all finds it.
        self._held.add(frame)
        try:
            os.write(handle, self.presence.owner.name.encode())
        except OSError:
            os.close(handle)
            handle = -1
            with contextlib.suppress(OSError):
                path.unlink()
            self._held.discard(frame)
            raise
        finally:
            if handle >= 0:
                os.close(handle)
        return True

    def _remove_stale(self, frame: int) -> bool:
        """Remove the claim if its owner is dead. True if there is none now, False where one lives."""
        path = self.path(frame)
        name = read_claim(path)
        if name is None:
            return True
        if name == self.presence.owner.name and frame in self._held:
            return False
        if self.presence.is_alive(name, path):
            return False
        # Two processes may come to this line at once. Renaming lets one of them win; the loser may
        # catch the winner's new claim, sees another name in it, and puts it back.
        aside = self.folder / f".stale-{self.presence.owner.name}-{frame}"
        try:
            os.rename(path, aside)
        except FileNotFoundError:
            return True
        if read_claim(aside) != name:
            with contextlib.suppress(OSError):
                if not path.exists():
                    os.rename(aside, path)
                    return False
            with contextlib.suppress(OSError):
                aside.unlink()
            return False
        with contextlib.suppress(OSError):
            aside.unlink()
        self.taken_over += 1
        return True


def read_claim(path: Path) -> str | None:
    """The owner's name in a claim (empty if its writer was cut off), or None if there is none."""
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip()
    except FileNotFoundError:
        return None
    except OSError as error:
        raise as_resource_error(error, path) from error
