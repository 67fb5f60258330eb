"""Hard cases of random numbers (RNG): the largest integer, nets, padding, neighbours, repeats."""

from __future__ import annotations

import numpy as np

from mrbatch.contracts import Case, Measurement
from mrbatch.metrics.judging import none, same_bits, together, within
from mrbatch.stability.random_draws import Kind, converted, draw, pixel_keys

LAST = 1.0 - 2.0**-24
"""The largest float that a random number may be."""


def neighbours(seed: int, *, kind: Kind = "owen", side: int = 256) -> Measurement:
    """RNG-02: no correlation at lags 1 to 8 in pixels and frames, nor between views, halves and seeds; of one
    sample, and of the mean of few samples of a function with an edge, as a render has it."""
    first = seed + 1

    def values(key: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        pairs = draw(kind, key.ravel()[:, None], np.arange(3), 2)[1].reshape(side, side, 3, 2)
        return pairs[..., 0, 0], (pairs[..., 0] + pairs[..., 1] < 0.6).mean(axis=-1)

    here = values(pixel_keys(side, side, first))
    others = [values(pixel_keys(side, side, first, frame=lag)) for lag in range(1, 9)]
    others += [values(pixel_keys(side, side, first, **{name: 1})) for name in ("view", "half")]
    others.append(values(pixel_keys(side, side, first + 1)))
    pairs = [(image, other[n]) for n, image in enumerate(here) for other in others]
    for image in here:
        for lag in range(1, 9):
            pairs += [(image[:, lag:], image[:, :-lag]), (image[lag:], image[:-lag])]
    found = np.array([np.corrcoef(a.ravel(), b.ravel())[0, 1] for a, b in pairs])
    return within(found, 0.0, np.array([4.0 / np.sqrt(a.size) for a, _ in pairs]), what="correlation")


def largest_number(seed: int) -> Measurement:
    """RNG-03, RNG-06: the largest integers stay below 1, and an index below the length of its table."""
    x = np.array([0, 255, 256, 2**31, 2**32 - 257, 2**32 - 128, 2**32 - 1], dtype=np.uint32)
    single, double = converted(x)
    width = np.arange(1, 65537).astype(np.float32)
    return together(
        same_bits(single, ((x >> 8) * 2.0**-24).astype(np.float32)),
        same_bits(double, (x + 0.5) * 2.0**-32),
        within(single.max(), LAST, 0.0, what="the largest"),
        none((double <= 0.0) | (double >= 1.0), "numbers of 32 bits outside (0, 1)"),
        none(np.floor(single.max() * width) >= width, "indices beyond their table"),
    )


def elementary_boxes(seed: int) -> Measurement:
    """RNG-04: the first 2^k points put exactly one in each of the 2^k boxes of every shape, up to k = 12."""
    key = pixel_keys(3, 1, seed + 1).ravel()[:, None, None]
    dimension = np.array([0, 1, 77, 123456789])[None, :, None]
    _, two, precise = draw("owen", key, np.arange(1 << 12), dimension)
    wrong = []
    for k in range(13):
        n = 1 << k
        for points in (two[..., :n, :].astype(np.float64), precise[..., :n, :]):
            for j in range(k + 1):
                box = np.floor(points[..., 0] * 2**j) * 2 ** (k - j) + np.floor(points[..., 1] * 2 ** (k - j))
                wrong.append(np.any(np.sort(box, axis=-1) != np.arange(n), axis=-1))
    return none(np.concatenate([w.ravel() for w in wrong]), "sets of points that miss a box")


def padding(seed: int, *, kind: Kind = "owen") -> Measurement:
    """RNG-05: the mean of 4 u v is 1 for u, v of any two of 128 dimensions, at 4096 samples.

    One standard error of random numbers is 0.0138, and of their 8128 pairs the worst needs five of it.
    """
    key = pixel_keys(1, 1, seed + 1, x0=17, y0=-5).ravel()[:, None]
    _, two, _ = draw(kind, key, np.arange(4096), np.arange(64)[:, None])
    x = two.reshape(64, 4096, 2).transpose(0, 2, 1).reshape(128, 4096).astype(np.float64)
    products = 4.0 * (x @ x.T) / 4096
    # A dimension with itself gives 4/3.
    off = ~np.eye(128, dtype=bool)
    return within(products[off], 1.0, 0.055 if kind == "owen" else 0.070, what="mean of 4 u v")


def far_out(seed: int, *, kind: Kind = "owen") -> Measurement:
    """RNG-07: there is no table to run past; dimensions and counters up to 2^32 give fresh pairs."""
    key = pixel_keys(1, 1, seed + 1).ravel()
    dimension = np.concatenate([np.arange(100000), np.arange(-50000, 0)]).astype(np.int32)
    index = np.concatenate([np.arange(100000), np.arange(2**31 - 50000, 2**31), np.arange(-50000, 0)])
    repeats = []
    for pairs in (draw(kind, key, 0, dimension)[2], draw(kind, key, index, 4)[2]):
        code = np.sort(np.floor(pairs * 2.0**32).astype(np.uint64) @ np.array([1 << 32, 1], np.uint64))
        repeats.append(np.diff(code) == 0)
    return none(np.concatenate(repeats), "pairs that were there before")


def independent_pairs(seed: int) -> Measurement:
    """TRAP-2f: two dimensions of a pixel are no shifted copies of each other: the mean of [u < 1/2][v < 1/2]
    is 1/4 in every pixel."""
    key = pixel_keys(8, 8, seed + 1).ravel()[:, None]
    found = []
    for kind in ("owen", "cranley-patterson"):
        a, b = (draw(kind, key, np.arange(4096), d)[1][..., 0] < 0.5 for d in (2, 11))
        found.append((a & b).mean(axis=-1))
    return within(np.concatenate(found), 0.25, 0.02)


CASES: tuple[Case, ...] = (
    Case(
        "RNG-02",
        "neighbours in pixels, frames and views are not correlated",
        neighbours,
        setup="256 x 256 pixels, lags 1 to 8, scrambled points",
        statistical=True,
    ),
    Case(
        "RNG-03",
        "the largest random number is below 1",
        largest_number,
        setup="integers up to 2^32 - 1 as floats; tables of 1 to 65536 entries",
        rows=("RNG-06",),
    ),
    Case(
        "RNG-04",
        "scrambled points fill every elementary box",
        elementary_boxes,
        setup="2^0 to 2^12 points of 12 sequences",
        rows=("TRAP-2g",),
    ),
    Case(
        "RNG-05",
        "any two of 128 dimensions are independent",
        padding,
        setup="4096 samples of one pixel",
        statistical=True,
    ),
    Case("RNG-07", "numbers far out do not repeat", far_out, setup="300,000 pairs, counters up to 2^32"),
    Case(
        "TRAP-2f",
        "two dimensions are no copies of each other",
        independent_pairs,
        setup="64 pixels, 4096 samples, scrambled and shifted points",
        statistical=True,
    ),
)
