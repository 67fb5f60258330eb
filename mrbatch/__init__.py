"""mrbatch: puts virtual objects and volumes into captured datasets, lit by what was captured."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mrbatch.batch.job_run import plan_job as plan
    from mrbatch.batch.job_run import render_job as render
    from mrbatch.bench.regression import check_jobs
    from mrbatch.bench.sweep import sweep
    from mrbatch.capture.marker_video.board import make_board
    from mrbatch.capture.marker_video.bracket_merge import merge_hdr
    from mrbatch.capture.marker_video.calibrate import calibrate_camera
    from mrbatch.job import load_job
    from mrbatch.stability.run import check_stability

__version__ = "0.1.0"

__all__ = [
    "__version__",
    "calibrate_camera",
    "check_jobs",
    "check_stability",
    "load_job",
    "make_board",
    "merge_hdr",
    "plan",
    "render",
    "sweep",
]

_HOMES = {
    "calibrate_camera": ("mrbatch.capture.marker_video.calibrate", "calibrate_camera"),
    "check_jobs": ("mrbatch.bench.regression", "check_jobs"),
    "check_stability": ("mrbatch.stability.run", "check_stability"),
    "load_job": ("mrbatch.job", "load_job"),
    "make_board": ("mrbatch.capture.marker_video.board", "make_board"),
    "merge_hdr": ("mrbatch.capture.marker_video.bracket_merge", "merge_hdr"),
    "plan": ("mrbatch.batch.job_run", "plan_job"),
    "render": ("mrbatch.batch.job_run", "render_job"),
    "sweep": ("mrbatch.bench.sweep", "sweep"),
}
"""Public name to where it lives; loaded when first used, so that `import mrbatch` is light."""


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        module, attribute = _HOMES[name]
        return getattr(import_module(module), attribute)
    raise AttributeError(f"module `mrbatch` has no attribute `{name}`")


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOMES})
