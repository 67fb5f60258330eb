"""Settings of two-pass differential path tracing."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from mrbatch.scene.path_settings import PathSettings


class TwoPassSettings(PathSettings):
    """Light on virtual objects, and the difference of two pictures on real ones: with and without them."""

    name: Literal["two-pass"] = Field("two-pass", description="The method")
