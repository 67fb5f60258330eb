"""The shots of an exposure bracket: their codes, their tags of exposure, and which of them are the same."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mrbatch.capture.marker_video.jpeg_noise import quantisation_noise
from mrbatch.errors import InputError, Place
from mrbatch.scene.stored_picture import colour_channels, primaries_of, read_stored

MIN_SHOTS, MAX_SHOTS = 2, 64
_NOT_A_CURVE = 0.005
"""Share of a shot's brightest codes that must be one code for it to be where the sensor clips."""


@dataclass(frozen=True)
class Shot:
    """One picture of the bracket.

    `index`: its place in the list given, duplicates counted. `codes` (height, width, 3) uint8 or uint16.
    `tagged`: seconds of exposure as the file's tags say them, brought to the first shot's sensitivity and
    aperture; None without tags. `linear_tag`: whether the file says that its codes are linear. `lossy`: of
    JPEG files the standard deviations (red, green, blue) of codes in a busy block; None of others.
    """

    path: Path
    index: int
    codes: np.ndarray
    tagged: float | None
    linear_tag: bool = False
    lossy: tuple[float, float, float] | None = None

    @property
    def name(self) -> str:
        return self.path.name

    @property
    def top(self) -> int:
        """The largest code of its number type."""
        return int(np.iinfo(self.codes.dtype).max)


@dataclass(frozen=True)
class Bracket:
    """Shots of one scene, in the order given. `notes`: what was left out or assumed.

    `clip`: the code at which pictures clip. `rec709_from_source` (3, 3): linear light of the pictures'
    primaries to Rec.709.
    """

    shots: tuple[Shot, ...]
    clip: int
    rec709_from_source: np.ndarray
    notes: tuple[str, ...] = ()


def read_bracket(paths: Sequence[Path]) -> Bracket:
    """Reads all shots, as 8- or 16-bit codes.

    Raises InputError: unreadable, float pictures, sizes or number types that differ, fewer than two
    different pictures, or more than `MAX_SHOTS`.
    """
    if len(paths) > MAX_SHOTS:
        raise InputError(f"a bracket of {len(paths)} pictures: at most {MAX_SHOTS} are merged")
    shots: list[Shot] = []
    notes: list[str] = []
    seen: dict[bytes, str] = {}
    matrix: np.ndarray | None = None
    tags: list[dict[str, float]] = []
    for index, path in enumerate(paths):
        place = Place(file=str(path))
        found: dict[str, float] = {}
        stored = read_stored(path, check=lambda spec, _, into=found: into.update(_exposure_tags(spec)))
        values, _ = colour_channels(stored, place)
        if values.dtype.kind == "f":
            raise InputError(
                "the picture holds linear floats, not the codes of a photo",
                place=place,
                hint="a bracket is 8-bit JPEG or PNG, or 16-bit PNG or TIFF",
            )
        _, own, unknown = primaries_of(stored, place)
        if unknown:
            notes.append(f"{path.name}: colour profile `{unknown}` is not applied")
        if shots and (values.shape, values.dtype) != (shots[0].codes.shape, shots[0].codes.dtype):
            raise InputError(
                f"the picture is {_kind(values)}, the first one {_kind(shots[0].codes)}",
                place=place,
                hint="all pictures of a bracket have one size and one number of bits",
            )
        digest = hashlib.blake2b(np.ascontiguousarray(values).data, digest_size=16).digest()
        if digest in seen:
            notes.append(f"{path.name} is the same picture as {seen[digest]}: left out")
            continue
        seen[digest] = path.name
        matrix = own if matrix is None else matrix
        space = (stored.about["space"] or "").lower()
        codes = np.ascontiguousarray(values)
        lossy = quantisation_noise(path) if codes.dtype == np.uint8 else None
        shots.append(Shot(path, index, codes, None, space.startswith("lin"), lossy))
        tags.append(found)
    if len(shots) < MIN_SHOTS:
        raise InputError(
            f"a bracket needs {MIN_SHOTS} different pictures at least, got {len(shots)}",
            hint="give all exposures of one scene: mrbatch merge-hdr shot_*.jpg --output map.exr",
        )
    shots = [replace(s, tagged=_seconds(t, tags[0])) for s, t in zip(shots, tags)]
    assert matrix is not None
    return Bracket(tuple(shots), _clip(shots), matrix, tuple(notes))


def _kind(values: np.ndarray) -> str:
    return f"{values.shape[1]}x{values.shape[0]} with {8 * values.dtype.itemsize} bits"


def _exposure_tags(spec: Any) -> dict[str, float]:
    """EXIF's exposure time (s), F number and sensitivity, those that are there and positive."""
    names = {
        "time": ("ExposureTime", "Exif:ExposureTime"),
        "aperture": ("FNumber", "Exif:FNumber"),
        "iso": ("Exif:PhotographicSensitivity", "Exif:ISOSpeedRatings", "ISOSpeedRatings"),
    }
    found = {}
    for key, options in names.items():
        for name in options:
            value = spec.getattribute(name)
            value = value[0] if isinstance(value, tuple) and value else value
            if isinstance(value, (int, float)) and 0.0 < value < 1e9:
                found[key] = float(value)
                break
    apex = spec.getattribute("Exif:ShutterSpeedValue")
    if "time" not in found and isinstance(apex, (int, float)) and -20.0 < apex < 20.0:
        found["time"] = 2.0**-apex
    return found


def _seconds(tags: dict[str, float], first: dict[str, float]) -> float | None:
    """Exposure time as if taken with the first shot's aperture and sensitivity; None without a time."""
    if "time" not in tags:
        return None
    seconds = tags["time"]
    if "iso" in tags and "iso" in first:
        seconds *= tags["iso"] / first["iso"]
    if "aperture" in tags and "aperture" in first:
        seconds *= (first["aperture"] / tags["aperture"]) ** 2
    return seconds


def _clip(shots: Sequence[Shot]) -> int:
    """The code at which these pictures clip: the type's largest, or a lower one where codes pile up.

    A raw converter that leaves head-room clips below the largest code; then the brightest shot ends in
    one code that many of its pixels have.
    """
    brightest = max(shots, key=lambda s: float(s.codes.mean()))
    counts = np.bincount(brightest.codes.ravel(), minlength=brightest.top + 1)
    highest = int(np.nonzero(counts)[0][-1])
    others = max(int(s.codes.max()) for s in shots)
    piled = (
        counts[highest] > _NOT_A_CURVE * brightest.codes.size and counts[highest] > 4 * counts[highest - 1]
    )
    return highest if piled and others == highest and highest > brightest.top // 2 else brightest.top
