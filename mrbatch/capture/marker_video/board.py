"""Targets to print: one call from type and paper to PDF or PNG files and the job's `target`."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from pydantic import ValidationError

from mrbatch.capture.marker_video.board_pdf import board_pdf
from mrbatch.capture.marker_video.board_picture import board_picture
from mrbatch.capture.marker_video.board_sheet import BoardSheet, BoardType, lay_out
from mrbatch.errors import JobError, Place, ResourceError


def make_board(
    kind: BoardType,
    outputs: str | Path | Sequence[str | Path],
    *,
    paper: str = "A4",
    dictionary: str | None = None,
    marker_id: int = 0,
    squares: tuple[int, int] | None = None,
    square: float | None = None,
    side: float | None = None,
    dpi: float = 300.0,
) -> BoardSheet:
    """Writes a printable target true to scale; `BoardSheet.yaml` is the job's `target` for it.

    `kind`: marker, charuco, grid, or aprilgrid (a grid of tag36h11). `outputs` end in .pdf or .png.
    Lengths in metres: `side` of markers, `square` of a chessboard (of grids: from marker to marker).
    Raises JobError: a target that cannot be or does not fit; ResourceError: a file that cannot be written.
    """
    paths = [Path(outputs)] if isinstance(outputs, (str, Path)) else [Path(o) for o in outputs]
    for path in paths:
        if path.suffix.lower() not in (".pdf", ".png"):
            raise JobError(f"a board is written as .pdf or .png, but the output is called {path.name}")
        if not path.parent.is_dir():
            raise JobError("the output's folder does not exist", place=Place(file=str(path)))
    try:
        sheet = lay_out(
            kind,
            paper,
            dictionary=dictionary,
            marker_id=marker_id,
            squares=squares,
            square=square,
            side=side,
        )
    except ValidationError as error:
        first = error.errors()[0]
        what = ".".join(str(part) for part in first["loc"])
        message = first["msg"].removeprefix("Value error, ")
        raise JobError(f"no such target: {what + ': ' if what else ''}{message}") from None
    for path in paths:
        data = board_pdf(sheet) if path.suffix.lower() == ".pdf" else _png(sheet, dpi)
        _write(path, data)
    return sheet


def _png(sheet: BoardSheet, dpi: float) -> bytes:
    import io

    from PIL import Image

    stream = io.BytesIO()
    Image.fromarray(board_picture(sheet, dpi)).save(stream, format="png", dpi=(dpi, dpi))
    return stream.getvalue()


def _write(path: Path, data: bytes) -> None:
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        temporary.write_bytes(data)
        os.replace(temporary, path)
    except OSError as error:
        raise ResourceError(
            f"cannot write the board ({error.strerror})", place=Place(file=str(path))
        ) from None
    finally:
        temporary.unlink(missing_ok=True)
