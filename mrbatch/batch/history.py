"""History: buffers that a frame hands to the next one, so that any frame can be made anywhere.

The shot is cut into segments; within one, frame f needs the state that f - 1 left. A committed frame
keeps its state in `history/<frame>.npz`. To make one frame, the chain starts at the nearest earlier
state that agrees with the journal, or at the segment's start, and the frames between are rendered
without pictures. A lone frame, a resume and another machine so get the same bits.
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mrbatch.batch.commit import Staged, hash_file, stage_file
from mrbatch.batch.journal import JournalReader
from mrbatch.errors import InputError

FOLDER = "history"
State = Mapping[str, np.ndarray]


@dataclass(frozen=True)
class Segment:
    """Frames of the shot that hang together: `frames`, in order, whose pictures belong to it.

    `warm_up`: earlier frames that are rendered first, from nothing and without pictures, so that a
    cut made only for length does not show. Their states are the segment's own and never committed.
    """

    frames: tuple[int, ...]
    warm_up: tuple[int, ...] = ()


def cut_segments(
    frames: Sequence[int], *, cuts: Collection[int] = (), length: int | None = None, warm_up: int = 0
) -> tuple[Segment, ...]:
    """All frames of a shot, sorted, cut into segments.

    `cuts`: first frames of new scenes (nothing is carried over them, warm-up neither). `length`:
    longest number of frames of a segment, None for no limit. `warm_up`: frames rendered before a
    segment that was cut for its length. Raises ValueError for a length below 1 or a negative warm-up.
    """
    if length is not None and length < 1 or warm_up < 0:
        raise ValueError(f"segments of {length} frames with a warm-up of {warm_up}")
    scenes: list[list[int]] = []
    for frame in sorted(frames):
        if not scenes or frame in cuts:
            scenes.append([])
        scenes[-1].append(frame)
    segments = []
    for scene in scenes:
        step = length or len(scene)
        for start in range(0, len(scene), step):
            before = scene[max(0, start - warm_up) : start]
            segments.append(Segment(tuple(scene[start : start + step]), tuple(before)))
    return tuple(segments)


def state_path(directory: Path, frame: int) -> Path:
    return directory / FOLDER / f"{frame}.npz"


def stage_state(directory: Path, frame: int, state: State, owner: str) -> Staged:
    """Write a state aside; its bytes depend on names, order and arrays alone.

    Raises ResourceError; ValueError for an array of Python objects.
    """
    final = state_path(directory, frame)
    arrays = {}
    for name, array in state.items():
        array = np.asarray(array)
        if array.dtype.hasobject:
            raise ValueError(f"history buffer `{name}` holds Python objects")
        arrays[name] = array
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=False, **arrays)

    def write(path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("wb") as file:
            file.write(buffer.getbuffer())

    return stage_file(final, write, None, owner)


def load_state(directory: Path, frame: int, file_hash: str) -> dict[str, np.ndarray] | None:
    """The committed state of a frame, or None where the file is absent or not the one recorded."""
    path = state_path(directory, frame)
    try:
        if not file_hash or hash_file(path) != file_hash:
            return None
        with np.load(path, allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except (OSError, ValueError, KeyError, zipfile.BadZipFile):
        return None


def own_state(state: State | None, frame: int) -> State:
    """A copy that nobody writes to. Raises ValueError where the renderer gave no state."""
    if state is None:
        raise ValueError(f"frame {frame} has no history, but the job's passes keep one")
    copies = {}
    for name, array in state.items():
        copy = np.array(array, copy=True)
        copy.setflags(write=False)
        copies[name] = copy
    return copies


class Chain:
    """Finds or makes the state that a frame starts from.

    `advance(frame, state)` renders a frame for its state alone. A frame whose input cannot be used
    hands on the state it got, in every run alike. `before_each` is called before each such frame.
    """

    def __init__(
        self,
        directory: Path,
        job_hash: str,
        segments: Sequence[Segment],
        journal: JournalReader,
        advance: Callable[[int, State | None], State | None],
        *,
        before_each: Callable[[], None] = lambda: None,
    ):
        self._directory = directory
        self._job_hash = job_hash
        self._journal = journal
        self._advance = advance
        self._before_each = before_each
        self._number = {frame: number for number, segment in enumerate(segments) for frame in segment.frames}
        self._segment_of = {frame: segment for segment in segments for frame in segment.frames}
        # The state after the last frame done, so that a sequence never reads its own files back.
        self._latest: tuple[int, State | None] | None = None

    def remember(self, frame: int, state: State | None) -> None:
        """The state that `frame` left, or (where it failed) handed on."""
        if self._segment_of:
            self._latest = (frame, state)

    def segment_number(self, frame: int) -> int:
        """Which segment a frame belongs to; -1 without history."""
        return self._number.get(frame, -1)

    def state_before(self, frame: int) -> State | None:
        """The state that `frame` starts from (None at a segment's start or without history)."""
        if not self._segment_of:
            return None
        segment = self._segment_of[frame]
        before = segment.frames[: segment.frames.index(frame)]
        chain = segment.warm_up + before
        state: State | None = None
        for position in range(len(before) - 1, -1, -1):
            known, state = self._known(before[position])
            if known:
                chain = before[position + 1 :]
                break
        owned = set(before)
        for earlier in chain:
            self._before_each()
            try:
                state = own_state(self._advance(earlier, state), earlier)
            except InputError:
                continue
            finally:
                if earlier in owned:
                    self._latest = (earlier, state)
        return state

    def is_busy(self, frame: int, holder: Callable[[int], str | None]) -> bool:
        """Whether another process makes a frame whose state this one needs: waiting is cheaper."""
        if not self._segment_of:
            return False
        segment = self._segment_of[frame]
        for earlier in reversed(segment.frames[: segment.frames.index(frame)]):
            if self._latest is not None and self._latest[0] == earlier:
                return False
            if any(entry.history_hash for entry in self._journal.matching(earlier, self._job_hash)):
                return False
            if holder(earlier):
                self._journal.refresh()
                return True
        return False

    def _known(self, frame: int) -> tuple[bool, State | None]:
        if self._latest is not None and self._latest[0] == frame:
            return True, self._latest[1]
        for entry in reversed(self._journal.matching(frame, self._job_hash)):
            state = load_state(self._directory, frame, entry.history_hash)
            if state is not None:
                return True, own_state(state, frame)
        return False, None
