"""Where a lens model folds back: known in closed form, and as a camera's own rays have it."""

from __future__ import annotations

import numpy as np
import pytest

from mrbatch.capture.marker_video.lens_limit import lens_limit, rayless_share

SIZE = (640, 480)
MATRIX = np.array([[400.0, 0.0, 320.0], [0.0, 400.0, 240.0], [0.0, 0.0, 1.0]])
"""Its corners are one focal length from the axis, less half a pixel."""


@pytest.mark.parametrize("k1", [-0.6, -0.4])
def test_one_coefficient(k1):
    """r (1 + k1 r^2) rises up to r = sqrt(-1 / (3 k1)), and is two thirds of that there."""
    limit = 2.0 / 3.0 * np.sqrt(-1.0 / (3.0 * k1))
    assert lens_limit(MATRIX, np.array([k1, 0, 0, 0, 0]), SIZE) == pytest.approx(limit, rel=1e-4)
    share = rayless_share(MATRIX, np.array([k1, 0, 0, 0, 0]), SIZE)
    x, y = np.meshgrid(np.arange(640) - 319.5, np.arange(480) - 239.5)
    assert share == pytest.approx(np.mean(np.hypot(x, y) > 400 * limit), abs=2e-3) and share > 0.01


@pytest.mark.parametrize("distortion", [[0.0] * 5, [0.1, 0.0, 0.0, 0.0, 0.0], [-0.1, 0.0, 0.0, 0.0, 0.0]])
def test_lenses_that_do_not_fold(distortion):
    assert np.isinf(lens_limit(MATRIX, np.array(distortion), SIZE))
    assert rayless_share(MATRIX, np.array(distortion), SIZE) == 0.0


@pytest.mark.data
def test_a_published_calibration_that_folds(shared_data):
    """Five coefficients fitted to corners near the middle (docs/markers.md)."""
    import json

    known = json.loads(
        (shared_data / "markers" / "charuco_realsense_jp" / "calib_and_poses.json").read_text()
    )
    share = rayless_share(np.array(known["K"]), np.array(known["dist"]), tuple(known["image_size"]))
    assert 0.05 < share < 0.5
