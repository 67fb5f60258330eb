"""Where compiled kernels cannot be kept, a user is told so."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest
import warp as wp

from mrbatch.contracts import Domain, Pass, Pipeline
from mrbatch.device.runner import Runner
from mrbatch.device.timing import TimingNode
from mrbatch.errors import ResourceError


def test_a_cache_that_cannot_be_made_is_named(tmp_path):
    (tmp_path / "file").write_text("in the way")
    code = (
        "from mrbatch.device.startup import start\n"
        "from mrbatch.errors import ResourceError\n"
        "try:\n    start()\n"
        "except ResourceError as error:\n    print(error.message, error.hint)\n"
    )
    result = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        env={**os.environ, "WARP_CACHE_PATH": str(tmp_path / "file")},
        check=True,
    )
    assert "compiled kernels" in result.stdout
    assert "WARP_CACHE_PATH" in result.stdout


def test_a_kernel_that_cannot_be_stored_is_an_error_of_resources(tmp_path, monkeypatch):
    @wp.kernel(enable_backward=False, module="unique")
    def lonely(out: wp.array(dtype=wp.float32)):
        out[wp.tid()] = 1.25

    (tmp_path / "file").write_text("in the way")
    step = Pass("lonely", Domain("points", 1, 1, 1), lambda context, span: None, kernels=(lonely,))
    with Runner(1) as runner:
        monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path / "file"))
        with pytest.raises(ResourceError, match="compiled kernels") as caught:
            runner.compile([Pipeline(frame=(step,))], TimingNode("job"))
    assert "WARP_CACHE_PATH" in caught.value.hint
