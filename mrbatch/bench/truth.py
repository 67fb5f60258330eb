"""What errors of a sweep are measured against, how far pictures are from it, and noise and bias apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mrbatch.batch.framing import framed
from mrbatch.bench.variants import Variants, converged
from mrbatch.errors import InputError, Place
from mrbatch.film.window import Window
from mrbatch.metrics.errors import ImageErrors, image_errors, weighted_mean
from mrbatch.metrics.region import noisy_region_of_interest, region_of_interest
from mrbatch.metrics.statistics import Interval
from mrbatch.report.pictures import read_picture

FLOOR = 3.0
"""Errors below so many times the truth's own are not told apart."""


@dataclass(frozen=True)
class Truth:
    """`picture` (h, w, 3) float64 in the unit of composites; `changed` (h, w) bool: the region of interest.

    `own`: its own relMSE on the region, None where it is not known. `independent`: not made by this program;
    else by it with `settings` and `samples` a pixel.
    """

    picture: np.ndarray
    changed: np.ndarray
    own: float | None
    source: str
    independent: bool
    settings: tuple[str, ...] = ()
    samples: int | None = None

    def fit(self, picture: np.ndarray) -> np.ndarray:
        """A picture of another resolution on the truth's pixels: by area means where it is larger."""
        height, width = self.changed.shape
        return framed(picture, (width, height), Window(0, 0, width, height))

    def errors(self, picture: np.ndarray, *, flip: bool = False) -> ImageErrors:
        """All figures of a composite of any resolution."""
        return image_errors(self.fit(picture), self.picture, region=self.changed, flip=flip)

    def difference(self, picture: np.ndarray) -> np.ndarray:
        """(n,) float32, scaled so that its squares add up to the relMSE of the region."""
        reference = self.picture
        mean = weighted_mean(np.abs(reference).mean(axis=2), np.ones(self.changed.shape))
        scale = np.sqrt(reference * reference + 1e-2 * mean * mean)
        found = ((self.fit(picture) - reference) / scale)[self.changed]
        return (found / np.sqrt(found.size)).astype(np.float32).ravel()


def full_settings(variants: Variants) -> tuple[str, ...]:
    """Changes of the job that leave nothing out that this program can do: all bounces, no filter."""
    found = ["output.filter={kind: none}", "accuracy.target_error=null"]
    method = variants.job.method
    if not hasattr(method, "max_depth"):
        return (*found, "method={name: delta-path-tracing}")
    wanted = {"max_depth": "null", "strategy": "mis", "sampler": "owen", "light_sampler": "cdf"}
    return (*found, *(f"method.{key}={value}" for key, value in wanted.items() if hasattr(method, key)))


def rendered_truth(variants: Variants, spp: int, *, threads: int) -> Truth:
    """By full settings. Raises InputError where virtual objects change nothing."""
    settings = full_settings(variants)
    found = converged(variants, spp, *settings, threads=threads)
    _check(found.changed, variants)
    own = image_errors(found.picture + found.noise, found.picture, region=found.changed, flip=False)
    assert own.region is not None
    return Truth(found.picture, found.changed, own.region.relmse, "full settings", False, settings, found.spp)


def stored_truth(variants: Variants, path: Path, deviation: Path | None = None) -> Truth:
    """From a picture of the whole frame, brought to the output's resolution.

    `deviation`: a picture of its standard deviation; without it the truth's own error is not known.
    Raises InputError for files that cannot be used.
    """
    with variants.subject() as subject:
        photo = subject.photo().astype(np.float64)
        view = subject.renderer.outputs.views[0]
    display = (view.whole.width, view.whole.height)
    given = read_picture(path)
    full = given.full_size
    if abs(full[0] * display[1] - full[1] * display[0]) > max(full[0], full[1]) or given.values.shape[2] != 3:
        raise InputError(
            f"the truth is {full[0]}x{full[1]} pixels, the frame {display[0]}x{display[1]}",
            place=Place(file=str(path)),
            hint="give a colour picture of the whole frame",
        )
    picture = framed(given.values, display, view.window).astype(np.float64)
    spread = None
    if deviation is not None:
        stored = read_picture(deviation)
        # The mean of several pixels is less uncertain than each of them.
        fewer = min(1.0, display[0] / full[0])
        spread = framed(stored.values, display, view.window).astype(np.float64) * fewer
        spread = np.broadcast_to(spread if spread.ndim == 3 else spread[..., None], picture.shape)
        changed = region_of_interest(picture, photo, deviation=spread)
    else:
        changed = noisy_region_of_interest(picture, photo)
    _check(changed, variants)
    own = None
    if spread is not None:
        found = image_errors(picture + spread, picture, region=changed, flip=False).region
        own = found.relmse if found else None
    return Truth(picture, changed, own, path.name, True)


def _check(changed: np.ndarray, variants: Variants) -> None:
    if not changed.any():
        raise InputError(
            "virtual objects change nothing in this frame",
            place=Place(frame=variants.frame),
            hint="choose another frame with `--frame`",
        )


@dataclass(frozen=True)
class Parts:
    """An error's parts (relMSE): `noise` goes with more samples, `bias` stays. 95 % by jackknife."""

    total: Interval
    noise: Interval
    bias: Interval


def noise_and_bias(differences: Sequence[np.ndarray], own: float | None) -> Parts:
    """From `Truth.difference` of renderings with seeds of their own, three or more.

    Products of two renderings' differences know no noise of theirs: their mean is the squared bias (and the
    truth's own error, which is taken off). Raises ValueError for fewer than three.
    """
    from scipy.stats import t

    n = len(differences)
    if n < 3:
        raise ValueError("noise and bias need three renderings or more")
    vectors = np.asarray(differences, dtype=np.float32)
    gram = np.einsum("ip,jp->ij", vectors, vectors, dtype=np.float64, optimize=True)

    def split(products: np.ndarray) -> np.ndarray:
        count = products.shape[0]
        trace = float(np.trace(products))
        common = (float(products.sum()) - trace) / (count * (count - 1))
        return np.array([trace / count, trace / count - common, common - (own or 0.0)])

    value = split(gram)
    # Leaving one out costs one row and one column of the products.
    kept = [np.delete(np.delete(gram, i, 0), i, 1) for i in range(n)]
    without = np.array([split(products) for products in kept])
    spread = np.sqrt((n - 1) / n * ((without - without.mean(axis=0)) ** 2).sum(axis=0))
    half = float(t.isf(0.025, n - 1)) * spread
    total, noise, bias = (
        Interval(float(v), float(v - h), float(v + h), 0.95, n) for v, h in zip(value, half, strict=True)
    )
    return Parts(total, noise, bias)
