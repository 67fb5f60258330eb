"""Starts of rays, as another renderer makes them too."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from mrbatch.scene.closed_forms import ball, floor, real, scene_of, virtual
from mrbatch.scene.ray_start import make_ray_start
from mrbatch.scene.scene_data import SceneData, SurfacePoint, surface_point, upload


def starts(kind, at):
    """Start and surface point below (0.25, 0.25) of a floor round `at`, in world coordinates."""
    ray_start = make_ray_start(kind)

    @wp.kernel(enable_backward=False, module="unique")
    def find(scene: SceneData, d: wp.vec3, out: wp.array(dtype=wp.vec3)):
        point = SurfacePoint()
        point = surface_point(scene, 0, 0.25, 0.25, -d)
        out[0] = point.p
        out[1] = ray_start(scene, point, d)

    objects = [real("floor", floor(2.0).transformed(matrix(at))), virtual("ball", ball(at=at))]
    scene = scene_of(objects)
    device = upload(scene, "embree")
    out = wp.zeros(2, dtype=wp.vec3, device="cpu")
    wp.launch(find, 1, [device.data, wp.vec3(0.0, 0.6, 0.8), out], device="cpu")
    found = out.numpy().astype(np.float64) + scene.origin
    return found[1] - found[0], found[0]


def matrix(at):
    m = np.eye(4)
    m[:3, 3] = at
    return m


@pytest.mark.parametrize("at", [(0.0, 0.0, 0.0), (3.0, -20.0, 1.0)])
def test_rays_can_start_as_mitsuba_starts_them(at):
    """p + n (1 + max |p|) 1500 x 2^-24, of the world's p wherever kernels have their origin."""
    step, p = starts("mitsuba", at)
    np.testing.assert_allclose(step, [0, 0, (1 + np.abs(p).max()) * 1500 * 2.0**-24], rtol=2e-2, atol=1e-7)
    exact, _ = starts("exact", at)
    assert 0 <= exact[2] < 0.05 * step[2]
