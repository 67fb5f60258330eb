"""Settings of image-based lighting."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from mrbatch.scene.path_settings import SamplingSettings


class ImageBasedLightingSettings(SamplingSettings):
    """Virtual objects lit by the map alone; what is real does not change."""

    name: Literal["image-based-lighting"] = Field("image-based-lighting", description="The method")
    occlusion: bool = Field(
        False, description="Whether real and virtual surfaces block the map's light on virtual ones"
    )
