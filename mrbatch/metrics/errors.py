"""How far a picture is from its reference: relMSE, RMSE, PSNR, SSIM and FLIP.

Each figure comes three times: over the whole frame, over the region of interest, and for the worst
16x16 tile (tiles count from absolute pixel (0, 0)). All of them are averages of error maps, so a
person can look at the map whose average a number is. Pictures are scene-linear Rec.709; 360-degree
pictures are weighted by the cosine of the latitude, which is each pixel's share of the sphere.

- `relmse`: mean of (x - r)^2 / (r^2 + 1e-2 m^2), m the reference's mean over pixels and channels of
  the *whole frame*, so that region and tiles are parts of one sum. `relmse_trimmed` leaves out the
  0.1 % of pixels (by weight) with the largest error.
- `rmse`: root mean square of x - r, in the picture's own linear unit.
- `rmse_display`, `psnr`, `ssim`: on clip(gain x L, 0, 1) through the sRGB curve, as floats of range 1.
  SSIM (Wang et al. 2004): Gaussian 11x11, sigma 1.5, K1 0.01, K2 0.03, population covariances, mean
  of the channels; edges are mirrored (wrapped across a panorama's seam) instead of cropped, so that
  every pixel has a value.
- `flip_hdr`, `flip_ldr`: Andersson et al. 2020 and 2021, by their own package; HDR over stated
  exposures, LDR on the same display picture as PSNR.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Literal

import numpy as np

from mrbatch.errors import InputError
from mrbatch.kernels.transfer import encode
from mrbatch.metrics.tiles import tile_edges, tile_sums

Projection = Literal["perspective", "equirectangular"]

TRIMMED_SHARE = 1e-3
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
_SSIM_SIGMA, _SSIM_RADIUS = 1.5, 5
_SSIM_C1, _SSIM_C2 = 0.01**2, 0.03**2
# FLIP's widest filter at 67 pixels a degree reaches 9 pixels, and two are chained.
_FLIP_HALO = 20


@dataclass(frozen=True)
class MetricInfo:
    """What a figure is called, its unit, and whether more of it is better."""

    title: str
    unit: str
    higher_is_better: bool


METRICS: Mapping[str, MetricInfo] = {
    "relmse": MetricInfo("relMSE", "1", False),
    "relmse_trimmed": MetricInfo("relMSE without the worst 0.1 %", "1", False),
    "rmse": MetricInfo("RMSE (linear)", "radiance", False),
    "rmse_display": MetricInfo("RMSE (display)", "1", False),
    "psnr": MetricInfo("PSNR", "dB", True),
    "ssim": MetricInfo("SSIM", "1", True),
    "flip_hdr": MetricInfo("HDR-FLIP", "1", False),
    "flip_ldr": MetricInfo("LDR-FLIP", "1", False),
}


@dataclass(frozen=True)
class Scores:
    """One number a metric, for one part of the picture. FLIP is None where it was not asked for."""

    relmse: float
    relmse_trimmed: float
    rmse: float
    rmse_display: float
    psnr: float
    ssim: float
    flip_hdr: float | None
    flip_ldr: float | None

    def items(self) -> tuple[tuple[str, float], ...]:
        pairs = ((f.name, getattr(self, f.name)) for f in fields(self))
        return tuple((name, value) for name, value in pairs if value is not None)


@dataclass(frozen=True)
class Exposures:
    """HDR-FLIP's exposure range in stops: state it, or figures of two runs cannot be compared."""

    start: float
    stop: float
    count: int


@dataclass(frozen=True)
class ImageErrors:
    """All figures of one picture against its reference.

    `tile`: for each metric the worst tile's figure; `tile_at`: that tile's first pixel (x, y), in
    absolute pixels. `region_share`: share of the frame (by weight) that the region covers. `maps`:
    (height, width) float64 by name: `relmse`, `squared`, `squared_display`, `ssim`, `flip_hdr`,
    `flip_ldr`; the figures are weighted means of these. `reference_mean`: the m of relMSE.
    """

    frame: Scores
    region: Scores | None
    region_share: float | None
    tile: Scores
    tile_at: Mapping[str, tuple[int, int]]
    maps: Mapping[str, np.ndarray]
    exposures: Exposures | None
    reference_mean: float


def image_errors(
    test: np.ndarray,
    reference: np.ndarray,
    *,
    gain: float | tuple[float, float, float] = 1.0,
    projection: Projection = "perspective",
    region: np.ndarray | None = None,
    flip: bool = True,
    exposures: Exposures | None = None,
    origin: tuple[int, int] = (0, 0),
    full_size: tuple[int, int] | None = None,
) -> ImageErrors:
    """Compare two scene-linear pictures (height, width, 3), or (height, width) for one channel.

    `gain`: photo = gain x radiance, a number or one a channel. `region`: (height, width) bool, the
    region of interest. `origin`: absolute pixel (x, y) of the pictures' first pixel, and `full_size`
    (width, height) of the frame, where the pictures are crops. `exposures`: HDR-FLIP's range; taken
    from the reference where not given, and returned.

    Raises InputError where shapes differ, a picture or the region is empty, or a value is not finite.
    """
    x, r = _checked(test, reference)
    height, width = r.shape[:2]
    full_width, full_height = full_size or (width, height)
    weights = pixel_weights(height, width, projection, first_row=origin[1], full_height=full_height)
    wraps = projection == "equirectangular" and width == full_width
    if region is not None:
        region = np.asarray(region, dtype=bool)
        if region.shape != (height, width):
            raise InputError(
                f"the region of interest is {region.shape[1]}x{region.shape[0]}, "
                f"the picture {width}x{height} pixels",
                hint="make the mask from pictures of this size",
            )
        if not region.any():
            raise InputError(
                "the region of interest is empty",
                hint="check that the reference shows the virtual objects and the other picture does not",
            )

    mean = weighted_mean(np.abs(r).mean(axis=2), weights)
    shown_x, shown_r = display(x, gain), display(r, gain)
    maps = {
        "relmse": relmse_map(x, r, mean),
        "squared": ((x - r) ** 2).mean(axis=2),
        "squared_display": ((shown_x - shown_r) ** 2).mean(axis=2),
        "ssim": ssim_map(shown_x, shown_r, wraps=wraps),
    }
    used = None
    if flip:
        used = exposures or flip_exposures(r)
        maps["flip_hdr"] = flip_hdr_map(x, r, used, wraps=wraps)
        maps["flip_ldr"] = flip_ldr_map(shown_x, shown_r, wraps=wraps)

    tile, tile_at = _worst_tiles(maps, weights, origin)
    share = None if region is None else float(weights[region].sum() / weights.sum())
    return ImageErrors(
        frame=_scores(maps, weights),
        region=None
        if region is None
        else _scores({name: m[region] for name, m in maps.items()}, weights[region]),
        region_share=share,
        tile=tile,
        tile_at=tile_at,
        maps=maps,
        exposures=used,
        reference_mean=mean,
    )


def pixel_weights(
    height: int,
    width: int,
    projection: Projection,
    *,
    first_row: int = 0,
    full_height: int | None = None,
) -> np.ndarray:
    """(height, width) float64: 1 in perspective; cos latitude at row centres in a panorama.

    The solid angle of an equirectangular pixel between two latitudes is exactly proportional to the
    cosine at its centre, so no finer rule is needed.
    """
    if projection == "perspective":
        return np.ones((height, width))
    rows = (np.arange(height) + first_row + 0.5) / (full_height or height)
    return np.repeat(np.sin(np.pi * rows)[:, None], width, axis=1)


def weighted_mean(values: np.ndarray, weights: np.ndarray) -> float:
    return float((values * weights).sum(dtype=np.float64) / weights.sum(dtype=np.float64))


def display(picture: np.ndarray, gain: float | tuple[float, float, float] = 1.0) -> np.ndarray:
    """clip(gain x L, 0, 1) through the sRGB curve, float64."""
    factor = np.asarray(gain, dtype=np.float64)
    return encode(np.clip(np.asarray(picture, dtype=np.float64) * factor, 0.0, 1.0), "srgb")


def relmse_map(test: np.ndarray, reference: np.ndarray, mean: float) -> np.ndarray:
    """(height, width) float64: squared relative error, mean of the channels; 0 where both are 0."""
    x, r = _channels(test), _channels(reference)
    squared = (x - r) ** 2
    denominator = r * r + 1e-2 * mean * mean
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = squared / denominator
    return np.where(squared == 0.0, 0.0, ratio).mean(axis=2)


def trimmed_mean(values: np.ndarray, weights: np.ndarray, share: float = TRIMMED_SHARE) -> float:
    """Weighted mean without the largest values, as many as fit into `share` of the weight."""
    flat, w = np.ravel(values), np.ravel(weights)
    order = np.argsort(flat, kind="stable")[::-1]
    dropped = np.cumsum(w[order]) <= share * w.sum() * (1 + 1e-12)
    keep = order[~dropped]
    return weighted_mean(flat[keep], w[keep])


def ssim_map(test: np.ndarray, reference: np.ndarray, *, wraps: bool = False) -> np.ndarray:
    """Structural similarity of two pictures of range 1 at every pixel, mean of the channels."""
    from scipy.ndimage import correlate1d

    t = np.arange(-_SSIM_RADIUS, _SSIM_RADIUS + 1)
    kernel = np.exp(-0.5 * (t / _SSIM_SIGMA) ** 2)
    kernel /= kernel.sum()

    def blur(a: np.ndarray) -> np.ndarray:
        return correlate1d(
            correlate1d(a, kernel, axis=0, mode="reflect"),
            kernel,
            axis=1,
            mode="wrap" if wraps else "reflect",
        )

    x, r = _channels(test), _channels(reference)
    mx, mr = blur(x), blur(r)
    vx, vr, cov = blur(x * x) - mx * mx, blur(r * r) - mr * mr, blur(x * r) - mx * mr
    ssim = ((2 * mx * mr + _SSIM_C1) * (2 * cov + _SSIM_C2)) / (
        (mx * mx + mr * mr + _SSIM_C1) * (vx + vr + _SSIM_C2)
    )
    return ssim.mean(axis=2)


def flip_exposures(reference: np.ndarray) -> Exposures:
    """HDR-FLIP's own choice of exposures, from the reference alone (Andersson et al. 2021, section 4).

    The brightest pixel, then the median, is put where the ACES curve reaches 0.85. Unlike the
    package's own code, which ends the process there, a picture that is mostly or wholly black is
    taken: the median is then that of the pixels that are not black, or the exposure is 0.
    """
    r = np.clip(_three(np.asarray(reference, dtype=np.float64)), 0.0, None)
    luminance = (r @ LUMINANCE).ravel()
    lit = luminance[luminance > 0.0]
    if lit.size == 0:
        return Exposures(0.0, 0.0, 2)
    middle = float(np.median(luminance))
    if middle <= 0.0:
        middle = float(np.median(lit))
    a = 0.85
    # ACES fit of Narkowicz with the 0.6 pre-exposure that FLIP uses: (k0 x^2 + k1 x) / (k3 x^2 + k4 x + k5).
    k0, k1, k3, k4, k5 = 0.36 * 2.51, 0.6 * 0.03, 0.36 * 2.43, 0.6 * 0.59, 0.14
    p, q, c = k0 - a * k3, k1 - a * k4, -a * k5
    target = (-q + np.sqrt(q * q - 4 * p * c)) / (2 * p)
    start, stop = float(np.log2(target / luminance.max())), float(np.log2(target / middle))
    return Exposures(start, stop, max(2, int(np.ceil(stop - start))))


def flip_hdr_map(
    test: np.ndarray, reference: np.ndarray, exposures: Exposures, *, wraps: bool = False
) -> np.ndarray:
    """(height, width) float64: HDR-FLIP, the largest LDR-FLIP over the exposures. Negatives count as 0."""
    # The package divides by count - 1, and calls any two pictures equal where it is 0.
    if not exposures.start <= exposures.stop or exposures.count < 2:
        raise InputError(
            f"HDR-FLIP exposures {exposures.start:g} to {exposures.stop:g} in {exposures.count} steps",
            hint="the first exposure must not exceed the last, with two steps or more",
        )
    parameters = {
        "startExposure": float(exposures.start),
        "stopExposure": float(exposures.stop),
        "numExposures": int(exposures.count),
    }
    highest = float(np.finfo(np.float32).max)
    return _flip(np.clip(test, 0.0, highest), np.clip(reference, 0.0, highest), "HDR", parameters, wraps)


def flip_ldr_map(test: np.ndarray, reference: np.ndarray, *, wraps: bool = False) -> np.ndarray:
    """(height, width) float64: LDR-FLIP of two sRGB-encoded pictures of range 1."""
    return _flip(np.clip(test, 0.0, 1.0), np.clip(reference, 0.0, 1.0), "LDR", {}, wraps)


def _flip(test: np.ndarray, reference: np.ndarray, kind: str, parameters: dict, wraps: bool) -> np.ndarray:
    import flip_evaluator

    x, r = _three(test).astype(np.float32), _three(reference).astype(np.float32)
    halo = _FLIP_HALO if wraps else 0
    if halo:
        x, r = (np.pad(p, ((0, 0), (halo, halo), (0, 0)), mode="wrap") for p in (x, r))
    flip, _, _ = flip_evaluator.evaluate(
        np.ascontiguousarray(r), np.ascontiguousarray(x), kind, applyMagma=False, parameters=parameters
    )
    flip = np.asarray(flip, dtype=np.float64)[..., 0]
    return flip[:, halo : flip.shape[1] - halo]


def _worst_tiles(maps, weights, origin) -> tuple[Scores, dict[str, tuple[int, int]]]:
    rows, columns = tile_edges(weights.shape[0], origin[1]), tile_edges(weights.shape[1], origin[0])
    weight = tile_sums(weights, origin)
    means = {name: tile_sums(m * weights, origin) / weight for name, m in maps.items()}
    source = {
        "relmse": means["relmse"],
        "rmse": means["squared"],
        "rmse_display": means["squared_display"],
        "psnr": means["squared_display"],
        "ssim": -means["ssim"],
    }
    source |= {name: means[name] for name in ("flip_hdr", "flip_ldr") if name in means}
    found: dict[str, float] = {}
    at = {}
    for name, values in source.items():
        i, j = np.unravel_index(int(np.argmax(values)), values.shape)
        at[name] = (int(origin[0] + columns[j]), int(origin[1] + rows[i]))
        found[name] = float(values[i, j])
    # A tile has at most 256 pixels: less than one of them fits into 0.1 %.
    found["relmse_trimmed"], at["relmse_trimmed"] = found["relmse"], at["relmse"]
    worst = Scores(
        relmse=found["relmse"],
        relmse_trimmed=found["relmse_trimmed"],
        rmse=math.sqrt(found["rmse"]),
        rmse_display=math.sqrt(found["rmse_display"]),
        psnr=psnr(found["psnr"]),
        ssim=-found["ssim"],
        flip_hdr=found.get("flip_hdr"),
        flip_ldr=found.get("flip_ldr"),
    )
    return worst, at


def psnr(mean_squared_error: float) -> float:
    """Decibels for range 1; infinite for equal pictures."""
    return float("inf") if mean_squared_error == 0.0 else float(-10.0 * np.log10(mean_squared_error))


def _scores(maps: Mapping[str, np.ndarray], weights: np.ndarray) -> Scores:
    mean = {name: weighted_mean(m, weights) for name, m in maps.items()}
    return Scores(
        relmse=mean["relmse"],
        relmse_trimmed=trimmed_mean(maps["relmse"], weights),
        rmse=float(np.sqrt(mean["squared"])),
        rmse_display=float(np.sqrt(mean["squared_display"])),
        psnr=psnr(mean["squared_display"]),
        ssim=mean["ssim"],
        flip_hdr=mean.get("flip_hdr"),
        flip_ldr=mean.get("flip_ldr"),
    )


def _channels(picture: np.ndarray) -> np.ndarray:
    a = np.asarray(picture, dtype=np.float64)
    return a[..., None] if a.ndim == 2 else a


def _three(picture: np.ndarray) -> np.ndarray:
    a = picture[..., None] if picture.ndim == 2 else picture
    return np.repeat(a, 3, axis=2) if a.shape[2] == 1 else a


def _checked(test: np.ndarray, reference: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    x, r = _channels(test), _channels(reference)
    if x.shape != r.shape:
        raise InputError(
            f"the pictures differ in size: test {_size(x)}, reference {_size(r)}",
            hint="compare pictures of the same width, height and channels",
        )
    if x.ndim != 3 or x.shape[2] not in (1, 3) or x.size == 0:
        raise InputError(
            f"cannot compare pictures of shape {x.shape}", hint="expected one or three channels and a pixel"
        )
    for name, picture in (("test picture", x), ("reference", r)):
        bad = ~np.isfinite(picture).all(axis=2)
        if bad.any():
            row, column = np.argwhere(bad)[0]
            raise InputError(
                f"{int(bad.sum())} pixels of the {name} are NaN or infinite, "
                f"the first at column {column}, row {row}",
                hint="an error of such a picture has no meaning: repair or mask it first",
            )
    return x, r


def _size(picture: np.ndarray) -> str:
    return "x".join(str(n) for n in (picture.shape[1], picture.shape[0], *picture.shape[2:]))
