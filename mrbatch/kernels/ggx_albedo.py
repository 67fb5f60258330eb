"""Directional albedo of the GGX lobe, from a table: what is left for the layers under it.

With Schlick's Fresnel the albedo is linear in the reflectance at normal incidence,

    E(mu) = F0 A(mu, alpha) + B(mu, alpha),   F = F0 + (1 - F0) (1 - wo.m)^5,

and A + B is the albedo of a lobe with F = 1, whose lack to 1 is light that leaves after more than one
microfacet. The table holds A and B for height-correlated masking on a grid of sqrt(mu) and sqrt(alpha);
`ggx_albedo.npy` is what `make_table` gives. Averages over the hemisphere are those of the interpolated
table, so that energy is kept to rounding wherever the table is right.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import warp as wp

SIDE = 32
"""Nodes along sqrt(mu), mu = cos of the angle to the normal, and along sqrt(alpha)."""
_FILE = Path(__file__).with_suffix(".npy")


def _lambda(alpha: float, w: np.ndarray) -> np.ndarray:
    t2 = (w[..., 0] ** 2 + w[..., 1] ** 2) / w[..., 2] ** 2
    return 0.5 * (np.sqrt(1.0 + alpha**2 * t2) - 1.0)


def quadrature(mu: float, alpha: float, nodes: int = 256) -> tuple[float, float]:
    """A and B in float64 by midpoint sums over visible normals (Heitz 2018).

    With q = 1 - s^2 = t^2 / (1 + t^2), t = tan(theta_m) / alpha, visible normals have the density
    G1 max(0, wo.m / cos_m) / (2 pi o_z) in (q, phi); s takes the pole at q = 1 away.
    """
    wo = np.array([np.sqrt(max(0.0, 1.0 - mu * mu)), 0.0, mu])
    s = (np.arange(nodes) + 0.5)[:, None] / nodes
    # The integrand is even in phi.
    phi = np.pi * (np.arange(nodes) + 0.5) / nodes
    t = alpha * np.sqrt(1.0 - s * s) / s
    m = np.stack(np.broadcast_arrays(t * np.cos(phi), t * np.sin(phi), 1.0), axis=-1)
    seen = np.maximum(m @ wo, 0.0)
    m /= np.linalg.norm(m, axis=-1, keepdims=True)
    cosine = m @ wo
    wi = 2.0 * cosine[..., None] * m - wo
    up = wi[..., 2] > 0.0
    lo, li = _lambda(alpha, wo), _lambda(alpha, np.where(up[..., None], wi, 1.0))
    mass = seen / (1.0 + lo) / mu * 2.0 * s / nodes**2 * (1.0 + lo) / (1.0 + lo + li) * up
    grazing = np.clip(1.0 - cosine, 0.0, 1.0) ** 5
    return float((mass * (1.0 - grazing)).sum()), float((mass * grazing).sum())


def make_table(side: int = SIDE) -> np.ndarray:
    """(side, side, 2) float32: A and B at mu = (i / (side - 1))^2, alpha = (j / (side - 1))^2.

    The ends mu = 0 and alpha = 0 are taken just inside.
    """
    nodes = (np.arange(side) / (side - 1)) ** 2
    table = np.empty((side, side, 2), np.float32)
    for i, mu in enumerate(np.maximum(nodes, 1e-4)):
        for j, alpha in enumerate(np.maximum(nodes, 1e-4)):
            table[i, j] = quadrature(float(mu), float(alpha))
    return table


def averages(table: np.ndarray) -> np.ndarray:
    """(side, 2): 2 integral of A mu d mu and of B, of the table as it is interpolated, for each alpha."""
    side = len(table)
    x, weight = np.polynomial.legendre.leggauss(4)
    x, weight = 0.5 * (x + 1.0), 0.5 * weight
    total = np.zeros((side, 2))
    for i in range(side - 1):
        for u, w in zip(x, weight, strict=True):
            # mu = t^2, so mu d mu = 2 t^3 dt; linear in t between nodes.
            t = (i + u) / (side - 1)
            value = table[i].astype(np.float64) * (1.0 - u) + table[i + 1].astype(np.float64) * u
            total += 2.0 * value * 2.0 * t**3 * w / (side - 1)
    return total


def _native(table: np.ndarray) -> tuple[str, str]:
    # A table in the source needs no argument in the signature of every scattering function.
    side = len(table)

    def numbers(values: np.ndarray) -> str:
        return ", ".join(f"{v:.9e}f" for v in np.asarray(values, np.float32).ravel())

    head = f"""
    const int side = {side};
    const float last = (float)(side - 1);
    float y = ::sqrt(alpha < 0.0f ? 0.0f : (alpha > 1.0f ? 1.0f : alpha)) * last;
    int j = (int)y; if (j > side - 2) j = side - 2;
    float fy = y - (float)j;
    """
    albedo = f"""
    static const float table[] = {{ {numbers(table)} }};
    {head}
    float x = ::sqrt(mu < 0.0f ? 0.0f : (mu > 1.0f ? 1.0f : mu)) * last;
    int i = (int)x; if (i > side - 2) i = side - 2;
    float fx = x - (float)i;
    const float* p = table + (i * side + j) * 2;
    const float* q = p + side * 2;
    float a0 = p[0] + (p[2] - p[0]) * fy;
    float b0 = p[1] + (p[3] - p[1]) * fy;
    float a1 = q[0] + (q[2] - q[0]) * fy;
    float b1 = q[1] + (q[3] - q[1]) * fy;
    return wp::vec_t<2, float>(a0 + (a1 - a0) * fx, b0 + (b1 - b0) * fx);
    """
    mean = f"""
    static const float table[] = {{ {numbers(averages(table))} }};
    {head}
    const float* p = table + j * 2;
    return wp::vec_t<2, float>(p[0] + (p[2] - p[0]) * fy, p[1] + (p[3] - p[1]) * fy);
    """
    # Warp defines `float(x)` and `int(x)` as macros of its own: C casts stay plain.
    return albedo, mean


def load_table() -> np.ndarray:
    """The stored table."""
    return np.load(_FILE, allow_pickle=False)


_ALBEDO, _MEAN = _native(load_table())


@wp.func_native(_ALBEDO)
def ggx_albedo(mu: float, alpha: float) -> wp.vec2:
    """(A, B) at the cosine `mu` for roughness `alpha`: the albedo is F0 A + B."""


@wp.func_native(_MEAN)
def ggx_albedo_mean(alpha: float) -> wp.vec2:
    """(A, B) averaged over the hemisphere, weighted by 2 mu."""
