"""The command line: light to start, one place for errors, `validate` and `schema`."""

from __future__ import annotations

import json
import subprocess
import sys

import click
import pytest
from click.testing import CliRunner

from mrbatch import cli
from mrbatch.capture.registry import CAPTURES
from mrbatch.contracts import CaptureKind, Method, Pipeline
from mrbatch.errors import InputError, Place
from mrbatch.methods.registry import METHODS
from mrbatch.quantities import InputPath, Settings

HEAVY = ("warp", "cv2", "open3d", "av", "OpenImageIO", "scipy", "trimesh", "pydantic", "numpy", "rich")


class Footage(Settings):
    video: InputPath


class Knobs(Settings):
    spp: int = 4


@pytest.fixture(autouse=True)
def toys(monkeypatch):
    kind = CaptureKind("toy", "a toy", Footage, lambda *_: None)
    method = Method("toy", "a toy", ("toy",), Knobs, lambda *_: Pipeline(), ("virtual",))
    monkeypatch.setattr(CAPTURES, "_entries", {"toy": kind})
    monkeypatch.setattr(METHODS, "_entries", {"toy": method})


@pytest.fixture
def job(tmp_path):
    file = tmp_path / "desk.yaml"
    file.write_text("capture: {kind: toy, video: a.mp4}\nmethod: {name: toy}\n", encoding="utf-8")
    (tmp_path / "a.mp4").touch()
    return file


def run(*args):
    return CliRunner().invoke(cli.main, [str(a) for a in args])


@pytest.mark.parametrize("arguments", [["--help"], ["--version"], ["rendr"]])
def test_starting_imports_nothing_heavy(arguments):
    code = (
        "import sys, mrbatch\nfrom mrbatch.cli import main\n"
        f"try: main({arguments!r})\nexcept SystemExit: pass\n"
        f"print([m for m in {HEAVY!r} if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


def test_validate_imports_no_renderer(job):
    code = (
        "import sys\nfrom mrbatch.job import load_job\n"
        "print([m for m in ('warp', 'cv2', 'open3d', 'av', 'OpenImageIO') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["[]"]


def test_help_lists_every_command():
    result = run("--help")
    assert result.exit_code == 0
    for name in ["render", "plan", "validate", "metrics", "report", "info", "schema", "doctor"]:
        assert f"\n  {name} " in result.output
    assert run("--version").output == "mrbatch 0.1.0\n"


def test_validate_says_ok(job):
    result = run("validate", job)
    assert result.exit_code == 0 and result.output.startswith("OK")
    for word in ("desk", "toy", "all", "composite"):
        assert word in result.output


def test_validate_shows_all_errors_of_all_jobs(job, tmp_path):
    other = tmp_path / "other.yaml"
    other.write_text(
        "capture: {kind: toy, video: b.mp4}\nmethod: {name: toy, ssp: 3}\nsead: 1\n", encoding="utf-8"
    )
    result = run("validate", job, other)
    assert result.exit_code == 2
    assert "OK" in result.stdout
    assert f"{other}:2:21: unknown key `ssp`" in result.stderr and f"{other}:3:1:" in result.stderr
    assert "did you mean `seed`?" in result.stderr and "3 errors" in result.stderr
    assert f"{other}:1:29: `capture.video`: there is no file" in result.stderr
    assert "Traceback" not in result.stderr


def test_validate_missing_file_and_options(job, tmp_path):
    (tmp_path / "a.mp4").unlink()
    result = run("validate", job)
    assert result.exit_code == 2 and f"{job}:1:29: `capture.video`: there is no file" in result.stderr
    assert run("validate", "--no-files", job).exit_code == 0
    result = run("validate", "--no-files", "--set", "capture.video=../b.mp4", "--confine", tmp_path, job)
    assert result.exit_code == 2 and "leads out of" in result.stderr
    result = run("validate", "--no-files", "--resolved", "--set", "seed=9", job)
    assert json.loads(result.stdout)["seed"] == 9


def test_misspelt_command_and_option():
    result = run("valdate")
    assert result.exit_code == 2 and "did you mean `validate`?" in result.stderr
    assert run("validate").exit_code == 2
    assert run("validate", "--nofiles", "x").exit_code == 2


def test_schema_and_manual(tmp_path):
    assert json.loads(run("schema").stdout)["title"] == "mrbatch job"
    assert run("schema", "--output", tmp_path / "s.json").exit_code == 0
    assert json.loads((tmp_path / "s.json").read_text(encoding="utf-8"))["type"] == "object"
    assert run("schema", "--manual").stdout.startswith("# The job file")
    result = run("schema", "--output", tmp_path / "no" / "s.json")
    assert result.exit_code == 5 and "cannot write" in result.stderr


@pytest.mark.parametrize(
    ("raised", "code", "words"),
    [
        (
            InputError("the map holds NaN", place=Place(file="e.exr"), hint="x"),
            3,
            "error: e.exr: the map holds NaN",
        ),
        (KeyboardInterrupt(), 130, "interrupted"),
        (MemoryError(), 5, "out of memory"),
        (ZeroDivisionError("oh"), 70, "internal error: ZeroDivisionError: oh"),
        (click.FileError("f", "gone"), 2, "gone"),
    ],
)
def test_errors_become_codes(monkeypatch, raised, code, words):
    @click.command()
    def broken():
        raise raised

    monkeypatch.setattr(cli.LazyGroup, "get_command", lambda *_: broken)
    result = run("info")
    assert result.exit_code == code and words in result.stderr and "Traceback" not in result.stderr
    again = run("info", "--debug")
    assert again.exit_code == code
    assert ("Traceback" in again.stderr) == (code in (3, 5, 70))


@pytest.mark.parametrize("text", ["", "\n\n", "# later\n", "---\n", "{}\n"])
def test_an_empty_job_is_told_how_to_start(tmp_path, text):
    (tmp_path / "job.yaml").write_text(text, encoding="utf-8")
    result = run("validate", tmp_path / "job.yaml")
    assert result.exit_code == 2 and "job.yaml: the job is empty" in result.stderr
    assert "^" not in result.stderr and "capture: {kind:" in result.stderr and "method:" in result.stderr
    assert result.stderr.count("error:") == 1


def test_what_is_not_decided_yet_is_said(job):
    result = run("validate", job)
    assert "auto, " not in result.output
    words = " ".join(result.output.split())
    assert "colour half or float, decided when the footage has been looked at" in words
    assert "colour float" in " ".join(run("validate", job, "--set", "output.dtype=float").output.split())
