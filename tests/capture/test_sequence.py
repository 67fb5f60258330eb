"""Picture sequences: numbering, and values bit for bit against files written by other libraries."""

from __future__ import annotations

import cv2
import numpy as np
import OpenImageIO as oiio
import pytest

from mrbatch.capture.marker_video.sequence import find_sequence, picture_colour, read_picture
from mrbatch.capture.marker_video.settings import ColourSettings
from mrbatch.errors import InputError, Place
from mrbatch.kernels.transfer import from_linear
from mrbatch.scene.stored_picture import read_stored


def write_oiio(path, values, kind=None, names=None, **attributes):
    height, width, channels = values.shape
    kind = kind or {"float16": "half", "float32": "float"}.get(str(values.dtype), str(values.dtype))
    spec = oiio.ImageSpec(width, height, channels, kind)
    if names:
        spec.channelnames = names
    for name, value in attributes.items():
        if name == "chromaticities":
            spec.attribute(name, oiio.TypeDesc("float[8]"), value)
        elif name in ("x", "y", "full_x", "full_y", "full_width", "full_height"):
            setattr(spec, name, value)
        else:
            spec.attribute(name, value)
    out = oiio.ImageOutput.create(str(path))
    assert out.open(str(path), spec), out.geterror()
    assert out.write_image(values), out.geterror()
    out.close()
    return path


def read(path, settings=None):
    settings = settings or ColourSettings()
    colour, notes = picture_colour(read_stored(path), settings, Place(file=str(path)))
    return read_picture(path, colour, settings, 7), colour, notes


def touch(folder, *names):
    for name in names:
        (folder / name).write_bytes(b"x")


def test_patterns_number_by_name(tmp_path):
    touch(
        tmp_path,
        "photo_0008.png",
        "photo_0010.png",
        "photo_10000.png",
        "photo_12.png",
        "photo_linear_0009.png",
    )
    hashes = find_sequence([tmp_path / "photo_####.png"])
    assert hashes.numbers == (8, 10, 10000)
    assert find_sequence([tmp_path / "photo_%04d.png"]) == hashes
    assert hashes.path(10).name == "photo_0010.png"
    with pytest.raises(InputError, match="no picture for the frame"):
        hashes.path(9)
    assert find_sequence([tmp_path / "photo_%d.png"]).numbers == (12, 10000)
    star = find_sequence([tmp_path / "photo_*.png"])
    assert star.numbers == (8, 9, 10, 12, 10000)


def test_gaps_are_reported_by_the_sequences_own_step(tmp_path):
    touch(tmp_path, *(f"a{n:04d}.png" for n in (1001, 1002, 1004, 1005)))
    touch(tmp_path, *(f"b{n:04d}.png" for n in (0, 3, 6, 12)))
    assert find_sequence([tmp_path / "a####.png"]).missing == (1003,)
    assert find_sequence([tmp_path / "b####.png"]).missing == (9,)
    renumbered = find_sequence([tmp_path / "a####.png"], 1)
    assert renumbered.numbers == (1, 2, 4, 5)
    assert renumbered.missing == (3,)


def test_lists_keep_their_order(tmp_path):
    touch(tmp_path, "x1.png", "x3.png", "y2.png", "plain.png")
    files = [tmp_path / n for n in ("x1.png", "y2.png", "x3.png")]
    assert find_sequence(files).numbers == (1, 2, 3)
    backwards = find_sequence(files[::-1])
    assert backwards.numbers == (0, 1, 2)
    assert backwards.paths == tuple(files[::-1])
    assert find_sequence([tmp_path / "plain.png"], 1001).numbers == (1001,)


def test_wrong_patterns_are_refused(tmp_path):
    touch(tmp_path, "a_1.png", "a_01.png", "b_.png")
    for pattern, message in [
        ("a_*.png", "one number"),
        ("b_*.png", "no number"),
        ("c_####.png", "no file matches"),
        ("##_##.png", "more than one place"),
        ("none.png", "no such picture"),
        ("nowhere/##.png", "no such folder"),
    ]:
        with pytest.raises(InputError, match=message):
            find_sequence([tmp_path / pattern])


@pytest.mark.case("IO-03")
@pytest.mark.parametrize("suffix", ["png", "tif"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_integer_files_keep_their_codes(tmp_path, suffix, dtype):
    codes = np.random.default_rng(1).integers(0, np.iinfo(dtype).max + 1, (13, 17, 3)).astype(dtype)
    path = tmp_path / f"a.{suffix}"
    cv2.imwrite(str(path), codes[..., ::-1])
    picture, colour, notes = read(path)
    np.testing.assert_array_equal(picture.codes, codes)
    assert picture.codes.dtype == dtype
    assert (colour.transfer, colour.bits, notes) == ("srgb", 8 * np.dtype(dtype).itemsize, ())
    v = codes / np.iinfo(dtype).max
    truth = np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4)
    np.testing.assert_allclose(picture.linear, truth, rtol=1e-6, atol=1e-9)
    np.testing.assert_array_equal(from_linear(picture.linear, "srgb", colour.bits), codes)


def test_jpeg_is_as_another_decoder_gives_it(tmp_path):
    rng = np.random.default_rng(2)
    codes = cv2.resize(rng.integers(0, 256, (8, 10, 3)).astype(np.uint8), (100, 80))
    path = tmp_path / "a.jpg"
    cv2.imwrite(str(path), codes, [cv2.IMWRITE_JPEG_QUALITY, 95])
    np.testing.assert_array_equal(read(path)[0].codes, cv2.imread(str(path))[..., ::-1])


@pytest.mark.parametrize("orientation", range(1, 9))
def test_exif_orientation_is_applied(tmp_path, orientation):
    """Against OpenCV's decoder, which shows pictures upright; a smooth ramp survives JPEG."""
    ramp = np.add.outer(np.arange(40) * 3, np.arange(56)).astype(np.uint8)[..., None].repeat(3, 2)
    path = write_oiio(tmp_path / "a.jpg", ramp, Orientation=orientation)
    picture = read(path)[0]
    np.testing.assert_array_equal(picture.codes, cv2.imread(str(path))[..., ::-1])
    assert picture.flags == (("turned-by-exif",) if orientation > 1 else ())


@pytest.mark.case("IO-03")
@pytest.mark.parametrize("kind", [np.float16, np.float32])
def test_exr_is_linear_and_exact(tmp_path, kind):
    values = (np.random.default_rng(3).random((9, 12, 3)) * 100).astype(kind)
    values[0, 0] = [65504.0, 6e-8, 0.0]
    path = write_oiio(tmp_path / "a.exr", values, "half" if kind == np.float16 else "float")
    picture, colour, _ = read(path)
    np.testing.assert_array_equal(picture.linear, values.astype(np.float32))
    assert picture.codes is None
    assert colour.transfer == "linear"
    with pytest.raises(InputError, match="float pictures are scene-linear"):
        read(path, ColourSettings(transfer="srgb"))


def test_exr_windows_and_primaries(tmp_path):
    values = np.arange(4 * 5 * 3, dtype=np.float32).reshape(4, 5, 3)
    path = write_oiio(tmp_path / "w.exr", values, x=2, y=-1, full_x=0, full_y=0, full_width=6, full_height=5)
    picture = read(path)[0]
    assert picture.linear.shape == (5, 6, 3)
    np.testing.assert_array_equal(picture.linear[0:3, 2:6], values[1:4, 0:4])
    assert picture.linear[3:].max() == 0 and picture.linear[:, :2].max() == 0
    assert picture.flags == ("data-window-differs",)
    bt2020 = (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, 0.3127, 0.3290)
    path = write_oiio(tmp_path / "p.exr", np.ones((2, 2, 3), np.float32), chromaticities=bt2020)
    picture, colour, _ = read(path)
    np.testing.assert_allclose(picture.linear, 1.0, rtol=1e-6)
    assert colour.rec709_from_source[0][0] == pytest.approx(1.6605, abs=1e-4)  # ITU-R BT.2087
    rec709 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
    half = np.random.default_rng(0).random((4, 4, 3)).astype(np.float16)
    path = write_oiio(tmp_path / "q.exr", half, "half", chromaticities=rec709)
    np.testing.assert_array_equal(read(path)[0].linear, half.astype(np.float32))


def test_alpha_is_ignored_and_never_multiplied_in(tmp_path):
    codes = np.full((4, 5, 4), 200, np.uint8)
    codes[..., 3] = 10
    cv2.imwrite(str(tmp_path / "a.png"), codes)
    picture = read(tmp_path / "a.png")[0]
    assert np.all(picture.codes == 200)
    assert picture.flags == ("alpha-ignored",)


def test_grey_becomes_rgb_and_other_channels_are_refused(tmp_path):
    cv2.imwrite(str(tmp_path / "g.png"), np.arange(20, dtype=np.uint8).reshape(4, 5))
    picture = read(tmp_path / "g.png")[0]
    for c in range(3):
        np.testing.assert_array_equal(picture.codes[..., c], np.arange(20).reshape(4, 5))
    path = write_oiio(
        tmp_path / "l.exr", np.zeros((2, 2, 3), np.float32), names=["beauty.R", "beauty.G", "beauty.B"]
    )
    with pytest.raises(InputError, match="expected R, G, B"):
        read(path)
    swapped = np.dstack([np.full((2, 2), float(i), np.float32) for i in range(3)])
    path = write_oiio(tmp_path / "s.exr", swapped, names=["B", "G", "R"])
    np.testing.assert_array_equal(read(path)[0].linear[0, 0], [2, 1, 0])


@pytest.mark.case("IO-02")
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_values_that_are_no_light_are_named(tmp_path, bad):
    values = np.ones((6, 7, 3), np.float32)
    values[4, 2, 1] = values[5, 3, 0] = bad
    path = write_oiio(tmp_path / "n.exr", values)
    with pytest.raises(InputError, match="2 pixels hold NaN or infinity, the first at x 2, y 4") as caught:
        read(path)
    assert caught.value.place.frame == 7


def test_negative_light_is_clamped_and_flagged(tmp_path):
    values = np.full((2, 2, 3), 0.5, np.float32)
    values[1, 1, 2] = -0.01
    picture = read(write_oiio(tmp_path / "n.exr", values))[0]
    assert picture.linear[1, 1, 2] == 0.0
    assert picture.flags == ("negative-light-clamped",)


@pytest.mark.case("IO-08")
@pytest.mark.parametrize("name", ["a.png", "a.jpg", "a.tif", "a.exr"])
@pytest.mark.parametrize("keep", [0.0, 0.3, 0.9])
def test_cut_files_are_refused_with_their_frame(tmp_path, name, keep):
    rng = np.random.default_rng(4)
    if name.endswith("exr"):
        path = write_oiio(tmp_path / name, rng.random((64, 64, 3)).astype(np.float32))
    else:
        path = tmp_path / name
        cv2.imwrite(str(path), rng.integers(0, 256, (64, 64, 3)).astype(np.uint8))
    colour = picture_colour(read_stored(path), ColourSettings(), Place())[0]
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * keep)])
    with pytest.raises(InputError) as caught:
        read_picture(path, colour, ColourSettings(), 12)
    assert caught.value.place.frame == 12


@pytest.mark.parametrize("name", ["a.png", "a.jpg", "a.tif", "a.exr"])
def test_hostile_bytes_end_in_a_clear_error_or_a_picture(tmp_path, name):
    rng = np.random.default_rng(8)
    good = tmp_path / f"good_{name}"
    if name.endswith("exr"):
        write_oiio(good, rng.random((24, 24, 3)).astype(np.float32))
    else:
        cv2.imwrite(str(good), rng.integers(0, 256, (24, 24, 3)).astype(np.uint8))
    data = good.read_bytes()
    path = tmp_path / name
    for trial in range(60):
        broken = bytearray(data)
        span = len(broken) if trial % 2 else min(len(broken), 128)  # headers more often than pixels
        for at in rng.integers(0, span, 1 + trial % 5):
            broken[at] = rng.integers(0, 256)
        path.write_bytes(broken[: rng.integers(1, len(broken))] if trial % 7 == 0 else broken)
        try:
            picture, _, _ = read(path)
        except InputError:
            continue
        assert np.isfinite(picture.linear).all() and picture.linear.min() >= 0.0


def test_a_sequence_is_encoded_alike(tmp_path):
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((4, 4, 3), np.uint8))
    cv2.imwrite(str(tmp_path / "b.png"), np.zeros((4, 4, 3), np.uint16))
    colour = read(tmp_path / "a.png")[1]
    with pytest.raises(InputError, match="encoded otherwise"):
        read_picture(tmp_path / "b.png", colour, ColourSettings(), 1)
    chosen = read(tmp_path / "a.png", ColourSettings(transfer="bt709", primaries="bt2020"))[1]
    assert (chosen.transfer, chosen.primaries) == ("bt709", "bt2020")


@pytest.mark.data
def test_the_real_desk_pictures(shared_data):
    folder = shared_data / "markers" / "mitsuba_desk_window"
    if not folder.is_dir():
        pytest.skip("the desk set is absent")
    assert find_sequence([folder / "photo_####.png"]).numbers == (0, 1, 2, 3, 4, 5)
    linear = find_sequence([folder / "photo_linear_####.exr"])
    assert linear.numbers == (0, 4)
    assert linear.missing == ()
    photo, _, _ = read(folder / "photo_0000.png")
    exact, _, _ = read(linear.path(0))
    # The PNG is the linear photo, noisy and in sRGB codes; dark and clipped pixels apart they agree.
    middle = (exact.linear > 0.05) & (exact.linear < 0.8)
    assert np.median(np.abs(photo.linear / exact.linear - 1.0)[middle]) < 0.03
