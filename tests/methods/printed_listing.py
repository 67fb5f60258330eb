"""Algorithm 1 of Xu et al., *Delta Path Tracing*, line by line in float64 NumPy: what tests of its traps run.

The listing starts at a real diffuse point x seen by the camera (M(x) = 0) under the sky of radiance 1 that
surrounds everything; "the scene" that its rays hit is all there is, real and virtual. Directions to the map
are drawn uniformly over the sphere (the map is even, so this is its importance sampling). Numbers in comments
are the listing's lines. What it leaves open is read kindly: no light from below the surface, 0 / 0 is 0.
"""

from __future__ import annotations

import numpy as np
from numpy_tracer import cosine_direction, hit

P_ENV = 1.0 / (4.0 * np.pi)


def printed(
    items,
    point,
    normal,
    albedo,
    paths,
    seed,
    *,
    bounces=3,
    miss_adds=True,
    late_update=True,
    clamped_cosine=True,
):
    """Mean and standard error of L_o as printed, and look-ups of the map a path.

    `miss_adds`: lines 28 to 30 as they stand; off: a first ray that escapes ends its path. `late_update`:
    x and w_o are overwritten (25, 26) before the throughput is formed (27). `clamped_cosine`: off, n . w is
    taken as it is in 7 and 10, below the surface too.
    """
    rng = np.random.Generator(np.random.Philox(seed))
    x = np.tile(np.asarray(point, float), (paths, 1))
    n = np.tile(np.asarray(normal, float), (paths, 1))
    rho = np.full(paths, float(albedo))
    throughput = np.ones(paths)
    total = np.zeros(paths)
    alive = np.arange(paths)
    albedos = np.array([item.albedo for item in items])
    lookups = 0
    for bounce in range(1, bounces + 1):  # 3
        w_env = rng.normal(size=x.shape)  # 4
        w_env /= np.linalg.norm(w_env, axis=1, keepdims=True)
        _, _, blocker = hit(items, x, w_env)  # 5
        cosine = (n * w_env).sum(axis=1)
        density = np.maximum(cosine, 0.0) / np.pi
        weight = P_ENV / (P_ENV + density)  # 6
        facing = np.maximum(cosine, 0.0) if clamped_cosine else cosine
        change = throughput * weight * rho / np.pi * facing / P_ENV  # 7
        lookups += len(x)
        if bounce == 1:  # 8
            # A direction below x's own surface meets that surface at once.
            total[alive] -= np.where((blocker >= 0) | (cosine < 0.0), change, 0.0)  # 9, 10
        else:
            total[alive] += np.where(blocker < 0, change, 0.0)  # 13, 14
        w_i = cosine_direction(n, rng)  # 17
        t, n_next, which = hit(items, x, w_i)  # 18
        density = np.maximum((n * w_i).sum(axis=1), 0.0) / np.pi
        weight = density / (density + P_ENV)  # 19
        change = throughput * weight * rho  # 20: f cos / p is rho
        lookups += len(x)
        hits = which >= 0  # 21
        if bounce == 1:  # 22
            total[alive[hits]] -= change[hits]  # 23
        if miss_adds or bounce > 1:
            total[alive[~hits]] += change[~hits]  # 29
        alive, x, w_i, t = alive[hits], x[hits], w_i[hits], t[hits]
        next_rho = albedos[which[hits]]
        factor = rho[hits]
        if late_update:
            # f_r, n and w_o are those of x', where w_i comes from below; p_brdf drew w_i at x.
            factor = next_rho * (n_next[hits] * w_i).sum(axis=1) / (n[hits] * w_i).sum(axis=1)
        throughput = throughput[hits] * factor  # 27
        x, n, rho = x + t[:, None] * w_i, n_next[hits], next_rho  # 25, 26
        if len(x) == 0:
            break
    return total.mean(), total.std() / np.sqrt(paths), lookups / paths
