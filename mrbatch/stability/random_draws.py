"""Random numbers by the program's own functions, drawn in bulk: for cases and tests."""

from __future__ import annotations

import functools
from typing import Any, Literal

import numpy as np
import warp as wp

from mrbatch.kernels import rng

Kind = Literal["owen", "independent", "cranley-patterson"]
KINDS: tuple[Kind, ...] = ("owen", "independent", "cranley-patterson")


@functools.cache
def _pairs(kind: Kind) -> Any:
    sampler = rng.make_sampler(kind)
    one, two, bits = sampler.sample_1d, sampler.sample_2d, sampler.sample_2d_bits

    @wp.kernel(enable_backward=False, module="unique")
    def draw(
        key: wp.array(dtype=wp.uint64),
        index: wp.array(dtype=int),
        dimension: wp.array(dtype=int),
        a: wp.array(dtype=float),
        b: wp.array(dtype=wp.vec2),
        c: wp.array(dtype=wp.vec2ui),
    ):
        i = wp.tid()
        a[i] = one(key[i], index[i], dimension[i])
        b[i] = two(key[i], index[i], dimension[i])
        c[i] = bits(key[i], index[i], dimension[i])

    return draw


@functools.cache
def _starts(kind: Kind) -> Any:
    sampler = rng.make_sampler(kind)
    sample_start, sample_vertex = sampler.sample_start, sampler.sample_vertex

    @wp.kernel(enable_backward=False, module="unique")
    def draw(
        key: wp.array(dtype=wp.uint64),
        index: wp.array(dtype=int),
        pixel: int,
        vertex: int,
        out: wp.array2d(dtype=wp.vec2ui),
    ):
        i = wp.tid()
        start = sample_start(key[i], index[i], pixel, vertex)
        alone = sample_vertex(key[i], index[i], vertex)
        out[i, 0] = start.pixel
        out[i, 1] = start.vertex.light
        out[i, 2] = start.vertex.scatter
        out[i, 3] = alone.light
        out[i, 4] = alone.scatter

    return draw


@wp.kernel(enable_backward=False)
def _keys(words: wp.array2d(dtype=int), out: wp.array(dtype=wp.uint64)):
    i = wp.tid()
    out[i] = rng.pixel_key(
        wp.uint32(words[i, 0]), words[i, 1], words[i, 2], words[i, 3], words[i, 4], words[i, 5]
    )


@wp.kernel(enable_backward=False)
def _convert(x: wp.array(dtype=wp.uint32), a: wp.array(dtype=float), b: wp.array(dtype=wp.float64)):
    i = wp.tid()
    a[i] = rng.uint_to_float(x[i])
    b[i] = rng.uint_to_double(x[i])


def draw(
    kind: Kind, key: np.ndarray, index: np.ndarray | int, dimension: np.ndarray | int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(...) float, (..., 2) float, (..., 2) float64 with all 32 bits; all arguments are broadcast."""
    key, index, dimension = np.broadcast_arrays(key, index, dimension)
    shape, count = key.shape, key.size
    a = wp.zeros(count, dtype=float, device="cpu")
    b = wp.zeros(count, dtype=wp.vec2, device="cpu")
    c = wp.zeros(count, dtype=wp.vec2ui, device="cpu")
    inputs = [
        wp.array(np.ascontiguousarray(key.ravel(), dtype=np.uint64), device="cpu"),
        wp.array(np.ascontiguousarray(index.ravel(), dtype=np.int32), device="cpu"),
        wp.array(np.ascontiguousarray(dimension.ravel(), dtype=np.int32), device="cpu"),
    ]
    wp.launch(_pairs(kind), count, inputs=inputs, outputs=[a, b, c], device="cpu")
    precise = (c.numpy().astype(np.float64) + 0.5) * 2.0**-32
    return a.numpy().reshape(shape), b.numpy().reshape(*shape, 2), precise.reshape(*shape, 2)


def draw_start(
    kind: Kind, key: np.ndarray, index: np.ndarray | int, pixel: int = 0, vertex: int = 8
) -> np.ndarray:
    """(..., 5, 2) uint32: numbers of the pixel, of light and scatter at its vertex, and the latter alone."""
    key, index = np.broadcast_arrays(key, index)
    out = wp.zeros((key.size, 5), dtype=wp.vec2ui, device="cpu")
    inputs = [
        wp.array(np.ascontiguousarray(key.ravel(), dtype=np.uint64), device="cpu"),
        wp.array(np.ascontiguousarray(index.ravel(), dtype=np.int32), device="cpu"),
        pixel,
        vertex,
    ]
    wp.launch(_starts(kind), key.size, inputs=inputs, outputs=[out], device="cpu")
    return out.numpy().reshape(*key.shape, 5, 2)


def keys(words: np.ndarray) -> np.ndarray:
    """(n,) uint64 keys of rows (seed, frame, view, half, x, y)."""
    words = np.ascontiguousarray(words, dtype=np.int32)
    out = wp.zeros(len(words), dtype=wp.uint64, device="cpu")
    wp.launch(_keys, len(words), inputs=[wp.array(words, device="cpu"), out], device="cpu")
    return out.numpy()


def pixel_keys(
    width: int,
    height: int,
    seed: int = 1,
    frame: int = 0,
    view: int = 0,
    half: int = 0,
    x0: int = 0,
    y0: int = 0,
) -> np.ndarray:
    """(height, width) keys of a block of pixels."""
    y, x = np.mgrid[y0 : y0 + height, x0 : x0 + width]
    rest = [np.full(x.size, v) for v in (seed, frame, view, half)]
    return keys(np.stack([*rest, x.ravel(), y.ravel()], axis=1)).reshape(height, width)


def converted(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(n,) float32 and (n,) float64 that integers (n,) of 32 bits become."""
    a = wp.zeros(x.size, dtype=float, device="cpu")
    b = wp.zeros(x.size, dtype=wp.float64, device="cpu")
    wp.launch(_convert, x.size, inputs=[wp.array(x.astype(np.uint32), device="cpu"), a, b], device="cpu")
    return a.numpy(), b.numpy()
