"""Materials of glTF files: base colour, metalness, roughness and their textures as principled surfaces.

glTF 2.0, section 3.9: factors times textures; base colour in sRGB, roughness in green and metalness in
blue of one linear picture. Our roughness is GGX alpha, the square of theirs. Alpha of the base colour is
opacity, as `alphaMode` says. What lets light through (KHR_materials_transmission) is glass: thin, unless
KHR_materials_volume gives it a thickness.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from mrbatch.errors import InputError, Place
from mrbatch.kernels.transfer import to_linear
from mrbatch.scene.opacity import with_opacity
from mrbatch.scene.scene import POLISHED, Material, Texture, absorption
from mrbatch.scene.stored_picture import MAX_PIXELS

DARKEST = 2.0**-10
"""Least share of light that glass leaves: of none no logarithm is."""
F0 = 0.04
"""Reflectance of the interface at normal incidence that glTF fixes (index of refraction 1.5)."""


def material_from_gltf(
    found: Any, place: Place, extensions: Mapping[str, Any] | None = None
) -> tuple[Material, tuple[str, ...]]:
    """The material, and in words what of the file's own is left out.

    `found`: trimesh's `PBRMaterial`, or None for glTF's default; `extensions`: what they say of it, by name.
    Raises InputError for a picture that cannot be used.
    """
    glass = _glass(found, extensions or {}, place)
    if glass is not None:
        return glass
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
    return _with_alpha(material, found, float(base[3]), place), _left_out(extensions or {})


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


def _with_alpha(material: Material, found: Any, factor: float, place: Place) -> Material:
    """glTF 2.0, section 3.9.4: alpha counts as the material's `alphaMode` says."""
    mode = getattr(found, "alphaMode", None) or "OPAQUE"
    if mode not in ("MASK", "BLEND"):
        return material
    cutoff = 0.0
    if mode == "MASK":
        given = getattr(found, "alphaCutoff", None)
        cutoff = 0.5 if given is None else float(given)
        if cutoff <= 0.0:
            return material
    image = getattr(found, "baseColorTexture", None)
    codes = _picture(image, "base colour", place, "RGBA")
    values: Any = factor
    if codes is not None:
        values = codes[..., 3].astype(np.float32) * np.float32(factor / 255.0)
    return with_opacity(material, values, cutoff=cutoff, source=f"{place.file}, alpha")


def _glass(
    found: Any, extensions: Mapping[str, Any], place: Place
) -> tuple[Material, tuple[str, ...]] | None:
    """Of a material that lets most light through; None of others."""
    transmission = extensions.get("KHR_materials_transmission", {})
    passed = _number(transmission.get("transmissionFactor"), 0.0)
    if passed < 0.5:
        return None
    ior = min(max(_number(extensions.get("KHR_materials_ior", {}).get("ior"), 1.5), 1.0), 4.0)
    colour = _factor(getattr(found, "baseColorFactor", None), 4)[:3]
    roughness = _factor(getattr(found, "roughnessFactor", None), 1)[0] ** 2
    left_out = []
    if passed < 1.0 or "transmissionTexture" in transmission:
        left_out.append("the part that lets no light through")
    if getattr(found, "alphaMode", None) in ("MASK", "BLEND"):
        left_out.append("alpha")
    if _emission(found, place)[0] != (0.0, 0.0, 0.0):
        left_out.append("emission")
    if getattr(found, "normalTexture", None) is not None:
        left_out.append("normals of the glass")
    if getattr(found, "baseColorTexture", None) is not None:
        left_out.append("the glass's colour by texture")
    volume = extensions.get("KHR_materials_volume", {})
    if _number(volume.get("thicknessFactor"), 0.0) > 0.0:
        if colour.min() < 1.0:
            left_out.append("the base colour of the glass")
        told = volume.get("attenuationColor")
        left = [_number(c, 1.0) for c in told] if isinstance(told, list) and len(told) == 3 else [1.0] * 3
        depth = _number(volume.get("attenuationDistance"), math.inf)
        dark = (0.0, 0.0, 0.0)
        if math.isfinite(depth) and depth > 0.0:
            dark = absorption(np.maximum(_factor(left, 3), DARKEST), depth)  # type: ignore[arg-type]
        alpha = 0.0 if roughness < POLISHED else float(roughness)
        look = Material("dielectric", (1.0, 1.0, 1.0), alpha, ior=ior, absorption=dark)
        return look, tuple(left_out)
    if roughness >= POLISHED:
        left_out.append("roughness of the thin glass")
    r, g, b = (max(float(c), DARKEST) for c in colour)
    return Material("thin_dielectric", (r, g, b), 0.0, ior=ior), tuple(left_out)


def _left_out(extensions: Mapping[str, Any]) -> tuple[str, ...]:
    passed = _number(extensions.get("KHR_materials_transmission", {}).get("transmissionFactor"), 0.0)
    return ("the part that lets light through",) if passed > 0.0 else ()


def _number(value: Any, usual: float) -> float:
    """A finite number of a file's JSON, or what is usual."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        return usual
    return float(value)


def _factor(value: Any, count: int) -> np.ndarray:
    """(count,) float64 in 0..1; 1 where the file says nothing. Bytes, as trimesh may give, are scaled."""
    if value is None:
        return np.ones(count)
    given = np.atleast_1d(np.asarray(value))
    scale = 255.0 if given.dtype == np.uint8 else 1.0
    out = np.ones(count)
    out[: len(given)] = given[:count] / scale
    return np.clip(np.nan_to_num(out, nan=1.0), 0.0, 1.0)


def _picture(image: Any, what: str, place: Place, channels: str = "RGB") -> np.ndarray | None:
    """(H, W, channels) uint8, or None. `image` is Pillow's, not yet decoded."""
    if image is None:
        return None
    width, height = image.size
    if width * height > MAX_PIXELS:
        raise InputError(f"the {what} texture of the file claims {width}x{height} pixels", place=place)
    try:
        return np.asarray(image.convert(channels))
    except Exception as error:  # a decoder that meets broken bytes may raise anything
        raise InputError(
            f"the {what} texture of the file cannot be read ({type(error).__name__})",
            place=place,
            hint="it may be damaged or truncated: export it again",
        ) from error
