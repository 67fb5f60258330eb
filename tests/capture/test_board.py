"""Printed targets: what the printer gets is what the detector looks for, to a tenth of a millimetre."""

from __future__ import annotations

import re
from dataclasses import replace

import cv2
import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image
from rendered_marker import photograph, tags_are_turned

import mrbatch
from mrbatch.capture.marker_video.board_pdf import board_pdf, outlines
from mrbatch.capture.marker_video.board_picture import board_picture
from mrbatch.capture.marker_video.board_sheet import FOOT, MARGIN, lay_out, paper_size
from mrbatch.capture.marker_video.markers import TargetDetector
from mrbatch.capture.marker_video.target_settings import TargetSettings
from mrbatch.cli import main
from mrbatch.document import read_document
from mrbatch.errors import JobError

DOTS = 16
"""Pixels a millimetre of what a PDF is drawn with."""
SHEETS = {
    "marker": {"kind": "marker", "marker_id": 7},
    "big tag": {"kind": "marker", "dictionary": "tag36h11", "marker_id": 85, "side": 0.1377, "paper": "A3"},
    "charuco": {"kind": "charuco"},
    "charuco, even rows": {"kind": "charuco", "squares": (5, 6), "paper": "letter"},
    "aprilgrid": {"kind": "aprilgrid", "squares": (3, 1), "paper": "A5"},
    "grid": {"kind": "grid", "squares": (1, 2), "marker_id": 48, "paper": "A5"},
}


def job_target(sheet) -> TargetSettings:
    """The target as a job that holds the printed snippet reads it."""
    return TargetSettings.model_validate(read_document(sheet.yaml, "job.yaml").data["target"])


def on_the_page(points, sheet):
    """(n, 2) mm from the page's top left corner of points (n, 3) in the world of the target."""
    middle = np.array([0.5 * sheet.width, MARGIN + 0.5 * (sheet.height - 2 * MARGIN - FOOT)])
    return middle + 1000.0 * points[:, :2] * [1.0, -1.0]


def photo(page):
    """8-bit sRGB photo of a printed page (255 white, grey by area) that lies square before the lens."""
    return photograph(0.04 + 0.76 * page / 255.0, noise=0.003, blur=0.8)


@pytest.mark.parametrize("name", SHEETS)
def test_the_detector_finds_the_picture_true_to_scale(name):
    sheet = lay_out(**SHEETS[name])
    # Markers of some hundred pixels, as a video shows them: whole patterns are fitted to hundredths.
    cells = sheet.cells[0]
    dpi = 150.0 if name.startswith("charuco") else 25.4 * 96.0 / (cells.cell * len(cells.black))
    picture = photo(board_picture(sheet, dpi))
    target = job_target(sheet)
    assert replace(sheet, target=target).yaml == sheet.yaml
    found = TargetDetector(target).detect(picture)
    expected = {
        "marker": 4,
        "big tag": 4,
        "charuco": 24,
        "charuco, even rows": 20,
        "aprilgrid": 12,
        "grid": 8,
    }
    assert len(found) == expected[name] and not found.others and not found.duplicates
    off = found.points_2d * 25.4 / dpi - on_the_page(found.points_3d, sheet)
    assert np.abs(off).max() < 0.1, np.abs(off).max()
    size = np.ptp(found.points_2d, axis=0) * 25.4 / dpi
    assert size == pytest.approx(1000.0 * np.ptp(found.points_3d[:, :2], axis=0), abs=0.1)


@pytest.mark.parametrize("name", SHEETS)
def test_the_pdf_draws_the_same(name):
    """Its operators, followed by hand, give the same picture, to a sixteenth of a millimetre."""
    sheet = lay_out(**SHEETS[name])
    drawn = follow(board_pdf(sheet), dots=DOTS)
    picture = board_picture(sheet, DOTS * 25.4, text=False)
    assert drawn.shape == picture.shape
    # Edges apart: `fillPoly` blackens all pixels that they touch.
    edges = cv2.morphologyEx(picture, cv2.MORPH_GRADIENT, np.ones((3, 3))) > 0
    assert edges.mean() < 0.1 and (drawn == picture)[~edges].all()


def follow(pdf: bytes, dots: int) -> np.ndarray:
    """The page of a PDF of ours at `dots` a millimetre; checks the table of places on the way."""
    start = int(re.search(rb"startxref\n(\d+)\n%%EOF\n$", pdf)[1])
    assert pdf[start : start + 4] == b"xref"
    for number, place in enumerate(re.findall(rb"(\d{10}) 00000 n ", pdf[start:]), start=1):
        assert pdf[int(place) :].startswith(b"%d 0 obj\n" % number)
    width, height = (float(v) for v in re.search(rb"/MediaBox \[0 0 (\S+) (\S+)\]", pdf).groups())
    length, content = re.search(rb"/Length (\d+) >>\nstream\n(.*)\nendstream", pdf, re.S).groups()
    assert len(content) == int(length)
    scale = dots * 25.4 / 72.0
    page = np.full((round(height * scale), round(width * scale)), 255, np.uint8)
    loops: list[list] = []
    stack: list[float] = []
    text = re.sub(rb"BT .* ET", b"", content).split()
    for word in text:
        if re.fullmatch(rb"-?\d+(\.\d+)?", word):
            stack.append(float(word))
            continue
        if word == b"m":
            loops.append([stack])
        elif word == b"l":
            loops[-1].append(stack)
        elif word == b"re":
            x, y, w, h = stack
            loops.append([[x, y], [x + w, y], [x + w, y + h], [x, y + h]])
        elif word in (b"f", b"f*"):
            shapes = [
                np.rint(16 * (np.array(loop) * [1, -1] + [0, height]) * scale - 8).astype(np.int32)
                for loop in loops
            ]
            cv2.fillPoly(page, shapes, 0, shift=4)  # even-odd, as f*
            loops = []
        else:
            assert word in (b"g", b"h"), word
        stack = []
    return page


def test_the_ruler_is_a_hundred_millimetres():
    sheet = lay_out("charuco")
    picture = board_picture(sheet, 600.0, text=False)
    x, y = sheet.ruler
    row = picture[round((y - 3.5) * 600 / 25.4)]
    ticks = np.flatnonzero(row < 128)
    assert (ticks.max() - ticks.min() - np.ptp(ticks[ticks < row.size / 2])) * 25.4 / 600 == pytest.approx(
        100.0, abs=0.1
    )


def test_opencv_draws_the_same_marker():
    sheet = lay_out("marker", dictionary="DICT_6X6_250", marker_id=123, side=0.064)
    cells = sheet.cells[0]
    drawn = cv2.aruco.generateImageMarker(
        cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_6X6_250), 123, len(cells.black)
    )
    assert (cells.black == (drawn < 128)).all()
    tag = lay_out("marker", dictionary="tag36h11", marker_id=0).cells[0].black
    drawn = cv2.aruco.generateImageMarker(
        cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11), 0, len(tag)
    )
    assert (tag == ((drawn[::-1, ::-1] if tags_are_turned() else drawn) < 128)).all()


def test_outlines_fill_to_the_cells():
    rng = np.random.default_rng(5)
    for _ in range(50):
        black = rng.random((rng.integers(1, 9), rng.integers(1, 9))) < 0.5
        page = np.zeros((black.shape[0] * 8 + 1, black.shape[1] * 8 + 1), np.uint8)
        loops = [np.array([(8 * c, 8 * r) for r, c in loop], np.int32) for loop in outlines(black)]
        if loops:
            cv2.fillPoly(page, loops, 1)
        assert (page[4::8, 4::8].astype(bool) == black).all()


def test_files_are_written_with_their_resolution(tmp_path):
    sheet = mrbatch.make_board("marker", [tmp_path / "m.pdf", tmp_path / "m.png"], dpi=150.0)
    with Image.open(tmp_path / "m.png") as image:
        assert image.size == (1240, 1754) and image.info["dpi"] == pytest.approx((150.0, 150.0), rel=1e-3)
    first = (tmp_path / "m.pdf").read_bytes()
    assert first == board_pdf(sheet) and b"side 60 mm" in first and b"DICT_4X4_50, id 0" in first
    assert sorted(p.name for p in tmp_path.iterdir()) == ["m.pdf", "m.png"]


def test_the_command_prints_the_target(tmp_path):
    arguments = [
        "board",
        "--type",
        "marker",
        "--id",
        "7",
        "--side",
        "60 mm",
        "--output",
        str(tmp_path / "m.pdf"),
    ]
    result = CliRunner().invoke(main, arguments, catch_exceptions=False)
    assert result.exit_code == 0
    assert result.stdout == "target:\n  marker: {dictionary: DICT_4X4_50, id: 7, side: 60 mm}\n"
    for wrong in (["--side", "60"], ["--squares", "seven"], ["--id", "50"], ["--dictionary", "DICT_9X9"]):
        result = CliRunner().invoke(main, [*arguments, *wrong])
        assert result.exit_code == 2 and "internal" not in result.output, wrong


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"kind": "marker", "side": 0.25}, "does not fit on A4"),
        ({"kind": "charuco", "squares": (7, 5), "square": 0.05}, "does not fit"),
        ({"kind": "marker", "paper": "B9"}, "there is no paper `B9`"),
        ({"kind": "marker", "paper": "90x90mm"}, "expected 120 mm"),
        ({"kind": "grid", "squares": (0, 4)}, "1 to 100 columns"),
    ],
)
def test_what_cannot_be_printed(options, said):
    with pytest.raises(JobError, match=said):
        lay_out(**options)


def test_wrong_outputs(tmp_path):
    with pytest.raises(JobError, match=r"written as .pdf or .png"):
        mrbatch.make_board("marker", tmp_path / "m.svg")
    with pytest.raises(JobError, match="id 50 is not in DICT_4X4_50"):
        mrbatch.make_board("marker", tmp_path / "m.pdf", marker_id=50)
    with pytest.raises(JobError, match="folder does not exist"):
        mrbatch.make_board("marker", tmp_path / "none" / "m.pdf")


def test_papers():
    assert paper_size("a4") == (210.0, 297.0) and paper_size("Letter") == (215.9, 279.4)
    assert paper_size("12 x 9 in") == pytest.approx((304.8, 228.6))
