"""Previews: untouched pixels keep their codes, sheets hold every frame, movies are tagged and complete."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from mrbatch.errors import ResourceError
from mrbatch.film.composite import composite
from mrbatch.film.preview import ContactSheet, MoviePreview, preview_codes, write_picture
from mrbatch.kernels.transfer import to_linear


def read(path):
    import cv2

    return cv2.imread(str(path), cv2.IMREAD_COLOR)[..., ::-1]


@pytest.mark.parametrize("transfer", ["srgb", "bt709", "bt1886", "gamma22", "gamma28"])
@pytest.mark.parametrize("stored", [np.float32, np.float16])
def test_untouched_pixels_keep_their_codes(tmp_path, transfer, stored):
    codes = np.stack([np.arange(256), np.arange(256)[::-1], np.arange(256)], axis=-1).astype(np.uint8)[None]
    B = to_linear(codes, transfer, 8)
    zero = np.zeros_like(B)
    D = zero.copy()
    D[0, 100] = 0.1
    C = composite(zero, zero[..., 0], B, D).astype(stored).astype(np.float32)
    write_picture(tmp_path / "p.png", preview_codes(C, transfer))
    got = read(tmp_path / "p.png")
    same = np.all(got == codes, axis=-1)[0]
    assert not same[100] and same.sum() == 255
    assert [p.name for p in tmp_path.iterdir()] == ["p.png"]


def test_captures_that_screens_cannot_show_go_through_srgb():
    linear = np.full((1, 1, 3), 0.2158605, np.float32)
    for transfer in ("linear", "pq", "hlg", "srgb"):
        assert preview_codes(linear, transfer)[0, 0, 0] == 128
    assert preview_codes(linear, "srgb", exposure=0.5)[0, 0, 0] == round(
        255 * (1.055 * (0.2158605 / 2) ** (1 / 2.4) - 0.055)
    )
    assert preview_codes(np.array([[[np.nan, -1.0, 9.0]]]), "srgb").tolist() == [[[0, 0, 255]]]


def test_jpeg_is_close(tmp_path):
    y, x = np.mgrid[0:48, 0:64]
    codes = np.stack([x * 4, y * 5, x + y], axis=-1).astype(np.uint8)
    write_picture(tmp_path / "p.jpg", codes)
    assert np.abs(read(tmp_path / "p.jpg").astype(int) - codes).mean() < 4


def test_pictures_in_unwritable_places(tmp_path):
    codes = np.zeros((2, 2, 3), np.uint8)
    with pytest.raises(ResourceError) as caught:
        write_picture(tmp_path / "absent" / "p.png", codes)
    assert caught.value.exit_code == 5
    with pytest.raises(ValueError, match="png"):
        write_picture(tmp_path / "p.tif", codes)


def plain(colour, height=90, width=160):
    return np.full((height, width, 3), colour, np.uint8)


def test_sheet_shows_every_frame_once():
    sheet = ContactSheet("a shot", width=80)
    colours = [(10 * i + 60, 255 - 10 * i, 40) for i in range(7)]
    for i, colour in enumerate(colours):
        sheet.add(1001 + i, plain(colour), f"{i / 25:.2f} s")
    picture = sheet.draw()
    assert sheet.numbers == tuple(range(1001, 1008))
    for colour in colours:
        assert np.all(picture == colour, axis=-1).sum() == 80 * 45
    light = np.all(picture > 200, axis=-1)
    assert light.sum() > 100, "numbers are written"


def test_long_shots_are_thinned_evenly():
    sheet = ContactSheet(width=8, limit=10)
    for i in range(100):
        sheet.add(i, plain((0, 0, 0), 4, 8))
    steps = set(np.diff(sheet.numbers))
    assert len(steps) == 1 and 5 <= len(sheet.numbers) <= 10 and sheet.numbers[0] == 0


def test_sheet_of_mixed_sizes_and_long_notes(tmp_path):
    sheet = ContactSheet("Übung · ﬁn", width=60)
    sheet.add(1, plain((200, 0, 0), 1, 1), "x" * 200)
    sheet.add(2, plain((0, 200, 0), 300, 20))
    sheet.write(tmp_path / "s.png")
    assert read(tmp_path / "s.png").shape == sheet.draw().shape
    with pytest.raises(ValueError, match="frame"):
        ContactSheet().draw()


def movie_frames(path):
    import av

    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        context = stream.codec_context
        tags = (context.color_range, context.colorspace, context.color_primaries, context.color_trc)
        return [(float(f.pts * f.time_base), f) for f in container.decode(stream)], tags, stream


COLOURS = [(200, 30, 40), (20, 180, 60), (128, 128, 128), (255, 255, 255), (0, 0, 0), (30, 40, 220)]


@pytest.mark.parametrize("codec", ["auto", "mpeg4"])
@pytest.mark.parametrize(("height", "width"), [(64, 96), (61, 95)])
def test_movie_is_complete_and_tagged(tmp_path, codec, height, width):
    rate = Fraction(30000, 1001)
    with MoviePreview(tmp_path / "m.mp4", rate, transfer="srgb", codec=codec) as movie:
        for colour in COLOURS:
            movie.add(plain(colour, height, width))
            assert not (tmp_path / "m.mp4").exists()
    assert [p.name for p in tmp_path.iterdir()] == ["m.mp4"]
    frames, tags, stream = movie_frames(tmp_path / "m.mp4")
    assert len(frames) == len(COLOURS) and stream.average_rate == rate
    np.testing.assert_allclose([t for t, _ in frames], np.arange(6) / float(rate), atol=1e-4)
    assert (stream.width, stream.height) == (width + width % 2, height + height % 2)
    if movie.codec == "libx264":
        assert tuple(int(t) for t in tags) == (1, 1, 1, 13)
    for (_, frame), (r, g, b) in zip(frames, COLOURS, strict=True):
        y, u, v = (np.asarray(p)[: p.line_size * p.height].reshape(p.height, -1)[8, 8] for p in frame.planes)
        # Rec.709 luma and chroma in limited range (ITU-R BT.709-6, items 3.2 to 3.5).
        luma = (0.2126 * r + 0.7152 * g + 0.0722 * b) / 255
        expected = (
            16 + 219 * luma,
            128 + 224 * (b / 255 - luma) / 1.8556,
            128 + 224 * (r / 255 - luma) / 1.5748,
        )
        np.testing.assert_allclose((int(y), int(u), int(v)), expected, atol=2.5 if codec == "auto" else 6)


def test_movie_that_fails_leaves_nothing(tmp_path):
    with pytest.raises(RuntimeError), MoviePreview(tmp_path / "m.mp4", Fraction(25)) as movie:
        movie.add(plain((1, 2, 3)))
        raise RuntimeError
    assert not list(tmp_path.iterdir())
    with pytest.raises(ValueError, match="movie of"), MoviePreview(tmp_path / "m.mp4", Fraction(25)) as movie:
        movie.add(plain((1, 2, 3)))
        movie.add(plain((1, 2, 3), 10, 10))
    assert not list(tmp_path.iterdir())
    with MoviePreview(tmp_path / "m.mp4", Fraction(25)):
        pass
    assert not list(tmp_path.iterdir()), "no frames, no file"


def test_movie_in_an_unwritable_place(tmp_path):
    with (
        pytest.raises(ResourceError, match="No such file"),
        MoviePreview(tmp_path / "absent" / "m.mp4", Fraction(25)) as movie,
    ):
        movie.add(plain((1, 2, 3)))
