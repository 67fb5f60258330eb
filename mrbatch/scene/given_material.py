"""From what a job says of a material to the material itself: its textures are read here."""

from __future__ import annotations

import functools
from dataclasses import replace
from pathlib import Path

import numpy as np

from mrbatch.errors import InputError, Place
from mrbatch.kernels.transfer import to_linear, to_rec709
from mrbatch.scene import material_settings as looks
from mrbatch.scene.metals import metal_colours
from mrbatch.scene.scene import POLISHED, Material, Texture, absorption
from mrbatch.scene.stored_picture import check_finite, colour_channels, primaries_of, read_stored


def surface_of(look: looks.Material) -> Material:
    """Of what a job gives as a material. Raises InputError."""
    if isinstance(look, looks.Dielectric) and look.thin:
        return Material("thin_dielectric", look.colour, 0.0, name=look.name or "", ior=look.ior)
    if isinstance(look, looks.Dielectric):
        return Material(
            "dielectric",
            (1.0, 1.0, 1.0),
            # What is nearly polished is polished: a smooth boundary has no noise.
            0.0 if look.roughness < POLISHED else look.roughness,
            name=look.name or "",
            ior=look.ior,
            absorption=absorption(look.colour, look.depth),
            priority=look.priority,
        )
    if isinstance(look, looks.Conductor) and look.preset is not None:
        base, edge = metal_colours(look.preset)
        return Material("principled", base, look.roughness, name=look.name or "", metalness=1.0, edge=edge)
    alpha = 0.0 if isinstance(look, looks.Diffuse) else look.roughness
    material = replace(material_of(look.type, look.reflectance, alpha), name=look.name or "")
    if isinstance(look, looks.Principled):
        # Schlick's value at normal incidence is the interface's own.
        f0 = ((look.ior - 1.0) / (look.ior + 1.0)) ** 2
        material = replace(material, metalness=look.metalness, f0=f0, edge=look.edge_tint)
    return material


def material_of(kind: str, reflectance: object, alpha: float) -> Material:
    """A material of one reflectance (3,), or of a texture's. Raises InputError."""
    if isinstance(reflectance, looks.Texture):
        pixels, notes = _texture(reflectance.texture, reflectance.colour)
        if reflectance.mean is not None:
            mean = pixels.reshape(-1, 3).mean(axis=0, dtype=np.float64)
            factor = np.divide(reflectance.mean, mean, out=np.zeros(3), where=mean > 0)
            pixels = (pixels * factor).astype(np.float32)
        average = tuple(float(c) for c in pixels.reshape(-1, 3).mean(axis=0, dtype=np.float64))
        texture = Texture(pixels, str(reflectance.texture), notes)
        return Material(kind, average, alpha, texture)  # type: ignore[arg-type]
    return Material(kind=kind, alpha=alpha, reflectance=tuple(reflectance))  # type: ignore[arg-type]


@functools.lru_cache(maxsize=16)
def _texture(path: Path, colour: str) -> tuple[np.ndarray, tuple[str, ...]]:
    """(H, W, 3) float32 reflectance, linear Rec.709, and notes on its reading. Raises InputError."""
    place = Place(file=str(path))
    stored = read_stored(path, what="texture", upright=False)
    codes, _ = colour_channels(stored, place)
    check_finite(codes, place)
    if codes.dtype.kind == "f":
        pixels = codes.astype(np.float32)
    else:
        pixels = to_linear(codes, colour, 8 * codes.dtype.itemsize)
    if pixels.min() < 0.0 or pixels.max() > 1.0:
        raise InputError(
            f"the texture reaches from {pixels.min():g} to {pixels.max():g}: a reflectance lies in 0..1",
            place=place,
            hint="scale the texture, or name its `colour` right",
        )
    notes: tuple[str, ...] = ()
    primaries, matrix, unknown = primaries_of(stored, place)
    if primaries != "bt709":
        pixels = to_rec709(pixels, matrix)
        beyond = (pixels < 0.0) | (pixels > 1.0)
        clamped = int(beyond.any(axis=2).sum())
        pixels = np.clip(pixels, 0.0, 1.0)
        notes = (
            f"the texture {path.name} is converted to Rec.709 from the primaries that its file names"
            + (f"; {clamped} texels lie outside and are clamped" if clamped else ""),
        )
    elif unknown:
        notes = (
            f"the texture {path.name} has the colour profile `{unknown}`, which is not applied: "
            "Rec.709 primaries are assumed",
        )
    pixels.setflags(write=False)
    return pixels, notes
