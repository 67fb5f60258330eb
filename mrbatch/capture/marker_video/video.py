"""Video through PyAV: which frames a player shows and when, and any of them by its time.

A frame is addressed by its presentation time stamp in a table that is made once, from the packets
alone. So reordering (B-frames), variable rates and edit lists need no guess at reading time, and a
damaged frame keeps its number: it costs itself and what was predicted from it, never its neighbours.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from mrbatch.capture.marker_video.colour import Colour, Picture, VideoTags, decide_colour
from mrbatch.capture.marker_video.planes import PIXEL_FORMATS, PixelFormat, chroma_of, picture_of, turn_of
from mrbatch.capture.marker_video.settings import ColourSettings
from mrbatch.errors import InputError, Place
from mrbatch.scene.file_kind import EMPTY, TEXT, VIDEOS, file_kind, unreadable

MAX_PIXELS = 2**27
"""A picture that claims more is refused before memory is asked for."""
CONTAINERS = (
    *("mov", "mp4", "m4a", "3gp", "3g2", "mj2", "matroska", "webm", "avi", "mpegts", "mpeg", "mpegvideo"),
    *("m4v", "h264", "hevc", "vvc", "av1", "obu", "ivf", "flv", "asf", "ogg", "mxf", "gxf", "nut", "dv"),
    *("mjpeg", "yuv4mpegpipe", "dirac", "dnxhd", "vc1", "gif", "apng", "rm"),
)
"""FFmpeg's names of the containers that are opened: none of them names other files."""
_AHEAD = 8
"""Up to so many frames ahead, decoding on is cheaper than a seek."""


@dataclass(frozen=True)
class FrameTable:
    """The frames that a player shows, in the order it shows them.

    `pts`: presentation time stamps in units of `time_base` (s), strictly increasing. `order`: place of
    each frame among all packets in decoding order. `keys`: (pts, place) of the packets from which
    decoding can start, by pts. `announced`: packets that the file's index names, `packets`: found.
    `rate`: frames per second as the file names or implies it, None where it does neither.
    """

    pts: tuple[int, ...]
    time_base: Fraction
    order: tuple[int, ...]
    keys: tuple[tuple[int, int], ...]
    announced: int = 0
    packets: int = 0
    rate: Fraction | None = None

    def __len__(self) -> int:
        return len(self.pts)

    def time(self, index: int) -> Fraction:
        """Seconds on the file's own clock."""
        return self.pts[index] * self.time_base

    def as_json(self) -> dict[str, Any]:
        return {
            "pts": list(self.pts),
            "time_base": [self.time_base.numerator, self.time_base.denominator],
            "order": list(self.order),
            "keys": [list(key) for key in self.keys],
            "announced": self.announced,
            "packets": self.packets,
            "rate": None if self.rate is None else str(self.rate),
        }

    @staticmethod
    def from_json(data: dict[str, Any]) -> FrameTable:
        return FrameTable(
            tuple(data["pts"]),
            Fraction(*data["time_base"]),
            tuple(data["order"]),
            tuple((int(pts), int(place)) for pts, place in data["keys"]),
            data["announced"],
            data["packets"],
            None if data["rate"] is None else Fraction(data["rate"]),
        )


@contextmanager
def _opened(path: Path) -> Iterator[tuple[Any, Any]]:
    container, stream = _open(path)
    try:
        yield container, stream
    finally:
        container.close()


def _open(path: Path) -> tuple[Any, Any]:
    """The container and its picture stream. Raises InputError."""
    import av
    from av.stream import Disposition

    place = Place(file=str(path))
    if not path.is_file():
        raise InputError("there is no such video", place=place, hint="check its path and name")
    if file_kind(path) in (EMPTY, TEXT):
        # A playlist or subtitles to the demuxer, never footage.
        raise unreadable(path, "a video", VIDEOS)
    try:
        # Only plain files that hold all of themselves: no playlist may lead to other files or the network.
        options = {"protocol_whitelist": "file", "format_whitelist": ",".join(CONTAINERS)}
        container = av.open(str(path.resolve()), options=options)
    except (av.error.FFmpegError, UnicodeDecodeError):
        raise unreadable(path, "a video", VIDEOS) from None
    streams = [s for s in container.streams.video if not s.disposition & Disposition.attached_pic]
    if not streams:
        container.close()
        raise InputError("there is no video stream in the file", place=place)
    stream = streams[0]
    if stream.codec_context is None or not stream.time_base:
        container.close()
        raise InputError("there is no decoder for the video stream", place=place, hint="convert it to H.264")
    width, height = stream.codec_context.width, stream.codec_context.height
    if width * height > MAX_PIXELS:
        container.close()
        raise InputError(f"the video claims {width}x{height} pixels, more than {MAX_PIXELS}", place=place)
    # Errors of a packet then rise at that packet, which frame threads would delay.
    stream.thread_type = "SLICE"
    # Most decoders paint over damage without a word unless told to check; H.264 and MPEG-4 flag the
    # frame by themselves, and there `explode` would also refuse harmless slips of some cameras.
    if stream.codec_context.name not in ("h264", "mpeg4"):
        stream.codec_context.options = {"err_detect": "crccheck+bitstream+buffer+explode"}
    return container, stream


def _reason(error: Exception) -> str:
    return str(getattr(error, "strerror", None) or error)


def build_frame_table(path: Path) -> FrameTable:
    """The table of a video's frames. Raises InputError: no video, no frame, a file cut short.

    Frames outside of the edit list are marked by the demuxer and left out. Where packets carry no
    time stamps, the video is decoded once to learn them.
    """
    import av

    packets: list[tuple[int | None, bool, bool]] = []
    with _opened(path) as (container, stream):
        time_base = Fraction(stream.time_base)
        announced = len(stream.index_entries)
        rate = stream.guessed_rate or stream.average_rate
        try:
            for packet in container.demux(stream):
                if packet.size:
                    packets.append((packet.pts, packet.is_keyframe, packet.is_discard))
        except av.error.FFmpegError as error:
            if not packets:
                raise InputError(
                    f"cannot read the video: {_reason(error)}", place=Place(file=str(path))
                ) from None
    stamps = [pts for pts, _, _ in packets]
    if None in stamps or len(set(stamps)) != len(stamps):
        packets = _decoded_stamps(path)
    shown = sorted((pts, i) for i, (pts, _, discard) in enumerate(packets) if not discard)
    keys = sorted((pts, i) for i, (pts, key, _) in enumerate(packets) if key)
    if not shown:
        raise InputError("there is no frame in the video", place=Place(file=str(path)))
    return FrameTable(
        tuple(pts for pts, _ in shown),
        time_base,
        tuple(i for _, i in shown),
        tuple(keys),  # type: ignore[arg-type]
        announced,
        len(packets),
        Fraction(rate) if rate else None,
    )


def _decoded_stamps(path: Path) -> list[tuple[int | None, bool, bool]]:
    import av

    stamps: list[tuple[int | None, bool, bool]] = []
    with _opened(path) as (container, stream):
        for packet in container.demux(stream):
            try:
                frames = packet.decode()
            except av.error.FFmpegError:
                continue
            stamps += [(f.pts, bool(f.key_frame), False) for f in frames if f.pts is not None]
    if len({pts for pts, _, _ in stamps}) != len(stamps):
        raise InputError(
            "the video's frames have no time stamps of their own",
            place=Place(file=str(path)),
            hint="remux it into MP4 or Matroska, or give a picture sequence",
        )
    return stamps


@dataclass(frozen=True)
class VideoInfo:
    """What all frames of a video share, as shown (after `turn` quarter turns counter-clockwise)."""

    width: int
    height: int
    pixel_format: str
    turn: int
    colour: Colour
    notes: tuple[str, ...] = ()

    def as_json(self) -> dict[str, Any]:
        return {
            "width": self.width,
            "height": self.height,
            "pixel_format": self.pixel_format,
            "turn": self.turn,
            "colour": self.colour.as_json(),
            "notes": list(self.notes),
        }

    @staticmethod
    def from_json(data: dict[str, Any]) -> VideoInfo:
        return VideoInfo(
            **{**data, "colour": Colour.from_json(data["colour"]), "notes": tuple(data["notes"])}
        )


class VideoReader:
    """Frames of one video by their place in the table; one decoded frame is kept. Not for two threads."""

    def __init__(self, path: Path, table: FrameTable):
        self.path = path
        self.table = table
        self._place = {pts: place for pts, place in zip(table.pts, table.order)}
        self._place |= {pts: place for pts, place in table.keys}
        self._open: tuple[Any, Any] | None = None
        self._frames: Iterator[Any] | None = None
        self._kept: Any = None
        self._bad: set[int] = set()

    def close(self) -> None:
        if self._open is not None:
            self._open[0].close()
        self._open = self._frames = self._kept = None

    def __enter__(self) -> VideoReader:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def frame(self, index: int) -> Any:
        """The decoded frame (`av.VideoFrame`). Raises InputError with frame and time stamp."""
        pts = self.table.pts[index]
        before = [k for k, key in enumerate(self.table.keys) if key[0] <= pts]
        keys = [self.table.keys[k] for k in before[:-3:-1]]
        frame = self._kept if self._kept is not None and self._kept.pts == pts else None
        if frame is None and self._is_ahead(index):
            frame = self._decode_to(pts)
        for key in [*keys, None]:
            if frame is not None:
                break
            # The last resort, decoding from the start, is for files whose index misleads.
            self._seek(key[0] if key else None)
            frame = self._decode_to(pts)
        first = keys[0][1] if keys else 0
        damaged = any(first <= bad <= self.table.order[index] for bad in self._bad)
        if frame is None or damaged:
            what = "cannot be decoded" if frame is None else "is damaged"
            raise InputError(
                f"the video's frame at {float(self.table.time(index)):.6f} s (pts {pts}) {what}",
                place=Place(file=str(self.path), frame=index),
                hint="copy the file again, or leave the frame out",
            )
        return frame

    def _is_ahead(self, index: int) -> bool:
        """Whether decoding on reaches the frame sooner than a seek."""
        if self._frames is None or self._kept is None or self._kept.pts >= self.table.pts[index]:
            return False
        now = int(np.searchsorted(self.table.pts, self._kept.pts))
        return index - now <= _AHEAD or not any(
            self._kept.pts < key <= self.table.pts[index] for key, _ in self.table.keys
        )

    def _seek(self, pts: int | None) -> None:
        import av

        if pts is None:
            self.close()
        if self._open is None:
            self._open = _open(self.path)
        container, stream = self._open
        self._kept = None
        if pts is not None:
            try:
                container.seek(pts, stream=stream, backward=True)
            except av.error.FFmpegError:
                return self._seek(None)
        self._frames = self._decoded()
        return None

    def _decoded(self) -> Iterator[Any]:
        import av

        assert self._open is not None
        container, stream = self._open
        packets = container.demux(stream)
        while True:
            try:
                packet = next(packets)
            except (StopIteration, av.error.FFmpegError):
                return
            if packet.is_corrupt:
                self._bad.add(self._place_of(packet.pts))
            try:
                frames = packet.decode()
            except av.error.EOFError:
                frames = []
            except av.error.FFmpegError:
                self._bad.add(self._place_of(packet.pts))
                frames = []
            for frame in frames:
                if frame.is_corrupt:
                    self._bad.add(self._place_of(frame.pts))
                yield frame

    def _place_of(self, pts: int | None) -> int:
        return self._place.get(pts, -1) if pts is not None else -1

    def _decode_to(self, pts: int) -> Any:
        """The frame of that time stamp, or None if decoding has passed it or ended."""
        assert self._frames is not None
        for frame in self._frames:
            if frame.pts is None:
                continue
            self._kept = frame
            if frame.pts >= pts:
                return frame if frame.pts == pts else None
        self._frames = None
        return None

    def probe(self, settings: ColourSettings) -> VideoInfo:
        """What the frames share, from the first that can be decoded. Raises InputError."""
        place = Place(file=str(self.path))
        error: InputError | None = None
        for index in range(min(len(self.table), 10)):
            try:
                frame = self.frame(index)
                break
            except InputError as caught:
                error = error or caught
        else:
            raise error if error is not None else InputError("no frame can be decoded", place=place)
        form = self._format(frame, place)
        assert self._open is not None
        stream = self._open[1]
        jpeg = form.jpeg or (stream.codec_context.name == "mjpeg")
        tags = VideoTags(
            layout=form.layout,
            bits=form.bits,
            height=frame.height,
            matrix=int(frame.colorspace),
            transfer=int(frame.color_trc),
            primaries=int(frame.color_primaries),
            range=2 if form.jpeg else int(frame.color_range),
            chroma=chroma_of(frame, stream) if form.factors != (1, 1) else None,
            jpeg=jpeg,
            subsampled=form.factors != (1, 1),
        )
        colour, notes = decide_colour(tags, settings, place)
        more = []
        if frame.interlaced_frame:
            more.append("frames are flagged as interlaced: deinterlace them if they show combing")
        aspect = stream.codec_context.sample_aspect_ratio
        if aspect and aspect != 1:
            more.append(f"pixels are not square ({aspect}); the calibration must be for the stored pixels")
        if self.table.announced > self.table.packets:
            more.append(
                f"the file announces {self.table.announced} frames but holds {self.table.packets}: is it cut?"
            )
        turn = turn_of(frame, place)
        if turn:
            more.append(f"pictures are turned by {90 * turn} degrees counter-clockwise, as the file asks")
        width, height = (frame.height, frame.width) if turn % 2 else (frame.width, frame.height)
        return VideoInfo(width, height, frame.format.name, turn, colour, (*notes, *more))

    def _format(self, frame: Any, place: Place) -> PixelFormat:
        form = PIXEL_FORMATS.get(frame.format.name)
        if form is None:
            raise InputError(
                f"the pixel format {frame.format.name} is not supported",
                place=place,
                hint="convert to yuv420p, yuv422p10le, yuv444p, gray, rgb24 or gbrp",
            )
        return form

    def picture(self, index: int, info: VideoInfo) -> Picture:
        """One frame, scene-linear. Raises InputError: unreadable, or another size or format midway."""
        return self.convert(self.frame(index), index, info)

    def convert(self, frame: Any, index: int, info: VideoInfo) -> Picture:
        """A decoded frame, scene-linear; may run beside the decoding of another. Raises InputError."""
        place = Place(file=str(self.path), frame=index)
        width, height = (frame.height, frame.width) if info.turn % 2 else (frame.width, frame.height)
        if (width, height) != (info.width, info.height):
            raise InputError(
                f"the frame is {width}x{height}, the video's first {info.width}x{info.height}", place=place
            )
        if frame.format.name != info.pixel_format:
            raise InputError(
                f"the pixel format changes from {info.pixel_format} to {frame.format.name}", place=place
            )
        result = picture_of(frame, self._format(frame, place), info.colour)
        if info.turn == 0:
            return result
        linear = np.ascontiguousarray(np.rot90(result.linear, info.turn))
        codes = None if result.codes is None else np.ascontiguousarray(np.rot90(result.codes, info.turn))
        return Picture(linear, codes, result.flags)
