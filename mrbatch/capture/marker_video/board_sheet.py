"""A printed target as geometry: which parts of a page are black, in millimetres from its top left corner.

The same geometry becomes a vector PDF (`board_pdf`) and a picture (`board_picture`), and the same target
settings go into the job, so that what is printed is what is looked for.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from mrbatch.capture.marker_video.markers import marker_bits, opencv_board
from mrbatch.capture.marker_video.target_settings import BoardSettings, MarkerSettings, TargetSettings
from mrbatch.errors import JobError
from mrbatch.quantities import LENGTH_UNITS, parse_quantity

PAPERS = {
    "A5": (148.0, 210.0),
    "A4": (210.0, 297.0),
    "A3": (297.0, 420.0),
    "A2": (420.0, 594.0),
    "A1": (594.0, 841.0),
    "A0": (841.0, 1189.0),
    "letter": (215.9, 279.4),
    "legal": (215.9, 355.6),
    "tabloid": (279.4, 431.8),
}
"""Width and height upright, in millimetres."""
MARGIN = 10.0
"""Millimetres at the page's edges that printers leave white."""
FOOT = 24.0
"""Millimetres above the lower margin for the ruler and the text."""
RULER = 100.0
BoardType = Literal["marker", "charuco", "aprilgrid", "grid"]


@dataclass(frozen=True)
class Cells:
    """Square cells: `x`, `y` of the top left corner and `cell`, the side of one, mm; `black` (n, m) bool."""

    x: float
    y: float
    cell: float
    black: np.ndarray

    def runs(self) -> Iterator[tuple[float, float, float, float]]:
        """Black rectangles x0, y0, x1, y1 in mm that do not overlap: runs of cells in a row."""
        for row, line in enumerate(self.black):
            edges = np.flatnonzero(np.diff(np.concatenate([[0], line.astype(int), [0]])))
            for start, end in zip(edges[::2], edges[1::2]):
                top = self.y + row * self.cell
                yield self.x + start * self.cell, top, self.x + end * self.cell, top + self.cell


@dataclass(frozen=True)
class BoardSheet:
    """One page. `width`, `height` in mm; `cells` of markers and squares; `ruler` (x, y): where its line of
    100 mm starts; `texts`: x, y of the base line in mm, size in mm, text."""

    target: TargetSettings
    paper: str
    width: float
    height: float
    cells: tuple[Cells, ...]
    ruler: tuple[float, float]
    texts: tuple[tuple[float, float, float, str], ...]

    def rectangles(self) -> Iterator[tuple[float, float, float, float]]:
        """All that is black but the text, as rectangles x0, y0, x1, y1 in mm that do not overlap."""
        for cells in self.cells:
            yield from cells.runs()
        yield from self.ruler_marks()

    def ruler_marks(self) -> Iterator[tuple[float, float, float, float]]:
        """The ruler's line and its ticks: their middles are 10 mm apart."""
        x, y = self.ruler
        yield x - 0.1, y, x + RULER + 0.1, y + 0.2
        for k in range(11):
            tick = 4.0 if k in (0, 10) else 3.0 if k == 5 else 2.0
            yield x + 10.0 * k - 0.1, y - tick, x + 10.0 * k + 0.1, y

    @property
    def yaml(self) -> str:
        """The job's `target`."""
        if self.target.marker:
            m = self.target.marker
            return f"target:\n  marker: {{dictionary: {m.dictionary}, id: {m.id}, side: {_mm(m.side)}}}\n"
        b = self.target.board
        assert b is not None
        gap = f"square: {_mm(b.square)}" if b.square is not None else f"separation: {_mm(b.separation or 0)}"
        first = f", first_id: {b.first_id}" if b.first_id else ""
        return (
            f"target:\n  board: {{type: {b.type}, squares: [{b.squares[0]}, {b.squares[1]}], {gap}, "
            f"marker: {_mm(b.marker)}, dictionary: {b.dictionary}{first}}}\n"
        )


def _mm(metres: float) -> str:
    return f"{round(1000.0 * metres, 6):g} mm"


def paper_size(name: str) -> tuple[float, float]:
    """Width and height in mm of a named paper or of `WIDTHxHEIGHT` (`300x200 mm`). Raises JobError."""
    for known, size in PAPERS.items():
        if name.lower() == known.lower():
            return size
    try:
        numbers, unit = name.lower().replace(" ", ""), "mm"
        for suffix in ("mm", "cm", "in"):
            if numbers.endswith(suffix):
                numbers, unit = numbers.removesuffix(suffix), suffix
        width, height = (parse_quantity(f"{n} {unit}", LENGTH_UNITS, "a length") for n in numbers.split("x"))
    except ValueError:
        raise JobError(
            f"there is no paper `{name}`", hint=f"named are {', '.join(PAPERS)}; else say 300x200mm"
        ) from None
    if not (0.12 <= width <= 5.0 and 0.12 <= height <= 5.0):
        raise JobError(f"a paper of {_mm(width)} x {_mm(height)}: expected 120 mm to 5 m a side")
    return 1000.0 * width, 1000.0 * height


def lay_out(
    kind: BoardType,
    paper: str = "A4",
    *,
    dictionary: str | None = None,
    marker_id: int = 0,
    squares: tuple[int, int] | None = None,
    square: float | None = None,
    side: float | None = None,
) -> BoardSheet:
    """A page with one marker or a board in its middle, as large as fits where no size is given.

    `side` of a marker, `square` of a chessboard, in metres. `squares`: columns and rows. Raises JobError:
    no such paper, a board that does not fit; pydantic's ValidationError: no such dictionary or id.
    """
    size = paper_size(paper)
    if kind == "marker" and squares is not None:
        raise JobError("a single marker has no squares", hint="--type grid makes several")
    columns, rows = squares or {"charuco": (7, 5), "marker": (1, 1)}.get(kind, (6, 4))
    if not (1 <= columns <= 100 and 1 <= rows <= 100):
        raise JobError(f"a board of {columns} x {rows}: expected 1 to 100 columns and rows")
    turned = (columns > rows) != (size[0] > size[1]) and columns != rows
    width, height = size[::-1] if turned else size
    room = (width - 2 * MARGIN, height - 2 * MARGIN - FOOT)
    target = _target(kind, dictionary, marker_id, (columns, rows), square, side, room)
    cells, extent = _cells(target)
    quiet = cells[0].cell if target.marker else 0.0
    if extent[0] + 2 * quiet > width or extent[1] + quiet > room[1] + MARGIN:
        raise JobError(
            f"the target is {extent[0]:g} x {extent[1]:g} mm and does not fit on {paper} with its white rim",
            hint=f"at most {room[0]:g} x {room[1]:g} mm; give a smaller size or a larger paper",
        )
    x0, y0 = 0.5 * (width - extent[0]), MARGIN + 0.5 * (room[1] - extent[1])
    placed = tuple(Cells(c.x + x0, c.y + y0, c.cell, c.black) for c in cells)
    left = max(MARGIN, 0.5 * (width - RULER))
    ruler = (left, height - MARGIN - 12.0)
    sheet = BoardSheet(target, paper, width, height, placed, ruler, ())
    texts = (
        (left, height - MARGIN - 7.0, 3.0, "100 mm: measure this line; print at 100 % (actual size)"),
        (left, height - MARGIN - 2.0, 3.0, _caption(target)),
    )
    return BoardSheet(target, sheet.paper, width, height, placed, ruler, texts)


def _target(
    kind: BoardType,
    dictionary: str | None,
    marker_id: int,
    squares: tuple[int, int],
    square: float | None,
    side: float | None,
    room: tuple[float, float],
) -> TargetSettings:
    """The settings, with whole millimetres that fill the room (in mm) where no size is given."""
    if kind == "marker":
        side = 1e-3 * min(60.0, float(np.floor(min(room) / 1.5))) if side is None else side
        name = dictionary or "DICT_4X4_50"
        marker = {"dictionary": name, "id": marker_id, "side": _length(side)}
        return TargetSettings(marker=MarkerSettings.model_validate(marker))
    columns, rows = squares
    board: dict[str, Any] = {"squares": squares, "first_id": marker_id}
    if kind == "charuco":
        fitting = np.floor(min(room[0] / columns, room[1] / rows))
        square = 1e-3 * float(fitting) if square is None else square
        side = 1e-3 * float(np.floor(730.0 * square)) if side is None else side
        board |= {"type": "charuco", "square": _length(square)}
        name = _smallest("DICT_4X4", columns * rows // 2 + marker_id)
    else:
        if side is None:
            side = 1e-3 * float(np.floor(min(room[0] / (1.3 * columns), room[1] / (1.3 * rows))))
        gap = 1e-4 * round(3000.0 * side) if square is None else square - side
        board |= {"type": "grid", "separation": _length(gap)}
        name = _smallest("DICT_4X4", columns * rows + marker_id)
        name = "DICT_APRILTAG_36h11" if kind == "aprilgrid" else name
    board |= {"marker": _length(side), "dictionary": dictionary or name}
    return TargetSettings(board=BoardSettings.model_validate(board))


def _smallest(family: str, count: int) -> str:
    return f"{family}_{next((n for n in (50, 100, 250) if n >= count), 1000)}"


def _length(metres: float) -> str:
    """As a job writes it: the models read quantities with units."""
    return f"{round(metres, 9)!r} m"


def _cells(target: TargetSettings) -> tuple[list[Cells], tuple[float, float]]:
    """Black cells in mm from the target's top left corner, and the target's width and height in mm."""
    if target.marker:
        side = 1000.0 * target.marker.side
        return [_marker(target.marker.dictionary, target.marker.id, 0.0, 0.0, side)], (side, side)
    board = target.board
    assert board is not None
    made = opencv_board(board)
    cells, taken = [], set()
    for i, corners in zip(np.ravel(made.getIds()), made.getObjPoints(), strict=True):
        x, y = 1000.0 * np.asarray(corners, dtype=np.float64)[0, :2]
        cells.append(_marker(board.dictionary, int(i), float(x), float(y), 1000.0 * board.marker))
        if board.square is not None:
            taken.add((int(x / (1000.0 * board.square)), int(y / (1000.0 * board.square))))
    columns, rows = board.squares
    if board.square is None:
        step = 1000.0 * (board.marker + (board.separation or 0.0))
        gap = 1000.0 * (board.separation or 0.0)
        return cells, (columns * step - gap, rows * step - gap)
    square = 1000.0 * board.square
    full = np.ones((1, 1), dtype=bool)
    # Markers lie in the white squares; the others are black.
    for column in range(columns):
        for row in range(rows):
            if (column, row) not in taken:
                cells.append(Cells(column * square, row * square, square, full))
    return cells, (columns * square, rows * square)


def _marker(dictionary: str, marker: int, x: float, y: float, side: float) -> Cells:
    bits = marker_bits(dictionary, marker)
    return Cells(x, y, side / (len(bits) + 2), np.pad(~bits, 1, constant_values=True))


def _caption(target: TargetSettings) -> str:
    if target.marker:
        m = target.marker
        return f"{m.dictionary}, id {m.id}, side {_mm(m.side)}; x to the right, y up the page"
    b = target.board
    assert b is not None
    last = b.first_id + b.marker_count - 1
    size = f"square {_mm(b.square)}" if b.square is not None else f"separation {_mm(b.separation or 0)}"
    return (
        f"{b.type} {b.squares[0]} x {b.squares[1]}, {size}, marker {_mm(b.marker)}, "
        f"{b.dictionary}, ids {b.first_id} to {last}"
    )
