"""Look-ups and samples of an environment map by the program's own functions, in bulk: for cases and tests."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import warp as wp

from mrbatch.kernels.environment import EnvironmentData, LightSampler, make_environment
from mrbatch.scene.environment import Environment


@functools.cache
def _kernels(interpolation: str, sampler: LightSampler) -> tuple[Any, Any]:
    functions = make_environment(interpolation, sampler)  # type: ignore[arg-type]
    radiance, pdf, sample = functions.radiance, functions.pdf, functions.sample

    @wp.kernel(enable_backward=False, module="unique")
    def look(
        env: EnvironmentData,
        d: wp.array(dtype=wp.vec3),
        light: wp.array(dtype=wp.vec3),
        density: wp.array(dtype=float),
    ):
        i = wp.tid()
        light[i] = radiance(env, d[i])
        density[i] = pdf(env, d[i])

    @wp.kernel(enable_backward=False, module="unique")
    def draw(
        env: EnvironmentData,
        bits: wp.array(dtype=wp.vec2ui),
        d: wp.array(dtype=wp.vec3),
        light: wp.array(dtype=wp.vec3),
        density: wp.array(dtype=float),
    ):
        i = wp.tid()
        s = sample(env, bits[i])
        d[i] = s.direction
        light[i] = radiance(env, s.direction)
        density[i] = s.pdf

    return look, draw


def look(
    environment: Environment, directions: np.ndarray, sampler: LightSampler = "cdf"
) -> tuple[np.ndarray, np.ndarray]:
    """Radiance (n, 3) and density (n,) in world directions (n, 3)."""
    d = wp.array(np.ascontiguousarray(directions, dtype=np.float32), dtype=wp.vec3, device="cpu")
    light, density = wp.zeros_like(d), wp.zeros(len(d), dtype=float, device="cpu")
    kernel = _kernels(environment.interpolation, sampler)[0]
    wp.launch(kernel, len(d), inputs=[environment.upload(), d], outputs=[light, density], device="cpu")
    return light.numpy(), density.numpy()


def draw(
    environment: Environment, u: np.ndarray | int, seed: int = 99, sampler: LightSampler = "cdf"
) -> tuple[np.ndarray, ...]:
    """Directions (n, 3), radiance (n, 3), density (n,) for u (n, 2) float64; so many numbers of 32 bits where
    `u` is a count."""
    if isinstance(u, int):
        bits = np.random.default_rng(seed).integers(0, 2**32, size=(u, 2)).astype(np.uint32)
    else:
        bits = np.floor(np.ascontiguousarray(u, dtype=np.float64) * 2.0**32).astype(np.uint32)
    numbers = wp.array(bits, dtype=wp.vec2ui, device="cpu")
    d = wp.zeros(len(bits), dtype=wp.vec3, device="cpu")
    light, density = wp.zeros_like(d), wp.zeros(len(bits), dtype=float, device="cpu")
    kernel = _kernels(environment.interpolation, sampler)[1]
    given = [environment.upload(), numbers]
    wp.launch(kernel, len(bits), inputs=given, outputs=[d, light, density], device="cpu")
    return d.numpy(), light.numpy(), density.numpy()


def lamp(
    height: int, width: int, row: int, column: int, value: float | tuple[float, ...] = 1.0
) -> np.ndarray:
    """(height, width, 3) float32: one lit texel on black."""
    image = np.zeros((height, width, 3), dtype=np.float32)
    image[row, column] = value
    return image
