"""Open3D is imported on machines that lack libusb, and its absence is a user's error."""

from __future__ import annotations

import builtins
import subprocess
import sys

import pytest

from mrbatch.errors import ResourceError
from mrbatch.scene import open3d_loader


@pytest.mark.slow
def test_open3d_reads_points_after_the_loader():
    # In a process of its own, so that nothing has loaded libusb before.
    code = (
        "from mrbatch.scene.open3d_loader import open3d\n"
        "o3d = open3d()\n"
        "cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector([[1.0, 2.0, 3.0]]))\n"
        "print(cloud.get_center())\n"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.split() == ["[1.", "2.", "3.]"]


def test_a_missing_open3d_is_named(monkeypatch):
    real = builtins.__import__

    def without(name, *arguments, **options):
        if name == "open3d":
            raise ImportError("libX11.so.6: cannot open shared object file")
        return real(name, *arguments, **options)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(ResourceError, match="libX11") as caught:
        open3d_loader.open3d.__wrapped__()
    assert "open3d" in caught.value.hint
