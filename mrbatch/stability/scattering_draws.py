"""Scattering by the program's own functions, evaluated and sampled in bulk: for cases and tests."""

from __future__ import annotations

import functools
import math
from typing import Any

import numpy as np
import warp as wp

from mrbatch.kernels.bsdf import KINDS, BsdfSample, Surface, make_bsdf
from mrbatch.kernels.dielectric import DielectricSample, make_dielectric
from mrbatch.kernels.fresnel import fresnel_dielectric


@wp.struct
class Rows:
    wo: wp.array(dtype=wp.vec3)
    wi: wp.array(dtype=wp.vec3)
    u: wp.array(dtype=wp.vec2)


def _kernels(bsdf: Any) -> tuple[Any, Any]:
    evaluate, density, sample = bsdf.evaluate, bsdf.pdf, bsdf.sample

    @wp.kernel(enable_backward=False, module="unique")
    def evaluate_all(s: Surface, rows: Rows, f: wp.array(dtype=wp.vec3), p: wp.array(dtype=float)):
        i = wp.tid()
        f[i] = evaluate(s, rows.wo[i], rows.wi[i])
        p[i] = density(s, rows.wo[i], rows.wi[i])

    @wp.kernel(enable_backward=False, module="unique")
    def sample_all(s: Surface, rows: Rows, out: wp.array(dtype=BsdfSample)):
        i = wp.tid()
        out[i] = sample(s, rows.wo[i], rows.u[i])

    return evaluate_all, sample_all


_made: dict[int, tuple[Any, Any]] = {}


def kernels(bsdf: Any) -> tuple[Any, Any]:
    """Kernels that evaluate and that sample; `make_bsdf` gives one object for the same arguments."""
    if id(bsdf) not in _made:
        _made[id(bsdf)] = _kernels(bsdf)
    return _made[id(bsdf)]


def surface(kind: str, alpha: float = 0.5, reflectance: tuple[float, ...] = (1.0, 1.0, 1.0)) -> Surface:
    s = Surface()
    s.kind, s.alpha, s.reflectance = KINDS[kind], alpha, wp.vec3(*reflectance)
    return s


def principled(
    alpha: float,
    *,
    base: tuple[float, ...] = (1.0, 1.0, 1.0),
    metalness: float = 0.0,
    f0: float = 0.04,
    edge: tuple[float, ...] = (1.0, 1.0, 1.0),
) -> Surface:
    s = Surface()
    s.kind, s.alpha, s.metalness, s.f0 = KINDS["principled"], alpha, metalness, f0
    s.reflectance, s.edge = wp.vec3(*base), wp.vec3(*edge)
    return s


def vectors(a: np.ndarray, count: int | None = None) -> Any:
    """`wp.array` of vec3 of (n, 3), or of one vector `count` times."""
    rows = np.asarray(a, np.float32)
    rows = rows if count is None else np.broadcast_to(rows, (count, 3))
    return wp.array(np.ascontiguousarray(rows), dtype=wp.vec3, device="cpu")


def evaluated(s: Surface, wo: np.ndarray, wi: np.ndarray, bsdf: Any = None) -> tuple[np.ndarray, np.ndarray]:
    """f cos (n, 3) and density (n,) in float64, of directions (n, 3) or (3,)."""
    n = max(len(np.atleast_2d(wo)), len(np.atleast_2d(wi)))
    rows = Rows()
    rows.wo, rows.wi = vectors(wo, n), vectors(wi, n)
    f, p = wp.zeros(n, dtype=wp.vec3, device="cpu"), wp.zeros(n, dtype=float, device="cpu")
    wp.launch(kernels(bsdf or make_bsdf())[0], n, [s, rows], [f, p], device="cpu")
    return f.numpy().astype(np.float64), p.numpy().astype(np.float64)


def sampled(s: Surface, wo: np.ndarray, u: np.ndarray, bsdf: Any = None) -> tuple[np.ndarray, ...]:
    """wi (n, 3), weight (n, 3), density (n,) in float64, of numbers u (n, 2)."""
    rows = Rows()
    rows.wo, rows.u = vectors(wo, len(u)), wp.array(u, dtype=wp.vec2, device="cpu")
    out = wp.zeros(len(u), dtype=BsdfSample, device="cpu")
    wp.launch(kernels(bsdf or make_bsdf())[1], len(u), [s, rows], [out], device="cpu")
    a = out.numpy()
    return tuple(a[name].astype(np.float64) for name in ("wi", "weight", "pdf"))


@functools.cache
def _boundary(correlated: bool) -> tuple[Any, Any]:
    functions = make_dielectric(correlated)
    evaluate, density, sample = functions.evaluate, functions.pdf, functions.sample

    @wp.kernel(enable_backward=False, module="unique")
    def evaluate_all(
        alpha: float,
        eta: float,
        wo: wp.array(dtype=wp.vec3),
        wi: wp.array(dtype=wp.vec3),
        f: wp.array(dtype=float),
        p: wp.array(dtype=float),
    ):
        i = wp.tid()
        f[i] = evaluate(alpha, eta, wo[i], wi[i])
        p[i] = density(alpha, eta, wo[i], wi[i])

    @wp.kernel(enable_backward=False, module="unique")
    def sample_all(
        alpha: float,
        eta: float,
        wo: wp.array(dtype=wp.vec3),
        u: wp.array(dtype=wp.vec2),
        out: wp.array(dtype=DielectricSample),
    ):
        i = wp.tid()
        out[i] = sample(alpha, eta, wo[i], u[i])

    return evaluate_all, sample_all


def boundary_evaluated(
    alpha: float, eta: float, wo: np.ndarray, wi: np.ndarray, correlated: bool = True
) -> tuple[np.ndarray, np.ndarray]:
    """f cos (n,) and density (n,) of a clear boundary, in float64."""
    n = len(np.broadcast_to(wo, np.broadcast_shapes(wo.shape, wi.shape)))
    f, p = (wp.zeros(n, dtype=float, device="cpu") for _ in range(2))
    given = [alpha, eta, vectors(wo, n), vectors(wi, n)]
    wp.launch(_boundary(correlated)[0], n, given, [f, p], device="cpu")
    return f.numpy().astype(np.float64), p.numpy().astype(np.float64)


def boundary_sampled(
    alpha: float, eta: float, wo: np.ndarray, u: np.ndarray, correlated: bool = True
) -> tuple[np.ndarray, ...]:
    """wi (n, 3), weight (n,), density (n,) of a clear boundary, in float64."""
    n = len(u)
    out = wp.zeros(n, dtype=DielectricSample, device="cpu")
    numbers = wp.array(np.ascontiguousarray(u, dtype=np.float32), dtype=wp.vec2, device="cpu")
    wp.launch(_boundary(correlated)[1], n, [alpha, eta, vectors(wo, n), numbers], [out], device="cpu")
    rows = out.numpy()
    return tuple(rows[name].astype(np.float64) for name in ("wi", "weight", "pdf"))


@wp.kernel(enable_backward=False)
def _fresnel(c: wp.array(dtype=float), eta: wp.array(dtype=float), out: wp.array(dtype=float)):
    i = wp.tid()
    out[i] = fresnel_dielectric(c[i], eta[i])


def fresnel(c: Any, eta: Any) -> np.ndarray:
    """Reflectance of a clear boundary at cosines `c`, float64 of the shape of both arguments together."""
    c, eta = np.broadcast_arrays(np.asarray(c, np.float32), np.asarray(eta, np.float32))
    out = wp.zeros(c.size, dtype=float, device="cpu")
    inputs = [wp.array(np.ascontiguousarray(x.ravel()), device="cpu") for x in (c, eta)]
    wp.launch(_fresnel, c.size, inputs, [out], device="cpu")
    return out.numpy().astype(np.float64).reshape(c.shape)


def squares(n: int, seed: int) -> np.ndarray:
    """(n, 2) float32 numbers."""
    return np.random.default_rng(seed).random((n, 2), dtype=np.float32)


def view(degrees: float) -> np.ndarray:
    """(3,) a direction that many degrees from the normal, as float32 holds it."""
    t = math.radians(degrees)
    return np.array([math.sin(t), 0.0, math.cos(t)], dtype=np.float32).astype(np.float64)


def hemisphere(n: int, seed: int) -> np.ndarray:
    """(n, 3) float32 directions above the surface, evenly spread."""
    d = np.random.default_rng(seed).normal(size=(n, 3))
    d[:, 2] = np.abs(d[:, 2])
    return (d / np.linalg.norm(d, axis=1, keepdims=True)).astype(np.float32)


def sphere(n: int, seed: int) -> np.ndarray:
    """(n, 3) directions, evenly spread."""
    d = np.random.default_rng(seed).normal(size=(n, 3))
    return d / np.linalg.norm(d, axis=1, keepdims=True)
