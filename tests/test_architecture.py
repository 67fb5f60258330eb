"""The floor plan of the package: imports flow one way, rooms have names, files stay small."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "mrbatch"
LIMIT = 400
"""Lines above which a file is usually two concepts."""
LONGER = {
    "metrics/errors.py": "the figures share windows and weights",
    "capture/marker_video/video.py": "one reader: table, decoding and colour of a video",
    "methods/delta_path_tracing/kernels.py": "one kernel, which is the estimator",
    "film/exr.py": "writing, reading and checking mirror each other",
    "batch/run.py": "one loop: claims, commits and failures of frames",
}


def contract() -> dict:
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    return tomllib.loads(text)["tool"]["importlinter"]["contracts"][0]


def check_imports(folder: Path) -> subprocess.CompletedProcess[str]:
    code = "import sys; from importlinter.cli import lint_imports; sys.exit(lint_imports(no_cache=True))"
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    return subprocess.run(
        [sys.executable, "-c", code],
        cwd=folder,
        capture_output=True,
        text=True,
        env={**environment, "PYTHONPATH": str(folder), "PYTHONIOENCODING": "utf-8"},
        check=False,
    )


@pytest.fixture
def copy(tmp_path):
    """The package's sources in a folder of their own."""
    shutil.copytree(PACKAGE, tmp_path / "mrbatch", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    return tmp_path


def test_imports_flow_one_way():
    result = check_imports(ROOT)
    assert result.returncode == 0, result.stdout + result.stderr


@pytest.mark.parametrize(
    ("room", "line"),
    [
        ("kernels", "from mrbatch.film import layers"),
        ("device", "import mrbatch.job"),
        ("scene", "def late():\n    from mrbatch.capture import frame"),
        ("report", "from mrbatch.batch.run import run"),
    ],
)
def test_a_wrong_import_is_found(copy, room, line):
    (copy / "mrbatch" / room / "planted.py").write_text(line + "\n", encoding="utf-8")
    result = check_imports(copy)
    assert result.returncode != 0
    assert f"mrbatch.{room}.planted" in result.stdout


def test_every_room_is_in_the_contract():
    modules = {path.stem for path in PACKAGE.glob("*.py") if not path.stem.startswith("__")}
    rooms = {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    assert {f"mrbatch.{name}" for name in modules | rooms} == set(contract()["layers"])


def test_nothing_is_called_utils():
    banned = re.compile(r"^(utils?|commons?|helpers?|managers?|misc)$|_(utils?|helpers?|manager)$")
    found = [path for path in PACKAGE.rglob("*") if banned.search(path.stem) and path.suffix in {"", ".py"}]
    assert not found


def test_files_hold_one_concept():
    long = {
        path.relative_to(PACKAGE).as_posix(): count
        for path in PACKAGE.rglob("*.py")
        if (count := len(path.read_text(encoding="utf-8").splitlines())) > LIMIT
    }
    assert not {name: count for name, count in long.items() if name not in LONGER}
    assert all((PACKAGE / name).is_file() for name in LONGER), "a file of the list is gone"
    # A reason makes a file a little longer, not twice as long.
    assert all(count <= LIMIT * 5 // 4 for count in long.values()), long


def test_every_file_says_what_it_is():
    silent = [
        path.relative_to(PACKAGE).as_posix()
        for path in PACKAGE.rglob("*.py")
        if not path.read_text(encoding="utf-8").lstrip().startswith(('"""', 'r"""'))
    ]
    assert not silent
