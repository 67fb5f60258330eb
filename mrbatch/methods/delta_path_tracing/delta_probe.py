"""`probe` of delta path tracing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from mrbatch.methods.probe import Probe, probe
from mrbatch.methods.registry import method as find_method
from mrbatch.scene.scene import Scene


def delta_probe(scene: Scene, point: Sequence[float] | np.ndarray, **options: Any) -> Probe:
    """`probe` of this method."""
    return probe(find_method("delta-path-tracing"), scene, point, **options)
