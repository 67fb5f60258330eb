"""Settings of delta path tracing."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from mrbatch.scene.path_settings import PathSettings


class DeltaPathTracingSettings(PathSettings):
    """Light change on real surfaces and light on virtual ones, by tracing only paths that change."""

    name: Literal["delta-path-tracing"] = Field("delta-path-tracing", description="The method")
