"""The shot: everything that is found out once, before the first frame, and sent to every worker.

It lies in `shot/` of the output folder as one JSON file, named by its content. A frame is a pure
function of job, shot and frame number.
"""

from __future__ import annotations

import base64
import hashlib
import json
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mrbatch import __version__
from mrbatch.batch.commit import commit_file
from mrbatch.batch.history import Segment
from mrbatch.contracts import Verdict
from mrbatch.effects.plan import Plan
from mrbatch.errors import InputError, Place

FOLDER = "shot"
VERSION = 2


def content_hash(value: Any) -> str:
    """SHA-256 of a JSON-ready value in canonical form, as `sha256:<hex>`."""
    text = json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return "sha256:" + hashlib.sha256(text.encode()).hexdigest()


@dataclass(frozen=True)
class Shot:
    """What `prepare` found.

    `key`: hash of what it was made from. `table`: the capture's own (frame times, poses, gains).
    `colour_type` of all EXR files and why; `engine` resolved; `plan` with the tiles of every frame;
    `segments` of the history.
    """

    key: str
    table: Mapping[str, Any]
    frames: tuple[int, ...]
    engine: str
    colour_type: str
    colour_reason: str
    plan: Plan
    segments: tuple[Segment, ...]
    notes: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """JSON-ready."""
        return {
            "version": VERSION,
            "mrbatch": __version__,
            "key": self.key,
            "table": self.table,
            "frames": list(self.frames),
            "engine": self.engine,
            "colour_type": self.colour_type,
            "colour_reason": self.colour_reason,
            "effects": self.plan.as_dict()["effects"],
            "tiles": [
                [
                    number,
                    view,
                    _pack(ids),
                    _pack(self.plan.seen[number, view]),
                    self.plan.influence[number, view],
                ]
                for (number, view), ids in self.plan.tiles.items()
            ],
            "segments": [[list(s.frames), list(s.warm_up)] for s in self.segments],
            "notes": list(self.notes),
        }

    @property
    def hash(self) -> str:
        return content_hash(self.as_dict())


def _pack(ids: np.ndarray) -> str:
    return base64.b64encode(zlib.compress(np.asarray(ids, dtype="<i4").tobytes(), 6)).decode()


def _unpack(text: str) -> np.ndarray:
    return np.frombuffer(zlib.decompress(base64.b64decode(text)), dtype="<i4").astype(np.int32)


def from_dict(data: Mapping[str, Any]) -> Shot:
    """The shot that `as_dict` described. Raises KeyError, TypeError or ValueError for another."""
    effects = {
        name: Verdict(e["state"], e["why"], e["numbers"], e["bound"]) for name, e in data["effects"].items()
    }
    tiles = {(int(n), str(view)): _unpack(packed) for n, view, packed, _, _ in data["tiles"]}
    seen = {(int(n), str(view)): _unpack(packed) for n, view, _, packed, _ in data["tiles"]}
    words = {(int(n), str(view)): str(why) for n, view, _, _, why in data["tiles"]}
    return Shot(
        key=data["key"],
        table=data["table"],
        frames=tuple(int(n) for n in data["frames"]),
        engine=data["engine"],
        colour_type=data["colour_type"],
        colour_reason=data["colour_reason"],
        plan=Plan(effects, tiles, seen, words),
        segments=tuple(Segment(tuple(frames), tuple(warm)) for frames, warm in data["segments"]),
        notes=tuple(data["notes"]),
    )


def _path(directory: Path, key: str) -> Path:
    return directory / FOLDER / f"{key.removeprefix('sha256:')[:16]}.json"


def load_shot(directory: Path, key: str) -> Shot | None:
    """The shot of that key, where it was written before and is whole; else None."""
    path = _path(directory, key)
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        if data.get("version") != VERSION or data.get("key") != key:
            return None
        return from_dict(data)
    except (OSError, ValueError, KeyError, TypeError, zlib.error):
        return None


def commit_shot(directory: Path, shot: Shot, owner: str) -> None:
    """Writes the shot as frames are written: aside, read back, flushed, renamed.

    Raises ResourceError where the folder cannot be written.
    """
    path = _path(directory, shot.key)
    path.parent.mkdir(parents=True, exist_ok=True)
    text = json.dumps(shot.as_dict(), sort_keys=True, allow_nan=False)

    def verify(written: Path) -> str:
        again = from_dict(json.loads(written.read_text(encoding="utf-8")))
        if again.hash != shot.hash:
            raise InputError(
                "the shot file does not read back as it was written", place=Place(file=str(written))
            )
        return again.hash

    def write(there: Path) -> None:
        there.write_text(text, encoding="utf-8")

    commit_file(path, write, verify, owner)
