"""Hard cases of the weights of two ways of drawing (MIS): ranges of densities, special values, a split."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import warp as wp

from mrbatch.contracts import Case, Measurement
from mrbatch.kernels import numerics as nm
from mrbatch.kernels.environment import EnvironmentData, LightSampler, make_environment
from mrbatch.kernels.sampling import cosine_hemisphere
from mrbatch.metrics.judging import mean_within, none, together, within
from mrbatch.scene.closed_forms import sky
from mrbatch.scene.light_paths import PathFlags, make_paths

SCATTERED = 0.5 + np.log(5.0) / 8.0
"""Share of an even sky's light that scattered directions bring to an open plane: int 2 c 4c / (4c + 1) dc."""


@wp.kernel(enable_backward=False)
def _weights(
    na: wp.array(dtype=float),
    a: wp.array(dtype=float),
    nb: wp.array(dtype=float),
    b: wp.array(dtype=float),
    out: wp.array2d(dtype=float),
):
    i = wp.tid()
    out[i, 0] = nm.balance_heuristic(a[i], b[i])
    out[i, 1] = nm.power_heuristic(a[i], b[i])
    out[i, 2] = nm.balance_heuristic_counts(na[i], a[i], nb[i], b[i])


def weights(na: np.ndarray, a: np.ndarray, nb: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(n, 3) float32: balance, power, and balance with counts, of densities a against b (n,)."""
    out = wp.zeros((len(a), 3), dtype=float, device="cpu")
    given = [wp.array(np.ascontiguousarray(v, dtype=np.float32), device="cpu") for v in (na, a, nb, b)]
    wp.launch(_weights, len(a), given, [out], device="cpu")
    return out.numpy()


def wide_pairs(seed: int, count: int = 1_000_000) -> tuple[np.ndarray, ...]:
    """Counts 0 to 999 and densities 0, 1e-38 to 1e38 and infinity, half of the pairs near each other."""
    random = np.random.default_rng(seed)
    a, b = (10.0 ** random.uniform(-38, 38, (2, count))).astype(np.float32)
    na, nb = random.integers(0, 1000, (2, count)).astype(np.float32)
    for values in (a, b):
        values[random.random(count) < 0.02] = np.inf
        values[random.random(count) < 0.02] = 0.0
    near = random.random(count) < 0.5
    b[near] = a[near] * random.uniform(0.5, 2.0, near.sum()).astype(np.float32)
    b[np.isnan(b)] = 0.0
    return na, a, nb, b


def sums(seed: int) -> Measurement:
    """MIS-01: forth and back sum to 1 within 4 units, to 0 where neither draws."""
    na, a, nb, b = wide_pairs(seed)
    total = weights(na, a, nb, b).astype(np.float64) + weights(nb, b, na, a)
    some, counted = (a > 0) | (b > 0), ((a > 0) & (na > 0)) | ((b > 0) & (nb > 0))
    oracle = np.stack([some, some, counted], axis=1).astype(np.float64)
    return within(total, oracle, np.where(oracle, 4.0 * float(np.spacing(np.float32(1.0))), 0.0))


def strong(seed: int) -> Measurement:
    """MIS-04: densities about 1e20, whose squares leave float32, against float64."""
    random = np.random.default_rng(seed)
    a, b = (10.0 ** random.uniform(15, 25, (2, 100_000))).astype(np.float32)
    na, nb = random.integers(1, 1000, (2, a.size)).astype(np.float32)
    A, B, NA, NB = (v.astype(np.float64) for v in (a, b, na, nb))
    truth = np.stack([A / (A + B), 1.0 / (1.0 + (B / A) ** 2), NA * A / (NA * A + NB * B)], axis=1)
    found = weights(na, a, nb, b)
    # Below the smallest normal float nothing keeps its digits.
    large = truth > np.finfo(np.float32).tiny / 1e-6
    return within(np.where(large, found, truth), truth, 1e-6, relative=True)


def special(seed: int) -> Measurement:
    """MIS-02, MIS-03: 0 against 0 is 0, a peak without width against a density 1, what none draws 0."""
    inf = np.inf
    na, nb = np.array([1, 1, 1, 1, 0, 1]), np.array([1, 1, 1, 1, 1, 0])
    a, b = np.array([0, inf, 1, inf, inf, 1]), np.array([0, 1, inf, inf, 1, inf])
    counted = np.array([0.0, 1.0, 0.0, 0.5, 0.0, 1.0])
    found = weights(na, a, nb, b)
    return together(within(found[:4, :2], counted[:4, None], 0.0), within(found[:, 2], counted, 0.0))


@functools.cache
def _split(sampler: LightSampler) -> Any:
    paths = make_paths(PathFlags(light_sampler=sampler))
    light_weight, scatter_weight = paths.light_weight, paths.scatter_weight
    environment = make_environment("bilinear", sampler)
    env_pdf, env_sample, env_radiance = environment.pdf, environment.sample, environment.radiance

    @wp.kernel(enable_backward=False, module="unique")
    def split(
        env: EnvironmentData,
        bits: wp.array(dtype=wp.vec2ui),
        u: wp.array(dtype=wp.vec2),
        light_part: wp.array(dtype=float),
        scatter_part: wp.array(dtype=float),
    ):
        i = wp.tid()
        pi = 3.14159265358979
        s = env_sample(env, bits[i])
        cosine = wp.max(s.direction[2], 0.0)
        light_part[i] = (
            light_weight(1, s.pdf, cosine / pi) * cosine / pi * env_radiance(env, s.direction)[0] / s.pdf
        )
        d = cosine_hemisphere(u[i])
        scatter_part[i] = scatter_weight(d[2] / pi, 1, env_pdf(env, d)) * env_radiance(env, d)[0]

    return split


def open_plane(
    seed: int, sampler: LightSampler = "median-cut", n: int = 1_000_000
) -> tuple[np.ndarray, np.ndarray]:
    """(n,), (n,) float64: light of an even sky on an open plane by drawn and by scattered directions."""
    random = np.random.default_rng(seed)
    light = sky()
    bits = wp.array(random.integers(0, 2**32, (n, 2)).astype(np.uint32), dtype=wp.vec2ui, device="cpu")
    u = wp.array(random.random((n, 2), dtype=np.float32), dtype=wp.vec2, device="cpu")
    out = [wp.zeros(n, dtype=float, device="cpu") for _ in range(2)]
    data = light.upload()
    light.provide(data, sampler)
    wp.launch(_split(sampler), n, [data, bits, u, *out], device="cpu")
    drawn, scattered = (a.numpy().astype(np.float64) for a in out)
    return drawn, scattered


def split(seed: int, sampler: LightSampler = "median-cut") -> Measurement:
    """MIS-06: scattered directions bring .70118 of the light to an open plane, drawn ones .29882."""
    drawn, scattered = open_plane(seed, sampler)
    n = len(drawn)
    parts = (scattered, SCATTERED), (drawn, 1.0 - SCATTERED)
    means = (mean_within(v.mean(), v.std() / np.sqrt(n), part, 0.0, observations=n) for v, part in parts)
    return together(*means, none((drawn < 0) | (scattered < 0), "negative shares"))


CASES: tuple[Case, ...] = (
    Case(
        "MIS-01",
        "weights of two ways of drawing sum to 1",
        sums,
        setup="1e6 pairs of densities 0 to infinity, counts 0 to 999",
        rows=("TRAP-2",),
    ),
    Case(
        "MIS-03",
        "special densities have their weights",
        special,
        setup="0, 1 and infinity against each other; counts of 0",
        rows=("MIS-02",),
    ),
    Case("MIS-04", "the power heuristic where squares leave float32", strong, setup="densities 1e15 to 1e25"),
    Case(
        "MIS-06",
        "light of an even sky is split as the weights say",
        split,
        setup="open plane, 1e6 directions of each way",
        statistical=True,
    ),
)
