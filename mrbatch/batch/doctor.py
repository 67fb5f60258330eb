"""What this machine can do: one small run with a known answer for each thing that a job leans on.

A check never takes the others down; what goes wrong becomes a line that says what to do. Nothing is
left behind, except that compiled kernels stay in the kernel cache.
"""

from __future__ import annotations

import importlib.metadata
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any, Literal

import numpy as np

from mrbatch.errors import EXIT_DONE, EXIT_RESOURCES, MrbatchError, ResourceError

Verdict = Literal["ok", "warning", "failed"]
"""`warning`: jobs run, with less; `failed`: a job of the sample's kind cannot run."""

GIB = 2**30
LEAST_MEMORY = 2 * GIB
LEAST_DISK = GIB


@dataclass(frozen=True)
class Finding:
    """What one check found. `hint`: what to do, empty where nothing is to do; `seconds`: what it took."""

    name: str
    verdict: Verdict
    detail: str
    hint: str = ""
    seconds: float = 0.0
    values: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Check:
    """A check: `run` gives detail and values, or raises. `hint`: what to do if it fails.

    `needed`: without it a job of the sample's kind cannot run.
    """

    name: str
    run: Callable[[], tuple[str, Mapping[str, Any]]]
    hint: str
    needed: bool = True


class Shortfall(Exception):
    """Raised by a check that found less than it wants, though jobs run: a warning."""

    def __init__(self, detail: str, hint: str):
        super().__init__(detail)
        self.hint = hint


def examine(*, thorough: bool = False, folder: Path | None = None) -> Iterator[Finding]:
    """Runs the checks one by one and gives each finding as it comes.

    `thorough`: with the heavy ones (Open3D); `folder`: where frames would be written (default: here).
    """
    for check in checks(thorough=thorough, folder=folder or Path.cwd()):
        yield run_check(check)


def run_check(check: Check) -> Finding:
    """Runs one check; whatever it raises becomes a finding."""
    began = time.perf_counter()
    verdict: Verdict = "ok"
    hint = ""
    values: dict[str, Any] = {}
    try:
        detail, found = check.run()
        values = dict(found)
    except Shortfall as short:
        verdict, detail, hint = "warning", str(short), short.hint
    except MrbatchError as error:
        verdict, detail, hint = _bad(check), error.message, error.hint or check.hint
    except Exception as error:
        text = " ".join(str(error).split())
        verdict, detail, hint = _bad(check), f"{type(error).__name__}: {text}", check.hint
    return Finding(check.name, verdict, detail, hint, time.perf_counter() - began, values)


def _bad(check: Check) -> Verdict:
    return "failed" if check.needed else "warning"


def exit_code(findings: list[Finding]) -> int:
    """0 where jobs can run, else 5."""
    return EXIT_RESOURCES if any(f.verdict == "failed" for f in findings) else EXIT_DONE


def checks(*, thorough: bool, folder: Path) -> list[Check]:
    """All checks, cheapest first; `thorough` adds Open3D."""
    reinstall = "install mrbatch again in a fresh virtual environment"
    listed = [
        Check("python", _python, "use CPython 3.11 or later, 64 bit"),
        Check("libraries", _libraries, reinstall),
        Check("cores", _cores, ""),
        Check("memory", _memory, ""),
        Check("disk", lambda: _disk(folder), "choose another folder with --output"),
        Check("kernel cache", _cache, "set WARP_CACHE_PATH to a folder that can be written"),
        Check("kernel compiler", _compiler, "install warp-lang again; it brings its own compiler"),
        Check(
            "ray engine Embree",
            _embree,
            "jobs will use Warp's own engine, which is slower; AVX2 is needed for this one",
            needed=False,
        ),
        Check("ray engine Warp", _warp_rays, "install warp-lang again"),
        Check("engines agree", _agree, "render with --set engine=warp and report this machine", needed=False),
        Check("EXR files", _exr, reinstall),
        Check("video", _video, reinstall),
        Check("markers", _markers, "install opencv-contrib-python-headless and no other OpenCV beside it"),
    ]
    if thorough:
        listed.append(
            Check("Open3D", _open3d, "only jobs with point clouds or depth pictures need it", needed=False)
        )
    return listed


def _python() -> tuple[str, Mapping[str, Any]]:
    version, bits = platform.python_version(), 64 if sys.maxsize > 2**32 else 32
    if sys.version_info < (3, 11) or bits != 64:
        raise ResourceError(f"Python {version}, {bits} bit")
    system = f"{platform.system()} {platform.machine()}"
    return f"{version}, {system}", {"python": version, "system": system}


def _libraries() -> tuple[str, Mapping[str, Any]]:
    """Every library that the package asks for is there, in a version it was made for."""
    from packaging.requirements import Requirement

    found: dict[str, str] = {}
    wrong = []
    for line in importlib.metadata.requires("mrbatch") or ():
        wanted = Requirement(line)
        if wanted.marker is not None and not wanted.marker.evaluate({"extra": ""}):
            continue
        try:
            version = importlib.metadata.version(wanted.name)
        except importlib.metadata.PackageNotFoundError:
            wrong.append(f"{wanted.name} is missing")
            continue
        found[wanted.name] = version
        if not wanted.specifier.contains(version, prereleases=True):
            wrong.append(f"{wanted.name} {version} is installed, {wanted.specifier} is wanted")
    if any(text.endswith("missing") for text in wrong):
        raise ResourceError("; ".join(wrong))
    if wrong:
        raise Shortfall("; ".join(wrong), "pip install the wanted versions; others are untested")
    text = ", ".join(f"{name} {version}" for name, version in found.items())
    return text, {"versions": found}


def _cores() -> tuple[str, Mapping[str, Any]]:
    from mrbatch.device.runner import usable_cores

    return f"{usable_cores()} to use of {os.cpu_count()}", {"usable": usable_cores(), "all": os.cpu_count()}


def _memory() -> tuple[str, Mapping[str, Any]]:
    import psutil

    memory = psutil.virtual_memory()
    text = f"{memory.available / GIB:.1f} GiB free of {memory.total / GIB:.1f}"
    if memory.available < LEAST_MEMORY:
        raise Shortfall(text, "close other programs; large pictures may need more")
    return text, {"available_bytes": memory.available, "total_bytes": memory.total}


def _disk(folder: Path) -> tuple[str, Mapping[str, Any]]:
    import psutil

    standing = next((p for p in (folder, *folder.resolve().parents) if p.is_dir()), Path.cwd())
    try:
        with tempfile.TemporaryFile(dir=standing) as file:
            file.write(b"mrbatch")
    except OSError as error:
        raise ResourceError(f"{standing} cannot be written: {error.strerror}") from error
    free = psutil.disk_usage(str(standing)).free
    text = f"{free / GIB:.1f} GiB free in {standing}"
    if free < LEAST_DISK:
        raise Shortfall(text, "free some space, or choose another folder with --output")
    return text, {"folder": str(standing), "free_bytes": free}


def _compiler() -> tuple[str, Mapping[str, Any]]:
    from mrbatch.device.self_test import compile_and_run

    seconds = compile_and_run()
    return f"a new kernel compiled in {seconds:.1f} s and ran", {"compile_seconds": seconds}


def _cache() -> tuple[str, Mapping[str, Any]]:
    from mrbatch.device.self_test import cache_folder

    folder = cache_folder()
    size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    return f"{folder}, writable, holds {size / 1e6:.0f} MB", {"folder": str(folder), "bytes": size}


def _embree() -> tuple[str, Mapping[str, Any]]:
    from mrbatch.device.embree import INSTRUCTION_SET
    from mrbatch.device.self_test import embree_version, hit_a_triangle

    version = embree_version()
    hit_a_triangle("embree")
    return f"{version} with {INSTRUCTION_SET} hits a triangle", {"version": version, "isa": INSTRUCTION_SET}


def _warp_rays() -> tuple[str, Mapping[str, Any]]:
    from mrbatch.device.self_test import hit_a_triangle

    hit_a_triangle("warp")
    return "hits a triangle", {}


def _agree() -> tuple[str, Mapping[str, Any]]:
    from mrbatch.device.self_test import engines_agree

    difference = engines_agree()
    return f"to {difference:.1e} of the scene's size", {"relative_difference": difference}


def _exr() -> tuple[str, Mapping[str, Any]]:
    """Two parts, one half and one float, written and read back to the bit."""
    import OpenImageIO as oiio

    rng = np.random.default_rng(1)
    parts: list[np.ndarray] = [rng.random((5, 7, 3)).astype(kind) for kind in (np.float16, np.float32)]
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        path = str(Path(folder) / "two_parts.exr")
        specs = [oiio.ImageSpec(7, 5, 3, kind) for kind in ("half", "float")]
        for spec, name in zip(specs, ("left", "right")):
            spec.attribute("name", name)
            spec.attribute("compression", "zip")
        output = oiio.ImageOutput.create(path)
        if output is None or not output.open(path, specs):
            raise ResourceError(f"EXR cannot be written: {oiio.geterror()}")
        for number, part in enumerate(parts):
            if number and not output.open(path, specs[number], "AppendSubimage"):
                raise ResourceError(f"a second part cannot be written: {output.geterror()}")
            if not output.write_image(part):
                raise ResourceError(f"EXR cannot be written: {output.geterror()}")
        output.close()
        source = oiio.ImageInput.open(path)
        if source is None:
            raise ResourceError(f"EXR cannot be read: {oiio.geterror()}")
        for number, part in enumerate(parts):
            back = np.asarray(source.read_image(number, 0, 0, 3, oiio.FLOAT))
            if not np.array_equal(back, part.astype(np.float32)):
                raise ResourceError("EXR pixels come back changed")
        source.close()
    return f"OpenImageIO {oiio.VERSION_STRING}: two parts written and read back", {}


def _video() -> tuple[str, Mapping[str, Any]]:
    """A short film is encoded and decoded; the right number of frames comes back."""
    import av

    if "h264" not in av.codecs_available:
        raise ResourceError("PyAV has no H.264 decoder")
    codec = "libx264" if "libx264" in av.codecs_available else "mpeg4"
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        path = str(Path(folder) / "film.mp4")
        with av.open(path, "w") as container:
            stream: Any = container.add_stream(codec, rate=Fraction(25))
            stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
            for level in (16, 96, 176, 235):
                picture = np.full((48, 64, 3), level, dtype=np.uint8)
                container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
            container.mux(stream.encode())
        with av.open(path) as container:
            shades = [int(frame.to_ndarray(format="gray").mean()) for frame in container.decode(video=0)]
    if len(shades) != 4 or shades != sorted(shades):
        raise ResourceError(f"a film of 4 frames comes back as {len(shades)}")
    if codec != "libx264":
        raise Shortfall(
            "H.264 is read; libx264 is missing", "preview videos will be MPEG-4: install `av` from PyPI"
        )
    return f"PyAV {av.__version__}: H.264 read and written", {"encoder": codec}


def _markers() -> tuple[str, Mapping[str, Any]]:
    """A marker is drawn and found again."""
    import cv2

    if not hasattr(cv2, "aruco"):
        raise ResourceError(f"OpenCV {cv2.__version__} comes without its module aruco")
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    page = np.full((200, 200), 255, dtype=np.uint8)
    page[50:150, 50:150] = cv2.aruco.generateImageMarker(dictionary, 7, 100)
    _, ids, _ = cv2.aruco.ArucoDetector(dictionary).detectMarkers(page)
    if ids is None or ids.ravel().tolist() != [7]:
        raise ResourceError(f"OpenCV {cv2.__version__} does not find a marker that it drew")
    return f"OpenCV {cv2.__version__}: a marker is drawn and found", {}


def _open3d() -> tuple[str, Mapping[str, Any]]:
    """In a process of its own: it is large, and a library that it lacks must not end this one."""
    code = "from mrbatch.scene.open3d_loader import open3d; print(open3d().__version__)"
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=300, check=False
    )
    if result.returncode:
        lines = [line for line in result.stderr.splitlines() if line.strip()]
        raise ResourceError(lines[-1] if lines else f"its import ended with code {result.returncode}")
    return f"{result.stdout.split()[-1]} is imported", {"version": result.stdout.split()[-1]}
