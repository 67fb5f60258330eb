"""How much a film of a still scene flickers, with each filter: the noise of its frames, apart from motion.

In a film the camera moves, and so does the photo's own grain: neither is noise of the renderer, and both hide
it. So one frame is rendered again and again, photo and camera as they are, each time with other random
numbers. Every random number is a hash of seed, frame, pixel and sample in which seed and frame stand side
by side (`kernels/rng.py`): one frame under n seeds varies as n frames of a still shot do under one seed. In
film that moves, this is the part of the change from frame to frame that no motion accounts for.

Measured are code values as they are shown: the composite in 8 bits through the capture's transfer function,
of these the luma (weights of Rec.709), over time the standard deviation of each pixel. It is told as it is
(`fine`: grain) and of the luma after a Gaussian blur of `BLUR` pixels (`coarse`: patches that boil). Of white
noise the blur leaves 1 / (2 sqrt(pi) BLUR), a fourteenth; what a filter spreads over patches it leaves.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from mrbatch.bench.subject import Subject
from mrbatch.bench.variants import Variants
from mrbatch.errors import ResourceError
from mrbatch.film.preview import preview_codes
from mrbatch.metrics.region import region_of_interest

KINDS = ("none", "bilateral", "variance", "oidn")
BLUR = 4.0
"""Standard deviation, in pixels, of the blur behind which only patches are left."""
LUMA = np.array([0.2126, 0.7152, 0.0722])
RARE = 0.999


@dataclass(frozen=True)
class Flicker:
    """How `pixels` vary over time, in 8-bit code values of luma.

    `fine`, `coarse`: standard deviation before and after the blur, root mean square over the pixels.
    `above`: share of pixels whose own (`fine`) is above one code. `rare`: above which one pixel in a thousand
    is: bright samples that come and go. NaN where there are no pixels.
    """

    pixels: int
    fine: float
    coarse: float
    above: float
    rare: float


@dataclass(frozen=True)
class FlickerRow:
    """One filter, on what of the changed pixels is wholly real, wholly virtual, or partly either."""

    kind: str
    real: Flicker
    virtual: Flicker
    edges: Flicker


@dataclass(frozen=True)
class FlickerComparison:
    """`missing`: filters that are not installed here."""

    rows: tuple[FlickerRow, ...]
    missing: tuple[str, ...]
    method: str
    frame: int
    spp: int
    pictures: int


def flicker(
    variants: Variants,
    *,
    pictures: int = 16,
    kinds: Sequence[str] = KINDS,
    threads: int = 1,
    said: Callable[[str], None] = lambda text: None,
) -> FlickerComparison:
    """Renders the frame `pictures` times with each filter, with the job's seed and those after it.

    The pixels are those that virtual objects change, by the mean of the pictures without a filter and its
    standard error (`region_of_interest`). `said`: hears of progress. Raises ValueError for fewer than two
    pictures, and where virtual objects change nothing.
    """
    if pictures < 2:
        raise ValueError("what varies takes two pictures or more")
    said("no filter")
    plain, coverage, changed = _unfiltered(variants, pictures, threads)
    if not changed.any():
        raise ValueError("virtual objects change nothing in this frame")
    real, virtual = (coverage == 0.0).all(axis=0), (coverage == 1.0).all(axis=0)
    parts = [changed & part for part in (real, virtual, ~(real | virtual))]
    rows, missing = [], []
    for kind in kinds:
        try:
            if kind == "none":
                lumas = plain
            else:
                said(kind)
                lumas = np.stack([luma for luma, _, _ in _pictures(variants, kind, pictures, threads)])
        except ResourceError as error:
            said(str(error))
            missing.append(kind)
            continue
        rows.append(FlickerRow(kind, *flicker_of(lumas, parts)))
    return FlickerComparison(
        tuple(rows), tuple(missing), variants.job.method_name, variants.frame, variants.spp, pictures
    )


def flicker_of(lumas: np.ndarray, parts: Sequence[np.ndarray]) -> list[Flicker]:
    """Of pictures of one still scene, lumas (n, h, w) in code values, on each of `parts` (h, w) bool."""
    from scipy.ndimage import gaussian_filter

    fine = lumas.std(axis=0, ddof=1, dtype=np.float64)
    blurred = np.stack([gaussian_filter(luma.astype(np.float64), BLUR) for luma in lumas])
    coarse = blurred.std(axis=0, ddof=1)
    found = []
    for part in parts:
        if not part.any():
            found.append(Flicker(0, *[float("nan")] * 4))
            continue
        own = fine[part]
        found.append(
            Flicker(
                pixels=int(part.sum()),
                fine=float(np.sqrt(np.mean(own**2))),
                coarse=float(np.sqrt(np.mean(coarse[part] ** 2))),
                above=float(np.mean(own > 1.0)),
                rare=float(np.quantile(own, RARE)),
            )
        )
    return found


def _unfiltered(variants: Variants, pictures: int, threads: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lumas (n, h, w), coverage by virtual objects (n, h, w), and where they change the photo (h, w)."""
    found = _pictures(variants, "none", pictures, threads)
    linear = np.stack([composite for _, composite, _ in found]).astype(np.float64)
    error = linear.std(axis=0, ddof=1) / np.sqrt(pictures)
    with variants.subject() as subject:
        photo = subject.photo().astype(np.float64)
    changed = region_of_interest(linear.mean(axis=0), photo, deviation=error)
    return np.stack([luma for luma, _, _ in found]), np.stack([c for _, _, c in found]), changed


def _pictures(
    variants: Variants, kind: str, pictures: int, threads: int
) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Luma (h, w) in code values, composite (h, w, 3) and coverage (h, w) of each."""
    prepared = variants.prepared(f"output.filter.kind={kind}", "output.filter.radius=null")
    found = []
    with Subject(prepared, variants.frame, threads=threads) as subject:
        for number in range(pictures):
            run = subject.run((variants.job.seed + number) % (1 << 32))
            codes = preview_codes(run.composite, prepared.facts.transfer)
            found.append((codes @ LUMA, run.composite, run.coverage))
    return found
