"""Marker video: a hand-held camera round a printed target, as video or picture sequence."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mrbatch.capture.marker_video.settings import MarkerVideoSettings
from mrbatch.contracts import Capture, CaptureKind, Told


def _open(settings: Any, folder: Any) -> Capture:
    from mrbatch.capture.marker_video.capture import MarkerVideoCapture

    return MarkerVideoCapture(settings, Path(folder))


def _told(table: Mapping[str, Any]) -> Told:
    from mrbatch.capture.marker_video.told import told

    return told(table)


KIND = CaptureKind(
    name="marker-video",
    meaning="a video or picture sequence in which a printed marker, board or tags fix the world",
    settings=MarkerVideoSettings,
    open=_open,
    told=_told,
)
