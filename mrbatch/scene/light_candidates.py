"""Directions to the environment's light: drawn from the map, or resampled among several that are.

Resampled importance sampling (Talbot et al., *Importance Resampling for Global Illumination*, EGSR 2005;
Bitterli et al., *Spatiotemporal Reservoir Resampling*, ACM TOG 39(4), 2020, equation 6): of N candidates x_i
of the map's density p one, y, is chosen with probability in proportion to target(x_i) / p(x_i), and stands
for all with the weight W = 1 / target(y) x 1/N sum of target(x_i) / p(x_i): unbiased wherever the target is
positive where the integrand is, however the candidates depend on each other.

Our target is w f cos p: p stands for the radiance, which it is in proportion to but within cells, so that
candidates cost no look-up of the map, and target / p is w f cos alone. w is the weight of the light's
directions against scattered ones. It belongs to the integrand, as a function of direction and not of how the
direction was found, so that the two weights sum to one and the sum of both parts stays unbiased; it is the
balance heuristic's for N directions drawn from the map, for what choosing leaves, but for shadows, is the
mean of all N.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from mrbatch.kernels.bsdf import Surface
from mrbatch.kernels.environment import EnvironmentData
from mrbatch.kernels.numerics import to_local
from mrbatch.kernels.rng import VertexNumbers

DIM_CHOICE = wp.constant(wp.int32(3))
"""Dimension, within those of a vertex, of the number that chooses among candidates."""

_LAST = wp.constant(wp.float32(1.0 - 2.0**-24))


@wp.struct
class LightDirection:
    """A direction to the light, unit, world; the map's density of it (0: there is none). `share`: factor on
    what arrives from there, 1 where it was not chosen among others."""

    direction: wp.vec3
    pdf: float
    share: float


def make_light_direction(
    candidates: int,
    *,
    env_sample: Any,
    evaluate: Any,
    scatter_pdf: Any,
    light_bits: Any,
    light_weight: Any,
    sample_1d: Any,
    transmission: bool = False,
) -> Any:
    """`wp.func` of one of `count` directions that a vertex asks for, its `number` counting from 0.

    `(environment, surface, basis, wo, ng, drawn, key, index, number, count, dimension) -> LightDirection`:
    the frame `basis` of the shading normal, `wo` in it, the geometric normal `ng`, `drawn` the vertex's
    numbers. `transmission`: light may also arrive from behind a surface.
    """

    @wp.func
    def drawn_direction(
        environment: EnvironmentData,
        surface: Surface,
        basis: wp.mat33,
        wo: wp.vec3,
        ng: wp.vec3,
        drawn: VertexNumbers,
        key: wp.uint64,
        index: int,
        number: int,
        count: int,
        dimension: int,
    ) -> LightDirection:
        sample = env_sample(environment, light_bits(drawn, key, index, number, count, dimension))
        result = LightDirection()
        result.direction = sample.direction
        result.pdf = sample.pdf
        result.share = 1.0
        return result

    @wp.func
    def chosen_direction(
        environment: EnvironmentData,
        surface: Surface,
        basis: wp.mat33,
        wo: wp.vec3,
        ng: wp.vec3,
        drawn: VertexNumbers,
        key: wp.uint64,
        index: int,
        number: int,
        count: int,
        dimension: int,
    ) -> LightDirection:
        result = LightDirection()
        total = float(0.0)
        kept = float(0.0)
        choice = sample_1d(key, index * count + number, dimension + DIM_CHOICE)
        for n in range(wp.static(candidates)):
            place = number * wp.static(candidates) + n
            bits = light_bits(drawn, key, index, place, count * wp.static(candidates), dimension)
            sample = env_sample(environment, bits)
            wi = to_local(basis, sample.direction)
            side = wp.dot(ng, sample.direction)
            if wp.static(transmission):
                side *= wi[2]
            if sample.pdf > 0.0 and side > 0.0:
                f = evaluate(surface, wo, wi)
                target = f[0] + f[1] + f[2]
                if target > 0.0:
                    # `light_weight` is a share of `count`; here only its relation among candidates counts.
                    target *= light_weight(count, sample.pdf, scatter_pdf(surface, wo, wi))
                    total += target
                    # One number below 1 serves all choices: what each leaves of it is as random as it was.
                    part = target / total
                    if choice < part:
                        choice = wp.min(choice / part, _LAST)
                        kept = target
                        result.direction = sample.direction
                        result.pdf = sample.pdf
                    else:
                        choice = wp.min((choice - part) / (1.0 - part), _LAST)
        if kept > 0.0:
            result.share = total / kept
        return result

    return chosen_direction if candidates > 1 else drawn_direction
