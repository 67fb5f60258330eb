"""Sweep axes of delta path tracing: each setting that trades accuracy for time."""

from mrbatch.contracts import Axis
from mrbatch.scene.path_settings import PATH_AXES

AXES = (
    *PATH_AXES,
    Axis(
        "pixel filter",
        "method.pixel_filter",
        ("box", "gaussian", "blackman-harris"),
        "edges against noise",
        "camera rays",
    ),
)
