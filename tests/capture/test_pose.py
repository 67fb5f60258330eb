"""Poses of whole shots: truth by construction, flips, gaps, refusals, several tags."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest
from rendered_marker import board_page, errors, look_at, marker_page, photograph, render

from mrbatch.capture.marker_video.calibration import make_calibration
from mrbatch.capture.marker_video.lost_frames import fill_lost, interpolate
from mrbatch.capture.marker_video.markers import Detection, marker_corners, opencv_board
from mrbatch.capture.marker_video.pose import _table, solve_poses
from mrbatch.capture.marker_video.pose_solver import pose_covariance, project, solve
from mrbatch.capture.marker_video.pose_table import FramePose
from mrbatch.capture.marker_video.tag_layout import estimate_layout, place
from mrbatch.capture.marker_video.target_settings import TagsSettings, TargetSettings
from mrbatch.errors import InputError

SIZE = (320, 240)
K = np.array([[400.0, 0.0, 160.0], [0.0, 400.0, 120.0], [0.0, 0.0, 1.0]])
CALIBRATION = make_calibration(K, None, *SIZE, pixel_centres="half")
FAR = make_calibration([[900.0, 0, 640], [0, 900.0, 360], [0, 0, 1]], [0.1, -0.05, 0.001, 0, 0], 1280, 720)
MARKER = TargetSettings.model_validate({"marker": {"dictionary": "DICT_4X4_50", "id": 7, "side": "60 mm"}})
BOARD = TargetSettings.model_validate(
    {
        "board": {
            "type": "charuco",
            "squares": [5, 4],
            "square": "30 mm",
            "marker": "22 mm",
            "dictionary": "DICT_4X4_50",
        }
    }
)
BOARD_POINTS = np.array([[0.03 * (i - 1.5), 0.03 * (1 - j), 0.0] for j in range(3) for i in range(4)])


def _seen(points, pose, calibration, sigma, random, ids=None) -> Detection:
    """What a perfect detector with Gaussian noise gives; projection by OpenCV."""
    inverse = np.linalg.inv(pose)
    rvec = cv2.Rodrigues(inverse[:3, :3])[0]
    pixels = cv2.projectPoints(
        points, rvec, inverse[:3, 3], calibration.opencv_matrix(), calibration.distortion
    )[0].reshape(-1, 2)
    noisy = pixels + 0.5 + random.normal(0.0, sigma, pixels.shape)
    ids = np.zeros(len(points), dtype=int) if ids is None else ids
    return Detection(noisy, points, ids, sigma**2 * np.eye(2 * len(points)))


def _orbit(degrees: float, distance: float, roll: float = 0.0, sideways: float = 0.0) -> np.ndarray:
    """A camera tilted from face-on about the page's x axis."""
    a = np.radians(degrees)
    return look_at([sideways, -distance * np.sin(a), distance * np.cos(a)], roll=roll)


def test_projection_jacobian_by_differences():
    pose = np.linalg.inv(_orbit(30, 0.5, roll=0.4))
    _, jacobian = project(BOARD_POINTS, pose, FAR)
    for k in range(6):
        step = np.zeros(6)
        step[k] = 1e-6
        sides = []
        for sign in (1, -1):
            moved = np.eye(4)
            moved[:3, :3] = cv2.Rodrigues(sign * step[:3])[0] @ pose[:3, :3]
            moved[:3, 3] = cv2.Rodrigues(sign * step[:3])[0] @ pose[:3, 3] + sign * step[3:]
            sides.append(project(BOARD_POINTS, moved, FAR)[0].ravel())
        np.testing.assert_allclose((sides[0] - sides[1]) / 2e-6, jacobian[:, k], rtol=1e-5, atol=1e-3)


@pytest.mark.parametrize("tilt", [0.5, 10, 35, 60, 80])
def test_noiseless_points_give_the_exact_pose(tilt):
    pose = _orbit(tilt, 0.6, roll=0.7, sideways=0.1)
    detection = _seen(marker_corners(0.06), pose, FAR, 1e-9, np.random.default_rng(1))
    angle, distance = errors(solve(detection, FAR)[0].world_from_camera, pose)
    assert angle < 1e-4
    assert distance < 1e-6


@pytest.mark.case("MRK-01")
@pytest.mark.parametrize(
    ("points", "tilt", "distance"),
    [(BOARD_POINTS, 0, 0.4), (BOARD_POINTS, 20, 0.8), (marker_corners(0.06), 40, 0.5)],
)
def test_stated_covariance_covers_the_truth(points, tilt, distance):
    """The squared error in units of the stated covariance is chi^2 of 6: 95 % lie below 12.59."""
    random = np.random.default_rng(2)
    pose = _orbit(tilt, distance, roll=0.2)
    inside, total = 0, 300
    for _ in range(total):
        detection = _seen(points, pose, FAR, 0.2, random)
        root = solve(detection, FAR)[0]
        covariance = pose_covariance(root, detection, FAR)
        turn = root.world_from_camera[:3, :3].T @ pose[:3, :3]
        # turning the scene about the camera's axes by w turns the camera the other way
        w = cv2.Rodrigues(turn.T)[0].ravel()
        off = np.concatenate([w, pose[:3, 3] - root.world_from_camera[:3, 3]])
        inside += off @ np.linalg.solve(covariance, off) < 12.59
    # 4 standard deviations of a binomial of 300 at 0.95
    assert abs(inside / total - 0.95) < 4 * np.sqrt(0.95 * 0.05 / total)


@pytest.mark.case("MRK-02", "TRAP-3g")
def test_no_flips_on_a_path_through_face_on():
    """Tilt -20 to 20 degrees: single pictures choose the wrong root, the path does not."""
    random = np.random.default_rng(3)
    tilts = np.linspace(-20, 20, 100)
    poses = [_orbit(t, 1.2, sideways=0.02) for t in tilts]
    looked = [
        (i, i / 25, _seen(marker_corners(0.06), pose, FAR, 0.2, random)) for i, pose in enumerate(poses)
    ]
    table = _table(looked, FAR, "skip", None)
    alone = 0
    for tilt, row, pose in zip(tilts, table.frames, poses, strict=True):
        by_root = [errors(r.world_from_camera, pose)[0] for r in row.roots]
        if abs(tilt) < 6:
            # the roots run into each other: noise alone moves the pose by as much as they differ
            continue
        alone += int(np.argmin(by_root)) != 0
        if row.world_from_camera is not None:
            assert errors(row.world_from_camera, pose)[0] == pytest.approx(min(by_root)), tilt
    assert alone >= 3, "the case is too easy to prove anything"
    assert len(table.poses()) > 80


@pytest.mark.case("MRK-03")
@pytest.mark.parametrize("side", [8, 12, 18, 45])
def test_tiny_markers_give_a_pose_or_a_refusal_never_a_wrong_one(side):
    random = np.random.default_rng(side)
    given = 0
    for k in range(60):
        tilt = random.uniform(20, 60)
        pose = _orbit(tilt, 900 * 0.06 / side, roll=random.uniform(-3, 3))
        seen = _seen(marker_corners(0.06), pose, FAR, 0.2, random)
        try:
            row = _table([(k, 0.0, seen)], FAR, "skip", None).frames[0]
        except InputError:
            continue
        given += 1
        # the mirror image is 2 x tilt away; honest noise stays within four of its sigma
        sigma = np.degrees(np.sqrt(np.trace(row.covariance[:3, :3])))
        assert errors(row.world_from_camera, pose)[0] < max(4 * sigma, 0.5 * tilt)
    assert given > 45 or side < 45


def _shot(poses, target_page, noise=0.01, blank=()):
    page, metres = target_page
    frames = []
    for i, pose in enumerate(poses):
        if i in blank:
            picture = np.full((SIZE[1], SIZE[0]), 120, dtype=np.uint8)
        else:
            picture = photograph(render(page, metres, K, pose, SIZE), noise=noise, seed=i)
        frames.append((i + 100, i / 25.0, lambda picture=picture: picture))
    return frames


PATH = [_orbit(30 + i, 0.25, roll=0.03 * i, sideways=0.003 * i) for i in range(8)]


@pytest.fixture(scope="module")
def gap_shot():
    return _shot(PATH, marker_page("DICT_4X4_50", 7, 0.06), blank=(3, 4, 5))


@pytest.mark.case("MRK-08")
def test_rendered_shot_with_a_gap_is_interpolated(gap_shot):
    table = solve_poses(gap_shot, CALIBRATION, MARKER, lost="interpolate")
    for i, (row, pose) in enumerate(zip(table.frames, PATH, strict=True)):
        assert row.number == 100 + i
        angle, distance = errors(row.world_from_camera, pose)
        if i in (3, 4, 5):
            assert row.flags == ("lost", "interpolated")
            assert row.covariance is None
            # one pixel on the marker's corners
            there = project(marker_corners(0.06), np.linalg.inv(row.world_from_camera), CALIBRATION)[0]
            truth = project(marker_corners(0.06), np.linalg.inv(pose), CALIBRATION)[0]
            assert np.abs(there - truth).max() < 1.0
        else:
            assert row.flags == ()
            assert angle < 0.3
            assert distance < 0.005 * 0.25
    assert table.median_rms < 0.1
    assert json.loads(json.dumps(table.as_json()))[3]["flags"] == ["lost", "interpolated"]


def test_policies_for_lost_frames(gap_shot):
    skipped = solve_poses(gap_shot, CALIBRATION, MARKER, lost="skip")
    assert sorted(skipped.poses()) == [100, 101, 102, 106, 107]
    held = solve_poses(gap_shot, CALIBRATION, MARKER, lost="hold-last")
    assert held.row(105).flags == ("lost", "held")
    np.testing.assert_array_equal(held.row(105).world_from_camera, held.row(102).world_from_camera)
    with pytest.raises(InputError, match=r"3 of 8 frames: 103 \(lost\), 104") as caught:
        solve_poses(gap_shot, CALIBRATION, MARKER, lost="stop")
    assert caught.value.place.frame == 103


def test_frames_before_the_first_pose():
    rows = [FramePose(0, 0.0, None, flags=("lost",)), FramePose(1, 1.0, np.eye(4))]
    assert fill_lost(rows, "hold-last")[0].world_from_camera is None
    early = fill_lost(rows, "interpolate")[0]
    assert early.flags == ("lost", "held")
    np.testing.assert_array_equal(early.world_from_camera, np.eye(4))


def test_interpolation_is_a_constant_turn():
    a, b = np.eye(4), np.eye(4)
    b[:3, :3] = cv2.Rodrigues(np.array([0.0, 0.0, 1.2]))[0]
    b[:3, 3] = [4.0, 0.0, 0.0]
    pose = interpolate(FramePose(0, 1.0, a), FramePose(4, 3.0, b), 1.5)
    np.testing.assert_allclose(pose[:3, :3], cv2.Rodrigues(np.array([0.0, 0.0, 0.3]))[0], atol=1e-12)
    np.testing.assert_allclose(pose[:3, 3], [1.0, 0.0, 0.0], atol=1e-12)


def test_never_seen_names_what_is_there():
    shot = _shot(PATH[:2], marker_page("DICT_6X6_250", 33, 0.06))
    with pytest.raises(InputError, match="marker 7 of DICT_4X4_50 is seen in none of the 2 frames") as caught:
        solve_poses(shot, CALIBRATION, MARKER)
    assert "DICT_6X6" in caught.value.hint
    shot = _shot(PATH[:1], marker_page("DICT_4X4_50", 9, 0.06))
    with pytest.raises(InputError) as caught:
        solve_poses(shot, CALIBRATION, MARKER)
    assert "shows the ids 9" in caught.value.hint
    blank = [(0, 0.0, lambda: np.full((240, 320), 80, dtype=np.uint8))]
    with pytest.raises(InputError) as caught:
        solve_poses(blank, CALIBRATION, MARKER)
    assert "no dictionary" in caught.value.hint


@pytest.mark.case("MRK-06")
def test_marker_seen_twice_names_both_places():
    page, metres = marker_page("DICT_4X4_50", 7, 0.06)
    left, right = np.eye(4), np.eye(4)
    left[0, 3], right[0, 3] = -0.1, 0.1
    pose = look_at([0.0, 0.0, 0.5])
    linear = render(page, metres, K, pose, SIZE, world_from_page=left)
    linear = render(page, metres, K, pose, SIZE, world_from_page=right, onto=linear)
    with pytest.raises(InputError, match=r"marker 7 is seen 2 times.*\(80, 120\)") as caught:
        solve_poses([(5, 0.0, lambda: photograph(linear))], CALIBRATION, MARKER)
    assert "(240, 120)" in caught.value.message
    assert caught.value.place.frame == 5


def test_a_marker_seen_twice_is_the_fault_of_its_frame_alone():
    page, metres = marker_page("DICT_4X4_50", 7, 0.06)
    beside = np.eye(4)
    beside[0, 3] = 0.1
    pictures = []
    for n in range(4):
        camera = look_at([0.02 * n, -0.3, 0.4])
        linear = render(page, metres, K, camera, SIZE)
        if n == 2:
            linear = render(page, metres, K, camera, SIZE, world_from_page=beside, onto=linear)
        pictures.append(photograph(linear))
    frames = [(10 + n, n / 25, lambda p=p: p) for n, p in enumerate(pictures)]
    table = solve_poses(frames, CALIBRATION, MARKER, lost="stop")
    assert [row.number for row in table.frames] == [10, 11, 12, 13]
    assert [row.fault is None for row in table.frames] == [True, True, False, True]
    assert "marker 7 is seen 2 times" in table.row(12).fault and sorted(table.poses()) == [10, 11, 13]
    rows = json.loads(json.dumps(table.as_json()))
    assert rows[2]["other_root"] is None
    assert np.array(rows[0]["other_root"]["world_from_camera"]).shape == (4, 4)
    np.testing.assert_array_equal(
        rows[0]["other_root"]["world_from_camera"], table.frames[0].other.world_from_camera
    )


def test_picture_of_another_size():
    with pytest.raises(InputError, match="64x48"):
        solve_poses([(0, 0.0, lambda: np.zeros((48, 64), dtype=np.uint8))], CALIBRATION, MARKER)


@pytest.mark.case("MRK-04")
@pytest.mark.parametrize(("tilt", "blur"), [(85, 0.0), (80, 0.0), (45, 5.0), (40, 3.0)])
def test_hard_pictures_give_a_pose_or_are_lost(tilt, blur):
    page, metres = marker_page("DICT_4X4_50", 7, 0.06)
    pose = _orbit(tilt, 0.16, roll=0.1)
    picture = photograph(render(page, metres, K, pose, SIZE, samples=8), blur=blur)
    try:
        table = solve_poses([(0, 0.0, lambda: picture)], CALIBRATION, MARKER, lost="skip")
    except InputError:
        return
    found = project(marker_corners(0.06), np.linalg.inv(table.frames[0].world_from_camera), CALIBRATION)[0]
    truth = project(marker_corners(0.06), np.linalg.inv(pose), CALIBRATION)[0]
    assert np.sqrt(np.mean(np.sum((found - truth) ** 2, axis=1))) < 1.0


@pytest.mark.case("MRK-04")
def test_half_hidden_board():
    page, metres = board_page(opencv_board(BOARD.board), 0.03)
    pose = _orbit(30, 0.3, roll=0.2)
    linear = render(page, metres, K, pose, SIZE)
    linear[:, 170:] = 0.2
    table = solve_poses([(0, 0.0, lambda: photograph(linear))], CALIBRATION, BOARD)
    angle, distance = errors(table.frames[0].world_from_camera, pose)
    assert angle < 1.0
    assert distance < 0.01 * 0.3


def _tag_scene(random, sigma):
    tags = {4: np.eye(4), 9: look_at([0.2, 0.05, 0.02]), 2: np.eye(4), 30: np.eye(4)}
    tags[9][:3, :3] = cv2.Rodrigues(np.array([0.0, -0.5, 0.2]))[0]
    tags[2][:3, :3] = cv2.Rodrigues(np.array([0.6, 0.0, 0.3]))[0]
    tags[2][:3, 3] = [-0.15, 0.1, 0.05]
    tags[30][:3, :3] = cv2.Rodrigues(np.array([0.2, 0.7, -0.4]))[0]
    tags[30][:3, 3] = [0.05, -0.2, 0.01]
    poses = [look_at([0.5 * np.cos(a), -0.6, 0.7 + 0.1 * np.sin(3 * a)]) for a in np.linspace(0.6, 2.5, 9)]
    looked = []
    for i, pose in enumerate(poses):
        # the origin tag is hidden in a third of the pictures
        shown = [t for t in tags if not (t == 4 and i % 3 == 1)]
        parts = []
        for t in shown:
            camera_from_tag = np.linalg.inv(pose) @ tags[t]
            parts.append(_seen(marker_corners(0.065), np.linalg.inv(camera_from_tag), FAR, sigma, random))
        looked.append(
            (
                i,
                Detection(
                    np.concatenate([p.points_2d for p in parts]),
                    np.concatenate([p.points_3d for p in parts]),
                    np.repeat(shown, 4),
                    sigma**2 * np.eye(8 * len(shown)),
                ),
            )
        )
    return tags, poses, looked


def test_layout_of_tags_is_found_from_the_shot():
    settings = TagsSettings.model_validate({"dictionary": "tag36h11", "side": "65 mm", "origin": 4})
    tags, poses, looked = _tag_scene(np.random.default_rng(4), 0.1)
    layout = estimate_layout(looked, FAR, settings)
    assert list(layout) == [2, 4, 9, 30]
    np.testing.assert_array_equal(layout[4], np.eye(4))
    for tag, truth in tags.items():
        angle, distance = errors(layout[tag], truth)
        assert angle < 0.4, tag
        assert distance < 0.002, tag
    rows = [(i, float(i), place(d, layout)) for i, d in looked]
    table = _table(rows, FAR, "stop", layout)
    for row, pose in zip(table.frames, poses, strict=True):
        angle, distance = errors(row.world_from_camera, pose)
        assert angle < 0.2
        assert distance < 0.004


def test_tags_that_move_are_refused():
    settings = TagsSettings.model_validate({"dictionary": "tag36h11", "side": "65 mm"})
    _, _, one = _tag_scene(np.random.default_rng(5), 0.1)
    rolled = [(i, d if i % 2 else _permuted(d)) for i, d in one]
    with pytest.raises(InputError, match="do not keep their places: tag"):
        estimate_layout(rolled, FAR, settings)


def _permuted(detection: Detection) -> Detection:
    """The same tags with their ids exchanged: as if they had been moved about."""
    swap = {2: 9, 9: 30, 30: 2, 4: 4}
    ids = np.array([swap[int(i)] for i in detection.ids])
    return Detection(detection.points_2d, detection.points_3d, ids, detection.covariance)


def test_origin_never_seen():
    settings = TagsSettings.model_validate({"dictionary": "tag36h11", "side": "65 mm", "origin": 77})
    _, _, looked = _tag_scene(np.random.default_rng(6), 0.1)
    with pytest.raises(InputError, match="origin tag 77") as caught:
        estimate_layout(looked, FAR, settings)
    assert "2, 4, 9, 30" in caught.value.hint


def test_smoothed_poses_of_a_rendered_shot(gap_shot):
    before = solve_poses(gap_shot, CALIBRATION, MARKER, lost="interpolate")
    table = solve_poses(gap_shot, CALIBRATION, MARKER, lost="interpolate", smoothing=2)
    assert before.smoothing is None and table.smoothing["segments"] == [100]
    for i, (row, pose) in enumerate(zip(table.frames, PATH, strict=True)):
        angle, distance = errors(row.world_from_camera, pose)
        assert angle < 0.3 and distance < 0.005 * 0.25
        assert row.flags == (("lost", "interpolated") if i in (3, 4, 5) else ())
    # moved no farther than the noise of the corners lets it
    assert table.median_rms < before.median_rms + 0.05


@pytest.mark.slow
def test_smoothing_halves_the_error_of_a_rendered_film():
    """Two seconds round a marker of 27 pixels: poses found in noisy pictures against those that made them."""
    page, metres = marker_page("DICT_4X4_50", 7, 0.06)
    path, frames = [], []
    for i in range(50):
        sway = 0.5 * np.pi * i / 25
        tilt, roll = 35 + 8 * np.sin(sway), 0.15 * np.cos(sway)
        path.append(_orbit(tilt, 0.9, roll=roll, sideways=0.08 * np.sin(sway)))
        picture = photograph(render(page, metres, K, path[-1], SIZE), noise=0.03, seed=i)
        frames.append((i, i / 25.0, lambda picture=picture: picture))

    def rms(smoothing):
        table = solve_poses(frames, CALIBRATION, MARKER, smoothing=smoothing)
        off = [errors(row.world_from_camera, pose) for row, pose in zip(table.frames, path, strict=True)]
        return np.sqrt(np.mean(np.square(off), axis=0)), table

    before, _ = rms(None)
    after, table = rms(2)
    assert np.all(after < 0.5 * before)
    assert table.smoothing["segments"] == [0] and table.smoothing["still"] == []
    assert len(table.smoothing["far"]) <= 2
