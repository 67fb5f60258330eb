"""`mrbatch info` on frames and on what is none."""

from __future__ import annotations

import json
from fractions import Fraction

import numpy as np
import pytest
from click.testing import CliRunner

from mrbatch.cli import main
from mrbatch.cli.info import command
from mrbatch.errors import InputError
from mrbatch.film import layers
from mrbatch.film.exr import FrameImage, ViewImage, write_frame
from mrbatch.film.window import Window
from mrbatch.scene.camera import Camera


@pytest.fixture
def frame(tmp_path):
    channels = layers.empty(["virtual", "depth", "samples"], 3, 4)
    camera = Camera(8, 6, np.diag([9.0, 9.0, 1.0]), np.zeros(8), np.eye(4))
    path = tmp_path / "desk.1001.exr"
    image = FrameImage(
        1001,
        {"": ViewImage(channels, camera)},
        (8, 6),
        Window(2, 1, 4, 3),
        frames_per_second=Fraction(25),
        owner="Jane Doe",
        metadata={
            "plan": {"shadow": "needed"},
            "seed": 7,
            "time": 0.2,
            "influence": {"": "9 of 12 tiles"},
            "flags": [],
        },
    )
    write_frame(path, image)
    return path


def test_a_person_reads_it(frame):
    result = CliRunner().invoke(command, [str(frame)], catch_exceptions=False)
    assert result.exit_code == 0
    words = " ".join(result.output.split())
    for piece in (
        "desk.1001.exr",
        "size 8 x 6",
        "4 x 3 from (2, 1), a crop",
        "compression zip",
        "RGBA half",
        "virtual.RGBA half",
        "depth.Z float",
        "samples float",
        "Jane Doe",
        "worldToCamera",
        'plan {"shadow": "needed"}',
        "seed 7",
        "frame 1001",
        "time 0.2 s of the footage",
        "influence 9 of 12 tiles",
        "flags none",
    ):
        assert piece in words, piece


def test_a_program_reads_it(frame):
    one = json.loads(CliRunner().invoke(command, [str(frame), "--json"]).output)
    assert one["file"] == str(frame) and one["bytes"] == frame.stat().st_size
    assert one["parts"][0]["window"] == [2, 1, 4, 3] and one["parts"][0]["mrbatch"]["seed"] == 7
    two = json.loads(CliRunner().invoke(command, [str(frame), str(frame), "--json"]).output)
    assert two == [one, one]


def test_views_and_foreign_files(tmp_path, frame):
    import OpenImageIO as oiio

    views = {name: ViewImage(layers.empty([], 2, 2)) for name in ("left", "right")}
    write_frame(tmp_path / "stereo.exr", FrameImage(1, views, (2, 2)))
    output = CliRunner().invoke(command, [str(tmp_path / "stereo.exr")], catch_exceptions=False).output
    assert "part left" in output and "part right" in output
    # A file of another program, with text under our prefix that is no JSON.
    spec = oiio.ImageSpec(2, 2, 1, "half")
    spec.channelnames = ("Y",)
    spec.attribute("mrbatch/odd", "{no json")
    out = oiio.ImageOutput.create("openexr")
    assert out.open(str(tmp_path / "y.exr"), spec)
    assert out.write_image(np.zeros((2, 2, 1), np.float32)) and out.close()
    output = CliRunner().invoke(command, [str(tmp_path / "y.exr")], catch_exceptions=False).output
    assert "Y" in output and "{no json" in output


def test_what_is_no_frame_is_an_input_error(tmp_path, frame):
    other = tmp_path / "notes.exr"
    other.write_text("no picture")
    for path in (other, tmp_path / "absent.exr", tmp_path):
        result = CliRunner().invoke(command, [str(path)])
        assert isinstance(result.exception, InputError) and str(path) in str(result.exception)
        assert main([("info"), str(path)], standalone_mode=False) == 3
    png = tmp_path / "p.png"
    import cv2

    cv2.imwrite(str(png), np.zeros((2, 2, 3), np.uint8))
    assert "png" in str(CliRunner().invoke(command, [str(png)]).exception)


def test_a_folder_is_told_what_to_do(tmp_path, frame):
    message = str(CliRunner().invoke(command, [str(tmp_path)]).exception)
    assert "this is a folder" in message and f"`mrbatch info {frame}`" in message
    (tmp_path / "job.json").write_text("{}")
    assert f"`mrbatch report {tmp_path}`" in str(CliRunner().invoke(command, [str(tmp_path)]).exception)
