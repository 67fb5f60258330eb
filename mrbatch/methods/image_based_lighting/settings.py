"""Settings of image-based lighting."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from mrbatch.quantities import Settings

Samples = Annotated[int, Field(ge=2, le=1 << 20, multiple_of=2)]


class ImageBasedLightingSettings(Settings):
    """Virtual objects lit by the map alone; what is real does not change."""

    name: Literal["image-based-lighting"] = Field("image-based-lighting", description="The method")
    spp: Samples = Field(64, description="Samples a pixel, both halves together, an even number from 2")
    occlusion: bool = Field(
        False, description="Whether real and virtual surfaces block the map's light on virtual ones"
    )
    strategy: Literal["mis", "environment", "bsdf"] = Field(
        "mis", description="How light from the map is sampled: both ways weighted, or one of them alone"
    )
    sampler: Literal["owen", "independent"] = Field(
        "owen", description="Random numbers: Owen-scrambled Sobol points, or independent ones"
    )
    light_sampler: Literal["auto", "median-cut", "cdf"] = Field(
        "auto",
        description="How directions are drawn from the map: leaves of equal light found without a search, or "
        "texel by texel from summed rows and columns; `auto`: leaves where they add no noise",
    )
    pixel_filter: Literal["box", "gaussian", "blackman-harris"] = Field(
        "box", description="Reconstruction filter of the virtual layers; the photo is never filtered"
    )
    masking: Literal["height-correlated", "separable"] = Field(
        "height-correlated", description="How masking and shadowing of microfacets combine"
    )
    batch: Annotated[int, Field(ge=1, le=256)] = Field(
        8, description="Samples that one step adds to each half, 1..256; changes no pixel"
    )
