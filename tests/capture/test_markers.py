"""Finding targets: rendered pictures of known geometry, wrong dictionaries, doubles, damage."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from pydantic import ValidationError
from rendered_marker import board_page, look_at, marker_page, photograph, render

from mrbatch.capture.marker_video.calibration import make_calibration
from mrbatch.capture.marker_video.markers import (
    TargetDetector,
    marker_bits,
    marker_corners,
    opencv_board,
    other_dictionaries,
)
from mrbatch.capture.marker_video.target_settings import DICTIONARY_SIZES, TargetSettings

SIZE = (320, 240)
K = np.array([[400.0, 0.0, 160.0], [0.0, 400.0, 120.0], [0.0, 0.0, 1.0]])
"""Pixel centres at half integers."""


def _calibration(distortion=None):
    return make_calibration(K, distortion, *SIZE, pixel_centres="half")


def _marker(dictionary="DICT_4X4_50", marker=7, side="60 mm"):
    return TargetSettings.model_validate({"marker": {"dictionary": dictionary, "id": marker, "side": side}})


def _truth(points, pose, distortion=None):
    inverse = np.linalg.inv(pose)
    d = np.zeros(5) if distortion is None else np.asarray(distortion)
    pixels = cv2.projectPoints(points, cv2.Rodrigues(inverse[:3, :3])[0], inverse[:3, 3], K, d)[0]
    return pixels.reshape(-1, 2)


@pytest.mark.parametrize("dictionary", ["DICT_4X4_50", "DICT_6X6_250", "tag36h11"])
@pytest.mark.parametrize("blur", [0.0, 1.5])
def test_corners_of_a_rendered_marker(dictionary, blur):
    target = _marker(dictionary)
    page, metres = marker_page(target.dictionary, 7, 0.06)
    pose = look_at([0.1, -0.2, 0.22], roll=0.3)
    picture = photograph(render(page, metres, K, pose, SIZE), blur=blur)
    found = TargetDetector(target, _calibration()).detect(picture)
    assert found.ids.tolist() == [7] * 4
    np.testing.assert_array_equal(found.points_3d, marker_corners(0.06))
    # half a pixel of offset, or the transfer function ignored, is far beyond this
    assert np.abs(found.points_2d - _truth(found.points_3d, pose)).max() < 0.1
    assert np.sqrt(np.diag(found.covariance)).max() < 0.1


@pytest.mark.slow
def test_stated_corner_covariance_is_true():
    """Fits of many noise patterns scatter as the covariance says, and have no bias beyond it."""
    page, metres = marker_page("DICT_4X4_50", 7, 0.06)
    pose = look_at([0.05, -0.15, 0.25])
    linear = render(page, metres, K, pose, SIZE, samples=8)
    detector = TargetDetector(_marker(), _calibration())
    found = [detector.detect(photograph(linear, noise=0.05, seed=s)) for s in range(40)]
    points = np.array([f.points_2d for f in found])
    stated = np.sqrt(np.mean([np.diag(f.covariance) for f in found]))
    scatter = np.sqrt(points.var(axis=0, ddof=1).mean())
    assert 0.6 < scatter / stated < 1.5
    assert np.abs(points.mean(axis=0) - _truth(marker_corners(0.06), pose)).max() < 2 * stated


@pytest.mark.case("MRK-07")
@pytest.mark.parametrize("k1", [-0.4, 0.4])
def test_lens_distortion_at_the_rim(k1):
    distortion = [k1, 0.0, 0.0, 0.0, 0.0]
    page, metres = marker_page("DICT_4X4_50", 7, 0.06, page=1.6)
    pose = look_at([0.07, -0.042, 0.3], target=[0.07, -0.042, 0.0])
    picture = photograph(render(page, metres, K, pose, SIZE, distortion=distortion, samples=6))
    found = TargetDetector(_marker(), _calibration(distortion)).detect(picture)
    truth = _truth(marker_corners(0.06), pose, distortion)
    assert len(found) == 4
    assert np.abs(found.points_2d - truth).max() < 0.1


def test_sixteen_bits_and_linear_floats_give_the_same_corners():
    page, metres = marker_page("DICT_4X4_50", 7, 0.06)
    pose = look_at([0.1, -0.1, 0.25])
    linear = render(page, metres, K, pose, SIZE)
    detector = TargetDetector(_marker(), _calibration())
    eight = photograph(linear, noise=0.0)
    a = detector.detect(eight).points_2d
    b = detector.detect(eight.astype(np.uint16) * 257).points_2d
    c = detector.detect(0.13 * linear).points_2d
    assert np.abs(a - b).max() < 1e-4
    assert np.abs(a - c).max() < 0.03


@pytest.mark.parametrize("legacy", [False, True])
@pytest.mark.parametrize("squares", [(7, 5), (5, 4)])
def test_charuco_frame_is_centred_x_right_y_up(squares, legacy):
    settings = {
        "type": "charuco",
        "squares": list(squares),
        "square": "30 mm",
        "marker": "22 mm",
        "dictionary": "DICT_4X4_50",
        "legacy": legacy,
        "first_id": 5,
    }
    target = TargetSettings.model_validate({"board": settings})
    board = cv2.aruco.CharucoBoard(
        squares,
        0.03,
        0.022,
        cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50),
        ids=np.arange(5, 5 + squares[0] * squares[1] // 2),
    )
    board.setLegacyPattern(legacy)
    page, metres = board_page(board, 0.03, pixels=60)
    found = TargetDetector(target).detect(np.where(page > 0, 230, 20).astype(np.uint8))
    assert len(found) == (squares[0] - 1) * (squares[1] - 1)
    height, width = page.shape
    expected = metres * np.column_stack(
        [found.points_2d[:, 0] - 0.5 * width, 0.5 * height - found.points_2d[:, 1]]
    )
    # 0.75 mm would be half a picture pixel
    np.testing.assert_allclose(found.points_3d[:, :2], expected, atol=0.1 * metres)
    assert not found.points_3d[:, 2].any()


@pytest.mark.slow
def test_grid_board():
    settings = {
        "type": "grid",
        "squares": [3, 2],
        "marker": "30 mm",
        "separation": "10 mm",
        "dictionary": "DICT_5X5_100",
        "first_id": 2,
    }
    target = TargetSettings.model_validate({"board": settings})
    board = opencv_board(target.board)
    drawn = np.pad(board.generateImage((440, 280)), 40, constant_values=255)
    found = TargetDetector(target).detect(drawn)
    assert sorted(set(found.ids.tolist())) == [2, 3, 4, 5, 6, 7]
    expected = np.column_stack([found.points_2d[:, 0] - 260, 180 - found.points_2d[:, 1]]) * 0.11 / 440
    np.testing.assert_allclose(found.points_3d[:, :2], expected, atol=0.15e-3)


def test_half_hidden_charuco_falls_back_to_marker_corners():
    settings = {
        "type": "charuco",
        "squares": [5, 4],
        "square": "30 mm",
        "marker": "22 mm",
        "dictionary": "DICT_4X4_50",
    }
    target = TargetSettings.model_validate({"board": settings})
    # 90 pixels a square make 11 a cell: the drawing has no rounded edges
    page, metres = board_page(opencv_board(target.board), 0.03, pixels=90)
    drawn = np.where(page > 0, 230, 20).astype(np.uint8)
    drawn[:, 90 + 195 :] = 120
    found = TargetDetector(target).detect(drawn)
    assert len(found) >= 4
    expected = metres * np.column_stack(
        [found.points_2d[:, 0] - 0.5 * page.shape[1], 0.5 * page.shape[0] - found.points_2d[:, 1]]
    )
    np.testing.assert_allclose(found.points_3d[:, :2], expected, atol=0.2 * metres)


def _still(picture_page):
    return photograph(render(*picture_page, K, look_at([0.0, -0.05, 0.25]), SIZE))


@pytest.mark.case("MRK-05")
def test_wrong_dictionary_finds_nothing_and_the_right_one_is_named():
    picture = _still(marker_page("DICT_6X6_250", 33, 0.06))
    assert len(TargetDetector(_marker("DICT_4X4_50")).detect(picture)) == 0
    hints = other_dictionaries([picture], "DICT_4X4_50")
    assert next(iter(hints)).startswith("DICT_6X6")
    assert 33 in hints["DICT_6X6_50"] if "DICT_6X6_50" in hints else 33 in hints["DICT_6X6_100"]


@pytest.mark.case("MRK-05")
def test_mirrored_marker_is_none():
    picture = _still(marker_page("DICT_4X4_50", 7, 0.06))
    assert len(TargetDetector(_marker()).detect(np.ascontiguousarray(picture[:, ::-1]))) == 0


@pytest.mark.case("MRK-05")
def test_one_wrong_bit_is_repaired_and_listed():
    # 6X6_50 has a large distance between markers, so that a bit can be repaired
    page, metres = marker_page("DICT_6X6_50", 7, 0.06)
    size = 16
    first = (page.shape[0] - 8 * size) // 2
    row, column = first + 3 * size, first + 4 * size
    page[row : row + size, column : column + size] = 1.0 - page[row : row + size, column : column + size]
    found = TargetDetector(_marker("DICT_6X6_50")).detect(_still((page, metres)))
    assert dict(found.repaired) == {7: 1}


def test_other_ids_are_not_taken():
    found = TargetDetector(_marker(marker=8)).detect(_still(marker_page("DICT_4X4_50", 7, 0.06)))
    assert len(found) == 0
    assert found.others == (7,)


@pytest.mark.case("MRK-06")
def test_marker_seen_twice_is_reported_with_both_places():
    page, metres = marker_page("DICT_4X4_50", 7, 0.06)
    pose = look_at([0.0, 0.0, 0.5])
    left, right = np.eye(4), np.eye(4)
    left[0, 3], right[0, 3] = -0.1, 0.1
    linear = render(page, metres, K, pose, SIZE, world_from_page=left)
    linear = render(page, metres, K, pose, SIZE, world_from_page=right, onto=linear)
    found = TargetDetector(_marker()).detect(photograph(linear))
    places = sorted(found.duplicates[7])
    np.testing.assert_allclose(places, [[80, 120], [240, 120]], atol=1.0)


def test_bits_are_opencvs():
    drawn = cv2.aruco.generateImageMarker(
        cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100), 3, 7 * 10
    )
    centres = drawn[5::10, 5::10][1:-1, 1:-1] > 127
    np.testing.assert_array_equal(marker_bits("DICT_5X5_100", 3), centres)


def test_dictionary_sizes_are_opencvs():
    for name, size in DICTIONARY_SIZES.items():
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
        assert dictionary.bytesList.shape[0] == size, name


@pytest.mark.parametrize(
    ("target", "message"),
    [
        ({}, "exactly one"),
        (
            {
                "marker": {"dictionary": "DICT_4X4_50", "id": 1, "side": "6 cm"},
                "tags": {"dictionary": "tag36h11", "side": "6 cm"},
            },
            "exactly one",
        ),
        ({"marker": {"dictionary": "DICT_4X4_50", "id": 50, "side": "6 cm"}}, "0 to 49"),
        ({"marker": {"dictionary": "DICT_4X4_50", "id": 1, "side": "-6 cm"}}, "greater than 0"),
        ({"marker": {"dictionary": "DICT_4X4", "id": 1, "side": "6 cm"}}, "DICT_4X4_50"),
        (
            {
                "board": {
                    "type": "charuco",
                    "squares": [7, 5],
                    "square": "2 cm",
                    "marker": "3 cm",
                    "dictionary": "DICT_4X4_50",
                }
            },
            "smaller",
        ),
        (
            {
                "board": {
                    "type": "charuco",
                    "squares": [20, 20],
                    "square": "4 cm",
                    "marker": "3 cm",
                    "dictionary": "DICT_4X4_50",
                }
            },
            "last id",
        ),
        (
            {"board": {"type": "grid", "squares": [2, 2], "marker": "3 cm", "dictionary": "DICT_4X4_50"}},
            "separation",
        ),
        ({"tags": {"dictionary": "tag36h11", "side": "6 cm", "layout": {}}}, "empty"),
        (
            {
                "tags": {
                    "dictionary": "tag36h11",
                    "side": "6 cm",
                    "layout": {"1": {"position": [0, 0, 0]}},
                    "origin": 2,
                }
            },
            "not in `layout`",
        ),
    ],
)
def test_targets_that_cannot_be(target, message):
    with pytest.raises(ValidationError, match=message):
        TargetSettings.model_validate(target)


def test_target_survives_json():
    target = TargetSettings.model_validate(
        {
            "tags": {
                "dictionary": "tag36h11",
                "side": "65 mm",
                "layout": {3: {"position": ["1 m", 0, 0], "rotation": ["90 deg", 0, 0]}},
            }
        }
    )
    assert TargetSettings.model_validate(target.model_dump(mode="json")) == target
