"""Scattering in float64, written from the papers: Walter et al. 2007 (D and G1, eqs. 33 and 34), Heitz 2014
(eq. 99), Fresnel and Snell."""

from __future__ import annotations

import numpy as np

CELLS = (32, 64)
"""Cells of (cosine, azimuth) of the upper hemisphere in which samples are counted."""


def twin_d(alpha: float, m: np.ndarray) -> np.ndarray:
    """Density of microfacet normals m (..., 3)."""
    c = m[..., 2]
    t2 = (1.0 - c * c) / (c * c)
    return alpha**2 / (np.pi * c**4 * (alpha**2 + t2) ** 2)


def twin_lambda(alpha: float, w: np.ndarray) -> np.ndarray:
    """Smith's Lambda of directions w (..., 3)."""
    t2 = (w[..., 0] ** 2 + w[..., 1] ** 2) / w[..., 2] ** 2
    return 0.5 * (np.sqrt(1.0 + alpha**2 * t2) - 1.0)


def twin(
    alpha: float, wo: np.ndarray, wi: np.ndarray, masking: str = "height-correlated"
) -> tuple[np.ndarray, np.ndarray]:
    """f cos and density of white metal."""
    wo, wi = np.broadcast_arrays(np.asarray(wo, np.float64), np.asarray(wi, np.float64))
    m = wo + wi
    m = m / np.linalg.norm(m, axis=-1, keepdims=True)
    lo, li = twin_lambda(alpha, wo), twin_lambda(alpha, wi)
    g2 = 1.0 / (1.0 + lo + li) if masking == "height-correlated" else 1.0 / ((1.0 + lo) * (1.0 + li))
    d = twin_d(alpha, m)
    return d * g2 / (4.0 * wo[..., 2]), d / (1.0 + lo) / (4.0 * wo[..., 2])


def twin_albedo(
    alpha: float, wo: np.ndarray, masking: str = "height-correlated", n: int = 1500
) -> tuple[float, float]:
    """Directional albedo by quadrature over visible normals, and the share of samples below the horizon.

    With q = t^2 / (1 + t^2), t = tan(theta_m) / alpha, visible normals have the density
    G1 max(0, wo.m / cos_m) / (2 pi o_z) in (q, phi); q = 1 - s^2 takes the pole at q = 1 away.
    """
    s, phi = (np.arange(n) + 0.5)[:, None] / n, 2.0 * np.pi * (np.arange(n) + 0.5) / n
    t = alpha * np.sqrt(1.0 - s * s) / s
    m = np.stack(np.broadcast_arrays(t * np.cos(phi), t * np.sin(phi), 1.0), axis=-1)
    seen = np.maximum(m @ wo, 0.0)
    m = m / np.linalg.norm(m, axis=-1, keepdims=True)
    wi = 2.0 * (m @ wo)[..., None] * m - wo
    g1 = 1.0 / (1.0 + twin_lambda(alpha, wo))
    mass = g1 * seen / wo[2] * 2.0 * s / n**2
    up = wi[..., 2] > 0.0
    li, lo = twin_lambda(alpha, np.where(up[..., None], wi, 1.0)), twin_lambda(alpha, wo)
    ratio = (1.0 + lo) / (1.0 + lo + li) if masking == "height-correlated" else 1.0 / (1.0 + li)
    return float((mass * ratio)[up].sum()), float(mass[~up].sum())


def cell_shares(alpha: float, wo: np.ndarray, fine: int) -> np.ndarray:
    """Share of samples in each of CELLS, by midpoint sums, `fine` steps a cell in both directions."""
    shares = np.zeros(CELLS)
    phi = 2.0 * np.pi * (np.arange(CELLS[1] * fine) + 0.5) / (CELLS[1] * fine)
    for row in range(CELLS[0]):
        z = (row + (np.arange(fine) + 0.5) / fine)[:, None] / CELLS[0]
        r = np.sqrt(1.0 - z * z)
        wi = np.stack(np.broadcast_arrays(r * np.cos(phi), r * np.sin(phi), z), axis=-1)
        p = twin(alpha, wo, wi)[1]
        shares[row] = p.sum(axis=0).reshape(CELLS[1], fine).sum(axis=1)
    return shares * 2.0 * np.pi / (CELLS[0] * CELLS[1] * fine**2)


def twin_fresnel(c: np.ndarray | float, eta: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
    """Rs and Rp of a clear boundary, from Snell's law."""
    c = np.asarray(c, dtype=np.float64)
    sine2 = (1 - c * c) / np.asarray(eta, dtype=np.float64) ** 2
    t = np.sqrt(np.maximum(1 - sine2, 0.0))
    rs, rp = (c - eta * t) / (c + eta * t), (eta * c - t) / (eta * c + t)
    beyond = sine2 >= 1
    return np.where(beyond, 1.0, rs**2), np.where(beyond, 1.0, rp**2)
