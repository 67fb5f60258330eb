"""`import mrbatch` and the help of the command line load no heavy library."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

HEAVY = (
    "warp",
    "cv2",
    "open3d",
    "av",
    "OpenImageIO",
    "scipy",
    "trimesh",
    "PIL",
    "embreex",
    "numpy",
    "pydantic",
)


def loaded_after(code: str) -> set[str]:
    text = f"import sys, json\n{code}\nprint(json.dumps(sorted(sys.modules)), file=sys.__stderr__)"
    result = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, check=True)
    return {name.partition(".")[0] for name in json.loads(result.stderr.splitlines()[-1])}


@pytest.mark.parametrize(
    "code",
    [
        "import mrbatch",
        "import mrbatch.contracts, mrbatch.errors",
        "from mrbatch.cli import main\nmain(['--help'], standalone_mode=False)",
        "from mrbatch.cli import main\nmain(['--version'], standalone_mode=False)",
        "from mrbatch.cli import main\nmain(['doctor', '--help'], standalone_mode=False)",
    ],
)
def test_nothing_heavy_is_loaded(code):
    assert not loaded_after(code) & set(HEAVY)


def test_a_job_is_read_without_what_renders_it():
    assert not loaded_after("from mrbatch import load_job") & {"warp", "cv2", "open3d", "av", "embreex"}


def test_the_probe_sees_what_is_loaded():
    assert "numpy" in loaded_after("import numpy")


def test_public_names_are_there():
    import mrbatch

    assert all(getattr(mrbatch, name) is not None for name in mrbatch.__all__)
    with pytest.raises(AttributeError, match="no_such_name"):
        mrbatch.no_such_name  # noqa: B018
