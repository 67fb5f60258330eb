"""Kernels against their twins in float64: errors in units of the last place, where precision matters."""

from __future__ import annotations

import numpy as np
import warp as wp

from mrbatch.contracts import Case, Measurement
from mrbatch.kernels import numerics as nm
from mrbatch.metrics.judging import none, together
from mrbatch.stability.map_draws import look
from mrbatch.stability.map_statistics import random_map, reference
from mrbatch.stability.scattering_draws import evaluated, fresnel, hemisphere, surface
from mrbatch.stability.scattering_twins import twin, twin_fresnel


def ulps(found: np.ndarray, truth: np.ndarray, scale: np.ndarray | float | None = None) -> np.ndarray:
    """The error of float32 `found` in units of the last place of `truth`; or of `scale`, where what is taken
    off is larger than what is left. Infinite where a value is no number."""
    unit = np.spacing(
        np.abs(np.asarray(truth if scale is None else scale, dtype=np.float64)).astype(np.float32)
    )
    with np.errstate(invalid="ignore"):
        error = np.abs(np.asarray(found, np.float64) - truth) / unit.astype(np.float64)
    return np.where(np.isfinite(error), error, np.inf)


def error_map(error: np.ndarray, along: np.ndarray, what: str, limit: float, parts: int = 4) -> Measurement:
    """Whether no error, in units of the last place, is beyond `limit`; the largest of each part of `along` is
    told, from its lowest to its highest values."""
    order = np.argsort(along, kind="stable")
    told = [float(part.max()) for part in np.array_split(error[order], parts)]
    text = ", ".join(f"{value:.3g}" for value in told)
    worst, edges = float(error.max()), (float(along.min()), float(along.max()))
    return Measurement(
        worst <= limit,
        f"at most {text} ulp for {what} from {edges[0]:.3g} to {edges[1]:.3g}",
        "float64",
        f"{limit:g} ulp",
    )


@wp.kernel(enable_backward=False)
def _angles(
    y: wp.array(dtype=float),
    x: wp.array(dtype=float),
    angle: wp.array(dtype=float),
    wave: wp.array(dtype=wp.vec2),
):
    i = wp.tid()
    angle[i] = nm.arctangent2(y[i], x[i])
    wave[i] = nm.sine_cosine_turns(y[i])


def angles(seed: int) -> Measurement:
    """Arc tangent, and sine and cosine of a turn's share, over the circle and near its axes."""
    random = np.random.default_rng(seed)
    y, x = random.normal(size=(2, 200_000)).astype(np.float32)
    y[:50_000] *= (10.0 ** random.uniform(-12, 0, 50_000)).astype(np.float32)
    y, x = y / np.hypot(y, x), x / np.hypot(y, x)
    angle = wp.zeros(y.size, dtype=float, device="cpu")
    wave = wp.zeros(y.size, dtype=wp.vec2, device="cpu")
    wp.launch(
        _angles, y.size, [wp.array(v, dtype=float, device="cpu") for v in (y, x)], [angle, wave], device="cpu"
    )
    turn = 2.0 * np.pi * y.astype(np.float64)
    truth = np.stack([np.sin(turn), np.cos(turn)], axis=1)
    exact = np.arctan2(y.astype(np.float64), x.astype(np.float64))
    return together(
        error_map(ulps(angle.numpy(), exact), np.log10(np.abs(exact) + 1e-30), "log10 of the angle", 4.0),
        # Sine and cosine are as good as their largest value, 1.
        error_map(ulps(wave.numpy(), truth, 1.0).max(axis=1), y, "sine and cosine of turns", 4.0),
    )


def microfacets(seed: int, *, alphas: tuple[float, ...] = (1e-3, 0.05, 0.3, 1.0)) -> Measurement:
    """f cos and density of rough metal, at the smallest roughness too: they are made of differences that are
    taken before anything is rounded, so some ten units of the last place are all that is lost."""
    judged = []
    for alpha in alphas:
        wo, wi = hemisphere(20_000, seed + 1), hemisphere(20_000, seed + 2)
        # Half of the pairs near the mirror direction, where the lobe is.
        wi[::2, :2] = -wo[::2, :2] + alpha * wi[::2, :2]
        wi[::2, 2] = wo[::2, 2]
        wi /= np.linalg.norm(wi, axis=1, keepdims=True)
        f, p = evaluated(surface("conductor", alpha), wo, wi)
        exact = twin(alpha, wo, wi)
        error = np.maximum(ulps(f[:, 0], exact[0]), ulps(p, exact[1]))
        judged.append(error_map(error, wo[:, 2], f"cosines at roughness {alpha:g},", 32.0))
    return together(*judged)


def reflectance(seed: int) -> Measurement:
    """Fresnel's reflectance of glass, air and diamond: as good as its largest value, 1."""
    judged = []
    for eta in (1.5, 1 / 1.5, 1.001, 2.4):
        c = np.linspace(1e-4, 1, 20_001).astype(np.float32).astype(np.float64)
        rs, rp = twin_fresnel(c, np.float64(np.float32(eta)))
        # Near total reflection the root of what is left magnifies the rounding of the sine.
        error = ulps(fresnel(c, eta), (rs + rp) / 2, 1.0)
        judged.append(error_map(error, c, f"cosines, index {eta:.4g},", 100.0))
    return together(*judged)


def look_ups(seed: int) -> Measurement:
    """Radiance of a map by bilinear look-up: directions are float32, good to 2e-7, and a cell spans 1 / size
    of the map: some 2 size units of the last place of the map's largest value."""
    from mrbatch.scene.environment import Environment

    image = random_map(64, 128, seed)
    d = np.random.default_rng(seed).normal(size=(40_000, 3))
    d = (d / np.linalg.norm(d, axis=1)[:, None]).astype(np.float32)
    light = look(Environment(image), d)[0]
    error = ulps(light, reference(image, "centres", d), float(image.max())).max(axis=1)
    return together(
        error_map(error, d[:, 2].astype(np.float64), "heights", 4.0 * 128),
        none(light < 0, "negative look-ups"),
    )


@wp.kernel(enable_backward=False)
def _offsets(
    p: wp.array(dtype=wp.vec3),
    n: wp.array(dtype=wp.vec3),
    d: wp.array(dtype=wp.vec3),
    t: wp.array(dtype=float),
    out: wp.array(dtype=wp.vec3),
):
    i = wp.tid()
    out[i] = nm.offset_origin(p[i], n[i], d[i], t[i])


def surface_starts(
    random: np.random.Generator, scale: float, offset: float, count: int = 20_000
) -> tuple[np.ndarray, ...]:
    """Points found in float32 by rays of length about `scale` on random planes, as an engine finds them.

    Gives p, ng, d (leaving either side), t, and exact points (float64) of the planes.
    """

    def directions() -> np.ndarray:
        d = random.normal(size=(count, 3))
        return (d / np.linalg.norm(d, axis=1)[:, None]).astype(np.float32)

    normal, origin = directions(), (random.normal(size=(count, 3)) * scale + offset).astype(np.float32)
    way = directions()
    t = (random.uniform(0.1, 2.0, count) * scale).astype(np.float32)
    exact = origin.astype(np.float64) + t[:, None].astype(np.float64) * way
    # p is what float32 makes of it, the plane passes through the exact point.
    p = origin + t[:, None] * way
    keep = np.abs(np.einsum("ij,ij->i", normal, way)) > 0.05
    return p[keep], normal[keep], directions()[keep], t[keep], exact[keep]


def offset_starts(p: np.ndarray, n: np.ndarray, d: np.ndarray, t: np.ndarray) -> np.ndarray:
    """(n, 3) float32: where rays d start that leave surfaces of normals n at points p, met at distances t."""
    out = wp.zeros(len(p), dtype=wp.vec3, device="cpu")
    given = [wp.array(np.ascontiguousarray(v), dtype=wp.vec3, device="cpu") for v in (p, n, d)]
    wp.launch(_offsets, len(p), [*given, wp.array(t, dtype=float, device="cpu")], [out], device="cpu")
    return out.numpy()


def ray_starts(
    seed: int,
    *,
    scales: tuple[float, ...] = (1e-4, 1.0, 1e4),
    offsets: tuple[float, ...] = (0.0, 1e3, 1e6),
) -> Measurement:
    """GEO-01, TRAP-1k: a ray that leaves a surface starts on its side of the exact plane, by a step of few
    units in the last place."""
    judged = []
    for scale in scales:
        for offset in offsets:
            p, n, d, t, exact = surface_starts(np.random.default_rng(seed + 1), scale, offset)
            start = offset_starts(p, n, d, t).astype(np.float64)
            side = np.sign(np.einsum("ij,ij->i", n.astype(np.float64), d.astype(np.float64)))
            height = np.einsum("ij,ij->i", start - exact, n.astype(np.float64)) * side
            reach = np.maximum(np.abs(p).max(axis=1), t)
            judged += [
                none(height <= 0.0, "starts behind their surface"),
                error_map(height / np.spacing(reach).astype(np.float64), reach, "reaches", 32.0, parts=2),
            ]
    return together(*judged)


CASES: tuple[Case, ...] = (
    Case(
        "GEO-01",
        "rays start on their side of the surface",
        ray_starts,
        setup="scales 1e-4 to 1e4, offsets to 1e6",
        rows=("TRAP-1k",),
    ),
    Case("TWIN-01", "angles", angles, setup="arc tangent, sine and cosine, 200,000 values"),
    Case(
        "TWIN-02",
        "rough metal",
        microfacets,
        setup="20,000 pairs at four roughnesses, half near the mirror's way",
    ),
    Case("TWIN-03", "Fresnel's reflectance", reflectance, setup="four indices, 20,001 angles"),
    Case(
        "TWIN-04", "look-ups of a map", look_ups, setup="128 x 64 texels over two decades, 40,000 directions"
    ),
)
