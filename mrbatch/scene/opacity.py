"""How much of a surface is there: by a number, by a picture, or cut out along a picture's edge."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mrbatch.errors import InputError, Place
from mrbatch.scene.material_settings import OpacityTexture
from mrbatch.scene.scene import Material, Texture
from mrbatch.scene.stored_picture import check_finite, read_stored


def with_opacity(
    material: Material, values: float | np.ndarray, *, cutoff: float = 0.0, source: str = ""
) -> Material:
    """The material with opacity `values`, one in 0..1 or (H, W) of them, cut to 0 or 1 where `cutoff` is
    above 0. A texture that says the same everywhere becomes the number."""
    texels = np.clip(np.asarray(values, dtype=np.float32), 0.0, 1.0)
    there = texels >= np.float32(cutoff) if cutoff > 0.0 else texels
    if there.min() == there.max():
        return replace(material, opacity=float(there.max()), opacity_texture=None, opacity_cutoff=0.0)
    pixels = np.repeat(texels[..., None], 3, axis=2)
    pixels.setflags(write=False)
    return replace(
        material,
        opacity=float(there.mean(dtype=np.float64)),
        opacity_texture=Texture(pixels, source),
        opacity_cutoff=cutoff,
    )


def given_opacity(material: Material, opacity: float | OpacityTexture | None) -> Material:
    """The material with the opacity that a job gives, if it does. Raises InputError for a picture that
    cannot be used."""
    if opacity is None:
        return material
    if not isinstance(opacity, OpacityTexture):
        return with_opacity(material, opacity)
    return with_opacity(
        material, _read(opacity), cutoff=opacity.cutoff or 0.0, source=f"{opacity.texture}, opacity"
    )


def _read(opacity: OpacityTexture) -> np.ndarray:
    """(H, W) float32, 0..1."""
    place = Place(file=str(opacity.texture))
    stored = read_stored(opacity.texture, what="texture", upright=False)
    names = [name.upper() for name in stored.names]
    wanted = opacity.channel
    if wanted == "auto":
        wanted = "alpha" if "A" in names else "red"
    if wanted == "alpha":
        if "A" not in names:
            raise InputError(
                f"the picture has no alpha channel, only {', '.join(stored.names)}",
                place=place,
                hint="export it with transparency, or set `channel: red`",
            )
        channel = names.index("A")
    else:
        channel = names.index("R") if "R" in names else 0
    codes = stored.values[..., channel : channel + 1]
    check_finite(codes, place)
    scale = 1.0 if codes.dtype.kind == "f" else float(np.iinfo(codes.dtype).max)
    values = codes[..., 0].astype(np.float32) / np.float32(scale)
    if values.min() < 0.0 or values.max() > 1.0:
        raise InputError(
            f"the texture reaches from {values.min():g} to {values.max():g}: opacity lies in 0..1",
            place=place,
            hint="scale the texture",
        )
    return values
