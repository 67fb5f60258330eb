"""Settings of one-pass differential path tracing."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from mrbatch.scene.path_settings import PathSettings


class OnePassSettings(PathSettings):
    """Light on virtual objects, and on real ones the difference of two radiances that are traced together."""

    name: Literal["one-pass"] = Field("one-pass", description="The method")
