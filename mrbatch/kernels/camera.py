"""Camera rays and projection, as pairs of `wp.func`s: perspective (OpenCV's distortion), equirectangular.

A lens of finite width is laid over either model's central ray (`through_lens`). Pixel centres lie at half
integers, row 0 at the top. Positions are relative to the scene's float64
origin, which the host subtracts before anything is rounded to float32.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import warp as wp

from mrbatch.kernels.sampling import concentric_disk

Model = Literal["perspective", "equirectangular"]
PERSPECTIVE = 0
EQUIRECTANGULAR = 1
_MODELS = {"perspective": PERSPECTIVE, "equirectangular": EQUIRECTANGULAR}

_PI = wp.constant(wp.float32(math.pi))
_UNLIMITED = 3.0e38
_NEWTON_STEPS = wp.constant(20)
DIM_LENS = wp.constant(wp.int32(4))
"""Dimension of the point on the lens: after that of the point in the pixel, before a path's first vertex."""


@wp.struct
class CameraData:
    """A camera as kernels take it.

    `fx fy cx cy skew` in pixels (x = fx X + skew Y + cx), pixel centres at half integers; `per_fx`, `per_fy`
    their reciprocals, for a division would be half of what a camera ray costs. `k1`..`k6`,
    `p1 p2`: OpenCV's coefficients. `radius2`: squared radius (tangent plane, undistorted) up to which
    the radial model grows and can be inverted. `rotation`: world_from_camera. `origin`: the camera's
    position relative to the scene's origin. `model`: PERSPECTIVE or EQUIRECTANGULAR. `lens_radius` metres,
    and `focus`, the planar z that is sharp, metres: of a lens of finite width, else 0.
    """

    fx: wp.float32
    fy: wp.float32
    cx: wp.float32
    cy: wp.float32
    skew: wp.float32
    per_fx: wp.float32
    per_fy: wp.float32
    k1: wp.float32
    k2: wp.float32
    k3: wp.float32
    k4: wp.float32
    k5: wp.float32
    k6: wp.float32
    p1: wp.float32
    p2: wp.float32
    radius2: wp.float32
    rotation: wp.mat33
    origin: wp.vec3
    model: wp.int32
    width: wp.int32
    height: wp.int32
    lens_radius: wp.float32
    focus: wp.float32


@wp.struct
class CameraRay:
    """Origin (relative to the scene's origin), unit direction (world), and whether the pixel has a ray."""

    origin: wp.vec3
    direction: wp.vec3
    ok: wp.bool


@dataclass(frozen=True)
class CameraFuncs:
    """`ray(cam: CameraData, x: float, y: float) -> CameraRay` and `project(cam, p: vec3) -> vec3`.

    `project` takes a point relative to the scene's origin and gives (x, y, depth): pixels, and planar
    z (perspective) or range (equirectangular). A depth of 0 or less: behind the camera, or outside
    what its distortion model maps one to one; x and y then mean nothing.
    """

    model: Model
    distortion: bool
    ray: Any
    project: Any


def has_distortion(camera: Any) -> bool:
    """Whether any distortion coefficient of `camera` differs from 0 (equirectangular: never)."""
    return camera.model == "perspective" and bool(np.any(np.asarray(camera.distortion) != 0.0))


def radial_limit(distortion: np.ndarray) -> float:
    """Largest squared radius up to which OpenCV's radial model r N(r^2) / D(r^2) grows; inf where always.

    `distortion`: k1 k2 p1 p2 k3 k4 k5 k6. With q = r^2 the derivative is
    (N D + 2 q (N' D - N D')) / D^2; the limit is the first positive root of that or of D.
    """
    k1, k2, _, _, k3, k4, k5, k6 = np.asarray(distortion, dtype=np.float64)
    n = np.polynomial.Polynomial([1.0, k1, k2, k3])
    d = np.polynomial.Polynomial([1.0, k4, k5, k6])
    slope = n * d + np.polynomial.Polynomial([0.0, 2.0]) * (n.deriv() * d - n * d.deriv())
    limit = math.inf
    for polynomial in (slope.trim(), d.trim()):
        roots = polynomial.roots()
        real = roots[np.abs(roots.imag) <= 1e-9 * np.maximum(1.0, np.abs(roots.real))].real
        positive = real[real > 0.0]
        if positive.size:
            limit = min(limit, float(positive.min()))
    return limit


def camera_data(camera: Any, origin: np.ndarray) -> CameraData:
    """`CameraData` of a camera with the fields of `scene.camera.Camera`; `origin` (3,) float64, world.

    Raises ValueError for an unknown model, or focal lengths that are not positive and finite.
    """
    if camera.model not in _MODELS:
        raise ValueError(f"unknown camera model `{camera.model}`")
    pose = np.asarray(camera.world_from_camera, dtype=np.float64)
    data: Any = CameraData()
    data.model = _MODELS[camera.model]
    data.width = int(camera.width)
    data.height = int(camera.height)
    lens = getattr(camera, "lens", None)
    if lens is not None:
        data.lens_radius, data.focus = float(lens.radius), float(lens.focus)
    data.rotation = wp.mat33(pose[:3, :3].astype(np.float32))
    data.origin = wp.vec3(*(float(c) for c in pose[:3, 3] - np.asarray(origin, dtype=np.float64)))
    data.radius2 = _UNLIMITED
    if camera.model == "equirectangular":
        return data
    k = np.asarray(camera.matrix, dtype=np.float64)
    if not (np.all(np.isfinite(k)) and k[0, 0] > 0.0 and k[1, 1] > 0.0):
        raise ValueError(f"focal lengths {k[0, 0]} and {k[1, 1]}: must be positive and finite")
    data.fx, data.fy, data.cx, data.cy, data.skew = k[0, 0], k[1, 1], k[0, 2], k[1, 2], k[0, 1]
    data.per_fx, data.per_fy = 1.0 / k[0, 0], 1.0 / k[1, 1]
    d = np.asarray(camera.distortion, dtype=np.float64)
    data.k1, data.k2, data.p1, data.p2, data.k3, data.k4, data.k5, data.k6 = (float(c) for c in d)
    data.radius2 = min(radial_limit(d), _UNLIMITED)
    return data


@wp.func
def _distort(cam: CameraData, x: float, y: float) -> wp.vec2:
    """OpenCV's distortion of a point of the plane z = 1."""
    q = x * x + y * y
    radial = (1.0 + q * (cam.k1 + q * (cam.k2 + q * cam.k3))) / (
        1.0 + q * (cam.k4 + q * (cam.k5 + q * cam.k6))
    )
    return wp.vec2(
        x * radial + 2.0 * cam.p1 * x * y + cam.p2 * (q + 2.0 * x * x),
        y * radial + cam.p1 * (q + 2.0 * y * y) + 2.0 * cam.p2 * x * y,
    )


@wp.func
def _distort_jacobian(cam: CameraData, x: float, y: float) -> wp.mat22:
    """Derivative of `_distort`."""
    q = x * x + y * y
    n = 1.0 + q * (cam.k1 + q * (cam.k2 + q * cam.k3))
    d = 1.0 + q * (cam.k4 + q * (cam.k5 + q * cam.k6))
    dn = cam.k1 + q * (2.0 * cam.k2 + 3.0 * q * cam.k3)
    dd = cam.k4 + q * (2.0 * cam.k5 + 3.0 * q * cam.k6)
    radial = n / d
    slope = 2.0 * (dn - radial * dd) / d  # d radial / dx = slope x
    mixed = x * y * slope + 2.0 * cam.p1 * x + 2.0 * cam.p2 * y
    return wp.mat22(
        radial + x * x * slope + 2.0 * cam.p1 * y + 6.0 * cam.p2 * x,
        mixed,
        mixed,
        radial + y * y * slope + 6.0 * cam.p1 * y + 2.0 * cam.p2 * x,
    )


@wp.func
def _undistort(cam: CameraData, xd: float, yd: float) -> wp.vec3:
    """(x, y, 1) with `_distort(x, y) = (xd, yd)`, or z = 0 where the model has no such point.

    Newton, from the distorted point; a step that leaves the invertible disc or raises the residual is
    halved. It ends when the residual no longer improves, and then must be at the float's own noise.
    OpenCV's fixed-point iteration converges linearly and diverges for strong barrels.
    """
    x = xd
    y = yd
    q = x * x + y * y
    if q >= cam.radius2:
        # Start inside: a barrel's distorted points can lie beyond its undistorted limit.
        inside = 0.9 * wp.sqrt(cam.radius2 / q)
        x = x * inside
        y = y * inside
    f = _distort(cam, x, y) - wp.vec2(xd, yd)
    error = wp.dot(f, f)
    for _ in range(_NEWTON_STEPS):
        if error == 0.0:
            break
        j = _distort_jacobian(cam, x, y)
        det = j[0, 0] * j[1, 1] - j[0, 1] * j[1, 0]
        if not (wp.abs(det) > 0.0):
            break
        dx = (j[1, 1] * f[0] - j[0, 1] * f[1]) / det
        dy = (j[0, 0] * f[1] - j[1, 0] * f[0]) / det
        improved = wp.bool(False)
        share = float(1.0)
        for _halving in range(6):
            if not improved:
                tx = x - share * dx
                ty = y - share * dy
                if tx * tx + ty * ty < cam.radius2:
                    g = _distort(cam, tx, ty) - wp.vec2(xd, yd)
                    e = wp.dot(g, g)
                    if e < error:
                        x = tx
                        y = ty
                        f = g
                        error = e
                        improved = wp.bool(True)
                share = 0.5 * share
        if not improved:
            break
    j = _distort_jacobian(cam, x, y)
    det = j[0, 0] * j[1, 1] - j[0, 1] * j[1, 0]
    # 2^-19 of the radius (at least that of a 90 degree view): some tens of roundings of the polynomial.
    noise = 1.9e-6 * wp.max(1.0, wp.sqrt(xd * xd + yd * yd))
    if det > 0.0 and error <= noise * noise:
        return wp.vec3(x, y, 1.0)
    return wp.vec3(0.0, 0.0, 0.0)


@wp.func
def through_lens(cam: CameraData, central: CameraRay, u: wp.vec2) -> CameraRay:
    """The ray of the same pixel through a uniform point of the lens, which `u` in [0, 1)^2 chooses.

    Thin lens: all rays of a pixel meet where its central ray meets the plane in focus (Potmesil and
    Chakravarty, SIGGRAPH 1981; Cook, Porter and Carpenter, 1984). The central ray is the calibrated
    pinhole's, distortion included, so a point at depth z spreads over 2 radius f |1/z - 1/focus| pixels, f
    being the calibrated focal length, which is the distance of the picture behind the lens in pixels.
    """
    d = wp.transpose(cam.rotation) * central.direction
    at = concentric_disk(u) * cam.lens_radius
    off = wp.vec3(at[0], at[1], 0.0)
    result = CameraRay()
    result.ok = central.ok
    result.origin = central.origin + cam.rotation * off
    result.direction = wp.normalize(cam.rotation * (d * (cam.focus / d[2]) - off))
    return result


def make_camera(model: Model = "perspective", distortion: bool = False) -> CameraFuncs:
    """`ray` and `project` for one camera model; without `distortion` its code is left out.

    Equal arguments give the same object. Raises ValueError for an unknown model, or for distortion of
    an equirectangular picture.
    """
    if model not in _MODELS:
        raise ValueError(f"unknown camera model `{model}`: expected perspective or equirectangular")
    if model == "equirectangular":
        if distortion:
            raise ValueError("an equirectangular camera has no distortion")
        return CameraFuncs(model, False, _equirectangular_ray, _equirectangular_project)
    return _make_perspective(bool(distortion))


@functools.cache
def _make_perspective(distortion: bool) -> CameraFuncs:
    tag = "distorted" if distortion else "pinhole"

    @wp.func(name=f"{tag}_ray")
    def ray(cam: CameraData, x: float, y: float) -> CameraRay:
        result = CameraRay()
        result.origin = cam.origin
        py = (y - cam.cy) * cam.per_fy
        px = (x - cam.cx - cam.skew * py) * cam.per_fx
        p = wp.vec3(px, py, 1.0)
        result.ok = wp.bool(True)
        if wp.static(distortion):
            p = _undistort(cam, px, py)
            if p[2] == 0.0:
                result.ok = wp.bool(False)
                p = wp.vec3(0.0, 0.0, 1.0)
        result.direction = wp.normalize(cam.rotation * p)
        return result

    @wp.func(name=f"{tag}_project")
    def project(cam: CameraData, p: wp.vec3) -> wp.vec3:
        c = wp.transpose(cam.rotation) * (p - cam.origin)
        depth = c[2]
        pixel = wp.vec3(0.0, 0.0, wp.min(depth, 0.0))
        if depth > 0.0:
            px = c[0] / depth
            py = c[1] / depth
            inside = wp.bool(True)
            if wp.static(distortion):
                if px * px + py * py < cam.radius2:
                    d = _distort(cam, px, py)
                    px = d[0]
                    py = d[1]
                else:
                    # Past its limit the polynomial folds back into the picture.
                    inside = wp.bool(False)
            if inside:
                pixel = wp.vec3(cam.fx * px + cam.skew * py + cam.cx, cam.fy * py + cam.cy, depth)
        return pixel

    return CameraFuncs("perspective", distortion, ray, project)


@wp.func
def _equirectangular_ray(cam: CameraData, x: float, y: float) -> CameraRay:
    """u = 1/2 - azimuth / (2 pi), v = polar angle / pi; frame: x to the picture's centre, z up."""
    result = CameraRay()
    result.origin = cam.origin
    azimuth = 2.0 * _PI * (0.5 - x / float(cam.width))
    v = y / float(cam.height)
    polar = _PI * v
    sine = wp.sin(polar)
    d = wp.vec3(sine * wp.cos(azimuth), sine * wp.sin(azimuth), wp.cos(polar))
    result.direction = wp.normalize(cam.rotation * d)
    result.ok = v >= 0.0 and v <= 1.0
    return result


@wp.func
def _equirectangular_project(cam: CameraData, p: wp.vec3) -> wp.vec3:
    """(x, y, range); range 0 at the camera itself. atan2: acos would lose half its digits at the poles."""
    c = wp.transpose(cam.rotation) * (p - cam.origin)
    u = 0.5 - wp.atan2(c[1], c[0]) / (2.0 * _PI)
    v = wp.atan2(wp.sqrt(c[0] * c[0] + c[1] * c[1]), c[2]) / _PI
    return wp.vec3(u * float(cam.width), v * float(cam.height), wp.length(c))
