"""The layers that a frame can have: names, channels, meaning, and what each needs computed.

A layer that is not asked for needs nothing, so nothing is rendered or allocated for it: `needs`
gives the estimates that the chosen layers call for, and `channels` makes the channels of a file
from them.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from mrbatch.errors import JobError
from mrbatch.film import cryptomatte
from mrbatch.film.composite import composite, shadow_matte

Kind = Literal["colour", "data"]
Estimates = Mapping[str, np.ndarray]
NOTHING = 1e10
"""Depth where nothing is: far behind everything, yet finite, as compositors expect."""

ESTIMATES: dict[str, str] = {
    "P": "(h, w, 3) virtual radiance, premultiplied, photo units",
    "a": "(h, w) coverage of what is virtual, 0..1",
    "D": "(h, w, 3) light change on what is real, signed, weighted by what of B stays visible",
    "B": "(h, w, 3) background: the captured picture, linear, photo units",
    "D_indirect": "(h, w, 3) light over other surfaces, signed; the rest of D is direct light taken away",
    "depth": "(h, w) distance of the nearest sample's first hit, metres; 1e10 for none",
    "normal": "(h, w, 3) mean world-space normal of first hits, weighted by coverage",
    "albedo": "(h, w, 3) mean albedo of first hits, weighted by coverage",
    "motion": "(h, w, 2) motion to the next frame, pixels, y down",
    "variance": "(h, w, 3) variance of the composite's mean",
    "samples": "(h, w) samples of both halves",
    "object_ids": "(h, w, k) uint32 ids of names (cryptomatte.name_id), 0 for none",
    "object_coverage": "(h, w, k) coverage of each id, 0..1",
    "material_ids": "(h, w, k) uint32 ids of names",
    "material_coverage": "(h, w, k) coverage of each id, 0..1",
}
"""Everything that a layer may ask of the film, with shape and unit."""


@dataclass(frozen=True)
class Layer:
    """One layer.

    `channels`: names in the file, in order. `kind`: colour (half or float, one type for a sequence)
    or data (always float). `empty`: value of every channel where nothing is. `needs`: names of
    `ESTIMATES`. `compute`: from these to (h, w) or (h, w, c) values.
    """

    name: str
    channels: tuple[str, ...]
    kind: Kind
    meaning: str
    needs: tuple[str, ...]
    compute: Callable[[Estimates], np.ndarray]
    empty: float = 0.0


def _named(name: str) -> Callable[[Estimates], np.ndarray]:
    return lambda e: e[name]


def _composite(e: Estimates) -> np.ndarray:
    colour = composite(e["P"], e["a"], e["B"], e["D"])
    return np.concatenate([colour, np.ones_like(colour[..., :1])], axis=-1)


def _crypto(kind: str) -> Callable[[Estimates], np.ndarray]:
    return lambda e: cryptomatte.ranked(e[f"{kind}_ids"], e[f"{kind}_coverage"])


def _crypto_channels(layer: str) -> tuple[str, ...]:
    return tuple(cryptomatte.channels(layer, np.zeros((1, 1, 2 * cryptomatte.RANKS), np.float32)))


def _dotted(layer: str, letters: str) -> tuple[str, ...]:
    return tuple(f"{layer}.{letter}" for letter in letters)


LAYERS: dict[str, Layer] = {
    layer.name: layer
    for layer in (
        Layer(
            "composite",
            ("R", "G", "B", "A"),
            "colour",
            "the finished picture, max(0, P + (1 - a) B + D); alpha is 1, for it holds its background",
            ("P", "a", "B", "D"),
            _composite,
        ),
        Layer(
            "virtual",
            _dotted("virtual", "RGBA"),
            "colour",
            "what is virtual, premultiplied by its coverage A",
            ("P", "a"),
            lambda e: np.concatenate([e["P"], e["a"][..., None]], axis=-1),
        ),
        Layer(
            "background",
            _dotted("background", "RGB"),
            "colour",
            "what virtual things are laid over: photo, resampled panorama, cloud frame or environment",
            ("B",),
            _named("B"),
        ),
        Layer(
            "delta",
            _dotted("delta", "RGB"),
            "colour",
            "signed light change on real surfaces; add it after virtual is laid over background",
            ("D",),
            _named("D"),
        ),
        Layer(
            "shadow",
            ("shadow",),
            "data",
            "share of the visible background's luminance that virtual things take away directly, 0..1",
            ("a", "B", "D", "D_indirect"),
            lambda e: shadow_matte(e["a"], e["B"], e["D"] - e["D_indirect"]),
        ),
        Layer(
            "indirect",
            _dotted("indirect", "RGB"),
            "colour",
            "the part of delta that comes or stays away over other surfaces, signed",
            ("D_indirect",),
            _named("D_indirect"),
        ),
        Layer(
            "depth",
            ("depth.Z",),
            "data",
            "metres to what is virtual, nearest sample, planar z (360 degrees: range); 1e10 for nothing",
            ("depth",),
            _named("depth"),
            NOTHING,
        ),
        Layer(
            "normal",
            _dotted("normal", "XYZ"),
            "data",
            "world-space normal of what is virtual, weighted by coverage",
            ("normal",),
            _named("normal"),
        ),
        Layer(
            "albedo",
            _dotted("albedo", "RGB"),
            "data",
            "albedo of what is virtual, linear Rec.709, weighted by coverage",
            ("albedo",),
            _named("albedo"),
        ),
        Layer(
            "motion",
            _dotted("motion", "XY"),
            "data",
            "motion to the next frame, pixels, y down",
            ("motion",),
            _named("motion"),
        ),
        Layer(
            "variance",
            _dotted("variance", "RGB"),
            "data",
            "variance of the pixel's mean",
            ("variance",),
            _named("variance"),
        ),
        Layer(
            "samples",
            ("samples",),
            "data",
            "samples of the pixel, both halves",
            ("samples",),
            _named("samples"),
        ),
        Layer(
            "crypto_object",
            _crypto_channels(cryptomatte.OBJECT),
            "data",
            "Cryptomatte by object name",
            ("object_ids", "object_coverage"),
            _crypto("object"),
        ),
        Layer(
            "crypto_material",
            _crypto_channels(cryptomatte.MATERIAL),
            "data",
            "Cryptomatte by material name",
            ("material_ids", "material_coverage"),
            _crypto("material"),
        ),
    )
}
"""All layers by name, in the order in which files and lists show them."""

DEFAULT_LAYERS = ("composite", "virtual", "background", "delta")
"""What a job that names no layers gets: enough to composite again by hand."""

CRYPTOMATTES = {"crypto_object": cryptomatte.OBJECT, "crypto_material": cryptomatte.MATERIAL}


def choose(names: Iterable[str] | None) -> tuple[Layer, ...]:
    """Layers by name in the registry's order, each once; None gives the default set.

    The composite is always among them. Raises JobError for a name that is no layer's.
    """
    wanted = {"composite", *(DEFAULT_LAYERS if names is None else names)}
    for name in sorted(wanted):
        if name not in LAYERS:
            near = difflib.get_close_matches(name, LAYERS, 1)
            hint = f"did you mean `{near[0]}`?" if near else f"layers: {', '.join(LAYERS)}"
            raise JobError(f"unknown layer `{name}`", hint=hint)
    return tuple(layer for name, layer in LAYERS.items() if name in wanted)


def needs(names: Iterable[str] | None) -> frozenset[str]:
    """Names of `ESTIMATES` that the layers call for; what is not in it need not be computed."""
    return frozenset(name for layer in choose(names) for name in layer.needs)


def data_behind_matte(estimates: Estimates, matte: np.ndarray) -> dict[str, np.ndarray]:
    """The data of first hits where something real stands in front, `matte` (h, w) of the pixel.

    What is weighted by coverage is weighted by 1 - m too; where nothing virtual is left to be seen, depth
    and motion are those of nothing. Other estimates are as they were.
    """
    rest = 1.0 - matte.astype(np.float32)
    found = dict(estimates)
    for name in ("normal", "albedo", "object_coverage", "material_coverage"):
        if name in found:
            found[name] = found[name] * rest[..., None]
    hidden = rest <= 0.0
    for name, nothing in (("depth", NOTHING), ("motion", 0.0)):
        if name in found:
            found[name] = np.where(hidden if name == "depth" else hidden[..., None], nothing, found[name])
    return found


def channels(names: Iterable[str] | None, estimates: Estimates) -> dict[str, np.ndarray]:
    """Channels (h, w) float32 of the layers, in file order.

    `estimates`: at least `needs(names)`, with the shapes of `ESTIMATES`; sums in float64 are rounded
    to float32 here, once. Raises KeyError where one is missing, ValueError where a shape is wrong.
    """
    out: dict[str, np.ndarray] = {}
    size: tuple[int, ...] | None = None
    for layer in choose(names):
        missing = [name for name in layer.needs if name not in estimates]
        if missing:
            raise KeyError(f"layer `{layer.name}` needs {', '.join(missing)}")
        values = np.asarray(layer.compute(estimates), dtype=np.float32)
        if values.ndim == 2:
            values = values[..., None]
        if values.ndim != 3 or values.shape[-1] != len(layer.channels):
            raise ValueError(
                f"layer `{layer.name}`: shape {values.shape}, expected (h, w, {len(layer.channels)})"
            )
        size = size or values.shape[:2]
        if values.shape[:2] != size:
            raise ValueError(f"layer `{layer.name}`: size {values.shape[:2]}, the first layer has {size}")
        for i, channel in enumerate(layer.channels):
            out[channel] = values[..., i]
    return out


def empty(names: Iterable[str] | None, height: int, width: int) -> dict[str, np.ndarray]:
    """Channels of a view in which nothing virtual is and the background is black."""
    return {
        channel: np.full((height, width), 1.0 if channel == "A" else layer.empty, dtype=np.float32)
        for layer in choose(names)
        for channel in layer.channels
    }


_KIND_OF_CHANNEL: dict[str, Kind] = {c: layer.kind for layer in LAYERS.values() for c in layer.channels}


def channel_kind(channel: str) -> Kind:
    """Colour or data; channels that no layer knows are data, so that nothing is lost."""
    return _KIND_OF_CHANNEL.get(channel, "data")
