"""Sweep axes of image-based lighting."""

from mrbatch.contracts import Axis

AXES = (
    Axis("spp", "method.spp", (4, 16, 64, 256, 1024), "time ~ N, error ~ N^-1/2 or faster", "camera rays"),
    Axis("occlusion", "method.occlusion", (False, True), "shadow rays against bias", "shadow rays"),
    Axis(
        "strategy", "method.strategy", ("mis", "environment", "bsdf"), "variance by lobe and map", "lookups"
    ),
    Axis(
        "sampler",
        "method.sampler",
        ("owen", "cranley-patterson", "independent"),
        "slope -1/2 to -3/4 where smooth",
        "camera rays",
    ),
)
