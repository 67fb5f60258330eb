"""A small but whole job on the real capture kind: pictures of noise, known poses, a box on a table.

Everything is made from fixed seeds, so that two folders with the same arguments hold the same bytes.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

WIDTH, HEIGHT = 64, 48
FOCAL = 70.0

CRATE = {
    "name": "crate",
    "box": {"size": ["80 mm", "60 mm", "100 mm"]},
    "transform": {"translate": [0, 0, "50 mm"]},
    "material": {"type": "diffuse", "reflectance": [0.7, 0.2, 0.1]},
}


def pose(number: int) -> np.ndarray:
    """world_from_camera (4, 4) of a frame: half a metre from the origin, turning slowly about +z."""
    angle = 0.3 + 0.05 * number
    eye = np.array([0.45 * np.sin(angle), -0.45 * np.cos(angle), 0.35])
    forward = -eye / np.linalg.norm(eye)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    matrix[:3, 3] = eye
    return matrix


def codes(number: int, dtype: Any, width: int = WIDTH, height: int = HEIGHT) -> np.ndarray:
    """The picture of a frame (height, width, 3): noise over the whole range of codes, or linear floats."""
    random = np.random.default_rng(1000 + number)
    if np.issubdtype(dtype, np.floating):
        return random.gamma(2.0, 0.25, (height, width, 3)).astype(dtype)
    return random.integers(0, np.iinfo(dtype).max, (height, width, 3), dtype=dtype, endpoint=True)


def write_picture(path: Path, values: np.ndarray) -> None:
    """PNG from uint8 or uint16, EXR from float32."""
    import OpenImageIO as oiio

    spec = oiio.ImageSpec(values.shape[1], values.shape[0], 3, str(values.dtype).replace("32", ""))
    spec.attribute("DateTime", "")  # else EXR files carry the second in which they were written
    out = oiio.ImageOutput.create(str(path))
    assert out.open(str(path), spec) and out.write_image(values) and out.close()


def sky() -> np.ndarray:
    """(8, 16, 3) float32: brighter above, with one strong light."""
    rows = np.linspace(1.5, 0.3, 8)[:, None, None] * np.array([0.9, 1.0, 1.1])
    values = np.broadcast_to(rows, (8, 16, 3)).astype(np.float32).copy()
    values[1, 5] = 60.0
    return values


def write_job(
    folder: Path,
    frames: Sequence[int] = (0, 1, 2, 3),
    *,
    dtype: Any = np.uint8,
    spp: int = 4,
    virtual: bool | list[dict[str, Any]] = True,
    width: int = WIDTH,
    height: int = HEIGHT,
    **parts: Any,
) -> Path:
    """Writes pictures, poses, sky and `job.yaml` into `folder`; `parts` replace top-level keys of the job."""
    folder.mkdir(parents=True, exist_ok=True)
    suffix = "exr" if np.issubdtype(np.dtype(dtype), np.floating) else "png"
    for number in frames:
        write_picture(folder / f"photo_{number:04d}.{suffix}", codes(number, dtype, width, height))
    write_picture(folder / "sky.exr", sky())
    poses = [{"frame": n, "world_from_camera": pose(n).tolist()} for n in frames]
    (folder / "poses.json").write_text(json.dumps(poses), encoding="utf-8")
    focal = FOCAL * width / WIDTH
    job: dict[str, Any] = {
        "name": "small",
        "capture": {
            "kind": "marker-video",
            "frames": f"photo_####.{suffix}",
            "poses": "poses.json",
            "camera": {
                "matrix": [[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]],
                "width": width,
                "height": height,
                "pixel_centres": "half",
            },
            "gain": 0.5,
        },
        "environment": {"file": "sky.exr"},
        "real": [{"name": "table", "plane": {"size": ["0.3 m", "0.3 m"]}, "reflectance": [0.4, 0.3, 0.2]}],
        "virtual": [CRATE] if virtual is True else virtual or [],
        "method": {"name": "delta-path-tracing", "spp": spp},
        "output": {"directory": "out", "preview": {"contact_sheet": False, "video": False}},
    }
    path = folder / "job.yaml"
    path.write_text(json.dumps(job | parts), encoding="utf-8")
    return path


def start(job: Path, out: Path, *options: object) -> subprocess.Popen[str]:
    """`mrbatch render` as a process of its own, telling its progress as JSON on standard error."""
    command = [sys.executable, "-m", "mrbatch", "render", str(job), "--output", str(out), "--no-report"]
    command += ["--progress", "json", "--threads", "1", *map(str, options)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def finish(process: subprocess.Popen[str], seconds: float = 120.0) -> list[dict[str, Any]]:
    """Waits for the end; the events that were told, without lines that are not JSON."""
    _, told = process.communicate(timeout=seconds)
    return [json.loads(line) for line in told.splitlines() if line.startswith("{")]


def wait_for(process: subprocess.Popen[str], kind: str) -> dict[str, Any]:
    """Reads events until one of `kind` comes."""
    assert process.stderr is not None
    lines = []
    for line in process.stderr:
        lines.append(line)
        if line.startswith("{") and (event := json.loads(line))["event"] == kind:
            return event
    raise AssertionError(f"no {kind}: {''.join(lines)}")


def frames_in(folder: Path) -> dict[str, bytes]:
    """The bytes of every frame under its final name."""
    return {path.name: path.read_bytes() for path in sorted(folder.glob("*.exr")) if path.name[0] != "."}


def strangers_in(folder: Path) -> list[str]:
    """Files that a run must not leave: temporary ones, claims, signs of life."""
    names = [path.name for path in folder.rglob("*") if path.is_file()]
    return [name for name in names if name.startswith(".") or name.endswith((".claim", ".alive"))]
