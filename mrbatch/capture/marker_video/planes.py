"""A decoded video frame's planes, side data and tags, as arrays and names."""

from __future__ import annotations

import re
import threading
from dataclasses import dataclass
from typing import Any

import numpy as np

from mrbatch.capture.marker_video.colour import (
    Colour,
    Picture,
    linear_from_codes,
    linear_from_signal,
    signal_from_yuv,
)
from mrbatch.errors import InputError, Place


@dataclass(frozen=True)
class PixelFormat:
    """How a pixel format lies in memory: `planes` of `yuv`, `nv` (chroma interleaved), `gbr`, `gray` or
    `packed` with `samples` a pixel, `channels` naming where R, G, B are; `factors` of chroma."""

    kind: str
    bits: int
    factors: tuple[int, int] = (1, 1)
    samples: int = 1
    channels: tuple[int, int, int] = (0, 1, 2)
    shift: int = 0
    jpeg: bool = False

    @property
    def layout(self) -> str:
        return {"yuv": "yuv", "nv": "yuv", "gray": "gray"}.get(self.kind, "rgb")


def _formats() -> dict[str, PixelFormat]:
    table = {"gray": PixelFormat("gray", 8), "gbrp": PixelFormat("gbr", 8)}
    for name, factors in {
        "420": (2, 2),
        "422": (2, 1),
        "444": (1, 1),
        "440": (1, 2),
        "411": (4, 1),
        "410": (4, 4),
    }.items():
        table[f"yuv{name}p"] = PixelFormat("yuv", 8, factors)
        table[f"yuvj{name}p"] = PixelFormat("yuv", 8, factors, jpeg=True)
        for bits in (9, 10, 12, 14, 16):
            table[f"yuv{name}p{bits}le"] = PixelFormat("yuv", bits, factors)
    for bits in (9, 10, 12, 14, 16):
        table[f"gray{bits}le"] = PixelFormat("gray", bits)
        table[f"gbrp{bits}le"] = PixelFormat("gbr", bits)
    table["nv12"] = PixelFormat("nv", 8, (2, 2))
    table["nv16"] = PixelFormat("nv", 8, (2, 1))
    table["p010le"] = PixelFormat("nv", 10, (2, 2), shift=6)
    table["rgb24"] = PixelFormat("packed", 8, samples=3)
    table["bgr24"] = PixelFormat("packed", 8, samples=3, channels=(2, 1, 0))
    table["rgb48le"] = PixelFormat("packed", 16, samples=3)
    for name, channels in {
        "rgb0": (0, 1, 2),
        "bgr0": (2, 1, 0),
        "0rgb": (1, 2, 3),
        "0bgr": (3, 2, 1),
    }.items():
        table[name] = PixelFormat("packed", 8, samples=4, channels=channels)
    return table


PIXEL_FORMATS = _formats()


def _plane(
    frame: Any, index: int, width: int, height: int, form: PixelFormat, samples: int = 1
) -> np.ndarray:
    """(height, width * samples) unsigned codes of one plane, without its padding."""
    plane = frame.planes[index]
    dtype = np.dtype(np.uint8 if form.bits <= 8 else "<u2")
    # Not more than the rows themselves: the last one may lack its padding.
    need = (height - 1) * plane.line_size + width * samples * dtype.itemsize
    raw = np.frombuffer(plane, dtype=np.uint8, count=need)
    rows = np.lib.stride_tricks.as_strided(
        raw, (height, width * samples * dtype.itemsize), (plane.line_size, 1), writeable=False
    )
    codes = np.ascontiguousarray(rows).view(dtype)
    return codes >> form.shift if form.shift else codes


def picture_of(frame: Any, form: PixelFormat, colour: Colour) -> Picture:
    width, height = frame.width, frame.height
    if form.layout == "rgb":
        if form.kind == "gbr":
            g, b, r = (_plane(frame, i, width, height, form) for i in range(3))
            codes = np.stack([r, g, b], axis=-1)
        else:
            packed = _plane(frame, 0, width, height, form, form.samples)
            codes = packed.reshape(height, width, form.samples)[..., list(form.channels)]
        if colour.range == "limited":
            scale = np.float32(2 ** (form.bits - 8))
            signal = (codes.astype(np.float32) - 16 * scale) / (219 * scale)
            return linear_from_signal(np.clip(signal, 0.0, 1.0), colour)
        return linear_from_codes(np.ascontiguousarray(codes), colour)
    luma = _plane(frame, 0, width, height, form)
    if form.layout == "gray":
        if colour.range == "full":
            return linear_from_codes(np.repeat(luma[..., None], 3, axis=2), colour)
        return linear_from_signal(signal_from_yuv(luma, None, None, colour), colour)
    fx, fy = form.factors
    size = (-(-width // fx), -(-height // fy))
    if form.kind == "nv":
        both = _plane(frame, 1, *size, form, 2).reshape(size[1], size[0], 2)
        cb, cr = both[..., 0], both[..., 1]
    else:
        cb, cr = (_plane(frame, i, *size, form) for i in (1, 2))
    return linear_from_signal(signal_from_yuv(luma, cb, cr, colour, form.factors), colour)


def turn_of(frame: Any, place: Place) -> int:
    """Quarter turns counter-clockwise by which a player turns the picture. Raises InputError for others."""
    from av.sidedata.sidedata import Type

    side = frame.side_data.get(Type.DISPLAYMATRIX)
    if side is None:
        return 0
    m = np.frombuffer(bytes(side), dtype="=i4")[:9].reshape(3, 3)[:2, :2] // 65536
    for turn, (a, b) in enumerate([(1, 0), (0, -1), (-1, 0), (0, 1)]):
        if m.tolist() == [[a, b], [-b, a]]:
            return turn
    raise InputError(
        "the video is to be shown mirrored or turned by other than a quarter turn, which is not supported",
        place=place,
        hint="write it out upright first",
    )


_CHROMA_NAMES = {"left": "left", "center": "centre", "topleft": "top-left", "top": "top"}
_CHROMA_NAMES |= {"bottomleft": "bottom-left", "bottom": "bottom"}
_LOG = threading.Lock()


def chroma_of(frame: Any, stream: Any) -> str | None:
    """The frame's tagged chroma siting, which PyAV itself does not hand out: asked of the filter
    `showinfo`, whose line names it (`cl:left`)."""
    import av
    import av.logging
    from av.filter import Graph

    with _LOG:
        level = av.logging.get_level()
        try:
            av.logging.set_level(av.logging.INFO)
            graph = Graph()
            source = graph.add_buffer(template=stream)
            show, sink = graph.add("showinfo"), graph.add("buffersink")
            source.link_to(show)
            show.link_to(sink)
            graph.configure()
            with av.logging.Capture(local=True) as lines:
                graph.push(frame)
                graph.pull()
        except (av.error.FFmpegError, ValueError):
            return None
        finally:
            av.logging.set_level(level)
    found = re.search(r"\bcl:(\w+)", " ".join(str(line[2]) for line in lines))
    return _CHROMA_NAMES.get(found.group(1)) if found else None
