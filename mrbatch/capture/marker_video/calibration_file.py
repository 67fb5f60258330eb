"""The formats that calibrations come in, to one mapping of plain data: sizes checked, nothing executed."""

from __future__ import annotations

import io
import math
import re
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from mrbatch.capture.data_file import MAX_BYTES, parse_json, parse_yaml, read_text
from mrbatch.document import MAX_DEPTH
from mrbatch.errors import InputError, Place

WHAT = "calibration file"
MAX_ARRAYS = 256
"""Arrays of one NPZ file."""
MAX_KEYS = 1000
"""Keys of one mapping, and items of one list, of a FileStorage."""
_PICKLED = "the file holds pickled Python objects, which are not read"
_PICKLED_HINT = "save plain arrays: np.savez(path, camera_matrix=K, dist=d)"
_DASHES = re.compile(r"(?:-[ \t\r\n]+)+")
_TAG = re.compile(r"<(/?)[^<>!?][^<>]*?(/?)>")


def read_calibration_file(path: Path) -> dict[str, Any]:
    """The keys of a calibration file: OpenCV's FileStorage (YAML, XML, JSON), YAML, JSON, NPZ or NPY.

    Matrices are lists of numbers, or mappings that hold them as `data`. Raises InputError: missing, larger
    than 4 MiB, cannot be read, no keys.
    """
    place = Place(file=str(path))
    suffix = path.suffix.lower()
    if suffix in (".npz", ".npy"):
        return _read_numpy(path, place)
    text = read_text(path, WHAT)
    start = text.lstrip()
    if suffix == ".xml" or start.startswith(("<?xml", "<opencv")) or "opencv-matrix" in text:
        return _read_filestorage(text, suffix, place)
    if suffix == ".json" or start.startswith("{"):
        content = parse_json(text, WHAT, place)
    else:
        # OpenCV writes "%YAML:1.0", which no YAML reader takes; an empty line keeps the numbers of lines.
        lines = ["" if line.startswith("%YAML:") else line for line in text.splitlines()]
        content = parse_yaml("\n".join(lines), WHAT, place)
    if not isinstance(content, dict):
        raise InputError(
            "the calibration file holds no keys",
            place=place,
            hint="expected `camera_matrix` and `distortion_coefficients`",
        )
    return content


def _read_numpy(path: Path, place: Place) -> dict[str, Any]:
    try:
        with path.open("rb") as stream:
            data = stream.read(MAX_BYTES + 1)
    except OSError as error:
        raise InputError(f"the calibration file cannot be read ({error.strerror})", place=place) from None
    if len(data) > MAX_BYTES:
        raise InputError(f"the calibration file is larger than {MAX_BYTES >> 20} MiB", place=place)
    if data.startswith(b"\x93NUMPY"):
        return {"camera_matrix": _array(data, place)}
    if not data.startswith(b"PK"):
        raise InputError(
            "the calibration file cannot be read: it is neither an NPY nor an NPZ file", place=place
        )
    return _members(data, place)


def _members(data: bytes, place: Place) -> dict[str, Any]:
    """The arrays of an NPZ file, each and all of them together held to `MAX_BYTES` once unpacked."""
    found: dict[str, Any] = {}
    left = MAX_BYTES
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            entries = archive.infolist()
            if len(entries) > MAX_ARRAYS:
                raise InputError(f"the file holds {len(entries)} arrays, at most {MAX_ARRAYS}", place=place)
            for entry in entries:
                if entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                    raise InputError("the file is packed in another way than NumPy's", place=place)
                # What the directory says of sizes may be wrong: bytes are counted as they come out.
                with archive.open(entry) as member:
                    content = member.read(left + 1)
                left -= len(content)
                if left < 0:
                    raise InputError(f"the file unpacks to more than {MAX_BYTES >> 20} MiB", place=place)
                found[entry.filename.removesuffix(".npy")] = _array(content, place)
    except InputError:
        raise
    except Exception as error:  # a reader of archives that meets broken bytes may raise anything
        raise InputError(
            f"the calibration file cannot be read ({type(error).__name__}: {error})", place=place
        ) from None
    return found


def _array(data: bytes, place: Place) -> Any:
    """Plain data of an NPY file's bytes; its header is checked before memory is asked for."""
    form = np.lib.format
    stream = io.BytesIO(data)
    try:
        version = form.read_magic(stream)
        readers = {(1, 0): form.read_array_header_1_0, (2, 0): form.read_array_header_2_0}
        if version not in readers:
            raise ValueError(f"NPY version {version}")
        shape, _, kind = readers[version](stream)
        if kind.hasobject:
            raise InputError(_PICKLED, place=place, hint=_PICKLED_HINT)
        if math.prod(shape) * kind.itemsize > len(data) or any(n < 0 for n in shape):
            raise ValueError(f"it announces an array of shape {shape}, but has {len(data)} bytes")
        stream.seek(0)
        return form.read_array(stream, allow_pickle=False).tolist()
    except InputError:
        raise
    except Exception as error:  # headers are Python literals: broken ones may raise anything
        raise InputError(f"the calibration file cannot be read ({error})", place=place) from None


def _read_filestorage(text: str, suffix: str, place: Place) -> dict[str, Any]:
    import cv2

    if _depth(text) > MAX_DEPTH:  # OpenCV's parser calls itself at each level, to the end of the stack
        raise InputError(f"the calibration file is nested deeper than {MAX_DEPTH} levels", place=place)
    kind = {".xml": cv2.FileStorage_FORMAT_XML, ".json": cv2.FileStorage_FORMAT_JSON}.get(
        suffix, cv2.FileStorage_FORMAT_AUTO
    )
    try:
        storage = cv2.FileStorage(text, cv2.FileStorage_READ | cv2.FileStorage_MEMORY | kind)
        content = _mapping(storage.root())
    except (cv2.error, SystemError, ValueError, RecursionError) as error:
        cause = error.__cause__ or error
        reason = (str(cause).strip().splitlines() or ["damaged"])[-1]
        raise InputError(f"OpenCV cannot read the calibration file ({reason})", place=place) from None
    storage.release()
    return content


def _depth(text: str) -> int:
    """How deep brackets, YAML's dashes or XML elements are nested, at most; quoted ones are counted too."""
    deepest = level = 0
    if text.lstrip().startswith("<"):
        for match in _TAG.finditer(text):
            level += -1 if match[1] else 0 if match[2] else 1
            deepest = max(deepest, level)
        return deepest
    deepest = max((len(run[0].split()) for run in _DASHES.finditer(text)), default=0)
    for character in text:
        if character in "[{":
            level += 1
            deepest = max(deepest, level)
        elif character in "]}":
            level -= 1
    return deepest


def _node(node: Any) -> Any:
    """Value of a FileStorage node: number, text, list or mapping; a matrix is {rows, cols, dt, data}."""
    if node.isInt() or node.isReal():
        return node.real()
    if node.isString():
        return node.string()
    if node.isSeq():
        if node.size() > MAX_KEYS:
            raise ValueError(f"a list of {node.size()} items, at most {MAX_KEYS}")
        return [_node(node.at(i)) for i in range(node.size())]
    if node.isMap():
        # Matrices too: OpenCV's own reader of them writes past their end where sizes and data disagree.
        return _mapping(node)
    return None


def _mapping(node: Any) -> dict[str, Any]:
    keys = node.keys()
    if len(keys) > MAX_KEYS:  # each is looked for from the first on
        raise ValueError(f"a mapping of {len(keys)} keys, at most {MAX_KEYS}")
    return {key: _node(node.getNode(key)) for key in keys}
