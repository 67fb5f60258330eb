"""A sheet as PDF: vector outlines true to scale, one page, one standard font, nothing embedded.

ISO 32000-1: a page's unit is 1/72 inch, y runs up. Outlines of connected cells are filled as a whole by the
even-odd rule; cells drawn one by one would show hairlines between them.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mrbatch.capture.marker_video.board_sheet import BoardSheet

POINTS = 72.0 / 25.4
"""Points a millimetre."""


def board_pdf(sheet: BoardSheet) -> bytes:
    """The file's bytes; the same sheet gives the same bytes."""
    content = "\n".join(_content(sheet)).encode("ascii")
    box = f"[0 0 {_number(sheet.width * POINTS)} {_number(sheet.height * POINTS)}]"
    objects = [
        # Viewers propose not to scale; a person may still choose to.
        b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
        b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        f"<< /Type /Page /Parent 2 0 R /MediaBox {box} /Contents 4 0 R "
        "/Resources << /Font << /F1 5 0 R >> >> >>".encode("ascii"),
        b"<< /Length %d >>\nstream\n%s\nendstream" % (len(content), content),
        b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>",
    ]
    out = bytearray(b"%PDF-1.6\n")
    places = []
    for number, body in enumerate(objects, start=1):
        places.append(len(out))
        out += b"%d 0 obj\n%s\nendobj\n" % (number, body)
    table = len(out)
    out += b"xref\n0 %d\n0000000000 65535 f \n" % (len(objects) + 1)
    out += b"".join(b"%010d 00000 n \n" % place for place in places)
    out += b"trailer\n<< /Size %d /Root 1 0 R >>\nstartxref\n%d\n%%%%EOF\n" % (len(objects) + 1, table)
    return bytes(out)


def _content(sheet: BoardSheet) -> Iterator[str]:
    """Operators of the page: black fills, then text."""
    yield "0 g"

    def point(x: float, y: float) -> str:
        return f"{_number(x * POINTS)} {_number((sheet.height - y) * POINTS)}"

    for cells in sheet.cells:
        for loop in outlines(cells.black):
            corners = [point(cells.x + c * cells.cell, cells.y + r * cells.cell) for r, c in loop]
            yield f"{corners[0]} m " + " ".join(f"{corner} l" for corner in corners[1:]) + " h"
        yield "f*"
    for x0, y0, x1, y1 in sheet.ruler_marks():
        yield f"{point(x0, y1)} {_number((x1 - x0) * POINTS)} {_number((y1 - y0) * POINTS)} re f"
    for x, y, size, text in sheet.texts:
        escaped = text.replace("\\", r"\\").replace("(", r"\(").replace(")", r"\)")
        yield f"BT /F1 {_number(size * POINTS)} Tf {point(x, y)} Td ({escaped}) Tj ET"


def outlines(black: np.ndarray) -> list[list[tuple[int, int]]]:
    """Closed outlines, as (row, column) of grid points, round the black cells of (n, m); holes included."""
    padded = np.pad(black, 1)
    onward: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for row, column in zip(*np.nonzero(padded)):
        r, c = int(row) - 1, int(column) - 1
        # Clockwise round the cell, the edges that no black neighbour shares.
        for start, end, there in (
            ((r, c), (r, c + 1), padded[row - 1, column]),
            ((r, c + 1), (r + 1, c + 1), padded[row, column + 1]),
            ((r + 1, c + 1), (r + 1, c), padded[row + 1, column]),
            ((r + 1, c), (r, c), padded[row, column - 1]),
        ):
            if not there:
                onward.setdefault(start, []).append(end)
    loops = []
    while onward:
        start = min(onward)
        loop, at = [start], start
        while True:
            ends = onward[at]
            following = ends.pop()
            if not ends:
                del onward[at]
            at = following
            if at == start:
                break
            loop.append(at)
        loops.append(_corners(loop))
    return loops


def _corners(loop: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """The loop without points in the middle of straight edges."""
    kept = []
    for before, at, after in zip([loop[-1], *loop[:-1]], loop, [*loop[1:], loop[0]]):
        if (at[0] - before[0], at[1] - before[1]) != (after[0] - at[0], after[1] - at[1]):
            kept.append(at)
    return kept


def _number(value: float) -> str:
    return f"{value:.4f}".rstrip("0").rstrip(".")
