"""The job: everything that one run needs to know, strict and frozen."""

from __future__ import annotations

import string
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, PrivateAttr, WithJsonSchema, field_validator, model_validator
from pydantic_core import PydanticCustomError

from mrbatch.capture.registry import CAPTURES
from mrbatch.contracts import Method, Participant
from mrbatch.errors import Place
from mrbatch.film.filter.settings import Filter
from mrbatch.film.layers import DEFAULT_LAYERS, LAYERS
from mrbatch.job.choice import Choice, Loc, problem, problems
from mrbatch.job.frames import ALL, FrameSelection
from mrbatch.methods.registry import METHODS, PARTICIPANTS
from mrbatch.methods.registry import method as find_method
from mrbatch.methods.registry import participant as find_participant
from mrbatch.quantities import Duration, OutputPath, Settings
from mrbatch.scene.camera_settings import LensSettings, ShutterSettings
from mrbatch.scene.settings import Environment, RealObject, VirtualObject

FILM_LAYERS = ("composite", "background", "variance", "samples")
"""Layers that the film makes itself, whatever the method."""

NOT_PIXELS: dict[str, Any] = {"x-pixels": False}
"""Marks a field that cannot change a pixel: it stays out of the job's hash."""
OUTPUT_PATH: dict[str, Any] = {"x-pixels": False, "x-path": "output"}
"""Marks a path that is written, so it need not be there."""


def _to_tuple(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


def _to_ratio(value: Any) -> Any:
    """`1/4` or 0.25."""
    if isinstance(value, str):
        above, slash, below = value.partition("/")
        if slash and above.strip().isdecimal() and below.strip().isdecimal() and int(below) > 0:
            return int(above) / int(below)
        raise ValueError("expected a number or a fraction, such as `1/4`")
    return float(value) if isinstance(value, int) and not isinstance(value, bool) else value


_RATIO_SCHEMA = WithJsonSchema(
    {
        "anyOf": [
            {"type": "number", "exclusiveMinimum": 0, "maximum": 4},
            {"type": "string", "pattern": r"^\s*\d+\s*/\s*\d+\s*$"},
        ]
    }
)


class Preview(Settings):
    """Pictures to look at, beside the frames. They are no part of the promise of identical bits."""

    contact_sheet: bool = Field(True, description="One picture with all frames, small")
    video: bool = Field(True, description="An MP4 of the shot")
    png: bool = Field(False, description="A PNG for each frame")


class Output(Settings):
    """What is written, where, and how."""

    directory: OutputPath = Field(
        Path("out"), description="Folder for frames and report; made if absent", json_schema_extra=OUTPUT_PATH
    )
    pattern: str = Field(
        "{job}.{frame:04d}.exr",
        description="File name of a frame: `{job}` the job's name, `{frame:04d}` the frame number",
        json_schema_extra=NOT_PIXELS,
    )
    layers: Annotated[tuple[str, ...], BeforeValidator(_to_tuple), Field(min_length=1)] | None = Field(
        None,
        description=f"Layers of the files; none: of {', '.join(DEFAULT_LAYERS)} those that the method gives",
    )
    dtype: Literal["auto", "half", "float"] = Field(
        "auto", description="Number type of colour; `auto`: half for sources up to 10 bits, else float"
    )
    compression: Literal["none", "rle", "zips", "zip", "piz"] = Field(
        "zip", description="Compression of the EXR files, all lossless"
    )
    scale: Annotated[float, Field(gt=0.0, le=4.0), BeforeValidator(_to_ratio), _RATIO_SCHEMA] = Field(
        1.0, description="Output resolution over the capture's, above 0 to 4; a fraction `1/4` is fine"
    )
    crop: (
        Annotated[
            tuple[
                Annotated[int, Field(ge=0)],
                Annotated[int, Field(ge=0)],
                Annotated[int, Field(ge=1)],
                Annotated[int, Field(ge=1)],
            ],
            BeforeValidator(_to_tuple),
        ]
        | None
    ) = Field(
        None, description="[x, y, width, height] in output pixels, from the top left: render only these"
    )
    filter: Filter = Field(Filter(), description="What takes noise out of the finished frame")
    overscan: int = Field(0, ge=0, le=4096, description="Pixels rendered beyond each edge, 0..4096")
    preview: Preview = Field(
        Preview(), description="Pictures to look at, beside the frames", json_schema_extra=NOT_PIXELS
    )
    owner: str = Field(
        "",
        max_length=256,
        description="Owner named in the files' metadata",
        json_schema_extra=NOT_PIXELS,
    )

    @field_validator("pattern")
    @classmethod
    def _pattern(cls, value: str) -> str:
        try:
            fields = {name for _, name, _, _ in string.Formatter().parse(value) if name is not None}
            if not fields <= {"job", "frame"}:
                raise ValueError("only `{job}` and `{frame:04d}` stand for something in a file name")
            if "frame" not in fields:
                raise ValueError("`{frame:04d}` is missing, so all frames would have one name")
            name = value.format(job="job", frame=1)
        except (KeyError, IndexError, AttributeError):
            raise ValueError("only `{job}` and `{frame:04d}` stand for something in a file name") from None
        if any(c in '/\\:*?"<>|' or not c.isprintable() for c in name) or name.startswith("."):
            raise ValueError('a file name holds no `/ \\ : * ? " < > |` and starts with no dot')
        if not name.endswith(".exr"):
            raise ValueError("the file name must end in .exr")
        if name == value.format(job="job", frame=2) or len(name) > 200:
            raise ValueError("each frame needs a name of its own, up to 200 characters")
        return value


QUALITIES = {"draft": 2e-2, "preview": 4e-3, "final": 4e-4, "reference": 2e-5}
"""What `accuracy.quality` asks for, as `target_error`: 14, 6, 2 and 0.4 % of a pixel's own brightness."""


class Accuracy(Settings):
    """How good frames have to be, and how long they may take. Without a target each pixel gets the method's
    `spp` samples."""

    quality: Literal["draft", "preview", "final", "reference"] | None = Field(
        None,
        description="A `target_error` by name: "
        + ", ".join(f"`{name}` {error:g}" for name, error in QUALITIES.items()),
    )
    target_error: float | None = Field(
        None,
        gt=0.0,
        le=1.0,
        description="relMSE of the region of interest, which is what virtual objects change: samples are "
        "added where they are needed, in place of `spp`; 0.001 is 3 % of a pixel's own brightness",
    )
    max_spp: int = Field(4096, ge=4, le=1 << 20, description="Most samples a pixel with a target, 4..1048576")
    time_limit: Annotated[Duration, Field(gt=0.0)] | None = Field(
        None,
        description="Time for the whole command, its start included, above 0: all frames are thinned to keep "
        "it, to no less than 2 samples a pixel",
    )

    @property
    def target(self) -> float | None:
        """relMSE that frames have to reach, or None."""
        return QUALITIES[self.quality] if self.quality is not None else self.target_error

    @model_validator(mode="after")
    def _one_target(self) -> Accuracy:
        if self.quality is not None and self.target_error is not None:
            raise ValueError("one of `quality` and `target_error` is given")
        return self


def _chosen(info: Any, part: str, key: str) -> list[str]:
    """Names chosen in a part of the job, even where the part's other settings are wrong.

    The raw job is handed to the validators as their context.
    """
    raw = (info.context or {}).get(part) if isinstance(info.context, dict) else None
    items = info.data.get(part, raw)
    if not isinstance(items, (list, tuple)):
        items = [items]
    names = [item.get(key) if isinstance(item, dict) else getattr(item, key, None) for item in items]
    return [name for name in names if isinstance(name, str)]


class Job(Settings):
    """One run: a capture, the scene in it, a method, and what is to be written.

    `capture`, `method` and `participants` hold the settings models of their registries.
    """

    name: str = Field(
        "job",
        pattern=r"^\w[\w .+-]*$",
        max_length=100,
        description="Name of the job, used in file names; if absent, the job file's stem",
        json_schema_extra=NOT_PIXELS,
    )
    capture: Annotated[Settings, Choice(CAPTURES, "kind")] = Field(
        description="The captured dataset, by `kind`"
    )
    environment: Environment | None = Field(None, description="Light from far away, as a map")
    real: Annotated[tuple[RealObject, ...], BeforeValidator(_to_tuple)] = Field(
        (), description="Surfaces of the captured place that light and shadow of virtual objects fall on"
    )
    virtual: Annotated[tuple[VirtualObject, ...], BeforeValidator(_to_tuple)] = Field(
        (), description="Objects that are put in"
    )
    lens: LensSettings | None = Field(
        None, description="The width of the camera's lens; none: everything virtual is sharp"
    )
    shutter: ShutterSettings | None = Field(
        None, description="How long the shutter is open; none: everything virtual is seen at one moment"
    )
    method: Annotated[Settings, Choice(METHODS, "name")] = Field(
        description="How the picture is computed, by `name`"
    )
    participants: Annotated[
        tuple[Annotated[Settings, Choice(PARTICIPANTS, "type")], ...], BeforeValidator(_to_tuple)
    ] = Field((), description="What else adds to the picture, such as volumes, by `type`")
    accuracy: Accuracy = Field(Accuracy(), description="How good frames have to be")
    output: Output = Field(Output(), validate_default=True, description="What is written, where, and how")
    effects: dict[str, Literal["auto", "on", "off"]] = Field(
        {}, description="Effects forced `on` or `off`; `auto` lets the plan decide"
    )
    seed: int = Field(0, ge=0, le=2**32 - 1, description="Seed of all random choices, 0..4294967295")
    engine: Literal["auto", "embree", "warp"] = Field(
        "auto",
        description="Ray engine; `auto`: Embree where it runs, else Warp",
        json_schema_extra=NOT_PIXELS,
    )
    frames: FrameSelection = Field(
        ALL,
        description="Frames to render: `all`, ranges such as `1001-1100x2,1200`, or a list",
        json_schema_extra=NOT_PIXELS,
    )
    on_error: Literal["stop", "skip", "hold-last"] = Field(
        "stop",
        description="A frame that cannot be read: `stop`, `skip` it, or `hold-last` good one",
        json_schema_extra=NOT_PIXELS,
    )

    _file: Path | None = PrivateAttr(None)
    _folder: Path = PrivateAttr(default_factory=Path.cwd)
    _fence: Path | None = PrivateAttr(None)
    _places: dict[Loc, Place] = PrivateAttr(default_factory=dict)

    @property
    def file(self) -> Path | None:
        """The job file, absolute; None for a job made in memory."""
        return self._file

    @property
    def folder(self) -> Path:
        """The folder that relative paths count from, absolute."""
        return self._folder

    @property
    def fence(self) -> Path | None:
        """The folder that the job was confined to, its links resolved; None for no such word."""
        return self._fence

    @property
    def capture_kind(self) -> str:
        return getattr(self.capture, "kind")  # noqa: B009 - added by the registry

    @property
    def method_name(self) -> str:
        return getattr(self.method, "name")  # noqa: B009 - added by the registry

    @property
    def method_object(self) -> Method:
        return find_method(self.method_name)

    @property
    def participant_objects(self) -> tuple[Participant, ...]:
        """In the order of `participants`."""
        return tuple(find_participant(getattr(p, "type")) for p in self.participants)  # noqa: B009

    def place(self, *loc: str | int) -> Place | None:
        """Where the value at that path stood, such as `job.place("virtual", 0, "mesh")`; for messages."""
        while loc and loc not in self._places:
            loc = loc[:-1]
        return self._places.get(loc)

    def __reduce__(self) -> Any:
        # Settings models made for a registry cannot be found by name when unpickling: a job travels as data.
        from mrbatch.job.resolve import rebuild, resolved

        return rebuild, (resolved(self), self._file, self._folder, self._places, self._fence)

    @field_validator("real", "virtual")
    @classmethod
    def _names(cls, value: Any, info: Any) -> Any:
        taken = {item.name: ("real", i) for i, item in enumerate(info.data.get("real", ()))}
        found: list[tuple[Loc, PydanticCustomError, Any]] = []
        for index, item in enumerate(value):
            if item.name in taken:
                where, other = taken[item.name]
                error = problem(
                    f"the name `{item.name}` is taken by {where}.{other}",
                    hint="give each object its own name",
                )
                found.append(((index, "name"), error, item.name))
            else:
                taken[item.name] = (info.field_name, index)
        if found:
            raise problems(found)
        return value

    @field_validator("lens")
    @classmethod
    def _focus(cls, value: LensSettings | None, info: Any) -> LensSettings | None:
        if value is not None and value.focus_object is not None and {"real", "virtual"} <= info.data.keys():
            names = [item.name for item in (*info.data["real"], *info.data["virtual"])]
            if value.focus_object not in names:
                error = problem(f"no object is called `{value.focus_object}`", choices=names)
                raise problems([(("focus_object",), error, value.focus_object)])
        return value

    @field_validator("method")
    @classmethod
    def _takes_capture(cls, value: Any, info: Any) -> Any:
        kinds = find_method(value.name).capture_kinds
        for kind in _chosen(info, "capture", "kind"):
            if kind in CAPTURES.names() and kind not in kinds:
                error = problem(
                    f"the method `{value.name}` does not take the capture kind `{kind}`",
                    hint=f"it takes: {', '.join(kinds) or 'none'}",
                )
                raise problems([(("name",), error, value.name)])
        shutter = info.data.get("shutter")
        half = (getattr(value, "spp", 0) + 1) // 2
        if shutter is not None and half % shutter.samples:
            error = problem(
                f"the {half} samples of each half cannot be shared evenly by {shutter.samples} moments",
                hint=f"give `spp` a multiple of {2 * shutter.samples}, or other `shutter.samples`",
            )
            raise problems([(("spp",), error, value.spp)])
        return value

    @field_validator("output")
    @classmethod
    def _layers(cls, value: Output, info: Any) -> Output:
        """Fills in the usual layers, or refuses those that the method does not give."""
        names = [name for name in _chosen(info, "method", "name") if name in METHODS.names()]
        if not names:
            return value
        given = tuple(dict.fromkeys((*FILM_LAYERS, *find_method(names[0]).layers)))
        if value.layers is None:
            usual = tuple(layer for layer in DEFAULT_LAYERS if layer in given)
            return value.model_copy(update={"layers": usual})
        found: list[tuple[Loc, PydanticCustomError, Any]] = []
        for index, layer in enumerate(value.layers):
            if layer not in given:
                why = f"the method `{names[0]}` gives no layer" if layer in LAYERS else "unknown layer"
                error = problem(f"{why} `{layer[:60]}`", choices=given)
                found.append((("layers", index), error, layer))
            elif layer in value.layers[:index]:
                found.append((("layers", index), problem(f"the layer `{layer}` is named twice"), layer))
        if found:
            raise problems(found)
        return value

    @field_validator("effects")
    @classmethod
    def _effects(cls, value: dict[str, str], info: Any) -> dict[str, str]:
        methods, participants = _chosen(info, "method", "name"), _chosen(info, "participants", "type")
        rules = [rule for name in methods if name in METHODS.names() for rule in find_method(name).rules]
        for name in participants:
            if name not in PARTICIPANTS.names():
                return value  # what it would bring is not known
            rules += find_participant(name).rules
        if not methods or methods[0] not in METHODS.names():
            return value
        known = tuple(dict.fromkeys(rule.effect for rule in rules))
        found: list[tuple[Loc, PydanticCustomError, Any]] = [
            ((name,), problem(f"unknown effect `{name[:60]}`", choices=known, key=True), state)
            for name, state in value.items()
            if name not in known
        ]
        if found:
            raise problems(found)
        return value

    @model_validator(mode="before")
    @classmethod
    def _mapping(cls, data: Any) -> Any:
        return {} if data is None else data
