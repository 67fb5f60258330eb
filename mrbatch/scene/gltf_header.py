"""A glTF file's JSON, read before its data: the further files it names, and whether it holds what it says."""

from __future__ import annotations

import json
import os
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from mrbatch.errors import InputError, Place

SUFFIXES = (".gltf", ".glb")
MAX_JSON_BYTES = 64 << 20
MAX_UNFOLDED = 16
"""Bytes of arrays that stand in no buffer (zeros, but for a few), over the bytes that are there."""
_COMPONENT_BYTES = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4}
_COMPONENTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}


def read_gltf_header(path: Path, place: Place) -> dict[str, Any]:
    """The JSON of a .gltf or .glb file. Raises InputError: unreadable, cut short, too large, no glTF."""
    try:
        with path.open("rb") as file:
            if path.suffix.lower() == ".glb":
                head = file.read(20)
                if len(head) < 20 or head[:4] != b"glTF" or head[16:20] != b"JSON":
                    raise InputError("not a GLB file", place=place, hint="export the mesh again")
                (length,) = struct.unpack("<I", head[12:16])
            else:
                length = path.stat().st_size
            if length > MAX_JSON_BYTES:
                raise InputError(f"the glTF's JSON has {length} bytes, at most {MAX_JSON_BYTES}", place=place)
            raw = file.read(length)
        if len(raw) < length:
            raise InputError("the GLB file is cut short", place=place, hint="copy or export it again")
        header = json.loads(raw.decode("utf-8-sig"))
    except OSError as error:
        raise InputError(f"the mesh file cannot be read ({error.strerror})", place=place) from None
    except (ValueError, RecursionError) as error:
        raise InputError(
            f"the glTF's JSON cannot be read ({type(error).__name__})",
            place=place,
            hint="it may be damaged or truncated: export it again",
        ) from None
    if not isinstance(header, dict):
        raise InputError("not a glTF file", place=place, hint="export the mesh again")
    return header


def _named(header: dict[str, Any], part: str) -> Iterator[str]:
    """The `uri` of each of the header's `buffers` or `images` that is a file's, not the data itself."""
    entries = header.get(part)
    for entry in entries if isinstance(entries, list) else ():
        uri = entry.get("uri") if isinstance(entry, dict) else None
        if isinstance(uri, str) and "base64," not in uri:
            yield uri


def _inside(path: Path, uri: str) -> Path | None:
    """The file of a URI, or None where it is no relative path below the folder of `path`."""
    name = unquote(uri)
    if not name.strip() or "\0" in name or "\\" in name or ":" in name or name.startswith("/"):
        return None
    below = os.path.normpath(name)
    return None if below.split(os.sep)[0] == os.pardir else path.parent / below


def buffer_files(path: Path, header: dict[str, Any], place: Place) -> dict[str, Path]:
    """The files that hold the buffers, by URI. Raises InputError for one outside of the file's folder."""
    found = {}
    for uri in _named(header, "buffers"):
        file = _inside(path, uri)
        if file is None:
            raise InputError(
                f"the glTF file names the buffer `{uri[:80]}`, which is no file below its own folder",
                place=place,
                hint="keep all files of a mesh together, or export it as GLB",
            )
        found[uri] = file
    return found


def picture_files(path: Path, header: dict[str, Any]) -> dict[str, Path]:
    """The files that hold pictures, by URI: those below the glTF file's own folder that are there."""
    found = {}
    for uri in _named(header, "images"):
        picture = _inside(path, uri)
        if picture is not None and picture.is_file():
            found[uri] = picture
    return found


def material_extensions(header: dict[str, Any]) -> dict[str | None, dict[str, Any]]:
    """What extensions say of the file's materials, by the name (None: without one) that one of them has."""
    found: dict[str | None, dict[str, Any]] = {}
    entries = header.get("materials")
    materials = [m for m in entries if isinstance(m, dict)] if isinstance(entries, list) else []
    names = [m.get("name") if isinstance(m.get("name"), str) else None for m in materials]
    for name, material in zip(names, materials):
        extensions = material.get("extensions")
        if isinstance(extensions, dict) and names.count(name) == 1:
            found[name] = {k: v for k, v in extensions.items() if isinstance(v, dict)}
    return found


def further_files(path: Path) -> list[Path]:
    """Files beside a mesh file that belong to it: a glTF's buffers, and its pictures where they are there.

    Raises InputError as `read_gltf_header` and `buffer_files` do; a missing mesh file has none.
    """
    if path.suffix.lower() not in SUFFIXES or not path.is_file():
        return []
    place = Place(file=str(path))
    header = read_gltf_header(path, place)
    return [*buffer_files(path, header, place).values(), *picture_files(path, header).values()]


def check_gltf_header(path: Path, place: Place) -> dict[str, Path]:
    """Refuses a glTF file whose arrays need far more bytes than there are, before anything is allocated.

    Returns its `buffer_files`. Raises InputError, also for a header that cannot be read.
    """
    header = read_gltf_header(path, place)
    buffers = buffer_files(path, header, place)
    try:
        there = path.stat().st_size + sum(file.stat().st_size for file in buffers.values())
    except OSError as error:
        raise InputError(
            f"a buffer of the glTF file cannot be read ({error.strerror})",
            place=Place(file=str(error.filename)),
            hint="keep all files of a mesh together, or export it as GLB",
        ) from None
    accessors = header.get("accessors", [])
    unfolded = 0
    try:
        for accessor in accessors:
            count = accessor["count"]
            size = _COMPONENT_BYTES[accessor["componentType"]] * _COMPONENTS[accessor["type"]]
            if not isinstance(count, int) or count < 0:
                raise ValueError
            if "bufferView" not in accessor:
                unfolded += count * size
            elif count > there:
                raise InputError(f"the glTF file announces {count} items, but has {there} bytes", place=place)
    except (KeyError, TypeError, ValueError, AttributeError):
        raise InputError("the glTF file describes its arrays wrongly", place=place) from None
    if unfolded > MAX_UNFOLDED * there:
        raise InputError(
            f"the glTF file announces {unfolded} bytes of zeros, but has {there}",
            place=place,
            hint="write the arrays out, or simplify the mesh",
        )
    return buffers
