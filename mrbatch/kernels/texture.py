"""Textures: one flat array of texels for all pictures of a scene, bilinear look-up with repeat.

Texture coordinates follow OpenGL and OBJ: (0, 0) is the lower left corner of the picture, v grows
upwards, while row 0 of a picture is its top row. glTF counts v downwards; readers of glTF store 1 - v.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import warp as wp

_MAX_TEXELS = 2**31 - 1


@wp.struct
class TextureAtlas:
    """Texels (linear Rec.709) of all textures, row after row; offset, width and height of each texture."""

    texels: wp.array(dtype=wp.vec3)
    offset: wp.array(dtype=wp.int32)
    width: wp.array(dtype=wp.int32)
    height: wp.array(dtype=wp.int32)


def build_texture_atlas(pictures: Sequence[np.ndarray], *, device: str = "cpu") -> TextureAtlas:
    """Atlas of pictures (height, width, 3) float32, row 0 at the top; number i is `pictures[i]`.

    The arrays are referenced by the struct, which has to stay alive while kernels use it. Raises
    ValueError for a picture of another shape or with values that are not finite, or over 2^31 texels.
    """
    checked = []
    for number, picture in enumerate(pictures):
        a = np.asarray(picture, dtype=np.float32)
        if a.ndim != 3 or a.shape[2] != 3 or a.shape[0] == 0 or a.shape[1] == 0:
            raise ValueError(f"texture {number}: expected shape (height, width, 3), got {a.shape}")
        if not np.isfinite(a).all():
            raise ValueError(f"texture {number}: {np.count_nonzero(~np.isfinite(a))} values are not finite")
        checked.append(a.reshape(-1, 3))
    sizes = np.array([len(a) for a in checked], dtype=np.int64)
    if sizes.sum() > _MAX_TEXELS:
        raise ValueError(f"textures: {sizes.sum()} texels in all, more than {_MAX_TEXELS}")
    offsets = np.concatenate([[0], np.cumsum(sizes)[:-1]]) if checked else np.zeros(0)
    texels = np.concatenate(checked) if checked else np.zeros((0, 3), dtype=np.float32)
    atlas = TextureAtlas()
    atlas.texels = wp.array(texels, dtype=wp.vec3, device=device)
    atlas.offset = wp.array(offsets.astype(np.int32), dtype=wp.int32, device=device)
    atlas.width = wp.array([p.shape[1] for p in pictures], dtype=wp.int32, device=device)
    atlas.height = wp.array([p.shape[0] for p in pictures], dtype=wp.int32, device=device)
    return atlas


@wp.func
def _fraction(x: float) -> float:
    """x - floor(x); 0 for what is not finite, so that no address can leave the texture."""
    f = x - wp.floor(x)
    if f >= 0.0 and f <= 1.0:
        return f
    return 0.0


@wp.func
def sample_texture(atlas: TextureAtlas, index: int, uv: wp.vec2) -> wp.vec3:
    """Bilinear texel values at `uv`, repeating; texel centres at ((i + 1/2) / width, ...).

    `index` below 0 means no texture and gives 1, so that a factor times it is the factor.
    """
    if index < 0:
        return wp.vec3(1.0, 1.0, 1.0)
    w = atlas.width[index]
    h = atlas.height[index]
    first = atlas.offset[index]
    x = _fraction(uv[0]) * float(w) - 0.5
    y = (1.0 - _fraction(uv[1])) * float(h) - 0.5
    x0 = int(wp.floor(x))
    y0 = int(wp.floor(y))
    fx = x - float(x0)
    fy = y - float(y0)
    x1 = x0 + 1
    y1 = y0 + 1
    if x0 < 0:
        x0 = w - 1
    if x1 >= w:
        x1 = 0
    if y0 < 0:
        y0 = h - 1
    if y1 >= h:
        y1 = 0
    a = atlas.texels[first + y0 * w + x0]
    b = atlas.texels[first + y0 * w + x1]
    c = atlas.texels[first + y1 * w + x0]
    d = atlas.texels[first + y1 * w + x1]
    top = a + fx * (b - a)
    bottom = c + fx * (d - c)
    return top + fy * (bottom - top)
