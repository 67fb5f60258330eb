"""What the tables of a marker video tell a person, from a table written by hand."""

from __future__ import annotations

import pytest

from mrbatch.capture.marker_video.told import told


def table(**changes):
    pose = [[1.0, 0, 0, 0], [0, 1.0, 0, 0], [0, 0, 1.0, 0], [0, 0, 0, 1.0]]
    return {
        "camera": {
            "width": 200,
            "height": 100,
            "matrix": [[100.0, 0, 100], [0, 50.0, 50], [0, 0, 1]],
            "distortion": [0.0, 0.0],
        },
        "flags": {},
        "footage": {
            "width": 200,
            "height": 100,
            "float": False,
            "colour": {"bits": 10, "transfer": "bt709"},
        },
        "frame_rate": "30000/1001",
        "frames": [1, 2, 3],
        "gains": {str(n): [0.5, 0.5, 0.5] for n in (1, 2, 3)},
        "poses": {str(n): pose for n in (1, 2, 3)},
        "pose_report": {
            "source": "target",
            "frames": [{"frame": n, "rms_px": rms} for n, rms in ((1, 0.2), (2, 0.5), (3, 0.3))],
        },
    } | changes


def facts(**changes):
    return {name: text for name, text, _ in told(table(**changes)).facts}


def test_footage_lens_track_and_gain():
    found = facts()
    assert found["footage"] == "200 x 100, 10-bit bt709, 29.97 frames a second"
    # Half the width over the focal length is 1: 45 degrees to each side.
    assert found["lens"] == "90.0 x 90.0 degrees, without distortion"
    track = "3 of 3 frames have a camera, from the marker: median 0.3 px off, worst 0.5 px (frame 2)"
    assert found["camera track"] == track
    assert found["gain"] == "0.5" and "flagged frames" not in found
    assert told(table()).frames == {n: {"marker rms": (v, "px")} for n, v in ((1, 0.2), (2, 0.5), (3, 0.3))}


@pytest.mark.parametrize(
    ("changes", "name", "text"),
    [
        ({"flags": {"1": ["held"], "2": ["held", "poor-fit"]}}, "flagged frames", "2 held, 1 poor-fit"),
        (
            {"pose_report": {"source": "file"}},
            "camera track",
            "3 of 3 frames have a camera, from the poses given",
        ),
        ({"gains": {"1": [0.1, 0.2, 0.3]}}, "gain", "0.1, 0.2, 0.3"),
        ({"gains": {"1": [1.0] * 3, "2": [3.0] * 3, "3": [2.0] * 3}}, "gain", "one a frame, median 2"),
        ({"frame_rate": None}, "footage", "200 x 100, 10-bit bt709"),
    ],
)
def test_other_tables(changes, name, text):
    assert facts(**changes)[name] == text
