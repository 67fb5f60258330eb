"""A toy capture kind and a toy method, so that the job's own rules are tested apart from others'."""

from __future__ import annotations

from typing import Literal

import pytest
from pydantic import Field

from mrbatch.capture.registry import CAPTURES
from mrbatch.contracts import CaptureKind, Method, Participant, Pipeline, Rule, Verdict
from mrbatch.methods.registry import METHODS, PARTICIPANTS
from mrbatch.quantities import InputPath, Length, Reflectance, Settings


class Marker(Settings):
    side: Length = Field(description="Side of the marker: a length")


class ToyCapture(Settings):
    kind: Literal["toy-video"] = Field("toy-video", description="Which capture kind this is")
    video: InputPath = Field(description="The video")
    marker: Marker | None = Field(None, description="The marker")
    gain: float | Literal["auto"] = Field("auto", description="Photo over radiance, above 0, or `auto`")


class ToyMethod(Settings):
    spp: int = Field(16, ge=1, le=65536, description="Samples a pixel, 1..65536")
    threshold: Reflectance = Field(0.5, description="A share, 0..1")


class ToyFog(Settings):
    density: Reflectance = Field(0.1, description="A share, 0..1")


def _never(*_):
    return Pipeline()


RULE = Rule("shadow", "light blocked", lambda facts: Verdict("needed", "toy"))
CAPTURE = CaptureKind("toy-video", "a toy", ToyCapture, _never)
OTHER_CAPTURE = CaptureKind("toy-cloud", "another toy", ToyMethod, _never)
METHOD = Method(
    "toy-method", "a toy", ("toy-video",), ToyMethod, _never, ("virtual", "delta", "depth"), rules=(RULE,)
)
FOG = Participant("toy-fog", "a toy", ToyFog, _never, rules=(Rule("glow", "light in fog", RULE.decide),))


@pytest.fixture
def toys(monkeypatch):
    """Registries that hold the toys alone."""
    monkeypatch.setattr(CAPTURES, "_entries", {"toy-video": CAPTURE, "toy-cloud": OTHER_CAPTURE})
    monkeypatch.setattr(METHODS, "_entries", {"toy-method": METHOD})
    monkeypatch.setattr(PARTICIPANTS, "_entries", {"toy-fog": FOG})


SAMPLE = """\
name: desk
capture:
  kind: toy-video
  video: desk.mp4
  marker: {side: 60 mm}
environment: {file: env.exr, rows: endpoints, yaw: 30 deg}
real:
  - {name: table, plane: {size: [1.2 m, 1.2 m]}, reflectance: photo}
  - name: paper
    plane: {size: [210 mm, 297 mm]}
    reflectance: {texture: paper.png, mean: 0.6}
virtual:
  - name: bunny
    mesh: bunny.ply
    transform: {translate: [10 mm, 0, 0], rotate: [90 deg, 0, 20 deg], scale: 0.5}
    material: {type: conductor, reflectance: [0.9, 0.6, 0.3], roughness: 0.15}
  - name: ball
    sphere: {radius: 3 cm}
method: {name: toy-method, spp: 64}
participants:
  - {type: toy-fog}
output:
  layers: [virtual, depth]
effects: {shadow: on, glow: off}
frames: 1001-1100x2
"""


@pytest.fixture
def sample() -> str:
    return SAMPLE
