"""Calibration files: every format gives the same camera, and every broken one a clear error."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest

from mrbatch.capture.marker_video.calibration import load_calibration, make_calibration
from mrbatch.errors import InputError

K = np.array([[500.25, 0.0, 321.5], [0.0, 501.75, 239.0], [0.0, 0.0, 1.0]])
D = [0.1, -0.2, 0.001, -0.002, 0.05]


def _filestorage(path):
    storage = cv2.FileStorage(str(path), cv2.FileStorage_WRITE)
    storage.write("image_width", 640)
    storage.write("image_height", 480)
    storage.write("camera_matrix", K)
    storage.write("distortion_coefficients", np.array(D))
    storage.write("note", "made by a test")
    storage.release()


def _plain(path):
    path.write_text(
        "width: 640\nheight: 480\nfx: 500.25\nfy: 501.75\ncx: 321.5\ncy: 239.0\n"
        "distortion: [0.1, -0.2, 0.001, -0.002, 0.05]\n",
        encoding="utf-8",
    )


def _ros(path):
    path.write_text(
        "image_width: 640\nimage_height: 480\ncamera_name: c\ndistortion_model: plumb_bob\n"
        "camera_matrix:\n  rows: 3\n  cols: 3\n  data: [500.25, 0, 321.5, 0, 501.75, 239.0, 0, 0, 1]\n"
        "distortion_coefficients:\n  rows: 1\n  cols: 5\n  data: [0.1, -0.2, 0.001, -0.002, 0.05]\n",
        encoding="utf-8",
    )


def _json(path):
    path.write_text(json.dumps({"K": K.tolist(), "dist": D, "image_size": [640, 480]}), encoding="utf-8")


def _npz(path):
    np.savez(path, mtx=K, dist=np.array([D]), image_size=np.array([640, 480]))


@pytest.mark.parametrize(
    ("name", "write"),
    [
        ("a.yml", _filestorage),
        ("a.xml", _filestorage),
        ("b.json", _filestorage),
        ("plain.yaml", _plain),
        ("ros.yaml", _ros),
        ("c.json", _json),
        ("d.npz", _npz),
    ],
)
def test_every_format_gives_the_same_camera(tmp_path, name, write):
    write(tmp_path / name)
    calibration = load_calibration(tmp_path / name)
    moved = K + np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
    np.testing.assert_allclose(calibration.matrix, moved, rtol=1e-14)
    np.testing.assert_allclose(calibration.opencv_matrix(), K, rtol=1e-14)
    np.testing.assert_allclose(calibration.distortion, [*D, 0, 0, 0], rtol=1e-14)
    assert (calibration.width, calibration.height) == (640, 480)


def test_matrix_alone_in_npy(tmp_path):
    np.save(tmp_path / "k.npy", K)
    calibration = load_calibration(tmp_path / "k.npy")
    assert calibration.width is None
    np.testing.assert_allclose(calibration.opencv_matrix(), K)
    assert not calibration.distortion.any()


def test_pixel_centres_at_half_integers_are_not_moved(tmp_path):
    path = tmp_path / "own.yaml"
    _plain(path)
    path.write_text(path.read_text() + "pixel_centres: half\n")
    np.testing.assert_array_equal(load_calibration(path).matrix, K)
    np.testing.assert_array_equal(load_calibration(path, pixel_centres="integer").opencv_matrix(), K)


def test_sections(tmp_path):
    path = tmp_path / "several.yaml"
    path.write_text(f"one:\n  K: {K.ravel().tolist()}\ntwo:\n  K: {(2 * K).ravel().tolist()}\n")
    with pytest.raises(InputError, match="2 calibrations: one, two"):
        load_calibration(path)
    np.testing.assert_allclose(load_calibration(path, section="one").opencv_matrix(), K)
    with pytest.raises(InputError) as caught:
        load_calibration(path, section="three")
    assert "one, two" in caught.value.hint


def test_camera_projects_as_opencv_does():
    calibration = make_calibration(K, [0.2, -0.1, 0.01, 0.02, 0.03, 0.1, 0.05, 0.02], 640, 480)
    points = np.random.default_rng(0).uniform([-0.5, -0.4, 1.0], [0.5, 0.4, 2.0], (50, 3))
    ours = calibration.camera(np.eye(4), 640, 480).project(points)[0]
    theirs = cv2.projectPoints(
        points, np.zeros(3), np.zeros(3), calibration.opencv_matrix(), calibration.distortion
    )[0].reshape(-1, 2)
    np.testing.assert_allclose(ours, theirs + 0.5, atol=1e-9)


@pytest.mark.parametrize(
    ("matrix", "distortion", "message"),
    [
        (np.diag([500.0, 0.0, 1.0]), D, "singular"),
        (np.diag([500.0, 500.0, 0.0]), D, "singular"),
        (np.diag([-500.0, 500.0, 1.0]), D, "positive"),
        (np.where(K == 321.5, np.nan, K), D, "NaN"),
        (K, [0.1, np.inf, 0, 0], "infinity"),
        (K.T, D, "form"),
        (K + np.array([[0, 2.0, 0], [0, 0, 0], [0, 0, 0]]), D, "skew"),
        (K[:2], D, "shape"),
        (K, [0.1, 0.2], "2 distortion coefficients"),
        (K, [0.1] * 12, "thin prism"),
        (K, [0.1] * 8 + [0] * 4 + [0.1, 0.1], "tilted"),
        ([["a", 0, 0], [0, 1, 0], [0, 0, 1]], D, "not numbers"),
    ],
)
def test_impossible_intrinsics(matrix, distortion, message):
    with pytest.raises(InputError, match=message):
        make_calibration(matrix, distortion, source="c.yaml")


def test_zero_thin_prism_and_tilt_are_taken():
    assert make_calibration(K, D + [0] * 9).distortion[4] == D[4]


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.json", "{", "cannot be read"),
        ("a.json", "[1]", "no keys"),
        ("a.yaml", "a: [1", "cannot be read"),
        ("a.yml", "%YAML:1.0\n---\nk: !!opencv-matrix\n  rows: [\n", "OpenCV cannot read"),
        ("a.yaml", "fx: 1\ncamera: yes\n", "no camera matrix"),
        ("a.npz", "text", "cannot be read"),
        ("a.json", '{"K": [[1,0,0],[0,1,0],[0,0,1]], "fisheye": true}', "fisheye"),
        ("a.yaml", "K: [1,0,0,0,1,0,0,0,1]\ndistortion_model: equidistant\n", "equidistant"),
        ("a.json", '{"K": [[1,0,0],[0,1,0],[0,0,1]], "image_size": [0, 4]}', "width is 0"),
        ("a.json", '{"K": [[1,0,0],[0,1,0],[0,0,1]], "width": 4}', "together"),
    ],
)
def test_broken_files(tmp_path, name, content, message):
    (tmp_path / name).write_text(content)
    with pytest.raises(InputError, match=message) as caught:
        load_calibration(tmp_path / name)
    assert caught.value.place.file == str(tmp_path / name)


def test_missing_keys_are_answered_with_those_there(tmp_path):
    (tmp_path / "a.json").write_text('{"rotation": 1, "serial": 2}')
    with pytest.raises(InputError) as caught:
        load_calibration(tmp_path / "a.json")
    assert "rotation, serial" in caught.value.hint


def test_pickles_are_refused(tmp_path):
    np.save(tmp_path / "a.npy", np.array({"K": K}, dtype=object), allow_pickle=True)
    with pytest.raises(InputError, match="pickled"):
        load_calibration(tmp_path / "a.npy")


def test_missing_file(tmp_path):
    with pytest.raises(InputError, match="does not exist"):
        load_calibration(tmp_path / "nowhere.yaml")


def test_other_picture_size_is_refused():
    with pytest.raises(InputError, match="1280x720"):
        make_calibration(K, D, 640, 480).check_size(1280, 720)
