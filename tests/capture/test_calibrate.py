"""Calibration of known cameras: from projected corners, rendered pictures, a video, and a real set."""

from __future__ import annotations

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image
from rendered_marker import board_page, look_at, photograph, render

import mrbatch
from mrbatch.capture.marker_video.calibrate import calibration_text, read_board
from mrbatch.capture.marker_video.calibration import load_calibration
from mrbatch.capture.marker_video.calibration_fit import coverage, fit_calibration, folds, weaknesses
from mrbatch.capture.marker_video.calibration_views import View, choose_views
from mrbatch.capture.marker_video.markers import board_from_opencv, opencv_board
from mrbatch.capture.marker_video.target_settings import BoardSettings
from mrbatch.cli import main
from mrbatch.errors import InputError, JobError

SIZE = (640, 480)
MATRIX = np.array([[612.0, 0.0, 331.0], [0.0, 609.0, 236.0], [0.0, 0.0, 1.0]])
"""Pixel centres at half integers."""
LENS = np.array([-0.18, 0.06, 0.0012, -0.0009, 0.0])
TEXT = "{type: charuco, squares: [7, 5], square: 30 mm, marker: 22 mm, dictionary: DICT_4X4_50}"
BOARD = read_board(TEXT)


def corners() -> np.ndarray:
    """(24, 3) inner corners in the world of the target."""
    to_ours = board_from_opencv(BOARD)
    points = np.asarray(opencv_board(BOARD).getChessboardCorners(), dtype=np.float64)
    return points @ to_ours[:3, :3].T + to_ours[:3, 3]


def poses(count: int, seed: int = 2) -> list[np.ndarray]:
    """world_from_camera all round the board, near and far, with the board in every part of the picture."""
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(count):
        eye = np.array([*rng.uniform(-0.22, 0.22, 2), rng.uniform(0.2, 0.36)])
        pose = look_at(eye, (*rng.uniform(-0.1, 0.1, 2), 0.0), roll=rng.uniform(-0.4, 0.4))
        found.append(pose)
    return found


def projected(pose: np.ndarray, lens=LENS, matrix=MATRIX) -> tuple[np.ndarray, np.ndarray]:
    """Corners that fall into the picture: pixels (n, 2), board (n, 3)."""
    board = corners()
    inverse = np.linalg.inv(pose)
    seen = cv2.projectPoints(board, cv2.Rodrigues(inverse[:3, :3])[0], inverse[:3, 3], matrix, lens)[0][:, 0]
    inside = np.all((seen > 2) & (seen < np.array(SIZE) - 2), axis=1)
    return seen[inside], board[inside]


def made_up_views(count=24, noise=0.2, seed=0, lens=LENS, found=None) -> list[View]:
    rng = np.random.default_rng(100 + seed)
    views = []
    for i, pose in enumerate(poses(count) if found is None else found):
        points, board = projected(pose, lens)
        if len(points) >= 8:
            views.append(View(f"v{i}", points + rng.normal(0.0, noise, points.shape), board, 2.0))
    return views


def truth(fit) -> np.ndarray:
    """(4,) fx fy cx cy as OpenCV counts pixels."""
    return np.array([MATRIX[0, 0], MATRIX[1, 1], MATRIX[0, 2] - 0.5, MATRIX[1, 2] - 0.5])


def found(fit) -> np.ndarray:
    return np.array([fit.matrix[0, 0], fit.matrix[1, 1], fit.matrix[0, 2], fit.matrix[1, 2]])


# The fit.


@pytest.mark.slow
def test_the_stated_sigma_is_the_error_made():
    """Over 12 draws of noise, errors divided by sigma have variance 1."""
    scores, lens = [], []
    for seed in range(12):
        fit = fit_calibration(made_up_views(seed=seed), SIZE, 5)
        scores.append((found(fit) - truth(fit)) / fit.sigma)
        lens.append((fit.distortion - LENS) / fit.sigma_distortion)
    for z in (np.array(scores), np.array(lens)):
        spread = np.sqrt(np.mean(z**2, axis=0))
        assert np.all((spread > 0.6) & (spread < 1.45)), spread
        assert np.abs(z.mean(axis=0)).max() < 4.0 / np.sqrt(12)


@pytest.mark.slow
def test_views_that_err_as_a_whole_show():
    """A board that bends in the hand: the fit's own sigma is far too small, that of the views is not."""
    by_fit, by_views = [], []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        views = []
        for view, pose in zip(made_up_views(seed=seed), poses(24), strict=True):
            inverse = np.linalg.inv(pose)
            bent = view.board.copy()
            x, y = bent[:, 0] / 0.1, bent[:, 1] / 0.07
            bent[:, 2] += 0.002 * (rng.normal() * x * x + rng.normal() * y * y + rng.normal() * x * y)
            turn = cv2.Rodrigues(inverse[:3, :3])[0]
            shift = [
                cv2.projectPoints(b, turn, inverse[:3, 3], MATRIX, LENS)[0][:, 0] for b in (bent, view.board)
            ]
            views.append(replace(view, points=view.points + shift[0] - shift[1]))
        fit = fit_calibration(views, SIZE, 4)
        by_fit.append((found(fit) - truth(fit)) / fit.sigma)
        by_views.append((found(fit) - truth(fit)) / fit.sigma_views)
    assert np.sqrt(np.mean(np.square(by_fit))) > 2.0
    assert 0.6 < np.sqrt(np.mean(np.square(by_views))) < 1.5
    assert any("disagree" in w for w in weaknesses(fit, coverage(fit)))


def test_without_noise_the_camera_comes_back():
    fit = fit_calibration(made_up_views(noise=0.0), SIZE, 5)
    assert found(fit) == pytest.approx(truth(fit), abs=0.02)
    assert fit.distortion == pytest.approx(LENS, abs=2e-4)
    assert fit.rms < 1e-3  # OpenCV takes single precision


@pytest.mark.parametrize(
    ("lens", "coefficients"),
    [
        ([0.0, 0.0, 0.0, 0.0, 0.0], 0),
        ([-0.25, 0.09, 0.0, 0.0, 0.0], 2),
        ([-0.25, 0.09, 0.003, -0.004, 0.0], 4),
    ],
)
def test_as_many_coefficients_as_the_views_call_for(lens, coefficients):
    fit = fit_calibration(made_up_views(lens=np.array(lens)), SIZE)
    assert np.count_nonzero(fit.distortion) == coefficients
    assert np.all(np.abs(found(fit) - truth(fit)) < 4 * fit.sigma)


def test_a_lens_that_folds_is_not_taken():
    """Corners near the middle alone: five coefficients fit them, and fold the picture's corners."""
    fit = fit_calibration(made_up_views(), SIZE, 5)
    assert not folds(fit)
    wild = replace(fit, distortion=np.array([0.0085, 0.751, 0.0, 0.0, -2.53]))
    assert folds(wild) and any("folds back" in w for w in weaknesses(wild, coverage(wild)))
    never = replace(fit, distortion=np.array([0.0, 0.0, 0.0, 0.0, 0.0, 4.0, 0.0, 0.0]))
    assert folds(never)  # no direction reaches the corner


def test_a_view_and_a_corner_that_do_not_fit_are_left_out():
    views = made_up_views()
    clean = fit_calibration(views, SIZE, 5)
    wrong = replace(views[3], name="wrong", points=np.roll(views[3].points, 7, axis=0))
    slip = views[7].points.copy()
    slip[2] += 5.0
    fit = fit_calibration(
        [*views[:3], wrong, *views[4:7], replace(views[7], points=slip), *views[8:]], SIZE, 5
    )
    assert [name for name, _ in fit.dropped] == ["wrong"] and fit.dropped_corners == 1
    assert np.all(np.abs(found(fit) - found(clean)) < 2 * clean.sigma)


def test_poor_coverage_is_told():
    same = [look_at((0.01 * k, 0.0, 0.9), (0.01 * k, 0.0, 0.0)) for k in range(5)]
    fit = fit_calibration(made_up_views(found=same), SIZE, 5)
    told = " ".join(weaknesses(fit, coverage(fit)))
    for piece in (
        "only 5 views",
        "of the picture only",
        "the way to the picture's corners",
        "tilted by less",
    ):
        assert piece in told, told
    good = fit_calibration(made_up_views(40), SIZE, 4)
    assert not weaknesses(good, coverage(good)), weaknesses(good, coverage(good))


def test_chosen_views_differ():
    """Of many views alike and a few others, the others are among the chosen."""
    alike = made_up_views(found=[look_at((0.001 * k, 0.0, 0.3)) for k in range(60)])
    others = [replace(v, name=f"other {v.name}") for v in made_up_views(6)]
    chosen = choose_views([*alike[:30], *others, *alike[30:]], SIZE, 12)
    assert len(chosen) == 12 and sum(v.name.startswith("other") for v in chosen) == len(others)
    assert choose_views(others, SIZE, 40) == others


def test_too_few_views():
    with pytest.raises(InputError, match="seen in 2 pictures; at least 3"):
        fit_calibration(made_up_views(2), SIZE)


# Pictures.


def drawn(pose) -> np.ndarray:
    """Linear picture of the board from a pose."""
    page, metres = board_page(opencv_board(BOARD), 0.03, pixels=40)
    return render(page, metres, MATRIX, pose, SIZE, distortion=LENS, samples=2)


@pytest.fixture(scope="module")
def pictures():
    return [drawn(pose) for pose in poses(12, seed=5)]


@pytest.mark.slow
def test_rendered_pictures(tmp_path, pictures):
    for i, linear in enumerate(pictures):
        cv2.imwrite(str(tmp_path / f"p{i:02}.png"), photograph(linear, noise=0.01, seed=i, blur=0.7))
    cv2.imwrite(str(tmp_path / "p99.png"), np.full(SIZE[::-1], 90, np.uint8))
    (tmp_path / "board.yaml").write_text(f"target:\n  board: {TEXT}\n")
    output, picture = tmp_path / "calibration.yaml", tmp_path / "residuals.png"
    report = mrbatch.calibrate_camera(
        sorted(tmp_path.glob("p*.png")), tmp_path / "board.yaml", output, picture=picture, coefficients=4
    )
    fit = report.fit
    off = (found(fit) - truth(fit)) / fit.sigma
    assert np.abs(off).max() < 3.5, off
    assert np.abs(found(fit)[:2] / truth(fit)[:2] - 1.0).max() < 0.002
    assert report.views.unseen == ("p99.png",) and fit.rms < 0.25
    read = load_calibration(output)
    assert (read.width, read.height) == SIZE
    assert read.matrix[:2, 2] == pytest.approx(fit.matrix[:2, 2] + 0.5, abs=1e-5)
    assert read.distortion[:4] == pytest.approx(fit.distortion, abs=1e-6)
    with Image.open(picture) as image:
        assert image.width >= 1000 and np.asarray(image).std() > 10


def test_a_video_in_which_the_camera_moves_fast(tmp_path, pictures):
    """Blurred frames are left out; what stays gives the camera."""
    av = pytest.importorskip("av")
    path = tmp_path / "board.mp4"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=25)
        stream.width, stream.height, stream.pix_fmt = *SIZE, "yuv420p"
        stream.options = {"crf": "12"}
        for i, linear in enumerate(pictures):
            for blur in (0.7, 6.0) if i % 4 == 0 else (0.7,):
                codes = photograph(linear, noise=0.005, seed=i, blur=blur)
                frame = av.VideoFrame.from_ndarray(np.repeat(codes[..., None], 3, axis=2), format="rgb24")
                container.mux(stream.encode(frame))
        container.mux(stream.encode())
    report = mrbatch.calibrate_camera([path], TEXT, tmp_path / "c.yaml", coefficients=4)
    assert report.views.looked_at == 15
    # Frames 1, 6 and 11 are the blurred ones: no board is found in them, or their edges give them away.
    gone = {*report.views.blurred, *report.views.unseen}
    assert {"frame 1", "frame 6", "frame 11"} <= gone
    fit = report.fit
    assert np.abs(found(fit)[:2] / truth(fit)[:2] - 1.0).max() < 0.003
    assert np.abs((found(fit) - truth(fit)) / fit.sigma).max() < 4.0


# Arguments.


def test_boards_are_read_from_anywhere(tmp_path):
    for text in (
        TEXT,
        f"board: {TEXT}",
        f"target:\n  board: {TEXT}",
        f"capture:\n  target:\n    board: {TEXT}",
    ):
        path = tmp_path / "b.yaml"
        path.write_text(text)
        assert read_board(path) == BOARD
    path.write_text("target:\n  marker: {dictionary: DICT_4X4_50, id: 7, side: 60 mm}\n")
    with pytest.raises(JobError, match="with a board, not with markers"):
        read_board(path)
    with pytest.raises(JobError, match="this is no board: squares"):
        read_board("{type: charuco, marker: 20 mm, dictionary: DICT_4X4_50}")
    with pytest.raises(InputError, match="board file does not exist"):
        read_board(tmp_path / "none.yaml")


def test_pictures_of_two_sizes(tmp_path):
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((48, 64), np.uint8))
    cv2.imwrite(str(tmp_path / "b.png"), np.zeros((64, 48), np.uint8))
    with pytest.raises(InputError, match="48x64, the first one 64x48"):
        mrbatch.calibrate_camera([tmp_path / "a.png", tmp_path / "b.png"], TEXT, tmp_path / "c.yaml")
    with pytest.raises(InputError, match="seen in none of 1 pictures"):
        mrbatch.calibrate_camera([tmp_path / "a.png"], TEXT, tmp_path / "c.yaml")
    with pytest.raises(JobError, match="one of the inputs"):
        mrbatch.calibrate_camera([tmp_path / "a.png"], TEXT, tmp_path / "a.png")


def test_another_dictionary_is_named(tmp_path, pictures):
    cv2.imwrite(str(tmp_path / "a.png"), photograph(pictures[0], blur=0.7))
    with pytest.raises(InputError) as caught:
        mrbatch.calibrate_camera([tmp_path / "a.png"], TEXT.replace("4X4", "6X6"), tmp_path / "c.yaml")
    assert "markers of DICT_4X4_50" in caught.value.hint


def test_the_file_is_plain_numbers():
    fit = fit_calibration(made_up_views(), SIZE, 4)
    text = calibration_text(fit)
    assert "e-" not in text.split("\n", 2)[2] and "fx: 6" in text
    assert isinstance(BOARD, BoardSettings)


# A real set.


@pytest.mark.slow
@pytest.mark.data
def test_a_real_camera(tmp_path, shared_data):
    """Against the intrinsics that the set's author fitted to the same pictures: within half a sigma."""
    folder = shared_data / "markers" / "charuco_realsense_jp"
    given = json.loads((folder / "calib_and_poses.json").read_text())
    pictures = [str(p) for p in sorted((folder / "images").glob("*.jpg"))]
    output = tmp_path / "c.yaml"
    arguments = ["calibrate", *pictures, "--board", TEXT, "--output", str(output), "--json", f"{output}.json"]
    result = CliRunner().invoke(main, [*arguments, "--distortion", "5"], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    told = json.loads((tmp_path / "c.yaml.json").read_text())
    k = np.array(given["K"])
    for name, value in zip(("fx", "fy", "cx", "cy"), (k[0, 0], k[1, 1], k[0, 2], k[1, 2])):
        assert abs(told[name] - value) < 0.5 * told["sigma"][name], name
    assert told["rms_px"] < 0.7 and told["corners"] > 640
    # Those five coefficients fold the picture's corners, which no view reached; two do not.
    assert any("folds back" in w for w in told["warnings"])
    result = CliRunner().invoke(main, arguments, catch_exceptions=False)
    told = json.loads((tmp_path / "c.yaml.json").read_text())
    assert np.count_nonzero(told["distortion"]) == 2 and "of the picture only" in " ".join(told["warnings"])
    assert abs(told["fx"] - k[0, 0]) < told["sigma"]["fx"] and abs(told["cx"] - k[0, 2]) < told["sigma"]["cx"]
