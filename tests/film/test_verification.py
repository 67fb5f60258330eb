"""Reading a written frame back: of any size, a few rows at a time, and nothing may be missing."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest

from mrbatch.errors import InputError
from mrbatch.film import exr, layers, verification
from mrbatch.film.exr import FrameImage, ViewImage, read_frame, write_frame
from mrbatch.film.verification import verify_frame
from mrbatch.film.window import Window


def write(path, *views, height=200, spoil=None, window=None):
    content = {}
    for view in views:
        channels = layers.empty(["composite", "depth"], height, 24)
        if spoil is not None:
            channels["depth.Z"][spoil] = np.float32(7.0)
        content[view] = ViewImage(channels)
    write_frame(path, FrameImage(1, content, (24, height), window=window))
    return tuple(channels)


@pytest.mark.parametrize("rows", [1, 7, 64, 1000])
def test_every_row_of_every_view_is_read(tmp_path, monkeypatch, rows):
    monkeypatch.setattr(verification, "ROWS", rows)
    path = tmp_path / "f.exr"
    names = write(path, "left", "right")
    digest = verify_frame(path, names, ("left", "right"))
    assert digest == hashlib.sha256(path.read_bytes()).hexdigest()
    for keep in (0.5, 0.9, 0.99):
        (tmp_path / "cut.exr").write_bytes(path.read_bytes()[: int(keep * path.stat().st_size)])
        with pytest.raises(InputError):
            verify_frame(tmp_path / "cut.exr", names, ("left", "right"))


@pytest.mark.parametrize("row", [0, 63, 64, 199])
def test_a_number_that_is_none_is_found_wherever_it_is(tmp_path, row):
    """The writer refuses it, so it is put into the file afterwards: 7.0 becomes infinity."""
    path = tmp_path / "f.exr"
    image = {"": ViewImage(layers.empty(["composite", "depth"], 200, 24))}
    image[""].channels["depth.Z"][row, 5] = 7.0
    write_frame(path, FrameImage(1, image, (24, 200), compression="none"))
    data = path.read_bytes()
    seven, infinity = np.float32(7.0).tobytes(), np.float32(np.inf).tobytes()
    assert data.count(seven) == 1
    path.write_bytes(data.replace(seven, infinity))
    with pytest.raises(InputError, match="NaN or infinity"):
        verify_frame(path)


def test_windows_off_the_origin(tmp_path):
    path = tmp_path / "f.exr"
    channels = layers.empty(["composite"], 70, 24)
    write_frame(path, FrameImage(1, {"": ViewImage(channels)}, (24, 60), window=Window(-3, -5, 24, 70)))
    verify_frame(path, channels, ("",))


def test_no_frame_is_too_large_for_its_own_writer(tmp_path, monkeypatch):
    """Files of others are read up to a limit; at 8K with all layers, ours are beyond it."""
    monkeypatch.setattr(exr, "MAX_VALUES", 1000)
    path = tmp_path / "f.exr"
    names = write(path, "")
    with pytest.raises(InputError, match="limit"):
        read_frame(path, max_values=exr.MAX_VALUES)
    verify_frame(path, names, ("",))


def test_what_is_missing_is_named(tmp_path):
    path = tmp_path / "f.exr"
    names = write(path, "left", "right")
    with pytest.raises(InputError, match=r"motion\.X are missing"):
        verify_frame(path, (*names, "motion.X"))
    with pytest.raises(InputError, match="views"):
        verify_frame(path, names, ("left",))
    with pytest.raises(InputError, match="views"):
        verify_frame(path, names, ("left", "right", "centre"))
