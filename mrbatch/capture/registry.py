"""Which capture kinds there are. Adding one takes its folder and one line here."""

from __future__ import annotations

import difflib
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import Generic, TypeVar

from mrbatch.contracts import CaptureKind
from mrbatch.errors import JobError

T = TypeVar("T")


class Registry(Generic[T]):
    """Names to what they stand for, imported when first asked for.

    `entries` maps a name to `module:attribute`. `what` names the things in messages.
    """

    def __init__(self, what: str, entries: dict[str, str]):
        self.what = what
        self._entries: dict[str, str | T] = dict(entries)

    def names(self) -> tuple[str, ...]:
        return tuple(self._entries)

    def get(self, name: str) -> T:
        """What `name` stands for. Raises JobError, with the nearest name, where there is none."""
        if name not in self._entries:
            near = difflib.get_close_matches(str(name), self._entries, n=1, cutoff=0.65)
            known = ", ".join(self._entries) or "none"
            raise JobError(
                f"unknown {self.what} `{name}`",
                hint=f"did you mean `{near[0]}`?" if near else f"known: {known}",
            )
        entry = self._entries[name]
        if isinstance(entry, str):
            module, _, attribute = entry.partition(":")
            return getattr(import_module(module), attribute)
        return entry

    @contextmanager
    def registered(self, name: str, thing: T) -> Iterator[T]:
        """`name` stands for `thing` inside the block."""
        before = dict(self._entries)
        self._entries[name] = thing
        try:
            yield thing
        finally:
            self._entries = before


CAPTURES: Registry[CaptureKind] = Registry(
    "capture kind",
    {
        "marker-video": "mrbatch.capture.marker_video:KIND",
    },
)


def capture_kind(name: str) -> CaptureKind:
    """The capture kind of that name. Raises JobError."""
    return CAPTURES.get(name)


def capture_kind_names() -> tuple[str, ...]:
    return CAPTURES.names()


def register(kind: CaptureKind):
    """Context in which `kind` can be used by jobs (for tests and experiments)."""
    return CAPTURES.registered(kind.name, kind)
