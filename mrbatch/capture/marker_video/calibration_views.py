"""Views of a board for calibration: found in pictures or a video, sharp, and chosen to differ.

Thirty views that differ tell more than three hundred alike, and the fit's time grows with their number.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mrbatch.capture.marker_video.markers import TargetDetector, other_dictionaries
from mrbatch.capture.marker_video.sequence import PICTURE_SUFFIXES
from mrbatch.capture.marker_video.settings import ColourSettings
from mrbatch.capture.marker_video.shot_poses import grey_codes_of
from mrbatch.capture.marker_video.target_settings import TargetSettings
from mrbatch.capture.marker_video.video import VideoReader, build_frame_table
from mrbatch.errors import InputError, Place
from mrbatch.scene.stored_picture import colour_channels, read_stored

CANDIDATES = 240
"""Frames of a video that are looked at, evenly over its length."""
MIN_CORNERS = 8
_SHOWN = 3
BLURRED = 2.0
"""Edges this many times as wide as the sharp views' are blurred."""
_LUMA = np.array([0.299, 0.587, 0.114])


@dataclass(frozen=True)
class View:
    """One picture's corners: `points` (n, 2) pixels, centres at half integers; `board` (n, 3) metres.

    `name`: file, or frame of a video. `edge`: width of its edges in pixels.
    """

    name: str
    points: np.ndarray
    board: np.ndarray
    edge: float


@dataclass(frozen=True)
class Views:
    """All views of one camera. `size`: width and height. `looked_at`: pictures searched; `unseen`: those
    that show no board; `blurred`: those left out."""

    views: tuple[View, ...]
    size: tuple[int, int]
    looked_at: int
    unseen: tuple[str, ...]
    blurred: tuple[str, ...]


def find_views(
    paths: Sequence[Path],
    target: TargetSettings,
    *,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Views:
    """Finds the board in pictures, or in one video.

    Raises InputError: unreadable files, pictures of several sizes, no board in any.
    """
    video = len(paths) == 1 and paths[0].suffix.lower() not in PICTURE_SUFFIXES
    pictures = _of_video(paths[0]) if video else _of_files(paths)
    detector = TargetDetector(target)
    views: list[View] = []
    unseen: list[str] = []
    size: tuple[int, int] | None = None
    looked_at = 0
    first: list[np.ndarray] = []
    for name, place, total, grey in pictures:
        here = (grey.shape[1], grey.shape[0])
        if size is not None and here != size:
            raise InputError(
                f"the picture is {here[0]}x{here[1]}, the first one {size[0]}x{size[1]}",
                place=place,
                hint="calibrate from pictures of one camera in one mode, held one way round",
            )
        size = here
        looked_at += 1
        found = detector.detect(grey)
        if len(found) >= MIN_CORNERS:
            views.append(View(name, found.points_2d, found.points_3d, edge_width(grey, found.points_2d)))
        else:
            unseen.append(name)
            if len(first) < _SHOWN:
                first.append(grey)
        progress(looked_at, total)
    assert size is not None
    if not views:
        raise _nothing_seen(first, target, looked_at)
    # Whoever picks stills has looked at them; of a video, frames in fast motion are left out.
    sharp, blurred = _sharp(views) if video else (views, [])
    return Views(tuple(sharp), size, looked_at, tuple(unseen), tuple(v.name for v in blurred))


def _nothing_seen(pictures: Sequence[np.ndarray], target: TargetSettings, looked_at: int) -> InputError:
    seen = other_dictionaries(pictures, target.dictionary)
    hint = "check --board against the print; film the whole board, near and sharp"
    if seen:
        name, ids = next(iter(seen.items()))
        some = ", ".join(str(i) for i in ids[:6])
        hint = f"the pictures show markers of {name} (ids {some}): is that what was printed?"
    return InputError(f"the board is seen in none of {looked_at} pictures", hint=hint)


def _of_files(paths: Sequence[Path]) -> Iterator[tuple[str, Place, int, np.ndarray]]:
    for path in paths:
        place = Place(file=str(path))
        values, _ = colour_channels(read_stored(path), place)
        if values.dtype.kind == "f":
            yield path.name, place, len(paths), np.asarray(values, np.float32) @ _LUMA.astype(np.float32)
            continue
        grey = np.rint(values @ _LUMA).astype(values.dtype)
        yield path.name, place, len(paths), grey


def _of_video(path: Path) -> Iterator[tuple[str, Place, int, np.ndarray]]:
    table = build_frame_table(path)
    step = max(1, -(-len(table) // CANDIDATES))
    numbers = range(0, len(table), step)
    with VideoReader(path, table) as reader:
        info = reader.probe(ColourSettings())
        for index in numbers:
            try:
                linear = reader.picture(index, info).linear
            except InputError:
                continue  # a damaged frame costs itself: there are others
            place = Place(file=str(path), frame=index)
            yield f"frame {index}", place, len(numbers), grey_codes_of(linear, False)


def edge_width(grey: np.ndarray, points: np.ndarray) -> float:
    """Width in pixels of the sharpest edges round the points: contrast over gradient."""
    low = np.maximum(np.floor(points.min(axis=0)).astype(int), 0)
    high = np.ceil(points.max(axis=0)).astype(int) + 1
    part = grey[low[1] : high[1], low[0] : high[0]].astype(np.float32)
    if min(part.shape) < 3:
        return np.inf
    dy, dx = np.gradient(part)
    steepest = float(np.percentile(np.hypot(dx, dy), 99))
    contrast = float(np.subtract(*np.percentile(part, [95, 5])))
    return contrast / steepest if steepest > 0 else np.inf


def _sharp(views: Sequence[View]) -> tuple[list[View], list[View]]:
    if not views:
        return [], []
    usual = float(np.percentile([v.edge for v in views], 25))
    return [v for v in views if v.edge <= BLURRED * usual], [v for v in views if v.edge > BLURRED * usual]


def choose_views(views: Sequence[View], size: tuple[int, int], count: int) -> list[View]:
    """At most `count` views that differ most in place, distance and tilt, in their order.

    Starts with the one that shows most corners; each next one is the farthest from all chosen.
    """
    if len(views) <= count:
        return list(views)
    features = np.array([_features(v, size) for v in views])
    chosen = [int(np.argmax([len(v.points) for v in views]))]
    distance = np.linalg.norm(features - features[chosen[0]], axis=1)
    while len(chosen) < count:
        following = int(np.argmax(distance))
        chosen.append(following)
        distance = np.minimum(distance, np.linalg.norm(features - features[following], axis=1))
    return [views[i] for i in sorted(chosen)]


def _features(view: View, size: tuple[int, int]) -> np.ndarray:
    """Middle in the picture, log of size, and the board's normal by a guessed focal length."""
    import cv2

    width, height = size
    focal = float(max(size))
    matrix = np.array([[focal, 0.0, 0.5 * width], [0.0, focal, 0.5 * height], [0.0, 0.0, 1.0]])
    middle = view.points.mean(axis=0) / [width, height]
    spread = np.log(np.linalg.norm(np.ptp(view.points, axis=0)) / np.hypot(width, height))
    done, turn, _ = cv2.solvePnP(view.board, view.points, matrix, None, flags=cv2.SOLVEPNP_IPPE)
    normal = cv2.Rodrigues(turn)[0][:, 2] if done else np.zeros(3)
    return np.array([2.0 * middle[0], 2.0 * middle[1], spread, 1.5 * normal[0], 1.5 * normal[1]])
