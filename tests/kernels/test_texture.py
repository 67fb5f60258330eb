"""Texture look-ups against a float64 bilinear reference."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from mrbatch.kernels.texture import TextureAtlas, build_texture_atlas, sample_texture


@wp.kernel(enable_backward=False, module="unique")
def _look_up(atlas: TextureAtlas, index: int, uv: wp.array(dtype=wp.vec2), out: wp.array(dtype=wp.vec3)):
    i = wp.tid()
    out[i] = sample_texture(atlas, index, uv[i])


def look_up(atlas, index, uv) -> np.ndarray:
    uv = np.atleast_2d(np.asarray(uv, dtype=np.float32))
    out = wp.zeros(len(uv), dtype=wp.vec3, device="cpu")
    wp.launch(
        _look_up, len(uv), [atlas, index, wp.array(uv, dtype=wp.vec2, device="cpu")], [out], device="cpu"
    )
    return out.numpy()


def pictures() -> list[np.ndarray]:
    rng = np.random.default_rng(5)
    return [rng.random((h, w, 3), dtype=np.float32) for h, w in ((3, 5), (1, 1), (8, 2), (1, 7))]


def reference(picture, uv) -> np.ndarray:
    """Bilinear over a picture that repeats, float64; v counts from the bottom row."""
    h, w, _ = picture.shape
    x = uv[:, 0].astype(np.float64) * w - 0.5
    y = (1.0 - uv[:, 1].astype(np.float64)) * h - 0.5
    x0, y0 = np.floor(x).astype(int), np.floor(y).astype(int)
    fx, fy = (x - x0)[:, None], (y - y0)[:, None]
    at = lambda r, c: picture[r % h, c % w].astype(np.float64)  # noqa: E731
    return (1 - fy) * ((1 - fx) * at(y0, x0) + fx * at(y0, x0 + 1)) + fy * (
        (1 - fx) * at(y0 + 1, x0) + fx * at(y0 + 1, x0 + 1)
    )


@pytest.mark.parametrize("index", range(4))
def test_bilinear_with_repeat(index):
    textures = pictures()
    uv = np.random.default_rng(6).uniform(-3.0, 3.0, (5000, 2)).astype(np.float32)
    np.testing.assert_allclose(
        look_up(build_texture_atlas(textures), index, uv), reference(textures[index], uv), atol=2e-5
    )


def test_texel_centres_return_texels_and_row_0_is_on_top():
    textures = pictures()
    picture = textures[0]
    atlas = build_texture_atlas(textures)
    h, w, _ = picture.shape
    for row in range(h):
        uv = [[(c + 0.5) / w, 1.0 - (row + 0.5) / h] for c in range(w)]
        np.testing.assert_allclose(look_up(atlas, 0, uv), picture[row], atol=1e-6)


def test_seam_is_continuous():
    atlas = build_texture_atlas(pictures())
    tiny = 1e-6
    a = look_up(atlas, 0, [[0.0, 0.3], [1.0, 0.3], [-tiny, 0.3], [1.0 - tiny, 0.3], [0.4, 0.0], [0.4, 1.0]])
    np.testing.assert_allclose(a[1:4], np.tile(a[0], (3, 1)), atol=2e-5)
    np.testing.assert_array_equal(a[4], a[5])


def test_flat_picture_is_exact():
    flat = np.full((4, 6, 3), np.float32([0.1, 0.7, 0.3]))
    uv = np.random.default_rng(7).uniform(-2, 2, (2000, 2))
    np.testing.assert_array_equal(look_up(build_texture_atlas([flat]), 0, uv), np.tile(flat[0, 0], (2000, 1)))


def test_wild_coordinates_stay_inside():
    textures = pictures()
    atlas = build_texture_atlas(textures)
    wild = [np.nan, np.inf, -np.inf, 1e30, -1e30, -1e-30, -1e-9, np.float32(1.0 - 2.0**-24), 1e8]
    uv = np.stack(np.meshgrid(wild, wild), axis=-1).reshape(-1, 2)
    for index, picture in enumerate(textures):
        got = look_up(atlas, index, uv)
        assert np.isfinite(got).all()
        low, high = picture.min(axis=(0, 1)), picture.max(axis=(0, 1))
        assert (got >= low - 1e-6).all() and (got <= high + 1e-6).all()


def test_no_texture_is_white():
    np.testing.assert_array_equal(look_up(build_texture_atlas([]), -1, [[0.3, 0.4]]), [[1.0, 1.0, 1.0]])


def test_atlas_refuses_what_it_cannot_hold():
    with pytest.raises(ValueError, match="texture 1: expected shape"):
        build_texture_atlas([np.zeros((2, 2, 3), np.float32), np.zeros((2, 2), np.float32)])
    bad = np.zeros((2, 2, 3), np.float32)
    bad[0, 1, 2] = np.nan
    with pytest.raises(ValueError, match="1 values are not finite"):
        build_texture_atlas([bad])
