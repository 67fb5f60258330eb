"""Hard cases of scattering (BSDF): energy, reciprocity, samples and their density, limits."""

from __future__ import annotations

import math

import numpy as np

from mrbatch.contracts import Case, Measurement
from mrbatch.kernels.bsdf import Surface
from mrbatch.metrics.judging import follows, mean_within, none, together, within
from mrbatch.metrics.statistics import chi_square_test
from mrbatch.stability.scattering_draws import (
    boundary_evaluated,
    boundary_sampled,
    evaluated,
    fresnel,
    hemisphere,
    principled,
    sampled,
    sphere,
    squares,
    surface,
    view,
)
from mrbatch.stability.scattering_twins import CELLS, cell_shares, twin_albedo, twin_fresnel

INDICES = (1.5, 1 / 1.5, 1.001, 1 / 1.33, 2.4)


def lambert(seed: int) -> Measurement:
    """BSDF-01: the albedo is the reflectance, by the weights and by a product rule over the cosine."""
    nodes, parts = np.polynomial.legendre.leggauss(16)
    z, parts = 0.5 * (nodes + 1.0), 0.5 * parts
    wi = np.stack([np.sqrt(1.0 - z * z), np.zeros(16), z], axis=1)
    judged = []
    for rho in (0.0, 0.5, 1.0):
        s = surface("diffuse", reflectance=(rho, rho, rho))
        weight = sampled(s, view(40.0), squares(1000, seed))[1]
        f, p = evaluated(s, view(40.0), wi)
        total = [2.0 * np.pi * (parts * f[:, 0]).sum(), 2.0 * np.pi * (parts * p).sum()]
        judged += [within(weight, rho, 1e-6, what="weight"), within(total, [rho, 1.0], 1e-6, what="integral")]
    return together(*judged)


def single_scattering(
    seed: int,
    *,
    points: tuple[tuple[float, float], ...] = ((1.0, 0), (0.1, 0), (0.5, 85)),
    count: int = 1_000_000,
) -> Measurement:
    """BSDF-02: what white metal returns at (alpha, degrees), against quadrature; 1 - ln 2 at alpha 1."""
    means, errors, oracle = [], [], []
    for k, (alpha, degrees) in enumerate(points):
        weight = sampled(surface("conductor", alpha), view(degrees), squares(count, seed + k))[1][:, 0]
        means.append(weight.mean())
        errors.append(weight.std() / math.sqrt(count))
        normal = alpha == 1.0 and degrees == 0
        oracle.append(1 - math.log(2) if normal else twin_albedo(alpha, view(degrees))[0])
    # Quadrature is good to 1e-5.
    return mean_within(means, errors, oracle, 1e-5, observations=count)


def white_metal(
    seed: int,
    *,
    alphas: tuple[float, ...] = (0.02, 0.3, 1.0),
    degrees: tuple[float, ...] = (0.0, 45.0, 85.0),
    metalness: tuple[float, ...] = (0.0, 1.0),
    count: int = 400_000,
) -> Measurement:
    """BSDF-03: the furnace: white plastic and white metal lose nothing, to half a per cent."""
    means, errors = [], []
    for alpha in alphas:
        for angle in degrees:
            for metal in metalness:
                s = principled(alpha, metalness=metal)
                weight = sampled(s, view(angle), squares(count, seed + len(means)))[1][:, 0]
                means.append(weight.mean())
                errors.append(weight.std() / math.sqrt(count))
    # The grid is coarse where a nearly smooth lobe meets the horizon.
    return mean_within(means, errors, 1.0, 0.005, observations=count)


def swapped(s: Surface, seed: int, tolerance: float, count: int = 100_000) -> Measurement:
    """f(i, o) = f(o, i) of random pairs above the surface."""
    a, b = hemisphere(count, seed + 3), hemisphere(count, seed + 4)
    forth, back = evaluated(s, a, b)[0] / b[:, 2:], evaluated(s, b, a)[0] / a[:, 2:]
    return within(forth, back, tolerance, relative=True)


def through_glass(seed: int, eta: float) -> Measurement:
    """f / n^2 of light's side is symmetric: f(wo, wi) eta^2 = f(wi, wo) seen from behind. The half vector of
    rough glass loses digits in float32."""
    a, b = sphere(20_000, seed + 5), sphere(20_000, seed + 6)
    a[:, 2], b[:, 2] = np.abs(a[:, 2]), -np.abs(b[:, 2])
    forth = boundary_evaluated(0.3, eta, a, b, False)[0] / np.abs(b[:, 2])
    # Seen from behind the frame turns over, and the ratio with it.
    flip = np.array([1.0, -1.0, -1.0])
    back = boundary_evaluated(0.3, 1 / eta, b * flip, a * flip, False)[0] / a[:, 2]
    some = (forth > 1e-3) & (np.abs(a[:, 2]) > 0.05) & (np.abs(b[:, 2]) > 0.05)
    return together(
        within(forth[some] * eta**2, back[some], 1e-2, relative=True),
        none(some.sum() < 1000, "sets of too few pairs"),
    )


MIXED = principled(0.5, base=(0.8, 0.3, 0.1), metalness=0.4, edge=(0.7, 0.8, 0.9))


def reciprocity(seed: int) -> Measurement:
    """BSDF-04: reciprocity of 1e5 pairs on matt, metal and mixed surfaces, and of glass."""
    return together(
        *(swapped(surface(kind, 0.3), seed, 1e-5) for kind in ("diffuse", "conductor")),
        swapped(MIXED, seed, 2e-5),
        *(through_glass(seed, eta) for eta in (1.5, 1 / 1.5)),
    )


def nearly_smooth(seed: int, count: int = 100_000) -> Measurement:
    """BSDF-05: at alpha 1e-4 a mirror that returns all light; finite down to a cosine of 1e-4."""
    u = squares(count, seed + 5)
    judged = []
    for degrees in (0.0, 60.0, 85.0):
        wo = view(degrees)
        wi, weight, pdf = sampled(surface("conductor", 1e-4), wo, u)
        off = np.median(np.linalg.norm(wi - wo * [-1, -1, 1], axis=1))
        judged += [
            within(weight[:, 0].mean(), 1.0, 0.01, what="mean"),
            within(off, 0.0, 4e-4, what="median angle"),
            none(~np.isfinite(weight).all(axis=1) | ~np.isfinite(pdf), "that are no numbers"),
        ]
    grazing = np.array([math.sqrt(1.0 - 1e-8), 0.0, 1e-4])
    for alpha in (0.0, 1e-4, 0.1, 1.0):
        wi, weight, pdf = sampled(surface("conductor", alpha), grazing, u)
        f, p = evaluated(surface("conductor", alpha), grazing, wi)
        values = np.column_stack([wi, weight, pdf, f, p])
        judged += [
            none(~np.isfinite(values), "that are no numbers"),
            none((weight < 0.0) | (weight > 1.0 + 1e-6), "weights that make energy"),
        ]
    return together(*judged)


def visible_normals(seed: int, alpha: float, fine: int, degrees: float, n: int = 400_000) -> Measurement:
    """Samples against the density: counts in cells of the sphere, all directions below in one; and the
    density's integral plus the share below is 1."""
    wo = view(degrees)
    wi, weight, pdf = sampled(surface("conductor", alpha), wo, squares(n, seed + 7))
    up = wi[:, 2] > 0.0
    phi = np.mod(np.arctan2(wi[up, 1], wi[up, 0]) / (2.0 * np.pi), 1.0)
    counts, _, _ = np.histogram2d(wi[up, 2], phi, bins=CELLS, range=((0, 1.0000002), (0, 1)))
    observed = np.append(counts.ravel(), n - up.sum())
    shares = cell_shares(alpha, wo, fine)
    below = twin_albedo(alpha, wo)[1]
    expected = n * np.append(shares.ravel(), max(1.0 - shares.sum(), 0.0))
    return together(
        follows(chi_square_test(observed, expected, minimum=10.0).p),
        within(shares.sum() + below, 1.0, 1e-3, what="integral"),
        none((weight[~up] != 0).any(axis=1) | (pdf[~up] != 0), "directions below that weigh anything"),
    )


def samples_and_density(seed: int) -> Measurement:
    """BSDF-06, at three roughnesses and views."""
    return together(
        *(visible_normals(seed, *point) for point in ((0.2, 24, 45.0), (0.5, 12, 85.0), (1.0, 12, 0.0)))
    )


def snell(seed: int) -> Measurement:
    """BSDF-07: Fresnel's reflectance against float64, total reflection, Brewster's angle."""
    c = np.linspace(1e-4, 1, 5001).astype(np.float32).astype(np.float64)
    judged = []
    for eta in INDICES:
        rs, rp = twin_fresnel(c, np.float64(np.float32(eta)))
        judged.append(within(fresnel(c, eta), (rs + rp) / 2, 1e-5))
    critical = math.cos(math.radians(41.8103))
    brewster = math.cos(math.radians(56.3099))
    judged += [
        within(fresnel([critical - 2e-6, 0.3, 0.0], 1 / 1.5), 1.0, 0.0, what="total reflection"),
        none(fresnel(critical + 1e-3, 1 / 1.5) > 0.9, "reflections before 41.81 degrees"),
        within(fresnel(brewster, 1.5), twin_fresnel(brewster, 1.5)[0] / 2, 1e-6, what="Brewster"),
        within(fresnel(1.0, 1.5), 0.04, 1e-7, what="normal incidence"),
        within(fresnel([0.0, 0.2, 1.0], 1.0), 0.0, 0.0, what="no boundary"),
    ]
    return together(*judged)


def smooth_boundary(seed: int, eta: float, n: int = 40_000) -> Measurement:
    """MIS-02: a smooth boundary reflects as often as Fresnel says, bends as Snell says, has no density, and
    directions drawn otherwise bring nothing."""
    u = np.random.default_rng(seed + 1).random((n, 2))
    judged = []
    for cosine in (1.0, 0.7, 0.2):
        sine = math.sqrt(1 - cosine**2)
        wo = np.array([sine * math.cos(0.3), sine * math.sin(0.3), cosine])
        wi, weight, pdf = boundary_sampled(0.0, eta, wo, u)
        up = wi[:, 2] > 0
        rs, rp = twin_fresnel(cosine, eta)
        share = float((rs + rp) / 2)
        spread = math.sqrt(share * (1 - share) / n)
        judged += [
            mean_within(up.mean(), spread, share, 1e-6, sees=0.02, observations=n),
            none(np.isfinite(pdf[weight > 0]), "finite densities"),
            within(weight, np.where(up, 1.0, 1 / eta**2), 1e-6, relative=True, what="weight"),
            within(wi[:, :2], np.where(up[:, None], -wo[:2], -wo[:2] / eta), 1e-6, what="direction"),
        ]
    f, p = boundary_evaluated(0.0, eta, view(45.0)[None], sphere(1000, seed + 2))
    return together(*judged, none((f != 0) | (p != 0), "other directions that bring light"))


def smooth_boundaries(seed: int) -> Measurement:
    """`smooth_boundary` for glass from both sides."""
    return together(*(smooth_boundary(seed, eta) for eta in (1.5, 1 / 1.5)))


def below_the_horizon(seed: int) -> Measurement:
    """MIS-03: nothing is scattered where either direction is on or below the horizon."""
    wrong = []
    for kind in ("diffuse", "conductor"):
        for oz, iz in ((0.0, 0.5), (-0.5, 0.5), (0.5, 0.0), (0.5, -0.5), (-0.5, -0.5)):
            wo = np.array([math.sqrt(1.0 - oz * oz), 0.0, oz])
            wi = np.array([-math.sqrt(1.0 - iz * iz), 0.0, iz])
            f, p = evaluated(surface(kind), wo, wi)
            wrong += [f.any(), p.any()]
            if oz <= 0.0:
                _, weight, pdf = sampled(surface(kind), wo, squares(100, seed))
                wrong += [weight.any(), pdf.any()]
    return none(np.array(wrong), "set-ups that scatter")


CASES: tuple[Case, ...] = (
    Case("BSDF-01", "a matt surface returns its reflectance", lambert, setup="reflectances 0, .5, 1"),
    Case(
        "BSDF-02",
        "rough metal of single scattering loses what it must",
        single_scattering,
        setup="white metal, roughness 1, .1, .5, from above and at 85 degrees, 1e6 samples",
        statistical=True,
    ),
    Case(
        "BSDF-03",
        "white surfaces lose nothing",
        white_metal,
        setup="plastic and metal, roughness .02 to 1, up to 85 degrees, 400,000 samples",
        statistical=True,
    ),
    Case(
        "BSDF-04",
        "light and eye may change places",
        reciprocity,
        setup="1e5 pairs on matt, metal, mixed surfaces; 20,000 through rough glass",
    ),
    Case(
        "BSDF-05",
        "nearly smooth metal is a mirror",
        nearly_smooth,
        setup="roughness 1e-4; cosines down to 1e-4 at roughness 0 to 1",
    ),
    Case(
        "BSDF-06",
        "samples follow their density",
        samples_and_density,
        setup="rough metal, 400,000 samples in 2048 cells of the sphere",
        statistical=True,
    ),
    Case("BSDF-07", "Fresnel's reflectance", snell, setup="five indices, 5001 angles; special angles"),
    Case(
        "MIS-02",
        "a smooth boundary is met by scattered directions alone",
        smooth_boundaries,
        setup="index 1.5 from both sides, three angles, 40,000 samples",
        rows=("BSDF-07",),
        statistical=True,
    ),
    Case(
        "MIS-03",
        "nothing is scattered below the horizon",
        below_the_horizon,
        setup="directions on and below the horizon, matt and metal",
    ),
)
