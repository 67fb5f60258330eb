"""Maps, directions and the statistics of samples drawn from maps, in float64: what several tests share."""

from __future__ import annotations

import numpy as np
from scipy import stats


def random_map(height, width, seed=0, contrast=2.0):
    random = np.random.default_rng(seed)
    return (10.0 ** random.uniform(-contrast, 0.0, (height, width, 3))).astype(np.float32)


def directions(count, seed=0):
    d = np.random.default_rng(seed).normal(size=(count, 3))
    return (d / np.linalg.norm(d, axis=1)[:, None]).astype(np.float32)


def house_uv(d):
    d = np.asarray(d, dtype=np.float64)
    d = d / np.linalg.norm(d, axis=-1, keepdims=True)
    u = 0.5 - np.arctan2(d[..., 1], d[..., 0]) / (2.0 * np.pi)
    return u, np.arccos(np.clip(d[..., 2], -1.0, 1.0)) / np.pi


def reference(radiance, rows, d):
    """The convention in plain float64: wrap columns, clamp rows, bilinear between texels."""
    height, width = radiance.shape[:2]
    u, v = house_uv(d)
    column = u * width - 0.5
    row = v * height - 0.5 if rows == "centres" else v * (height - 1)
    row = np.clip(row, 0.0, height - 1.0)
    c, r = np.floor(column).astype(int), np.minimum(np.floor(row).astype(int), max(height - 2, 0))
    fx, fy = (column - c)[:, None], (row - r)[:, None]
    below = np.minimum(r + 1, height - 1)
    image = radiance.astype(np.float64)
    top = image[r, c % width] * (1 - fx) + image[r, (c + 1) % width] * fx
    bottom = image[below, c % width] * (1 - fx) + image[below, (c + 1) % width] * fx
    return top * (1 - fy) + bottom * fy


def mean_and_error(values):
    return values.mean(axis=0), values.std(axis=0) / np.sqrt(len(values))


def sphere_grid(rows, columns):
    """Midpoints of equal steps in theta and phi, with their exact solid angles."""
    theta = (np.arange(rows) + 0.5) * np.pi / rows
    phi = (np.arange(columns) + 0.5) * 2.0 * np.pi / columns - np.pi
    theta, phi = (v.ravel() for v in np.meshgrid(theta, phi, indexing="ij"))
    half = 0.5 * np.pi / rows
    weight = 2.0 * np.sin(theta) * np.sin(half) * 2.0 * np.pi / columns
    d = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=1)
    return d, weight


def bins_of(environment, d, across, down):
    """Counts of directions in equal steps of u and cos theta."""
    local = d.astype(np.float64) @ environment.world_from_map
    u, _ = house_uv(local)
    z = local[:, 2] / np.linalg.norm(local, axis=1)
    x = np.minimum((u * across).astype(int), across - 1)
    y = np.clip((0.5 * (1.0 - z) * down).astype(int), 0, down - 1)
    return np.bincount(y * across + x, minlength=across * down)


def overlap(edges, bins):
    """(bins, n): share of each interval of `edges` that falls in each of equal bins of [0, 1]."""
    low, high = edges[:-1], edges[1:]
    starts = np.arange(bins)[:, None] / bins
    shared = np.minimum(high, starts + 1.0 / bins) - np.maximum(low, starts)
    return np.maximum(shared, 0.0) / (high - low)


def expected_bins(environment, across, down):
    """Exact probabilities of the bins: densities are constant over (u, cos theta) in a cell."""
    t = environment.tables()
    rows, columns = t.weight.shape
    probability = t.weight / t.weight.sum()
    u = (np.arange(columns + 1) - t.column_offset) / columns
    row = overlap(0.5 * (1.0 - t.row_z), down)
    # The first cell of a bilinear map lies across the seam.
    column = overlap(u, across) + overlap(u + 1.0, across)
    return (row @ probability @ column.T).ravel()


def chi_square(counts, probability):
    total = counts.sum()
    order = np.argsort(probability)
    expected, counts = probability[order] * total, counts[order]
    # Bins with few expected draws are pooled, the emptiest first.
    few = int(np.searchsorted(np.cumsum(expected), 10.0)) + 1
    few = max(few, int(np.searchsorted(expected, 5.0)))
    expected = np.append(expected[few:], expected[:few].sum())
    counts = np.append(counts[few:], counts[:few].sum())
    if expected[-1] < 5.0:
        assert counts[-1] <= 30
        expected, counts = expected[:-1], counts[:-1]
    return stats.chisquare(counts, expected * counts.sum() / expected.sum()).pvalue
