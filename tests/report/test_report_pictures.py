"""Reading pictures and drawing maps."""

from __future__ import annotations

import numpy as np
import OpenImageIO as oiio
import pytest

from mrbatch.errors import InputError
from mrbatch.metrics.noise import LEVELS
from mrbatch.report import pictures
from mrbatch.report.pictures import (
    data_uri,
    display_codes,
    magnitude_picture,
    map_scale,
    noise_picture,
    read_picture,
    signed_picture,
)


def write(path, values, names, *, window=None, full=None, kind="float"):
    height, width, channels = values.shape
    spec = oiio.ImageSpec(width, height, channels, kind)
    spec.channelnames = names
    if window:
        spec.x, spec.y = window
    spec.full_width, spec.full_height = full or (width, height)
    out = oiio.ImageOutput.create(str(path))
    assert out.open(str(path), spec)
    assert out.write_image(np.ascontiguousarray(values))
    out.close()
    return path


def test_exr_layers_and_windows(tmp_path):
    values = np.arange(6 * 8 * 8, dtype=np.float32).reshape(6, 8, 8)
    names = ("R", "G", "B", "A", "delta.R", "delta.G", "delta.B", "depth.Z")
    path = write(tmp_path / "a.exr", values, names, window=(16, 4), full=(100, 50))
    picture = read_picture(path)
    # OpenEXR keeps channels by name; OpenImageIO puts RGBA first again.
    np.testing.assert_array_equal(picture.values, values[..., :3])
    assert picture.origin == (16, 4) and picture.full_size == (100, 50)
    np.testing.assert_array_equal(read_picture(path, "delta").values, values[..., 4:7])
    np.testing.assert_array_equal(read_picture(path, "depth").values, values[..., 7:])
    with pytest.raises(InputError, match="no layer `virtual`") as caught:
        read_picture(path, "virtual")
    assert "delta.R" in str(caught.value)


def test_several_layers_are_read_at_once(tmp_path, monkeypatch):
    values = np.random.default_rng(2).random((6, 8, 8)).astype(np.float32)
    names = ("R", "G", "B", "A", "delta.R", "delta.G", "delta.B", "depth.Z")
    path = write(tmp_path / "a.exr", values, names)
    for together in (pictures.MAX_TOGETHER, 0):
        monkeypatch.setattr(pictures, "MAX_TOGETHER", together)
        found = pictures.read_layers(path, ["", "delta", "depth", "virtual"])
        assert set(found) == {"", "delta", "depth"}
        for layer, picture in found.items():
            np.testing.assert_array_equal(picture.values, read_picture(path, layer).values)


def test_what_is_not_read_does_not_count(tmp_path):
    names = tuple(f"{c}.{i}" for i in range(10) for c in "XYZ")
    path = write(tmp_path / "a.exr", np.ones((8, 8, 33), np.float32), ("R", "G", "B", *names))
    assert read_picture(path, max_values=8 * 8 * 3).values.shape == (8, 8, 3)


def test_pictures_are_reduced_by_area_averages():
    values = np.random.default_rng(4).random((60, 90, 1)).astype(np.float32)
    small = pictures.reduced(values, 30)
    expected = values.reshape(20, 3, 30, 3, 1).mean(axis=(1, 3))
    np.testing.assert_allclose(small, expected, rtol=1e-5)
    assert pictures.reduced(values, 90) is values


def test_codes_go_through_the_inverse_srgb_curve(tmp_path):
    codes = np.array([[[0, 10, 11], [128, 254, 255]]], np.uint8)
    path = write(tmp_path / "a.png", codes, ("R", "G", "B"), kind="uint8")
    s = codes / 255.0
    truth = np.where(s <= 0.04045, s / 12.92, ((s + 0.055) / 1.055) ** 2.4)
    np.testing.assert_allclose(read_picture(path).values, truth, rtol=1e-6)
    np.testing.assert_array_equal(display_codes(read_picture(path).values), codes)


def test_cutting_to_a_crop(tmp_path):
    values = np.random.default_rng(0).random((20, 30, 3), dtype=np.float32)
    full = read_picture(write(tmp_path / "f.exr", values, ("R", "G", "B")))
    crop = read_picture(
        write(tmp_path / "c.exr", values[5:15, 8:20], ("R", "G", "B"), window=(8, 5), full=(30, 20))
    )
    cut = full.cut_to(crop)
    assert cut is not None
    np.testing.assert_array_equal(cut.values, crop.values)
    assert crop.cut_to(full) is None


def test_bad_files_are_clear_errors(tmp_path):
    whole = write(tmp_path / "a.exr", np.ones((64, 64, 3), np.float32), ("R", "G", "B"))
    data = whole.read_bytes()
    (tmp_path / "cut.exr").write_bytes(data[: len(data) // 2])
    (tmp_path / "text.png").write_text("not a picture")
    for name in ("cut.exr", "text.png", "missing.exr"):
        with pytest.raises(InputError) as caught:
            read_picture(tmp_path / name)
        assert name in str(caught.value)
    with pytest.raises(InputError, match="announces 64x64"):
        read_picture(whole, max_values=64 * 64)


def test_maps_are_drawn_from_dark_to_pale_and_signed_around_grey():
    ramp = np.linspace(0, 1, 256)[None]
    magma = magnitude_picture(ramp, 1.0).astype(float)
    luminance = magma @ [0.2126, 0.7152, 0.0722]
    assert luminance[0, 0] < 5 and luminance[0, -1] > 220 and (np.diff(luminance[0]) > -1.5).all()
    assert magma[0, 128, 0] > magma[0, 128, 1]  # red over green: RGB, not BGR
    signed = signed_picture(np.array([[-2.0, -1.0, 0.0, 1.0, 2.0]]), 1.0)[0, :, 0]
    assert list(signed) == [0, 0, 128, 255, 255]
    assert (magnitude_picture(np.array([[np.nan]]), 1.0) == magnitude_picture(np.array([[1.0]]), 1.0)).all()
    assert tuple(display_codes(np.array([[[np.nan, 0, 0]]]))[0, 0]) == (255, 0, 255)


def test_a_map_of_noise_lies_over_the_picture():
    backdrop = np.full((20, 40, 3), 200, np.uint8)
    codes = np.zeros((3, 5), np.uint8)
    codes[:, 2:] = LEVELS
    codes[0, 4] = 1
    drawn = noise_picture(codes, 8, backdrop)
    assert drawn.shape == backdrop.shape
    grey = drawn[18, 2]
    assert grey[0] == grey[1] == grey[2] < 100  # nothing changed: the picture, dark and without colour
    assert drawn[18, 24].sum() > 550 and np.ptp(drawn[18, 24].astype(int)) > 30  # 100 %: pale magma
    assert drawn[1, 39].sum() < drawn[18, 39].sum() / 2  # 0.1 %: dark
    # Over a picture that was reduced to half, a block is half as large.
    half = noise_picture(codes, 4.0, backdrop[::2, ::2])
    assert np.abs(half.astype(int) - drawn[::2, ::2].astype(int)).mean() < 8
    one = noise_picture(np.full((1, 1), 30, np.uint8), 64, backdrop)
    assert (one == one[0, 0]).all()


def test_scale_is_not_set_by_a_firefly():
    values = np.ones((100, 100))
    values[3, 3] = 1e6
    assert map_scale(values) == 1.0
    assert map_scale(np.zeros((4, 4))) == 1.0
    lone = np.zeros((100, 100))
    lone[0, 0] = 5.0
    assert map_scale(lone) == 5.0


def test_embedded_pictures_keep_within_their_size():
    noise = np.random.default_rng(0).integers(0, 255, (1000, 1500, 3), dtype=np.uint8)
    assert len(data_uri(noise, max_bytes=60_000)) < 81_000
    assert data_uri(np.zeros((3, 2, 3), np.uint8)).startswith("data:image/png")
    assert data_uri(np.zeros((1, 5000, 3), np.uint8)).startswith("data:image/jpeg")
