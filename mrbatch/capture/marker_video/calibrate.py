"""From pictures or a video of a board to a calibration file, one call."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from mrbatch.capture.data_file import parse_yaml, read_text
from mrbatch.capture.marker_video.calibration_fit import (
    MODELS,
    CalibrationFit,
    Coverage,
    coverage,
    fit_calibration,
    weaknesses,
)
from mrbatch.capture.marker_video.calibration_picture import residual_picture
from mrbatch.capture.marker_video.calibration_views import Views, choose_views, find_views
from mrbatch.capture.marker_video.target_settings import BoardSettings, TargetSettings
from mrbatch.errors import JobError, Place, ResourceError

MAX_VIEWS = 40


@dataclass(frozen=True)
class CalibrationReport:
    """What was found, in what, and what to do better. `fit.matrix` counts pixel centres at integers."""

    fit: CalibrationFit
    views: Views
    coverage: Coverage
    warnings: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """The content of the calibration file, and what was left out."""
        return {
            **_content(self.fit),
            "looked_at": self.views.looked_at,
            "unseen": list(self.views.unseen),
            "blurred": list(self.views.blurred),
            "dropped": [{"view": name, "rms_px": error} for name, error in self.fit.dropped],
            "view_rms_px": dict(zip((v.name for v in self.fit.views), self.fit.view_rms)),
            "coverage": {
                "cells": self.coverage.cells,
                "reach": self.coverage.reach,
                "tilt_deg": self.coverage.tilt,
            },
            "warnings": list(self.warnings),
        }


def calibrate_camera(
    files: Sequence[str | Path],
    board: str | Path | BoardSettings,
    output: str | Path,
    *,
    picture: str | Path | None = None,
    coefficients: int | None = None,
    max_views: int = MAX_VIEWS,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> CalibrationReport:
    """Calibrates a camera from pictures of a board, or from one video, and writes `output` (YAML).

    `board`: settings, a YAML file with them (what `mrbatch board` prints, or a job), or their text.
    `picture`: a PNG of the residuals. `coefficients` of distortion: 0, 2, 4, 5 or 8; None to choose. Raises
    JobError: wrong arguments; InputError: files that cannot be read, too few views; ResourceError.
    """
    target = TargetSettings(board=board if isinstance(board, BoardSettings) else read_board(board))
    paths, result = [Path(f) for f in files], Path(output)
    if coefficients is not None and coefficients not in MODELS:
        raise JobError(f"{coefficients} distortion coefficients: expected one of {MODELS}")
    if not paths:
        raise JobError("no pictures are given")
    for path in (result, *([Path(picture)] if picture else [])):
        if not path.parent.is_dir():
            raise JobError("the output's folder does not exist", place=Place(file=str(path)))
        if path.resolve() in [p.resolve() for p in paths]:
            raise JobError("the output is one of the inputs", place=Place(file=str(path)))
    views = find_views(paths, target, progress=progress)
    fit = fit_calibration(choose_views(views.views, views.size, max_views), views.size, coefficients)
    seen = coverage(fit)
    report = CalibrationReport(fit, views, seen, tuple(weaknesses(fit, seen)))
    if picture:
        _write(Path(picture), residual_picture(fit))
    _write(result, calibration_text(fit).encode("utf-8"))
    return report


def read_board(source: str | Path) -> BoardSettings:
    """A board from a YAML file (`target: board:`, in a job too, or the board alone), or from YAML text.

    Raises JobError where that is no board; InputError where the file cannot be read.
    """
    text = str(source)
    inline = text.lstrip().startswith("{")
    place = Place(file="--board" if inline else text)
    content = parse_yaml(text if inline else read_text(Path(text), "board file"), "board", place)
    for key in ("capture", "target", "board"):
        if isinstance(content, dict) and isinstance(content.get(key), dict):
            content = content[key]
    if isinstance(content, dict) and ("marker" in content or "tags" in content) and "type" not in content:
        raise JobError(
            "a camera is calibrated with a board, not with markers alone",
            place=place,
            hint="print one: mrbatch board --type charuco --output board.pdf",
        )
    try:
        return BoardSettings.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        what = ".".join(str(part) for part in first["loc"])
        message = first["msg"].removeprefix("Value error, ")
        raise JobError(
            f"this is no board: {what + ': ' if what else ''}{message}",
            place=place,
            hint="`mrbatch board --type charuco ... > board.yaml` writes one",
        ) from None


def _content(fit: CalibrationFit) -> dict[str, Any]:
    k = fit.matrix
    return {
        "width": fit.size[0],
        "height": fit.size[1],
        "pixel_centres": "integer",
        "fx": float(k[0, 0]),
        "fy": float(k[1, 1]),
        "cx": float(k[0, 2]),
        "cy": float(k[1, 2]),
        "distortion": [float(d) for d in fit.distortion],
        "sigma": dict(zip(("fx", "fy", "cx", "cy"), (float(s) for s in fit.sigma))),
        "sigma_distortion": [float(s) for s in fit.sigma_distortion],
        "sigma_views": dict(zip(("fx", "fy", "cx", "cy"), (float(s) for s in fit.sigma_views))),
        "sigma_views_distortion": [float(s) for s in fit.sigma_views_distortion],
        "rms_px": fit.rms,
        "views": len(fit.views),
        "corners": int(sum(len(v.points) for v in fit.views)),
    }


def calibration_text(fit: CalibrationFit) -> str:
    """The calibration file: YAML that `load_calibration` reads."""

    def told(value: Any) -> str:
        if isinstance(value, dict):
            return "{" + ", ".join(f"{k}: {told(v)}" for k, v in value.items()) + "}"
        if isinstance(value, list):
            return "[" + ", ".join(told(v) for v in value) + "]"
        if not isinstance(value, float):
            return str(value)
        return np.format_float_positional(value, 6, trim="0") if np.isfinite(value) else "null"

    lines = [
        "# Camera calibration: fx, fy, cx, cy in pixels, distortion as OpenCV's k1 k2 p1 p2 k3 k4 k5 k6,",
        "# sigma: standard deviations of the fit, sigma_views: from leaving out views.",
        "# The centre of the first pixel is (0, 0), as in OpenCV.",
    ]
    lines += [f"{key}: {told(value)}" for key, value in _content(fit).items()]
    return "\n".join(lines) + "\n"


def _write(path: Path, data: bytes) -> None:
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        temporary.write_bytes(data)
        os.replace(temporary, path)
    except OSError as error:
        raise ResourceError(
            f"cannot write the file ({error.strerror})", place=Place(file=str(path))
        ) from None
    finally:
        temporary.unlink(missing_ok=True)
