"""Refusals of files say what the file is, in our words and not in a library's."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from mrbatch.capture.marker_video.video import build_frame_table
from mrbatch.errors import InputError
from mrbatch.film.exr import frame_metadata
from mrbatch.report.pictures import read_picture
from mrbatch.scene.environment import load_environment
from mrbatch.scene.file_kind import PICTURES, file_kind, unreadable

LIBRARY_WORDS = ("OpenImageIO", "EXR_ERR", "EXR Error", "Invalid data found", "scanline")


@pytest.fixture
def files(tmp_path):
    picture = np.random.default_rng(0).integers(0, 255, (60, 80, 3), dtype=np.uint8)
    cv2.imwrite(str(tmp_path / "good.png"), picture)
    cv2.imwrite(str(tmp_path / "good.hdr"), picture.astype(np.float32))
    (tmp_path / "empty").write_bytes(b"")
    (tmp_path / "text").write_text("camera: grüße\n" * 400, encoding="utf-8")
    (tmp_path / "noise").write_bytes(bytes(range(128, 256)) * 10)
    (tmp_path / "cut").write_bytes((tmp_path / "good.png").read_bytes()[:400])
    (tmp_path / "movie").write_bytes(b"\0\0\0\x20ftypisom" + bytes(100))
    (tmp_path / "exr").write_bytes(b"\x76\x2f\x31\x01\x02\0\0\0" + bytes(100))
    return tmp_path


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("good.png", "PNG"),
        ("good.hdr", "HDR"),
        ("empty", "empty"),
        ("text", "text"),
        ("noise", ""),
        ("movie", "MP4"),
        ("nowhere", ""),
    ],
)
def test_kinds(files, name, kind):
    assert file_kind(files / name) == kind


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("empty", "not a picture: the file is empty"),
        ("text", "not a picture but text"),
        ("noise", "not a picture, or it is damaged"),
        ("movie", "not a picture but an MP4 file"),
        ("cut", "begins as a PNG file but is damaged or cut short"),
    ],
)
def test_what_is_said(files, name, words):
    error = unreadable(files / name, "a picture", PICTURES)
    assert words in error.message and error.hint and str(files / name) in str(error)


READERS = {
    "picture": read_picture,
    "frame": frame_metadata,
    "environment": load_environment,
}


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize("name", ["empty", "text", "noise", "movie", "cut", "exr"])
def test_readers_speak_in_our_words(files, reader, name):
    with pytest.raises(InputError) as caught:
        READERS[reader](files / name)
    assert not [word for word in LIBRARY_WORDS if word in str(caught.value)], str(caught.value)
    assert caught.value.hint
    if name == "text":
        assert "but text" in caught.value.message


@pytest.mark.parametrize("name", ["empty", "text", "noise", "movie"])
def test_videos_too(files, name):
    path = (files / name).rename(files / f"{name}.mp4")
    with pytest.raises(InputError) as caught:
        build_frame_table(path)
    assert not [word for word in LIBRARY_WORDS if word in str(caught.value)], str(caught.value)
    assert caught.value.hint


def test_a_picture_with_missing_rows(files):
    import OpenImageIO as oiio

    values = np.random.default_rng(1).random((64, 64, 3), dtype=np.float32)
    out = oiio.ImageOutput.create("a.exr")
    assert out.open(str(files / "a.exr"), oiio.ImageSpec(64, 64, 3, "float")) and out.write_image(values)
    out.close()
    data = (files / "a.exr").read_bytes()
    (files / "a.exr").write_bytes(data[: len(data) // 2])
    for reader in (read_picture, load_environment):
        with pytest.raises(InputError, match="damaged or cut short") as caught:
            reader(files / "a.exr")
        assert not [word for word in LIBRARY_WORDS if word in str(caught.value)]
