"""`mrbatch metrics` and `mrbatch report` as a user calls them."""

from __future__ import annotations

import json
import math
from xml.etree import ElementTree

import cv2
import numpy as np
import OpenImageIO as oiio
import pytest
from click.testing import CliRunner

from mrbatch.cli.metrics import command as metrics
from mrbatch.cli.report import command as draw
from mrbatch.errors import InputError
from mrbatch.report.comparison import CompareSettings, compare
from mrbatch.report.model import Job, Report, load_report, save_report
from mrbatch.report.pairs import find_pairs


def exr(path, values, **layers):
    path.parent.mkdir(exist_ok=True)
    planes, names = [values], ["R", "G", "B"]
    for name, layer in layers.items():
        planes.append(layer)
        names += [f"{name}.{c}" for c in "RGB"]
    joined = np.ascontiguousarray(np.concatenate(planes, axis=2).astype(np.float32))
    spec = oiio.ImageSpec(joined.shape[1], joined.shape[0], joined.shape[2], "float")
    spec.channelnames = tuple(names)
    out = oiio.ImageOutput.create(str(path))
    assert out.open(str(path), spec) and out.write_image(joined)
    out.close()
    return path


def pictures(seed=0, scale=1.1):
    without = np.random.default_rng(seed).uniform(0.2, 0.8, (48, 64, 3))
    reference = without.copy()
    reference[20:28, 30:40] = 0.1
    test = reference.copy()
    test[20:28, 30:40] *= scale
    return test, reference, without


@pytest.fixture
def files(tmp_path):
    return [exr(tmp_path / f"{name}.exr", p) for name, p in zip(("test", "ref", "without"), pictures())]


def run(*arguments):
    return CliRunner().invoke(metrics, [str(a) for a in arguments])


def figure(report, metric, scope, frame=0):
    return next(s.value.value for s in report.frames[frame].scores if (s.metric, s.scope) == (metric, scope))


def test_figures_of_two_files(files, tmp_path):
    result = run(files[0], files[1], "--without", files[2], "--no-flip", "--json", tmp_path / "m.json")
    assert result.exit_code == 0, result.output
    report = load_report(tmp_path / "m.json")
    test, reference, without = (p.astype(np.float32).astype(np.float64) for p in pictures())
    m = reference.mean()
    per_pixel = ((test - reference) ** 2 / (reference**2 + 0.01 * m * m)).mean(axis=2)
    assert figure(report, "relmse", "frame") == pytest.approx(per_pixel.mean(), rel=1e-9)
    changed = (np.abs(reference - without) > 0.005 * m).any(axis=2)
    rows, columns = np.nonzero(changed)
    y, x = np.mgrid[:48, :64]
    near = (((y[..., None] - rows) ** 2 + (x[..., None] - columns) ** 2) <= 64).any(axis=2)
    assert figure(report, "relmse", "region") == pytest.approx(per_pixel[near].mean(), rel=1e-9)
    assert "relMSE" in result.output and "region" in result.output


def test_gates_decide_the_exit_code(files, tmp_path):
    test, reference, _ = pictures()
    value = math.sqrt(((test - reference) ** 2).mean())
    arguments = [files[0], files[1], "--no-flip", "--junit", tmp_path / "m.xml"]
    assert run(*arguments, "--max-rmse", 1.01 * value).exit_code == 0
    failed = run(*arguments, "--max-rmse", 0.99 * value, "--min-psnr", 1)
    assert failed.exit_code == 1 and "failed" in failed.output
    root = ElementTree.parse(tmp_path / "m.xml").getroot()
    assert root.get("failures") == "1" and root.get("tests") == "3"
    # The worst tile is worse than the frame.
    assert run(*arguments, "--max-rmse", 1.01 * value, "--on", "tile").exit_code == 1


def test_page_with_error_maps(files, tmp_path):
    result = run(files[0], files[1], "--html", tmp_path / "m.html", "--exposures", "-1,2,4")
    assert result.exit_code == 0, result.output
    page = (tmp_path / "m.html").read_text("utf-8")
    assert page.count("<img") == 5
    for words in ("Reference", "Difference", "FLIP", "relMSE"):
        assert words in page


def test_folders_with_the_same_names(tmp_path):
    for i, scale in enumerate((1.0, 1.05, 1.3)):
        test, reference, without = pictures(i, scale)
        for folder, picture in (("t", test), ("r", reference), ("w", without)):
            exr(tmp_path / folder / f"desk.{i + 7:04d}.exr", picture)
    arguments = [tmp_path / "t", tmp_path / "r", "--without", tmp_path / "w", "--no-flip"]
    result = run(*arguments, "--json", tmp_path / "m.json", "--max-relmse", 0.01)
    assert result.exit_code == 1
    report = load_report(tmp_path / "m.json")
    assert [f.number for f in report.frames] == [7, 8, 9]
    assert report.gates[0].frame == 9 and not report.gates[0].passed
    assert figure(report, "psnr", "frame", 0) == math.inf

    (tmp_path / "t" / "desk.0008.exr").write_bytes(b"broken")
    result = run(*arguments, "--json", tmp_path / "m.json")
    assert result.exit_code == 4
    states = {f.number: f.state for f in load_report(tmp_path / "m.json").frames}
    assert states == {7: "done", 8: "failed", 9: "done"}

    (tmp_path / "r" / "desk.0009.exr").unlink()
    result = run(*arguments, "--all")
    assert isinstance(result.exception, InputError) and "desk.0009.exr" in str(result.exception)


def test_partial_folders_are_compared_where_both_have_frames(tmp_path):
    for number in (1, 2, 3):
        test, reference, _ = pictures(number)
        exr(tmp_path / "t" / f"desk.{number:04d}.exr", test)
        if number != 2:
            exr(tmp_path / "r" / f"desk.{number:04d}.exr", reference)
    result = run(tmp_path / "t", tmp_path / "r", "--no-flip", "--json", tmp_path / "m.json")
    assert result.exit_code == 0, result.output
    report = load_report(tmp_path / "m.json")
    assert [f.number for f in report.frames] == [1, 3]
    assert "desk.0002.exr" in report.notes[0].text and "desk.0002.exr" in result.output
    (tmp_path / "r" / "desk.0001.exr").rename(tmp_path / "r" / "other.0001.exr")
    (tmp_path / "r" / "desk.0003.exr").unlink()
    result = run(tmp_path / "t", tmp_path / "r", "--no-flip")
    assert isinstance(result.exception, InputError) and "share no picture" in str(result.exception)
    assert "desk.0001.exr" in str(result.exception) and "other.0001.exr" in str(result.exception)


def test_previews_are_no_frames(tmp_path):
    for folder in ("t", "r"):
        exr(tmp_path / folder / "desk.0001.exr", pictures()[0])
        for name in ("contact_sheet.png", "desk.0001.png"):
            (tmp_path / folder / name).write_bytes(b"a preview that nobody reads")
    result = run(tmp_path / "t", tmp_path / "r", "--no-flip", "--json", tmp_path / "m.json")
    assert result.exit_code == 0, result.output
    assert [f.files[0].path for f in load_report(tmp_path / "m.json").frames] == ["desk.0001.exr"]
    for folder in ("t", "r"):
        (tmp_path / folder / "desk.0001.exr").unlink()
        cv2.imwrite(str(tmp_path / folder / "desk.0001.png"), np.full((20, 30, 3), 90, np.uint8))
    result = run(tmp_path / "t", tmp_path / "r", "--no-flip", "--all", "--json", tmp_path / "m.json")
    assert result.exit_code == 0, result.output
    assert [f.files[0].path for f in load_report(tmp_path / "m.json").frames] == ["desk.0001.png"]


def test_a_signed_layer_is_drawn_signed(tmp_path):
    flat = np.zeros((40, 60, 3))
    change = np.full((40, 60, 3), -0.2)
    change[:, :30] = 0.1
    for name, factor in (("a", 1.0), ("b", 0.5)):
        exr(tmp_path / f"{name}.exr", flat, delta=factor * change)
    pair = find_pairs(tmp_path / "a.exr", tmp_path / "b.exr")
    _, images = compare(pair, CompareSettings(layer="delta", flip=False, pictures=True))
    test, reference = images["a.exr#composite"], images["a.exr#reference"]
    assert test[0, 0, 0] > 127 > test[0, 59, 0] and reference[0, 0, 0] > 127 > reference[0, 59, 0]
    assert test[0, 59, 0] == 0 and reference[0, 59, 0] > 0  # one scale for both


def test_layer_mask_and_grey_pictures(tmp_path):
    test, reference, _ = pictures()
    a = exr(tmp_path / "a.exr", test, delta=test - 0.5)
    b = exr(tmp_path / "b.exr", reference, delta=reference - 0.5)
    mask = np.zeros((48, 64, 3))
    mask[20:28, 30:40] = 1
    m = exr(tmp_path / "mask.exr", mask)
    result = run(a, b, "--layer", "delta", "--roi", m, "--no-flip", "--json", tmp_path / "m.json")
    assert result.exit_code == 0, result.output
    inside = (test - reference)[20:28, 30:40]
    rmse = figure(load_report(tmp_path / "m.json"), "rmse", "region")
    assert rmse == pytest.approx(np.sqrt((inside**2).mean()), rel=1e-5)


@pytest.mark.parametrize(
    "change, words",
    [
        (lambda f, t: [f[0], t], "a file can be compared with a file only"),
        (lambda f, t: [f[0], t / "no.exr"], "no such file"),
        (lambda f, t: [f[0], f[1], "--roi", "auto"], "without the virtual objects"),
        (lambda f, t: [f[0], exr(t / "s.exr", np.ones((4, 4, 3)))], "4x4"),
        (lambda f, t: [exr(t / "n.exr", np.full((48, 64, 3), np.nan)), f[1]], "NaN"),
        (lambda f, t: [f[0], f[1], "--layer", "shadow"], "no layer"),
        (lambda f, t: [f[0], f[1], "--max-relmse", "1", "--on", "region"], "nothing was measured"),
    ],
)
def test_wrong_input_is_one_clear_error(files, tmp_path, change, words):
    result = run(*change(files, tmp_path), "--no-flip")
    assert isinstance(result.exception, InputError) and words in str(result.exception)


def test_wrong_options_are_usage_errors(files):
    assert run(*files[:2], "--gain", "1,2").exit_code == 2
    assert run(*files[:2], "--gain", "one").exit_code == 2
    assert run(*files[:2], "--exposures", "1,2,inf").exit_code == 2


def test_report_is_drawn_again(tmp_path):
    save_report(Report(job=Job(name="desk <1>")), tmp_path / "report.json")
    result = CliRunner().invoke(draw, [str(tmp_path)])
    assert result.exit_code == 0
    assert "desk &lt;1&gt;" in (tmp_path / "report.html").read_text("utf-8")
    files = [str(tmp_path / name) for name in ("x.md", "x.xml")]
    arguments = [str(tmp_path / "report.json"), "--markdown", files[0], "--junit", files[1]]
    assert CliRunner().invoke(draw, arguments).exit_code == 0
    assert ElementTree.parse(files[1]).getroot().tag == "testsuites"
    assert json.loads((tmp_path / "report.json").read_text("utf-8"))["job"]["name"] == "desk <1>"
    missing = CliRunner().invoke(draw, [str(tmp_path / "nowhere")])
    assert isinstance(missing.exception, InputError)
