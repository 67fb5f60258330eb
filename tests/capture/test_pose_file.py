"""Pose files: layouts, exact round trip, and poses that are none."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest

from mrbatch.capture.marker_video.pose_file import load_poses, save_poses
from mrbatch.errors import InputError


def _pose(seed: int) -> np.ndarray:
    random = np.random.default_rng(seed)
    pose = np.eye(4)
    pose[:3, :3] = cv2.Rodrigues(random.normal(size=3))[0]
    pose[:3, 3] = random.normal(size=3)
    return pose


def test_round_trip(tmp_path):
    poses = {7: _pose(1), 3: _pose(2)}
    save_poses(tmp_path / "poses.json", poses)
    read = load_poses(tmp_path / "poses.json")
    assert list(read) == [3, 7]
    for number, pose in poses.items():
        np.testing.assert_allclose(read[number], pose, rtol=0, atol=4e-16 * 4)


def test_opencv_layout_is_camera_from_world(tmp_path):
    pose = _pose(3)
    inverse = np.linalg.inv(pose)
    entry = {"rvec": cv2.Rodrigues(inverse[:3, :3])[0].ravel().tolist(), "tvec": inverse[:3, 3].tolist()}
    (tmp_path / "p.json").write_text(json.dumps({"poses": [entry, entry | {"frame": 5}]}))
    read = load_poses(tmp_path / "p.json")
    assert list(read) == [0, 5]
    np.testing.assert_allclose(read[5], pose, atol=1e-12)


def test_list_of_matrices_by_index(tmp_path):
    poses = [_pose(4), _pose(5)]
    (tmp_path / "p.json").write_text(json.dumps({"world_from_camera": [p.tolist() for p in poses]}))
    np.testing.assert_allclose(load_poses(tmp_path / "p.json")[1], poses[1], atol=1e-14)


def _entry(pose, frame=4):
    return [
        {"frame": 0, "world_from_camera": np.eye(4).tolist()},
        {"frame": frame, "world_from_camera": pose},
    ]


SCALED = (np.diag([1.001, 1.001, 1.001, 1.0])).tolist()
MIRROR = np.diag([-1.0, 1.0, 1.0, 1.0]).tolist()
TRANSPOSED = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [1, 2, 3, 1]]


@pytest.mark.parametrize(
    ("content", "message", "frame"),
    [
        (_entry(SCALED), "orthonormal", 4),
        (_entry(MIRROR), "mirror", 4),
        (_entry(TRANSPOSED), "last row", 4),
        (_entry([[1, 2], [3, 4]]), "shape", 4),
        (_entry([["a"]]), "not a matrix", 4),
        (_entry(np.full((4, 4), np.nan).tolist()), "NaN", 4),
        (_entry(np.eye(4).tolist(), frame=0), "two poses", 0),
        ([{"frame": 2, "rvec": [0, 0, 0]}], "neither", 2),
        ([{"frame": 2, "rvec": [0, 0], "tvec": [0, 0, 0]}], "three finite", 2),
        ([{"frame": "2"}], "whole number", None),
        ([], "empty", None),
        ({"camera": 1}, "no poses", None),
    ],
)
def test_bad_poses_name_the_frame(tmp_path, content, message, frame):
    (tmp_path / "p.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match=message) as caught:
        load_poses(tmp_path / "p.json")
    assert caught.value.place.frame == frame


def test_unreadable(tmp_path):
    with pytest.raises(InputError, match="does not exist"):
        load_poses(tmp_path / "p.json")
    (tmp_path / "p.json").write_text("[")
    with pytest.raises(InputError, match="cannot be read"):
        load_poses(tmp_path / "p.json")
