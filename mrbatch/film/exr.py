"""Frames as EXR files: one file a frame, one part a view, nothing in it but what the job decides.

Files are a function of the image alone: the library's date stamp is kept out, metadata is JSON with
sorted keys, and neither host, path nor threads show. Cameras: see `camera_metadata`.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any, Literal

import numpy as np

from mrbatch.errors import FramesError, InputError, Place, ResourceError
from mrbatch.film.camera_metadata import (
    described,
    from_description,
    screen_window,
    world_to_camera,
    world_to_ndc,
)
from mrbatch.film.layers import channel_kind
from mrbatch.film.window import Window
from mrbatch.kernels.transfer import PRIMARIES, from_linear, to_linear
from mrbatch.scene.camera import Camera
from mrbatch.scene.file_kind import unreadable
from mrbatch.scene.picture_library import library_error

ColourType = Literal["half", "float"]
HALF_MAX = 65504.0
"""The largest number that half can hold."""
MAX_VALUES = 2**30
"""Numbers (width * height * channels) that `read_frame` allocates for one part at most."""
PREFIX = "mrbatch/"


@dataclass(frozen=True)
class ViewImage:
    """One view: channels (h, w) float32 by name, in order, all of the data window's size.

    `attributes`: further string attributes of this part, such as Cryptomatte's.
    """

    channels: Mapping[str, np.ndarray]
    camera: Camera | None = None
    attributes: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class FrameImage:
    """One frame as it goes into a file.

    `views` by name (mono: `""`). `display`: width and height of the picture. `window`: the pixels that
    are there; smaller than the picture for a crop, larger for overscan; None for the whole picture.
    `metadata`: JSON-ready values, written as `mrbatch/KEY` to the first part.
    """

    number: int
    views: Mapping[str, ViewImage]
    display: tuple[int, int]
    window: Window | None = None
    colour_type: ColourType = "half"
    compression: Literal["none", "rle", "zips", "zip", "piz"] = "zip"
    frames_per_second: Fraction | None = None
    owner: str = ""
    metadata: Mapping[str, Any] = field(default_factory=dict)

    @property
    def data_window(self) -> Window:
        return self.window or Window(0, 0, *self.display)


def choose_colour_type(
    source_bits: int, peak: float, *, transfer: str = "srgb", source_is_half: bool = False
) -> tuple[ColourType, str]:
    """The number type of colour for a whole sequence, and why.

    Half for sources up to 10 bits whose every code it keeps (all but the steepest power, gamma28, with
    10 bits) and for half floats; float above, for half merges some 12-bit codes, and wherever light
    exceeds 65504. `source_bits`: bits a channel of the captured pictures, coded with `transfer`;
    `peak`: the largest radiance that any light can bring into a picture, photo units. Raises
    ValueError for an unknown transfer function.
    """
    if not peak <= HALF_MAX:  # so a NaN, too, gives float
        return "float", f"light of {peak:g} exceeds half's largest number, 65504"
    if source_is_half:
        return "half", "half floats in the source and no light above 65504: half keeps every value"
    if source_bits <= 10 and half_keeps_codes(source_bits, transfer):
        return "half", f"{source_bits}-bit {transfer} source and no light above 65504: half keeps every code"
    return "float", f"{source_bits}-bit {transfer} source: half would merge some of its codes"


def half_keeps_codes(bits: int, transfer: str) -> bool:
    """Whether each code comes back after its linear value was stored as half."""
    codes = np.arange(2**bits, dtype=np.uint16)
    stored = to_linear(codes, transfer, bits).astype(np.float16).astype(np.float32)
    return bool(np.array_equal(from_linear(stored, transfer, bits), codes))


def write_frame(path: Path, image: FrameImage, *, overflow: Literal["error", "clamp"] = "error") -> None:
    """Writes `image` to `path` (any suffix), replacing what is there; a failed file is taken away.

    `overflow`: what to do with numbers that half cannot hold: `error`, or `clamp` to 65504 with a note
    in `mrbatch/clamped` (how many in each channel). Same image, same bytes. Raises FramesError for
    NaN, infinity or overflow, ResourceError where the file cannot be written, ValueError for
    channels of wrong size.
    """
    import OpenImageIO as oiio

    path = Path(path)
    pixels, clamped = {}, {}
    for view, content in image.views.items():
        pixels[view], counts = _pixels(image, view, content, overflow)
        clamped.update({f"{view}.{c}" if view else c: n for c, n in counts.items()})
    metadata = dict(image.metadata)
    if clamped:
        metadata["clamped"] = clamped
    specs = [_spec(image, view, metadata if i == 0 else {}) for i, view in enumerate(image.views)]

    out = oiio.ImageOutput.create("openexr")
    if out is None:
        raise ResourceError("this OpenImageIO cannot write EXR", hint="install OpenImageIO from its wheel")
    if not out.open(str(path), tuple(specs) if len(specs) > 1 else specs[0]):
        raise _cannot_write(path, library_error(out) or "the library gave no reason", image.number)
    error = ""
    for i, (view, spec) in enumerate(zip(image.views, specs, strict=True)):
        written = (i == 0 or out.open(str(path), spec, "AppendSubimage")) and out.write_image(pixels[view])
        if not written:
            error = library_error(out) or "the library gave no reason"
            break
    if not out.close() and not error:
        error = library_error(out) or "the file could not be closed"
    # Closing flushes the last buffer but does not say when that fails; the last rows tell.
    if not error and not _ends_whole(path):
        error = "the file is incomplete after writing"
    if error:
        if path.is_file():  # never a device or a pipe
            path.unlink()
        raise _cannot_write(path, error, image.number)


def _ends_whole(path: Path) -> bool:
    """Whether the last row of the last part can be read; all other data lie before it."""
    import OpenImageIO as oiio

    source = oiio.ImageInput.open(str(path))
    if source is None:
        library_error(oiio)
        return False
    try:
        last = source.spec().get_int_attribute("oiio:subimages", 1) - 1
        if not source.seek_subimage(last, 0):
            return False
        spec = source.spec()
        bottom = spec.y + spec.height
        pixels = source.read_scanlines(last, 0, bottom - 1, bottom, 0, 0, spec.nchannels, "float")
        return pixels is not None and not library_error(source)
    finally:
        source.close()


def _cannot_write(path: Path, error: str, number: int) -> ResourceError:
    return ResourceError(
        f"cannot write the frame: {error.strip().splitlines()[0]}",
        place=Place(file=str(path), frame=number),
        hint="check that the folder exists and may be written, and that the disk has room",
    )


def _pixels(image: FrameImage, view: str, content: ViewImage, overflow: str) -> tuple[np.ndarray, dict]:
    """(h, w, channels) float32 in order, checked; and how many numbers of which channel were clamped."""
    window = image.data_window
    stack = np.empty((window.height, window.width, len(content.channels)), dtype=np.float32)
    clamped: dict[str, int] = {}
    for i, (name, values) in enumerate(content.channels.items()):
        if values.shape != (window.height, window.width):
            raise ValueError(
                f"channel {name}: shape {values.shape}, the window is {(window.height, window.width)}"
            )
        stack[..., i] = values
        channel = stack[..., i]
        finite = np.isfinite(channel)
        label = f"{name} of view `{view}`" if view else name
        if not finite.all():
            raise FramesError(
                f"channel {label} holds {np.count_nonzero(~finite)} NaN or infinite numbers, "
                f"first at {_first(~finite, window)}",
                place=Place(frame=image.number),
            )
        if _type(image, name) == "half":
            # What rounds to at most 65504 is fine; half rounds up from 65520 on.
            above = np.abs(channel) >= 65520.0
            if above.any() and overflow == "error":
                raise FramesError(
                    f"channel {label} reaches {float(np.abs(channel).max()):g}, above half's 65504, "
                    f"first at {_first(above, window)}",
                    place=Place(frame=image.number),
                    hint="write float colour: `output.dtype: float`",
                )
            if above.any():
                clamped[name] = int(np.count_nonzero(above))
                np.clip(channel, -HALF_MAX, HALF_MAX, out=channel)
    return stack, clamped


def _first(mask: np.ndarray, window: Window) -> str:
    y, x = np.argwhere(mask)[0]
    return f"pixel ({x + window.x}, {y + window.y})"


def _type(image: FrameImage, channel: str) -> ColourType:
    return image.colour_type if channel_kind(channel) == "colour" else "float"


def _spec(image: FrameImage, view: str, metadata: Mapping[str, Any]) -> Any:
    import OpenImageIO as oiio

    content, window = image.views[view], image.data_window
    names = tuple(content.channels)
    types = tuple(_type(image, name) for name in names)
    spec = oiio.ImageSpec(window.width, window.height, len(names), "half" if "half" in types else "float")
    spec.channelnames = names
    if len(set(types)) > 1:
        spec.channelformats = tuple(oiio.TypeDesc(t) for t in types)
    spec.x, spec.y = window.x, window.y
    spec.full_x, spec.full_y = 0, 0
    spec.full_width, spec.full_height = image.display
    spec.attribute("compression", image.compression)
    # An empty date keeps the library from stamping the file with the time of writing.
    spec.attribute("DateTime", "")
    spec.attribute("chromaticities", "float[8]", tuple(v for xy in PRIMARIES["bt709"] for v in xy))
    if len(image.views) > 1:
        spec.attribute("oiio:subimagename", view)
        spec.attribute("view", view)
    if image.frames_per_second is not None:
        rate = image.frames_per_second
        spec.attribute("framesPerSecond", oiio.TypeRational, (rate.numerator, rate.denominator))
    if image.owner:
        spec.attribute("owner", image.owner)
    if content.camera is not None:
        _describe_camera(spec, content.camera)
    for name, value in {"frame": image.number, **metadata}.items():
        spec.attribute(PREFIX + name, _json(value))
    for name, value in content.attributes.items():
        spec.attribute(name, value)
    return spec


def _describe_camera(spec: Any, camera: Camera) -> None:
    import OpenImageIO as oiio

    spec.attribute("worldToCamera", oiio.TypeMatrix, _matrix(world_to_camera(camera)))
    if camera.model == "perspective":
        spec.attribute("worldToNDC", oiio.TypeMatrix, _matrix(world_to_ndc(camera)))
        width, centre = screen_window(camera)
        spec.attribute("screenWindowWidth", width)
        spec.attribute("screenWindowCenter", "float[2]", centre)
    spec.attribute(PREFIX + "camera", _json(described(camera)))


def _matrix(m: np.ndarray) -> tuple[float, ...]:
    return tuple(float(v) for v in m.ravel())


def _json(value: Any) -> str:
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)


def read_frame(path: Path, *, max_values: int = MAX_VALUES) -> FrameImage:
    """Reads a file that `write_frame` wrote, all views and channels, as float32.

    Raises InputError where the file is absent, cut short, no EXR, or larger than `max_values`.
    """
    views: dict[str, ViewImage] = {}
    first: tuple[Any, dict[str, Any]] | None = None
    for spec, attributes, pixels in _parts(path, max_values):
        view = attributes.get("view") or ("" if not views else f"part{len(views)}")
        ours = _ours(attributes)
        channels = {name: pixels[..., i] for i, name in enumerate(spec.channelnames)}
        crypto = {k: v for k, v in attributes.items() if k.startswith("cryptomatte/")}
        views[view] = ViewImage(channels, from_description(ours.get("camera")), crypto)
        first = first or (spec, attributes)
    assert first is not None
    spec, attributes = first
    rate = attributes.get("framesPerSecond")
    metadata = {k: v for k, v in _ours(attributes).items() if k not in ("camera", "frame")}
    return FrameImage(
        number=_ours(attributes).get("frame", 0),
        views=views,
        display=(spec.full_width, spec.full_height),
        window=Window(spec.x, spec.y, spec.width, spec.height),
        colour_type="half" if str(spec.channelformat(0)) == "half" else "float",
        compression=attributes.get("compression", "zip"),
        frames_per_second=Fraction(*rate) if rate else None,
        owner=attributes.get("owner", ""),
        metadata=metadata,
    )


def frame_metadata(path: Path) -> dict[str, Any]:
    """What the headers say, without pixels: JSON-ready, `parts` with windows, channels and attributes.

    `mrbatch` of each part holds the parsed values under `mrbatch/`; `attributes` the others. Raises
    InputError as `read_frame` does.
    """
    parts = []
    for spec, attributes, _ in _parts(path, None):
        parts.append(
            {
                "name": attributes.get("oiio:subimagename", ""),
                "view": attributes.get("view", ""),
                "display": [spec.full_x, spec.full_y, spec.full_width, spec.full_height],
                "window": [spec.x, spec.y, spec.width, spec.height],
                "compression": attributes.get("compression", "none"),
                "channels": [
                    {"name": name, "type": str(spec.channelformat(i))}
                    for i, name in enumerate(spec.channelnames)
                ],
                "attributes": {
                    k: list(v) if isinstance(v, tuple) else v
                    for k, v in attributes.items()
                    if not k.startswith((PREFIX, "oiio:"))
                },
                "mrbatch": _ours(attributes),
            }
        )
    return {"bytes": Path(path).stat().st_size, "parts": parts}


def open_parts(path: Path) -> Iterator[tuple[Any, int, Any, dict[str, Any]]]:
    """For each part of an EXR: the open file, the part's number, its spec and its attributes.

    Raises InputError where the file is absent, damaged or no EXR; what is read of it is the caller's.
    """
    import OpenImageIO as oiio

    place = Place(file=str(path))
    if not Path(path).is_file():
        raise InputError("there is no such file", place=place, hint="give the path of an EXR file")
    source = None
    try:
        source = oiio.ImageInput.open(str(path))
        if source is None:
            library_error(oiio)
            raise unreadable(path, "an EXR frame", ("EXR",))
        if source.format_name() != "openexr":
            raise unreadable(path, "an EXR frame", ("EXR",))
        index = 0
        while source.seek_subimage(index, 0):
            spec = source.spec()
            yield (
                source,
                index,
                spec,
                {_STANDARD_NAMES.get(a.name, a.name): a.value for a in spec.extra_attribs},
            )
            index += 1
        library_error(source)  # seeking past the last part leaves a message
    except UnicodeDecodeError as error:  # from names, values, and messages that quote them
        raise InputError("the header is broken: it holds text that is no UTF-8", place=place) from error
    finally:
        if source is not None:
            source.close()


def _parts(path: Path, max_values: int | None) -> Iterator[tuple[Any, dict[str, Any], Any]]:
    """Each part's spec, its attributes, and its pixels (h, w, channels) float32; no pixels for None."""
    for source, index, spec, attributes in open_parts(path):
        pixels = None
        if max_values is not None:
            if spec.width * spec.height * spec.nchannels > max_values:
                raise InputError(
                    f"{spec.width} x {spec.height} with {spec.nchannels} channels is more than the limit",
                    place=Place(file=str(path)),
                )
            pixels = source.read_image(index, 0, 0, spec.nchannels, "float")
            if library_error(source) or pixels is None:
                raise unreadable(path, "an EXR frame", ("EXR",))
        yield spec, attributes, pixels


_STANDARD_NAMES = {
    "Copyright": "owner",
    "FramesPerSecond": "framesPerSecond",
    "PixelAspectRatio": "pixelAspectRatio",
    "DateTime": "capDate",
}
"""The library's names of attributes to the format's own."""


def _ours(attributes: Mapping[str, Any]) -> dict[str, Any]:
    """Values under `mrbatch/`, parsed; text that is no JSON is kept as it is."""
    parsed = {}
    for name, value in attributes.items():
        if name.startswith(PREFIX):
            try:
                parsed[name[len(PREFIX) :]] = json.loads(value)
            except (TypeError, ValueError, RecursionError):
                parsed[name[len(PREFIX) :]] = value
    return parsed
