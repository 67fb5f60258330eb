"""Ctrl-C and SIGTERM: the first ends the run in order, the second ends it at once.

The frame in work is given up, its temporary file removed, its claim released. Between the rename of
a frame and its line in the journal the signal waits, so that no finished work is done twice.
"""

from __future__ import annotations

import contextlib
import os
import signal
import threading
from collections.abc import Iterator

from mrbatch.errors import EXIT_INTERRUPTED


class Interrupts:
    """State of the signals of this process."""

    def __init__(self) -> None:
        self._shields = 0
        self._pending = False
        self._signals = 0
        self._stop: threading.Event | None = None

    @contextlib.contextmanager
    def caught(self, stop: threading.Event) -> Iterator[None]:
        """Within: the first SIGINT or SIGTERM sets `stop` and raises KeyboardInterrupt in the main
        thread, the second ends the process with code 130. Does nothing outside the main thread.
        """
        if threading.current_thread() is not threading.main_thread():
            yield
            return
        names = ("SIGINT", "SIGTERM", "SIGBREAK")
        known = [getattr(signal, name) for name in names if hasattr(signal, name)]
        self._signals, self._pending, self._stop = 0, False, stop
        previous = {number: signal.signal(number, self._handle) for number in known}
        try:
            yield
        finally:
            self._stop = None
            for number, handler in previous.items():
                signal.signal(number, handler if handler is not None else signal.SIG_DFL)

    @contextlib.contextmanager
    def shielded(self) -> Iterator[None]:
        """Within, a first signal sets `stop` but raises only at the end."""
        self._shields += 1
        try:
            yield
        finally:
            self._shields -= 1
        if self._shields == 0 and self._pending:
            self._pending = False
            raise KeyboardInterrupt

    def _handle(self, number: int, frame: object) -> None:
        self._signals += 1
        if self._signals > 1:
            os._exit(EXIT_INTERRUPTED)
        if self._stop is not None:
            self._stop.set()
        if self._shields:
            self._pending = True
        else:
            raise KeyboardInterrupt


interrupts = Interrupts()
"""Signals belong to the process, so there is one of these."""
