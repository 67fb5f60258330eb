"""Settings that methods share: of all that sample surfaces under a map, and of those that trace paths."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from mrbatch.contracts import Axis
from mrbatch.quantities import Settings

Samples = Annotated[int, Field(ge=2, le=1 << 20, multiple_of=2)]


class SamplingSettings(Settings):
    """How pixels, surfaces and the map's light are sampled. A method's model gives `name` its one value."""

    name: str
    spp: Samples = Field(64, description="Samples a pixel, both halves together, an even number from 2")
    strategy: Literal["mis", "environment", "bsdf"] = Field(
        "mis",
        description="How light from the map and from lamps is sampled: both ways weighted, or one of them "
        "alone, directions to light (`environment`) or scattered ones (`bsdf`)",
    )
    sampler: Literal["owen", "independent", "cranley-patterson"] = Field(
        "owen",
        description="Random numbers: Owen-scrambled Sobol points, independent ones, or Sobol points with a "
        "random shift, for comparisons",
    )
    light_sampler: Literal["auto", "median-cut", "cdf", "alias", "sample-map"] = Field(
        "auto",
        description="How directions are drawn from the map: leaves of equal light found without a search, "
        "texel by texel from summed rows and columns, or the same from an alias table; `auto`: leaves where "
        "they add no noise, else sums. `sample-map`, a fixed set of stored directions, is biased and for "
        "comparisons only",
    )
    pixel_filter: Literal["box", "gaussian", "blackman-harris"] = Field(
        "box", description="Reconstruction filter of the virtual layers; the photo is never filtered"
    )
    masking: Literal["height-correlated", "separable"] = Field(
        "height-correlated", description="How masking and shadowing of microfacets combine"
    )
    ray_start: Literal["exact", "mitsuba"] = Field(
        "exact",
        description="How far off a surface rays start: as little as float numbers need, or as Mitsuba 3 does "
        "(9e-5 of 1 m + |p|), for comparisons with it",
    )
    batch: Annotated[int, Field(ge=1, le=256)] = Field(
        8, description="Samples that one step adds to each half, 1..256; changes no pixel"
    )


class PathSettings(SamplingSettings):
    """And where light paths end."""

    max_depth: Annotated[int, Field(ge=2, le=1024)] | None = Field(
        None,
        description="Longest path in edges, the camera's included, 2..1024; none: roulette alone ends paths",
    )
    roulette_depth: Annotated[int, Field(ge=2, le=1024)] = Field(
        5, description="Path length in edges from which roulette may end a path, 2..1024"
    )
    light_samples: Annotated[int, Field(ge=1, le=64)] = Field(
        1,
        description="Directions drawn from the map where the camera's ray ends, and as many to lamps, for "
        "each sample, 1..64",
    )
    light_candidates: Annotated[int, Field(ge=1, le=32)] = Field(
        1,
        description="Directions from the map among which each one that a ray follows is chosen, by how much "
        "of the light from there the surface would send on, 1..32; 1: no choice",
    )


PATH_AXES = (
    Axis("spp", "method.spp", (4, 16, 64, 256, 1024), "time ~ N, error ~ N^-1/2 or faster", "camera rays"),
    Axis("depth", "method.max_depth", (2, 3, 4, 8, None), "bias falls as albedo^depth", "vertices"),
    Axis("roulette", "method.roulette_depth", (3, 5, 9), "noise against path length", "vertices"),
    Axis(
        "strategy", "method.strategy", ("mis", "environment", "bsdf"), "variance by lobe and map", "lookups"
    ),
    Axis(
        "light samples", "method.light_samples", (1, 2, 4, 8), "noise of direct light ~ N^-1/2", "shadow rays"
    ),
    Axis(
        "light candidates",
        "method.light_candidates",
        (1, 2, 4, 8),
        "noise of unshadowed light ~ N^-1/2",
        "shadow rays",
    ),
    Axis(
        "light sampler",
        "method.light_sampler",
        ("cdf", "median-cut", "alias", "sample-map"),
        "time; bias of the last",
        "shadow rays",
    ),
    Axis(
        "sampler",
        "method.sampler",
        ("owen", "cranley-patterson", "independent"),
        "slope -1/2 to -3/4 where smooth",
        "camera rays",
    ),
)
"""Settings of light paths that trade accuracy for time, and the law expected."""
