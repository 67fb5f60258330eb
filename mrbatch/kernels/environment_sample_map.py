"""Directions from a map of stored ones: a baseline that is biased, for comparisons only.

As Mehta et al. precompute them, and delta path tracing as printed (Xu et al., section 3.2) looks them up: as
many inversions of the map's CDF as it has texels, kept as a picture. It is a fixed set: most texels are
never drawn, however many samples are taken, while the density says that they are. How it is made:
`mrbatch.scene.environment_sample_map`.
"""

from __future__ import annotations

import warp as wp

from mrbatch.kernels.environment_alias import scaled
from mrbatch.kernels.environment_cells import EnvironmentData, EnvironmentSample


@wp.func
def sample_map_prefetch(env: EnvironmentData, bits: wp.vec2ui):
    """A baseline is left as it is printed."""


@wp.func
def sample_map_sample(env: EnvironmentData, bits: wp.vec2ui) -> EnvironmentSample:
    """The stored direction nearest to two 32-bit fractions, with its printed density.

    Nearest: a mean of stored directions lies where no light may be.
    """
    row = int(scaled(bits[0], env.stored.shape[0])[0])
    found = env.stored[row, int(scaled(bits[1], env.stored.shape[1])[0])]
    result = EnvironmentSample()
    result.direction = wp.transpose(env.map_from_world) @ wp.vec3(found[0], found[1], found[2])
    result.pdf = found[3]
    return result
