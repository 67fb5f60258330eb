"""A capture without files: pictures of noise made from the frame number, one view or two."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field

from mrbatch.capture.frame import CaptureFacts, FrameData, ViewData, ViewGeometry
from mrbatch.contracts import CaptureKind, Progress
from mrbatch.errors import InputError, Place
from mrbatch.kernels.transfer import to_linear
from mrbatch.quantities import Settings
from mrbatch.scene.camera import Camera

NAME = "toy-capture"


class ToyCaptureSettings(Settings):
    """Noise as pictures."""

    count: int = Field(6, description="How many frames")
    first: int = Field(0, description="Number of the first frame")
    width: int = Field(40, description="Pixels")
    height: int = Field(24, description="Pixels")
    views: Literal["one", "two", "two sizes"] = Field("one", description="Mono, or left and right")
    cuts: list[int] = Field([], description="First frames of new scenes")
    broken: list[int] = Field([], description="Frames that cannot be read")


class ToyCapture:
    """See `mrbatch.contracts.Capture`."""

    def __init__(self, settings: ToyCaptureSettings):
        self.settings = settings
        self.names = ("",) if settings.views == "one" else ("left", "right")

    def frame_numbers(self) -> Sequence[int]:
        return range(self.settings.first, self.settings.first + self.settings.count)

    announced_numbers = frame_numbers

    def prepare(self, progress: Progress) -> Mapping[str, Any]:
        return {"cuts": list(self.settings.cuts)}

    def facts(self, table: Mapping[str, Any]) -> CaptureFacts:
        return CaptureFacts(8, False, "srgb", Fraction(24))

    def geometry(self, number: int, table: Mapping[str, Any]) -> Mapping[str, ViewGeometry]:
        s = self.settings
        found = {}
        for index, name in enumerate(self.names):
            pose = np.eye(4)
            pose[:3, 3] = [0.065 * index, 0.01 * number, 0.0]
            width = s.width + 8 * index * (s.views == "two sizes")
            k = np.array([[50.0, 0, width / 2], [0, 50.0 + index, s.height / 2], [0, 0, 1]])
            found[name] = ViewGeometry(Camera(width, s.height, k, np.zeros(8), pose), np.ones(3))
        return found

    def codes(self, number: int, view: str) -> np.ndarray:
        random = np.random.default_rng([number + 10_000, len(view)])
        return random.integers(0, 256, (self.settings.height, self.settings.width, 3), dtype=np.uint8)

    def frame(self, number: int, table: Mapping[str, Any]) -> FrameData:
        if number in self.settings.broken:
            raise InputError("the picture is cut short", place=Place(frame=number), hint="copy it again")
        views = {}
        for name, known in self.geometry(number, table).items():
            codes = self.codes(number, name)
            views[name] = ViewData(known.camera, to_linear(codes, "srgb", 8), known.gain, None, codes)
        return FrameData(number, number / 24, views)

    def inputs(self) -> Sequence[Path]:
        return ()


KIND = CaptureKind(NAME, "noise", ToyCaptureSettings, lambda settings, folder: ToyCapture(settings))
