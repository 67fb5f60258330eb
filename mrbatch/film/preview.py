"""Pictures to look at: PNG and JPEG, a contact sheet, an MP4.

They go through the inverse of the transfer function that the capture came in with, so pixels that
nothing virtual touches keep their very codes (PNG; 8-bit sources). They stand outside the promise
of identical bits. Frames pass one at a time; only thumbnails are kept.
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import Any, Literal

import numpy as np

from mrbatch.errors import Place, ResourceError
from mrbatch.kernels.transfer import from_linear

SCREEN_TRANSFERS = ("srgb", "bt709", "bt1886", "gamma22", "gamma28")
"""Curves that an ordinary screen shows well; pictures of other captures are shown through sRGB."""


def preview_codes(linear: np.ndarray, transfer: str = "srgb", *, exposure: float = 1.0) -> np.ndarray:
    """Linear Rec.709 (h, w, 3), photo units, to 8-bit codes (h, w, 3) for a screen.

    `transfer`: the capture's; linear, PQ and HLG captures are shown through sRGB instead. `exposure`
    multiplies, 1 keeps the codes of untouched pixels.
    """
    curve = transfer if transfer in SCREEN_TRANSFERS else "srgb"
    return from_linear(linear if exposure == 1.0 else linear * exposure, curve, 8)


def write_picture(path: Path, codes: np.ndarray, *, quality: int = 92) -> None:
    """Writes 8-bit RGB (h, w, 3) as PNG or JPEG, by the suffix; a file under its name is complete.

    `quality`: of a JPEG, 1 to 100. Raises ResourceError where it cannot be written, ValueError for
    another suffix.
    """
    import cv2

    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in (".png", ".jpg", ".jpeg"):
        raise ValueError(f"`{path.name}`: expected .png, .jpg or .jpeg")
    options = [] if suffix == ".png" else [cv2.IMWRITE_JPEG_QUALITY, quality]
    done, data = cv2.imencode(suffix, np.ascontiguousarray(codes[..., ::-1]), options)
    if not done:
        raise ResourceError("the picture could not be encoded", place=Place(file=str(path)))
    temporary = _temporary(path)
    try:
        temporary.write_bytes(data.tobytes())
        os.replace(temporary, path)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        raise _cannot_write(path, error) from error


def _temporary(path: Path) -> Path:
    return path.with_name(f".{path.name}.{os.getpid()}.part")


def _cannot_write(path: Path, error: Exception) -> ResourceError:
    reason = getattr(error, "strerror", None) or str(error)
    return ResourceError(
        f"cannot write the preview: {reason}",
        place=Place(file=str(path)),
        hint="check that the folder exists and may be written, and that the disk has room",
    )


@dataclass(frozen=True)
class Thumbnail:
    """One frame of a contact sheet: small codes, the frame's number and a line of text."""

    number: int
    codes: np.ndarray
    note: str


class ContactSheet:
    """All frames small in one picture, with their numbers.

    `add` takes frames one at a time. Where more than `limit` come, every second, then every fourth
    frame is kept and so on, so that a long shot costs no more than a short one.
    """

    MARGIN = 24
    GAP = 14
    CAPTION = 30
    HEAD = 58
    PAPER = (24, 25, 28)
    INK = (232, 232, 230)
    FAINT = (150, 152, 156)

    def __init__(self, title: str = "", *, width: int = 320, limit: int = 60) -> None:
        self.title = title
        self.width = width
        self.limit = limit
        self._thumbnails: list[Thumbnail] = []
        self._seen = 0
        self._stride = 1

    def add(self, number: int, codes: np.ndarray, note: str = "") -> None:
        """A frame: 8-bit RGB (h, w, 3), its number, and a short text such as its time or error."""
        import cv2

        index, self._seen = self._seen, self._seen + 1
        if index % self._stride:
            return
        height = max(1, round(codes.shape[0] * self.width / codes.shape[1]))
        small = codes.shape[1] > self.width
        method = cv2.INTER_AREA if small else cv2.INTER_NEAREST
        thumbnail = cv2.resize(np.ascontiguousarray(codes), (self.width, height), interpolation=method)
        self._thumbnails.append(Thumbnail(number, thumbnail, note))
        if len(self._thumbnails) > self.limit:
            self._thumbnails = self._thumbnails[::2]
            self._stride *= 2

    @property
    def numbers(self) -> tuple[int, ...]:
        """Numbers of the frames that are shown."""
        return tuple(t.number for t in self._thumbnails)

    def draw(self) -> np.ndarray:
        """The sheet as 8-bit RGB (h, w, 3). Raises ValueError where no frame was added."""
        if not self._thumbnails:
            raise ValueError("a contact sheet needs a frame")
        cell_w = self.width
        cell_h = max(t.codes.shape[0] for t in self._thumbnails)
        n = len(self._thumbnails)
        # About 3:2 as a whole, and no half-empty last row where another count of columns fills it.
        columns = max(1, min(n, round(math.sqrt(1.5 * n * (cell_h + self.CAPTION) / cell_w))))
        rows = math.ceil(n / columns)
        columns = math.ceil(n / rows)
        width = 2 * self.MARGIN + columns * cell_w + (columns - 1) * self.GAP
        height = (
            self.MARGIN + self.HEAD + rows * (cell_h + self.CAPTION) + (rows - 1) * self.GAP + self.MARGIN
        )
        sheet = np.empty((height, width, 3), dtype=np.uint8)
        sheet[:] = self.PAPER
        several = f"{self._seen} frames" if self._seen != 1 else "1 frame"
        if self._stride > 1:
            several += f", every {self._stride}th shown"
        self._text(sheet, self.title or "contact sheet", self.MARGIN, self.MARGIN + 22, 22, self.INK, 600)
        self._text(sheet, several, self.MARGIN, self.MARGIN + 44, 14, self.FAINT, 400)
        for i, thumbnail in enumerate(self._thumbnails):
            x = self.MARGIN + (i % columns) * (cell_w + self.GAP)
            y = self.MARGIN + self.HEAD + (i // columns) * (cell_h + self.CAPTION + self.GAP)
            h, w = thumbnail.codes.shape[:2]
            sheet[y : y + h, x : x + w] = thumbnail.codes
            base = y + cell_h + 20
            end = self._text(sheet, str(thumbnail.number), x, base, 15, self.INK, 600)
            self._text(sheet, thumbnail.note, end + 10, base, 13, self.FAINT, 400, x + cell_w)
        return sheet

    def write(self, path: Path) -> None:
        """Draws the sheet into a PNG or JPEG; raises as `write_picture` does."""
        write_picture(path, self.draw())

    @staticmethod
    def _text(
        sheet: np.ndarray,
        text: str,
        x: int,
        y: int,
        size: int,
        colour: tuple[int, int, int],
        weight: int,
        right: int | None = None,
    ) -> int:
        """Writes from (x, y), the base line, cut at column `right`; gives the column after the text."""
        import cv2

        right = sheet.shape[1] if right is None else right
        if not text or x >= right:
            return x
        region = sheet[:, :right]
        drawn = np.ascontiguousarray(region)
        # A wide wrap range keeps a long text on its line; what is beyond the region is cut.
        end, drawn = cv2.putText(
            drawn, text, (x, y), colour, cv2.FontFace("sans"), size, weight, wrap=(0, 1 << 20)
        )
        region[:] = drawn
        return int(end[0])


_TRC = {"srgb": 13, "bt709": 1, "bt1886": 1, "gamma22": 4, "gamma28": 5}
"""ISO/IEC 23091-2 codes of transfer characteristics, as MP4 carries them."""


class MoviePreview:
    """An MP4 that is written frame by frame: H.264 4:2:0 where the codec is there, else MPEG-4.

    Use it in a `with` block: the file gets its name when the block ends well and does not appear
    otherwise. Tagged Rec.709 primaries and matrix, limited range, and the transfer function that the
    codes are in. A picture with odd sides is widened by repeating its last column or row.
    """

    def __init__(
        self,
        path: Path,
        frames_per_second: Fraction,
        *,
        transfer: str = "srgb",
        codec: Literal["auto", "libx264", "mpeg4"] = "auto",
    ) -> None:
        import av

        self.path = Path(path)
        self.rate = Fraction(frames_per_second).limit_denominator(65535)
        self.transfer = transfer if transfer in SCREEN_TRANSFERS else "srgb"
        self.codec = codec
        if codec == "auto":
            self.codec = "libx264" if "libx264" in av.codecs_available else "mpeg4"
        self.frames = 0
        self._temporary = _temporary(self.path)
        self._container: Any = None
        self._stream: Any = None
        self._size: tuple[int, int] | None = None

    def __enter__(self) -> MoviePreview:
        return self

    def add(self, codes: np.ndarray) -> None:
        """The next frame, 8-bit RGB (h, w, 3). All have one size: raises ValueError for another.

        Raises ResourceError where the file cannot be written.
        """
        import av

        if self._size is None:
            self._size = codes.shape[:2]
            try:
                self._open(codes.shape[1] + codes.shape[1] % 2, codes.shape[0] + codes.shape[0] % 2)
            except (av.FFmpegError, OSError) as error:
                raise _cannot_write(self.path, error) from error
        if codes.shape[:2] != self._size:
            raise ValueError(f"frame of {codes.shape[:2]} in a movie of {self._size}")
        even = np.pad(codes, ((0, codes.shape[0] % 2), (0, codes.shape[1] % 2), (0, 0)), mode="edge")
        frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(even), format="rgb24")
        frame = frame.reformat(
            format="yuv420p",
            src_colorspace="ITU709",
            dst_colorspace="ITU709",
            src_color_range="JPEG",
            dst_color_range="MPEG",
            interpolation="AREA",
        )
        frame.pts = self.frames
        frame.time_base = 1 / self.rate
        self.frames += 1
        self._encode(frame)

    def _open(self, width: int, height: int) -> None:
        import av

        self._container = av.open(str(self._temporary), "w", format="mp4", options={"movflags": "+faststart"})
        stream = self._container.add_stream(self.codec, rate=self.rate)
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        context = stream.codec_context
        context.time_base = 1 / self.rate
        context.color_range, context.colorspace, context.color_primaries = 1, 1, 1
        context.color_trc = _TRC[self.transfer]
        if self.codec == "libx264":
            context.options = {"crf": "16", "preset": "medium"}
        else:
            context.bit_rate = max(400_000, int(width * height * float(self.rate) * 0.25))
        self._stream = stream

    def _encode(self, frame: Any) -> None:
        import av

        try:
            for packet in self._stream.encode(frame):
                self._container.mux(packet)
        except (av.FFmpegError, OSError) as error:
            raise _cannot_write(self.path, error) from error

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        import av

        try:
            if self._container is not None:
                if kind is None:
                    self._encode(None)
                self._container.close()
                if kind is None:
                    os.replace(self._temporary, self.path)
        except (av.FFmpegError, OSError) as problem:
            if kind is None:
                raise _cannot_write(self.path, problem) from problem
        finally:
            self._temporary.unlink(missing_ok=True)
