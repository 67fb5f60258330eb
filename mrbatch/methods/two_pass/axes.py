"""Sweep axes of two-pass differential path tracing."""

from mrbatch.contracts import Axis

AXES = (
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
        "sampler", "method.sampler", ("owen", "independent"), "slope -1/2 to -3/4 where smooth", "camera rays"
    ),
)
