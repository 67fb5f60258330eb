"""The pictures of a page: which frames are shown, how each is drawn, with which legend, in how many bytes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from mrbatch.errors import MrbatchError
from mrbatch.metrics.noise import unpack_codes
from mrbatch.report import numbers
from mrbatch.report.model import Legend, Picture, Report
from mrbatch.report.pictures import (
    LinearPicture,
    data_uri,
    display_codes,
    magnitude_picture,
    map_scale,
    noise_picture,
    read_layers,
    read_picture,
    reduced,
    signed_picture,
)

MAX_FRAMES_SHOWN = 24
MAX_PICTURE_BYTES = 4_000_000
"""What all embedded pictures may take (base64 included): the page still fits into a mail."""
WIDTH = 720
WIDE = ("sheet", "plot")
"""Columns of an embedded picture, and the roles of pictures that have twice as many."""
ROLE_ORDER = (
    "sheet", "plot", "composite", "reference", "photo", "delta", "difference", "flip", "error", "other",
)  # fmt: skip
ROLES: dict[str, tuple[str, str]] = {
    "sheet": ("All frames", ""),
    "plot": ("Plot", ""),
    "composite": ("Composite", "the finished picture"),
    "reference": ("Reference", "what it is compared with"),
    "photo": ("Photo", "as filmed, before anything was added"),
    "delta": ("Light change", "on real surfaces: dark is shadow, bright is light that virtual objects send"),
    "difference": ("Difference", "picture minus reference"),
    "flip": ("HDR-FLIP", "the difference that an eye sees when it flips between both"),
    "error": ("Noise left", "root mean square, in per cent of a pixel's own brightness; grey is untouched"),
    "other": ("Picture", ""),
}
"""Title and one line of meaning by role."""
COMPARED: dict[str, tuple[str, str]] = {
    "composite": ("Test", "the picture that is judged"),
    "error": ("Relative error", "in per cent of the reference's own brightness"),
}
"""Where a report compares pictures with references: nothing is estimated there."""


def signed_legend(high: float) -> Legend:
    """Of a picture drawn by `signed_picture`."""
    text = numbers.number(high)
    return Legend(kind="signed", ticks=(f"−{text}", "0", f"+{text}"))


def magnitude_legend(high: float, unit: str = "") -> Legend:
    """Of a picture drawn by `magnitude_picture`."""
    return Legend(kind="magma", ticks=(f"0{unit}", f"{numbers.number(high)}{unit}"))


@dataclass(frozen=True)
class Shown:
    """A picture as the page draws it; `uri` is empty where it could not be embedded, `why` says why."""

    role: str
    title: str
    meaning: str
    caption: str
    uri: str
    why: str = ""
    legend: Legend | None = None


@dataclass(frozen=True)
class Group:
    """Pictures that belong together: those of one frame, or those of none."""

    frame: int | None
    pictures: tuple[Shown, ...]

    @property
    def bytes(self) -> int:
        return sum(len(picture.uri) for picture in self.pictures)


def picture_groups(
    report: Report,
    folder: Path | None,
    images: Mapping[str, np.ndarray],
    *,
    max_frames: int = MAX_FRAMES_SHOWN,
    max_bytes: int = MAX_PICTURE_BYTES,
) -> tuple[Group, ...]:
    """The pictures without a frame, then as many frames as fit, spread over the shot, in order."""
    painter = _Painter(report.kind, folder, images)
    wanted = sorted({p.frame for p in report.pictures if p.frame is not None})
    if len(wanted) > max_frames:
        places = np.linspace(0, len(wanted) - 1, max_frames).round().astype(int)
        wanted = [wanted[i] for i in places]
    left = max_bytes
    groups: list[Group] = []
    for frame in (None, *_spread(wanted)):
        chosen = sorted((p for p in report.pictures if p.frame == frame), key=_role)
        if not chosen:
            continue
        # The first frame is shown as far as it fits, others wholly or not at all.
        needed = frame is None or not any(g.frame is not None for g in groups)
        group = painter.group(frame, chosen, left if needed else max_bytes)
        if not needed and group.bytes > left:
            break
        left -= group.bytes
        groups.append(group)
    return tuple(sorted(groups, key=lambda g: (g.frame is not None, g.frame or 0)))


def _spread(frames: Sequence[int]) -> list[int]:
    """The same frames, ordered so that any first few are spread over the shot: ends, middle, quarters."""
    if len(frames) < 3:
        return list(frames)
    order = [0, len(frames) - 1]
    gaps = [(0, len(frames) - 1)]
    while gaps:
        first, last = gaps.pop(0)
        middle = (first + last) // 2
        if middle not in (first, last):
            order.append(middle)
            gaps += [(first, middle), (middle, last)]
    return [frames[i] for i in order]


def _role(picture: Picture) -> int:
    return ROLE_ORDER.index(picture.role)


@dataclass
class _Painter:
    """Draws pictures; signed ones of all frames on the scale of the first that is drawn."""

    kind: str
    folder: Path | None
    images: Mapping[str, np.ndarray]
    scales: dict[tuple[str, str], float] = field(default_factory=dict)
    layers: dict[str, list[str]] = field(default_factory=dict)
    """By path what is shown of a file in the group that is being drawn."""
    read: dict[str, dict[str, LinearPicture]] = field(default_factory=dict)

    def group(self, frame: int | None, chosen: Sequence[Picture], left: int) -> Group:
        shown = []
        self.layers = {}
        for picture in chosen:
            wanted = self.layers.setdefault(picture.path, [])
            wanted += [] if picture.layer in wanted else [picture.layer]
        self.read = {}
        for picture in chosen:
            one = self.shown(picture, left)
            left -= len(one.uri)
            shown.append(one)
        return Group(frame, tuple(shown))

    def shown(self, picture: Picture, left: int) -> Shown:
        title, meaning = ROLES[picture.role]
        if self.kind == "metrics":
            title, meaning = COMPARED.get(picture.role, (title, meaning))
        title += f" ({picture.view})" if picture.view else ""

        def result(uri: str = "", why: str = "", legend: Legend | None = None) -> Shown:
            why = f"{picture.path}: {why}" if why else ""
            return Shown(picture.role, title, meaning, picture.caption, uri, why, legend)

        if left <= 0:
            return result(why="left out, the page is full")
        legend = picture.legend
        codes = self.images.get(picture.path)
        if codes is None:
            try:
                codes, legend = self._drawn(picture)
            except MrbatchError as error:
                return result(why=error.message)
            except _NotShown as error:
                return result(why=str(error))
        wide = picture.role in WIDE
        uri = data_uri(codes, width=2 * WIDTH if wide else WIDTH, max_bytes=900_000 if wide else 300_000)
        return result(uri, "", legend) if len(uri) <= left else result(why="left out, the page is full")

    def _drawn(self, picture: Picture) -> tuple[np.ndarray, Legend | None]:
        """A file's values as a person wants to see them, uint8 RGB: by the role that it plays on the page."""
        whole = self._read(picture).values
        # Reduced before it is drawn: a page shows no more, and drawing takes longer than reading.
        values = whole if picture.role in WIDE else reduced(whole, WIDTH)
        if picture.noise is not None:
            about = picture.noise
            try:
                codes = unpack_codes(about.columns, about.rows, about.codes)
            except ValueError as error:
                raise _NotShown(str(error)) from error
            block = about.block * values.shape[1] / whole.shape[1]
            drawn = noise_picture(codes, block, display_codes(values))
            return drawn, Legend(kind="magma", ticks=("0.1 %", "1 %", "10 %", "100 %"))
        if picture.role in ("delta", "difference"):
            scale = self._scale(picture, values)
            return signed_picture(values, scale), signed_legend(scale)
        if picture.role in ("error", "flip"):
            flat = np.abs(values).mean(axis=2)
            scale = self._scale(picture, flat)
            return magnitude_picture(flat, scale), magnitude_legend(scale)
        return display_codes(values), None

    def _scale(self, picture: Picture, values: np.ndarray) -> float:
        return self.scales.setdefault((picture.role, picture.view), map_scale(values))

    def _read(self, picture: Picture) -> LinearPicture:
        if self.folder is None:
            raise _NotShown("not at hand")
        root = Path(self.folder).resolve()
        path = (root / picture.path).resolve()
        if not path.is_relative_to(root):
            raise _NotShown("lies outside the report's folder")
        if picture.path not in self.read:
            self.read[picture.path] = read_layers(path, self.layers.get(picture.path, [picture.layer]))
        found = self.read[picture.path].get(picture.layer)
        return found if found is not None else read_picture(path, picture.layer)  # says what is missing


class _NotShown(Exception):
    """Why a picture has only its place on the page."""
