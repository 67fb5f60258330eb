"""Materials of glTF files as principled surfaces: base colour, metalness, roughness and their textures.

glTF 2.0, section 3.9: factors times textures; base colour in sRGB, roughness in green and metalness in
blue of one linear picture. Our roughness is GGX alpha, the square of theirs.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mrbatch.errors import InputError, Place
from mrbatch.kernels.transfer import to_linear
from mrbatch.scene.scene import Material, Texture
from mrbatch.scene.stored_picture import MAX_PIXELS

F0 = 0.04
"""Reflectance of the interface at normal incidence that glTF fixes (index of refraction 1.5)."""


def material_from_gltf(found: Any, place: Place) -> tuple[Material, tuple[str, ...]]:
    """The material, and in words what of the file's own is left out.

    `found`: trimesh's `PBRMaterial`, or None for glTF's default. Raises InputError for a picture that
    cannot be used.
    """
    base = _factor(getattr(found, "baseColorFactor", None), 4)
    metalness = _factor(getattr(found, "metallicFactor", None), 1)[0]
    roughness = _factor(getattr(found, "roughnessFactor", None), 1)[0]
    colour = _picture(getattr(found, "baseColorTexture", None), "base colour", place)
    surface = _picture(getattr(found, "metallicRoughnessTexture", None), "roughness", place)
    texture = surface_texture = None
    reflectance = base[:3]
    if colour is not None:
        pixels = (to_linear(colour, "srgb", 8) * base[:3]).astype(np.float32)
        texture = Texture(pixels, f"{place.file}, base colour")
        reflectance = pixels.reshape(-1, 3).mean(axis=0, dtype=np.float64)
    alpha = roughness**2
    if surface is not None:
        pixels = np.zeros(surface.shape, np.float32)
        pixels[..., 0] = (surface[..., 1] / np.float32(255.0) * roughness) ** 2
        pixels[..., 1] = surface[..., 2] / np.float32(255.0) * metalness
        surface_texture = Texture(pixels, f"{place.file}, roughness and metalness")
        alpha, metalness, _ = pixels.reshape(-1, 3).mean(axis=0, dtype=np.float64)
    normals = _picture(getattr(found, "normalTexture", None), "normal", place)
    normal_texture = None
    if normals is not None:
        # Codes 0..255 are -1..1; trimesh does not tell the factor on x and y, which is rarely other than 1.
        vectors = normals.astype(np.float32) * np.float32(2.0 / 255.0) - np.float32(1.0)
        normal_texture = Texture(vectors, f"{place.file}, normals")
    emits, emission_texture = _emission(found, place)
    r, g, b = (float(c) for c in reflectance)
    material = Material(
        kind="principled",
        reflectance=(r, g, b),
        alpha=float(alpha),
        texture=texture,
        metalness=float(metalness),
        f0=F0,
        surface_texture=surface_texture,
        normal_texture=normal_texture,
        emission=emits,
        emission_texture=emission_texture,
    )
    return material, _left_out(found)


def _emission(found: Any, place: Place) -> tuple[tuple[float, float, float], Texture | None]:
    """Radiance, and its texture: the file's 1 is radiance 1 in the map's units."""
    factor = getattr(found, "emissiveFactor", None)
    if factor is None or not np.any(np.asarray(factor) > 0):
        return (0.0, 0.0, 0.0), None
    r, g, b = (float(c) for c in _factor(factor, 3))
    codes = _picture(getattr(found, "emissiveTexture", None), "emission", place)
    if codes is None:
        return (r, g, b), None
    pixels = (to_linear(codes, "srgb", 8) * [r, g, b]).astype(np.float32)
    if not pixels.any():
        return (0.0, 0.0, 0.0), None
    return (r, g, b), Texture(pixels, f"{place.file}, emission")


def _left_out(found: Any) -> tuple[str, ...]:
    parts = []
    if (getattr(found, "alphaMode", None) or "OPAQUE") != "OPAQUE":
        parts.append("transparency")
    return tuple(parts)


def _factor(value: Any, count: int) -> np.ndarray:
    """(count,) float64 in 0..1; 1 where the file says nothing. Bytes, as trimesh may give, are scaled."""
    if value is None:
        return np.ones(count)
    given = np.atleast_1d(np.asarray(value))
    scale = 255.0 if given.dtype == np.uint8 else 1.0
    out = np.ones(count)
    out[: len(given)] = given[:count] / scale
    return np.clip(np.nan_to_num(out, nan=1.0), 0.0, 1.0)


def _picture(image: Any, what: str, place: Place) -> np.ndarray | None:
    """(H, W, 3) uint8, or None. `image` is Pillow's, not yet decoded."""
    if image is None:
        return None
    width, height = image.size
    if width * height > MAX_PIXELS:
        raise InputError(f"the {what} texture of the file claims {width}x{height} pixels", place=place)
    try:
        return np.asarray(image.convert("RGB"))
    except Exception as error:  # a decoder that meets broken bytes may raise anything
        raise InputError(
            f"the {what} texture of the file cannot be read ({type(error).__name__})",
            place=place,
            hint="it may be damaged or truncated: export it again",
        ) from error
