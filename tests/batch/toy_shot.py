"""A toy renderer for the tests of the batch room, and a command that runs it as a process of its own.

A frame's file holds a header and bytes that are a pure function of (seed, frame, state), written
slowly in pieces, so that a kill may hit the middle of a file.

    python toy_shot.py DIRECTORY FIRST LAST [seed] [--seconds S] [--history] [--on-error P] ...
"""

from __future__ import annotations

import argparse
import hashlib
import sys
import threading
import time
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from mrbatch.batch.history import Segment
from mrbatch.batch.interrupt import interrupts
from mrbatch.batch.progress import progress
from mrbatch.batch.request import RunRequest
from mrbatch.batch.run import run
from mrbatch.errors import InputError, MrbatchError

PIECES = 8
PIECE_BYTES = 512


class ToyResult:
    """One frame of the toy."""

    def __init__(self, payload: bytes, seconds: float, history: Mapping[str, np.ndarray] | None):
        self.payload = payload
        self.seconds = seconds
        self.history = history
        self.counters = {"rays": len(payload)}
        self.details = {"toy": True}
        self.pause = 0.0

    def write(self, path: Path) -> None:
        with path.open("wb") as file:
            file.write(b"TOY1" + hashlib.sha256(self.payload).digest())
            for start in range(0, len(self.payload), PIECE_BYTES):
                file.write(self.payload[start : start + PIECE_BYTES])
                file.flush()
                time.sleep(self.pause)


def verify(path: Path) -> str:
    """The hash of a toy file's payload. Raises ValueError for a file that is not whole."""
    data = path.read_bytes()
    digest = hashlib.sha256(data[36:])
    if data[:4] != b"TOY1" or digest.digest() != data[4:36] or len(data) != 36 + PIECES * PIECE_BYTES:
        raise ValueError(f"{path} is not a whole toy frame")
    return digest.hexdigest()


def expected_payload(seed: int, frame: int, state: int = 0) -> bytes:
    generator = np.random.Generator(np.random.Philox(key=[seed, frame * 1_000_003 + state]))
    return generator.bytes(PIECES * PIECE_BYTES)


class Toy:
    """`render` of the toy; counts calls. `broken`: frames whose input cannot be used."""

    def __init__(self, seed: int = 1, *, history: bool = False, broken=(), seconds: float = 0.0):
        self.seed = seed
        self.history = history
        self.broken = set(broken)
        self.seconds = seconds
        self.calls: list[int] = []

    def __call__(self, frame: int, state: Mapping[str, np.ndarray] | None) -> ToyResult:
        self.calls.append(frame)
        if frame in self.broken:
            raise InputError(f"the picture of frame {frame} is cut short", hint="copy it again")
        time.sleep(self.seconds / 2)
        memory = None
        carried = 0
        if self.history:
            # An order-dependent recurrence: a chain that is started wrongly shows in every later frame.
            before = int(state["sum"][0]) if state is not None else 7
            carried = (before * 31 + frame) % 1_000_000_007
            memory = {"sum": np.array([carried], dtype=np.int64)}
        result = ToyResult(expected_payload(self.seed, frame, carried), self.seconds, memory)
        result.pause = self.seconds / 2 / PIECES
        return result


def request_for(directory: Path, frames, seed: int = 1, **options) -> RunRequest:
    return RunRequest(
        directory=directory,
        pattern=options.pop("pattern", "{job}.{frame:04d}.toy"),
        job_name="shot",
        job_hash=options.pop("job_hash", hashlib.sha256(f"seed {seed}".encode()).hexdigest()),
        frames=tuple(frames),
        **options,
    )


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("directory", type=Path)
    parser.add_argument("first", type=int)
    parser.add_argument("last", type=int)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=0.0)
    parser.add_argument("--history", type=int, default=0, help="length of a segment")
    parser.add_argument("--on-error", default="stop")
    parser.add_argument("--broken", type=int, nargs="*", default=[])
    parser.add_argument("--stale-after", type=float, default=60.0)
    options = parser.parse_args()
    frames = range(options.first, options.last + 1)
    segments = ()
    if options.history:
        shot = range(1, 1001)
        starts = range(0, len(shot), options.history)
        segments = tuple(Segment(tuple(shot[start : start + options.history])) for start in starts)
    request = request_for(
        options.directory,
        frames,
        options.seed,
        on_error=options.on_error,
        history=bool(options.history),
        segments=segments,
    )
    toy = Toy(options.seed, history=bool(options.history), broken=options.broken, seconds=options.seconds)
    stop = threading.Event()
    try:
        with interrupts.caught(stop), progress("json", sys.stdout) as events:
            result = run(
                request, toy, verify, events=events, stop=stop, stale_after=options.stale_after, poll=0.05
            )
    except MrbatchError as error:
        print(error, file=sys.stderr)
        return error.exit_code
    if result.error:
        print(result.error, file=sys.stderr)
    return result.exit_code


if __name__ == "__main__":
    sys.exit(main())
