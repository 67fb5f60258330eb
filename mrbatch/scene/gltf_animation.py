"""Animations of a glTF file: which of its nodes move, and how.

glTF 2.0, sections 3.6 (buffers, accessors) and 3.11 (animations): channels of translation, rotation and
scale, each of one node, with linear, stepped or cubic interpolation. Skins and morph targets bend meshes, and
are refused.
"""

from __future__ import annotations

import base64
import difflib
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mrbatch.errors import InputError, Place
from mrbatch.scene.channel import Channel, Fixed, Interpolation, Placement, constant
from mrbatch.scene.gltf_header import buffer_files, read_gltf_header

_INTERPOLATIONS: dict[str, Interpolation] = {
    "LINEAR": "linear",
    "STEP": "step",
    "CUBICSPLINE": "cubic-spline",
}
_TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5126: "<f4"}
_WIDTHS = {"translation": 3, "rotation": 4, "scale": 3}
_SHAPES = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}


@dataclass(frozen=True)
class NodeAnimation:
    """`name` and `length` (seconds, to the last key) of an animation; by node index the placements of the
    nodes from the file's own frame to it, for nodes that move or hang on one that does."""

    name: str
    length: float
    nodes: Mapping[int, tuple[Placement | Fixed, ...]]


def load_animation(path: Path, name: str | None) -> NodeAnimation:
    """The animation of that name, or the file's only one.

    Raises InputError: no such animation, several and no name, a skin or morph target, damaged data.
    """
    place = Place(file=str(path))
    header = read_gltf_header(path, place)
    try:
        return _animation(path, header, name, place)
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, struct.error) as error:
        raise InputError(
            f"the glTF's animation cannot be read ({type(error).__name__}: {error})",
            place=place,
            hint="it may be damaged: export it again",
        ) from None


def node_names(header: Mapping[str, Any]) -> list[str]:
    """Names that the reader of meshes gives to the nodes, each once: a node's own, or its index."""
    from trimesh.util import unique_name

    found: dict[str, int] = {}
    counts: dict[str | None, int] = {}
    for index, node in enumerate(header.get("nodes", [])):
        found[unique_name(node.get("name", str(index)), found, counts=counts)] = index
    return list(found)


def animation_names(header: Mapping[str, Any]) -> list[str]:
    """Of every animation; one without a name goes by its index."""
    return [str(a.get("name", index)) for index, a in enumerate(header.get("animations", []))]


def _animation(path: Path, header: Mapping[str, Any], name: str | None, place: Place) -> NodeAnimation:
    chosen = _chosen(animation_names(header), name, place)
    nodes = header["nodes"]
    if any("skin" in node and "mesh" in node for node in nodes):
        raise InputError(
            "the glTF bends a mesh by a skin, which is not simulated",
            place=place,
            hint="leave out `clip`, or bake the animation into nodes",
        )
    data = _Data(path, header, place)
    animation = header["animations"][chosen]
    channels: dict[int, dict[str, Channel]] = {}
    length = 0.0
    for channel in animation["channels"]:
        target = channel["target"]
        part = target["path"]
        if part == "weights":
            raise InputError(
                "the glTF's animation bends a mesh by morph targets, which are not simulated",
                place=place,
                hint="choose another animation, or leave out `clip`",
            )
        if part not in _WIDTHS:
            raise InputError(f"the glTF animates `{str(part)[:40]}` of a node", place=place)
        if "node" not in target:
            continue
        if "matrix" in nodes[target["node"]]:
            raise ValueError("a node that moves has a matrix")
        made = _channel(data, animation["samplers"][channel["sampler"]], part)
        channels.setdefault(target["node"], {})[part] = made
        length = max(length, float(made.times[-1]))
    parents = {child: index for index, node in enumerate(nodes) for child in node.get("children", [])}
    found = {}
    for index in range(len(nodes)):
        chain = _chain(index, parents)
        if any(node in channels for node in chain):
            found[index] = tuple(p for n in chain for p in _placements(nodes[n], channels.get(n, {})))
    return NodeAnimation(animation_names(header)[chosen], length, found)


def _chosen(names: Sequence[str], name: str | None, place: Place) -> int:
    if not names:
        raise InputError("the glTF file has no animation", place=place, hint="leave out `clip`")
    if name is None:
        if len(names) > 1:
            raise InputError(
                f"the glTF file has {len(names)} animations: {', '.join(names[:20])}",
                place=place,
                hint="name one as `clip.name`",
            )
        return 0
    if name not in names:
        near = difflib.get_close_matches(name, names, n=1)
        raise InputError(
            f"the glTF file has no animation `{name}`",
            place=place,
            hint=f"did you mean `{near[0]}`?" if near else f"it has: {', '.join(names[:20])}",
        )
    return names.index(name)


def _chain(index: int, parents: Mapping[int, int]) -> list[int]:
    """From the root to the node."""
    chain = [index]
    while chain[-1] in parents:
        chain.append(parents[chain[-1]])
        if len(chain) > len(parents) + 1:
            raise ValueError("a node is its own child")
    return chain[::-1]


def _placements(node: Mapping[str, Any], channels: Mapping[str, Channel]) -> tuple[Placement | Fixed, ...]:
    if "matrix" in node:
        return (Fixed(np.array(node["matrix"], dtype=np.float64).reshape(4, 4).T),)
    return (
        Placement(
            channels.get("translation") or constant(node.get("translation", (0.0, 0.0, 0.0))),
            channels.get("rotation")
            or constant(_unit(node.get("rotation", (0.0, 0.0, 0.0, 1.0))), turns=True),
            channels.get("scale") or constant(node.get("scale", (1.0, 1.0, 1.0))),
        ),
    )


def _unit(quaternions: Any) -> np.ndarray:
    values = np.asarray(quaternions, dtype=np.float64)
    lengths = np.linalg.norm(values, axis=-1, keepdims=True)
    if not np.all(lengths > 0.0):
        raise ValueError("a rotation of length 0")
    return values / lengths


def _channel(data: _Data, sampler: Mapping[str, Any], part: str) -> Channel:
    interpolation = _INTERPOLATIONS[sampler.get("interpolation", "LINEAR")]
    times = data.values(sampler["input"])[:, 0]
    values = data.values(sampler["output"])
    each = 3 if interpolation == "cubic-spline" else 1
    if len(times) == 0 or values.shape != (each * len(times), _WIDTHS[part]):
        raise ValueError(f"{len(times)} keys and {len(values)} values of {part}")
    if np.any(np.diff(times) <= 0.0) or not (np.isfinite(times).all() and np.isfinite(values).all()):
        raise ValueError("keys that are not finite, or not in order")
    turns = part == "rotation"
    if interpolation == "cubic-spline":
        values = values.reshape(len(times), 3, -1)
        if turns:
            values[:, 1] = _unit(values[:, 1])
    elif turns:
        values = _unit(values)
    return Channel(times, values, interpolation, turns)


class _Data:
    """The numbers of a file's accessors."""

    def __init__(self, path: Path, header: Mapping[str, Any], place: Place) -> None:
        self._path, self._header, self._place = path, header, place
        self._files = buffer_files(path, dict(header), place)

    def values(self, accessor: int) -> np.ndarray:
        """(count, components) float64; whole numbers as the fractions that they stand for."""
        entry = self._header["accessors"][accessor]
        if "sparse" in entry or "bufferView" not in entry:
            raise InputError("the glTF's animation has a sparse accessor", place=self._place)
        dtype, width = np.dtype(_TYPES[entry["componentType"]]), _SHAPES[entry["type"]]
        view = self._header["bufferViews"][entry["bufferView"]]
        step = view.get("byteStride", dtype.itemsize * width)
        count, first = entry["count"], entry.get("byteOffset", 0)
        raw = self._bytes(view["buffer"])[view.get("byteOffset", 0) :][: view["byteLength"]]
        if count < 0 or step < dtype.itemsize * width or first < 0:
            raise ValueError("an accessor that reads nothing")
        if count and first + step * (count - 1) + dtype.itemsize * width > len(raw):
            raise ValueError("an accessor that ends beyond its buffer")
        found = np.ndarray((count, width), dtype, raw, first, (step, dtype.itemsize)).astype(np.float64)
        if dtype.kind == "f":
            return found
        return np.maximum(found / np.iinfo(dtype).max, -1.0)

    def _bytes(self, buffer: int) -> bytes:
        uri = self._header["buffers"][buffer].get("uri")
        if uri is None:
            raw = self._path.read_bytes()
            (length,) = struct.unpack("<I", raw[12:16])
            start = 20 + length
            (size,) = struct.unpack("<I", raw[start : start + 4])
            return raw[start + 8 : start + 8 + size]
        if "base64," in uri:
            return base64.b64decode(uri.split("base64,", 1)[1])
        try:
            return self._files[uri].read_bytes()
        except OSError as error:
            raise InputError(
                f"a buffer of the glTF file cannot be read ({error.strerror})", place=self._place
            ) from None
