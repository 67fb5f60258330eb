"""The work counters of methods that trace rays among surfaces: same names, so that they can be compared."""

from mrbatch.contracts import Counter

COUNTERS = (
    Counter("camera rays", "rays", "rays from the camera to the first hit"),
    Counter("shadow rays", "rays", "occlusion rays towards the environment"),
    Counter("scatter rays", "rays", "closest-hit rays that follow scattered light"),
    Counter("lookups", "reads", "radiance read from the environment"),
    Counter("vertices", "points", "surface points at which light was sampled"),
)
CAMERA_RAYS, SHADOW_RAYS, SCATTER_RAYS, LOOKUPS, VERTICES = range(5)
"""Their places."""
