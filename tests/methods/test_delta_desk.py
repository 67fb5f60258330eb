"""One desk set with few samples: the composite is right in the mean, and better than without light change."""

from __future__ import annotations

from desk_scene import desk, judge

from mrbatch.methods.delta_path_tracing import METHOD as DELTA
from mrbatch.methods.image_based_lighting import METHOD as IMAGE_BASED


def test_window_desk_with_few_samples(shared_data):
    scene = desk(shared_data, "mitsuba_desk_window", "metal")
    found = judge(DELTA, scene, 0, spp=16, max_depth=8)
    baseline = judge(IMAGE_BASED, scene, 0, spp=16)
    assert found.test.difference.low > -0.01 and found.test.difference.high < 0.01
    assert found.test.passed
    assert found.relmse < 0.1 * baseline.relmse
    # Without shadow and bounced light the region is far too bright.
    assert baseline.test.difference.low > 0.01
