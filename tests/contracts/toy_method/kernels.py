"""The kernel of the toy."""

from __future__ import annotations

import functools
from typing import Any

import warp as wp

from mrbatch.film.accumulator import FilmData, film_add, film_load, film_pixel, film_store
from mrbatch.kernels.rng import make_sampler, pixel_key


@functools.cache
def make_kernel(sampler: str = "independent") -> Any:
    sample_2d = make_sampler(sampler).sample_2d

    @wp.kernel(enable_backward=False, module="unique")
    def toy_shade(
        film: FilmData,
        seed: wp.uint32,
        frame: int,
        view: int,
        darkness: float,
        units: wp.array(dtype=wp.int32),
        first_unit: int,
        half: int,
        first_sample: int,
        samples: int,
        counters: wp.array(dtype=wp.int64),
    ):
        thread = wp.tid()
        pixel = film_pixel(film, units[first_unit + (thread >> 8)], thread & 255)
        if pixel.index < 0:
            return
        key = pixel_key(seed, frame, view, half, pixel.x, pixel.y)
        total = film_load(film, half, pixel.index)
        background = film.background[pixel.index]
        for n in range(samples):
            u = sample_2d(key, first_sample + n, wp.int32(0))
            delta = background * (-darkness * u[0])
            total = film_add(total, wp.vec3(0.0, 0.0, 0.0), 0.0, delta, background)
        film_store(film, half, pixel.index, total, samples)
        wp.atomic_add(counters, 0, wp.int64(samples))

    return toy_shade
