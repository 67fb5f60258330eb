"""What was printed and filmed: one marker, a board of markers, or several tags on the scene.

Exactly one of the three is given. Each defines the world of the job (x right and y up the page, z out
of it towards the viewer, metres):

- `marker`: origin at the marker's centre.
- `board`: origin at the centre of the whole board (all squares of a ChArUco board, all markers of a grid).
- `tags`: the frame of the tag `origin`, as for a single marker; with a `layout` and no `origin`, the
  frame in which the layout is given.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from mrbatch.quantities import Length, Position, Rotation, Settings

DICTIONARY_SIZES = {
    "DICT_4X4_50": 50,
    "DICT_4X4_100": 100,
    "DICT_4X4_250": 250,
    "DICT_4X4_1000": 1000,
    "DICT_5X5_50": 50,
    "DICT_5X5_100": 100,
    "DICT_5X5_250": 250,
    "DICT_5X5_1000": 1000,
    "DICT_6X6_50": 50,
    "DICT_6X6_100": 100,
    "DICT_6X6_250": 250,
    "DICT_6X6_1000": 1000,
    "DICT_7X7_50": 50,
    "DICT_7X7_100": 100,
    "DICT_7X7_250": 250,
    "DICT_7X7_1000": 1000,
    "DICT_ARUCO_ORIGINAL": 1024,
    "DICT_ARUCO_MIP_36h12": 250,
    "DICT_APRILTAG_16h5": 30,
    "DICT_APRILTAG_25h9": 35,
    "DICT_APRILTAG_36h10": 2320,
    "DICT_APRILTAG_36h11": 587,
}
"""OpenCV's predefined dictionaries and how many markers each has."""

_ALIASES = {
    "tag16h5": "DICT_APRILTAG_16h5",
    "tag25h9": "DICT_APRILTAG_25h9",
    "tag36h10": "DICT_APRILTAG_36h10",
    "tag36h11": "DICT_APRILTAG_36h11",
} | {name.upper(): name for name in DICTIONARY_SIZES}


def _dictionary(value: Any) -> Any:
    if not isinstance(value, str):
        return value
    return _ALIASES.get(value, _ALIASES.get(value.upper(), value))


Dictionary = Annotated[Literal[tuple(DICTIONARY_SIZES)], BeforeValidator(_dictionary)]
"""Name of a predefined dictionary as OpenCV spells it, or the AprilTag family's own (`tag36h11`)."""
MarkerId = Annotated[int, Field(ge=0)]
PrintedLength = Annotated[Length, Field(gt=0.0)]


def _pair(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


def _integer_keys(value: Any) -> Any:
    """Ids as keys: text such as "7" (JSON has no other keys) becomes the number."""
    if not isinstance(value, Mapping):
        return value
    return {int(k) if isinstance(k, str) and k.strip().isdigit() else k: v for k, v in value.items()}


def _check_ids(dictionary: str, ids, name: str) -> None:
    size = DICTIONARY_SIZES[dictionary]
    beyond = [i for i in ids if i >= size]
    if beyond:
        raise ValueError(f"{name} {beyond[0]} is not in {dictionary}, whose ids are 0 to {size - 1}")


class MarkerSettings(Settings):
    """One square marker."""

    dictionary: Dictionary = Field(description="Dictionary that the marker is from, such as DICT_4X4_50.")
    id: MarkerId = Field(description="The marker's id within its dictionary.")
    side: PrintedLength = Field(description="Length of the black square's side as printed (measure it).")

    @model_validator(mode="after")
    def _known(self):
        _check_ids(self.dictionary, [self.id], "id")
        return self


class BoardSettings(Settings):
    """A flat board: ChArUco (markers in the white squares of a chessboard) or a grid of markers."""

    type: Literal["charuco", "grid"] = Field(description="charuco (chessboard with markers) or grid.")
    squares: Annotated[
        tuple[Annotated[int, Field(ge=1)], Annotated[int, Field(ge=1)]], BeforeValidator(_pair)
    ] = Field(description="Columns and rows: chessboard squares of a charuco board, markers of a grid.")
    square: PrintedLength | None = Field(
        None, description="Side of a chessboard square as printed (charuco only)."
    )
    marker: PrintedLength = Field(description="Side of a marker's black square as printed.")
    separation: PrintedLength | None = Field(
        None, description="White gap between neighbouring markers (grid only)."
    )
    dictionary: Dictionary = Field(description="Dictionary that the markers are from.")
    legacy: bool = Field(
        False,
        description="Pattern of OpenCV before 4.6: with an even number of rows the first square is white.",
    )
    first_id: MarkerId = Field(0, description="Id of the first marker; the others count on, row by row.")

    @property
    def marker_count(self) -> int:
        """How many markers the board carries."""
        columns, rows = self.squares
        return columns * rows if self.type == "grid" else columns * rows // 2

    @model_validator(mode="after")
    def _fits(self):
        if self.type == "charuco":
            if self.square is None:
                raise ValueError("a charuco board needs `square`, the side of a chessboard square")
            if self.separation is not None:
                raise ValueError("`separation` belongs to a grid; a charuco board takes `square`")
            if self.marker >= self.square:
                raise ValueError("`marker` must be smaller than `square`: it lies inside a white square")
            if min(self.squares) < 2 or self.squares == (2, 2):
                raise ValueError("a charuco board needs at least 2 x 3 squares to have two corners")
        else:
            if self.separation is None:
                raise ValueError("a grid board needs `separation`, the gap between markers")
            if self.square is not None:
                raise ValueError(
                    "`square` belongs to a charuco board; a grid takes `marker` and `separation`"
                )
            if self.legacy:
                raise ValueError("`legacy` belongs to a charuco board")
        _check_ids(self.dictionary, [self.first_id + self.marker_count - 1], "the board's last id")
        return self


class TagPlacement(Settings):
    """Where one tag is: its centre and turn in the layout's frame."""

    position: Position = Field(description="Centre of the tag: x, y, z with units.")
    rotation: Rotation = Field(
        (0.0, 0.0, 0.0),
        description="Angles about the layout's x, then y, then z axis; 0 is x right, y up the page, z out.",
    )


class TagsSettings(Settings):
    """Several tags of one size; where they are is known (`layout`) or estimated over the whole shot."""

    dictionary: Dictionary = Field(description="Dictionary or AprilTag family, such as tag36h11.")
    side: PrintedLength = Field(description="Length of each tag's black square's side as printed.")
    layout: Annotated[dict[MarkerId, TagPlacement], BeforeValidator(_integer_keys)] | None = Field(
        None, description="Known place of each tag by its id; without it places are estimated from the shot."
    )
    origin: MarkerId | None = Field(
        None,
        description="Id of the tag whose frame is the world; left out: the layout's frame, or without "
        "layout the tag seen in most frames (the lowest id of several).",
    )

    @model_validator(mode="after")
    def _known(self):
        ids = list(self.layout or ())
        if self.layout is not None and not ids:
            raise ValueError("`layout` is empty: name at least one tag or leave it out")
        _check_ids(self.dictionary, ids, "tag")
        if self.origin is not None:
            _check_ids(self.dictionary, [self.origin], "origin")
            if ids and self.origin not in ids:
                raise ValueError(f"origin {self.origin} is not in `layout`, which has {sorted(ids)}")
        return self


class TargetSettings(Settings):
    """What the camera's pose is found from: exactly one of `marker`, `board` and `tags`."""

    marker: MarkerSettings | None = Field(None, description="One square marker.")
    board: BoardSettings | None = Field(None, description="A flat ChArUco or grid board.")
    tags: TagsSettings | None = Field(None, description="Several tags on the scene.")

    @model_validator(mode="after")
    def _one(self):
        given = [name for name in ("marker", "board", "tags") if getattr(self, name) is not None]
        if len(given) != 1:
            raise ValueError(
                "expected exactly one of `marker`, `board`, `tags`" + (f", got {given}" if given else "")
            )
        return self

    @property
    def dictionary(self) -> str:
        """Name of the dictionary that the target's markers are from."""
        target = self.marker or self.board or self.tags
        assert target is not None
        return target.dictionary
