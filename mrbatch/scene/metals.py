"""Metals by name: what they reflect, from published optical constants.

Index of refraction n and extinction k by wavelength, as measured, give Fresnel's reflectance for each
wavelength and angle; seen under daylight (D65) by the standard observer it is a colour. The renderer's curve
over the angle is F82-tint (`kernels.fresnel`): it takes that colour at normal incidence and at 82 degrees
(cos 1/7), and is right there; between, it is off by what `tests/scene/test_metals.py` states.

Sources of n and k: P. B. Johnson and R. W. Christy, Phys. Rev. B 6, 4370 (1972), gold, silver and copper;
the same, Phys. Rev. B 9, 5056 (1974), chromium, iron, nickel and titanium; A. D. Rakic, Appl. Opt. 34, 4755
(1995), aluminium. All are of clean, polished or evaporated metal: what stands about in rooms is duller.
"""

from __future__ import annotations

import functools

import numpy as np

from mrbatch.kernels.transfer import PRIMARIES, xyz_from_rgb

EDGE_COSINE = 1.0 / 7.0
"""Where F82-tint is fitted: 81.8 degrees."""

_NOBLE = (3679, 3815, 3974, 4133, 4305, 4509, 4714, 4959, 5209, 5486, 5821, 6168, 6595, 7045, 7560, 8211)
_TRANSITION = (3680, 3810, 3970, 4130, 4310, 4510, 4710, 4960, 5210, 5490, 5820, 6170, 6590, 7040, 7560, 8210)
_RAKIC = (36466, 41328, 44280, 47687, 51660, 56357, 61993, 65225, 68881, 72932, 77491, 79478)

CONSTANTS: dict[str, np.ndarray] = {
    name: np.array([np.array(waves) * unit, n, k])
    for name, waves, unit, n, k in (
        (
            "gold",
            _NOBLE,
            0.1,
            (1.48, 1.46, 1.47, 1.46, 1.45, 1.38, 1.31, 1.04, 0.62, 0.43, 0.29, 0.21, 0.14, 0.13, 0.14, 0.16),
            (
                *(1.895, 1.933, 1.952, 1.958, 1.948, 1.914, 1.849, 1.833, 2.081, 2.455, 2.863, 3.272, 3.697),
                *(4.103, 4.542, 5.083),
            ),
        ),
        (
            "silver",
            _NOBLE,
            0.1,
            (0.07, 0.05, 0.05, 0.05, 0.04, 0.04, 0.05, 0.05, 0.05, 0.06, 0.05, 0.06, 0.05, 0.04, 0.03, 0.04),
            (
                *(1.657, 1.864, 2.070, 2.275, 2.462, 2.657, 2.869, 3.093, 3.324, 3.586, 3.858, 4.152, 4.483),
                *(4.838, 5.242, 5.727),
            ),
        ),
        (
            "copper",
            _NOBLE,
            0.1,
            (1.36, 1.33, 1.32, 1.28, 1.25, 1.24, 1.25, 1.22, 1.18, 1.02, 0.70, 0.30, 0.22, 0.21, 0.24, 0.26),
            (
                *(1.975, 2.045, 2.116, 2.207, 2.305, 2.397, 2.483, 2.564, 2.608, 2.577, 2.704, 3.205, 3.747),
                *(4.205, 4.665, 5.180),
            ),
        ),
        (
            "chromium",
            _TRANSITION,
            0.1,
            (1.87, 1.92, 2.00, 2.08, 2.19, 2.33, 2.51, 2.75, 2.94, 3.18, 3.22, 3.17, 3.09, 3.05, 3.08, 3.20),
            (2.69, 2.74, 2.83, 2.93, 3.04, 3.14, 3.24, 3.30, 3.33, 3.33, 3.30, 3.30, 3.34, 3.39, 3.42, 3.48),
        ),
        (
            "iron",
            _TRANSITION,
            0.1,
            (2.02, 2.12, 2.24, 2.35, 2.48, 2.59, 2.67, 2.74, 2.86, 2.95, 2.94, 2.88, 2.92, 2.86, 2.87, 2.94),
            (2.43, 2.50, 2.58, 2.65, 2.71, 2.77, 2.82, 2.88, 2.91, 2.93, 2.99, 3.05, 3.10, 3.19, 3.28, 3.39),
        ),
        (
            "nickel",
            _TRANSITION,
            0.1,
            (1.70, 1.72, 1.72, 1.70, 1.71, 1.73, 1.78, 1.82, 1.85, 1.92, 1.96, 1.99, 1.99, 2.06, 2.13, 2.26),
            (2.40, 2.48, 2.57, 2.69, 2.82, 2.95, 3.09, 3.25, 3.42, 3.61, 3.80, 4.02, 4.26, 4.50, 4.73, 4.97),
        ),
        (
            "titanium",
            _TRANSITION,
            0.1,
            (1.90, 1.99, 2.08, 2.14, 2.21, 2.27, 2.32, 2.36, 2.44, 2.54, 2.60, 2.67, 2.76, 2.86, 3.00, 3.21),
            (2.90, 2.93, 2.95, 2.98, 3.01, 3.04, 3.10, 3.19, 3.30, 3.43, 3.58, 3.72, 3.84, 3.96, 4.01, 4.01),
        ),
        (
            "aluminium",
            _RAKIC,
            0.01,
            (
                *(0.39877, 0.52135, 0.60790, 0.72780, 0.87340, 1.0728, 1.3660, 1.5724, 1.8301, 2.1606),
                *(2.6154, 2.7675),
            ),
            (
                *(4.3957, 5.0008, 5.3676, 5.7781, 6.2418, 6.7839, 7.4052, 7.7354, 8.0601, 8.3565),
                *(8.4914, 8.3866),
            ),
        ),
    )
}
"""By name (3, m) float64: wavelength in nm, n, k."""

WAVES = np.arange(380.0, 781.0, 10.0)
"""Wavelengths in nm that colours are summed over."""
D65 = np.array(
    [49.9755, 54.6482, 82.7549, 91.486, 93.4318, 86.6823, 104.865, 117.008, 117.812, 114.861]
    + [115.923, 108.811, 109.354, 107.802, 104.79, 107.689, 104.405, 104.046, 100.0, 96.3342]
    + [95.788, 88.6856, 90.0062, 89.5991, 87.6987, 83.2886, 83.6992, 80.0268, 80.2146, 82.2778]
    + [78.2842, 69.7213, 71.6091, 74.349, 61.604, 69.8856, 75.087, 63.5927, 46.4182, 66.8054]
    + [63.3828]
)
"""CIE standard illuminant D65 at `WAVES`."""


def observer(waves: np.ndarray) -> np.ndarray:
    """(3, m) the CIE 1931 observer: sums of Gaussians of two widths (Wyman, Sloan, Shirley, JCGT 2013)."""

    def lobe(height: float, centre: float, left: float, right: float) -> np.ndarray:
        width = np.where(waves < centre, left, right)
        return height * np.exp(-0.5 * ((waves - centre) / width) ** 2)

    return np.array(
        [
            lobe(1.056, 599.8, 37.9, 31.0) + lobe(0.362, 442.0, 16.0, 26.7) + lobe(-0.065, 501.1, 20.4, 26.2),
            lobe(0.821, 568.8, 46.9, 40.5) + lobe(0.286, 530.9, 16.3, 31.1),
            lobe(1.217, 437.0, 11.8, 36.0) + lobe(0.681, 459.0, 26.0, 13.8),
        ]
    )


def colour(spectrum: np.ndarray) -> np.ndarray:
    """(..., 3) linear Rec.709 of a reflectance (..., m) at `WAVES` under D65; an even one keeps its value."""
    rgb_from_xyz = np.linalg.inv(xyz_from_rgb(np.asarray(PRIMARIES["bt709"])))
    weights = rgb_from_xyz @ (observer(WAVES) * D65)
    return np.asarray(spectrum) @ (weights / weights.sum(axis=1, keepdims=True)).T


def reflectance(n: np.ndarray, k: np.ndarray, cosine: float) -> np.ndarray:
    """Fresnel's reflectance of unpolarized light in air by a metal, from the complex amplitudes."""
    index = np.asarray(n) + 1j * np.asarray(k)
    inside = np.sqrt(1.0 - (1.0 - cosine**2) / index**2)
    s = (cosine - index * inside) / (cosine + index * inside)
    p = (index * cosine - inside) / (index * cosine + inside)
    return 0.5 * (np.abs(s) ** 2 + np.abs(p) ** 2)


def spectrum(metal: str, cosine: float) -> np.ndarray:
    """(m,) reflectance at `WAVES`."""
    waves, n, k = CONSTANTS[metal]
    return reflectance(np.interp(WAVES, waves, n), np.interp(WAVES, waves, k), cosine)


@functools.cache
def metal_colours(metal: str) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Reflectance at normal incidence and the tint at 82 degrees, as F82-tint has it, each in 0..1.

    Saturated metals lie a little outside of Rec.709 (gold): they are clamped to it.
    """
    base = np.clip(colour(spectrum(metal, 1.0)), 0.0, 1.0)
    schlick = base + (1.0 - base) * (1.0 - EDGE_COSINE) ** 5
    edge = np.clip(colour(spectrum(metal, EDGE_COSINE)) / schlick, 0.0, 1.0)
    return tuple(base.tolist()), tuple(edge.tolist())
