"""Sweep axes of delta path tracing: each setting that trades accuracy for time."""

from mrbatch.contracts import Axis
from mrbatch.scene.path_settings import PATH_AXES

AXES = (
    *PATH_AXES,
    Axis(
        "filter",
        "method.pixel_filter",
        ("box", "gaussian", "blackman-harris"),
        "edges against noise",
        "camera rays",
    ),
    Axis("resolution", "output.scale", (0.25, 0.5, 1.0), "time ~ pixels", "camera rays"),
    Axis("engine", "engine", ("embree", "warp"), "same picture, other time", "scatter rays"),
)
