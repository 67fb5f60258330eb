"""Merging aligned shots of known exposure into radiance, each sample weighted by the inverse of its variance.

Of a code c with noise sigma(c), taken with exposure time t, radiance is f(c) / t with the standard
deviation f'(c) sigma(c) / t. Weights come from the *predicted* code (what the merge so far says the shot
should show), not from the measured one: weights that share the noise of what they weigh bias the mean.
Samples whose code or predicted code is clipped have no weight, rather than a small one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mrbatch.capture.marker_video.response_curve import ResponseCurve

BAND = 2**18
"""Pixels merged at a time: a bracket of nine 18-megapixel shots would take gigabytes as floats."""
HALO = 8
GHOST_SIGMAS = 5.0
GHOST_CHANGE = 0.12
"""Least relative change of light that counts as something having moved."""
_NOISE_BINS = 16
_BLOCK = 16
"""Pixels along a JPEG block of colours that are stored at half the resolution."""


@dataclass(frozen=True)
class Merged:
    """`radiance` (height, width, 3) float32. Masks (height, width): `clipped` where a channel clips even
    in the shortest exposure (radiance is a lower bound there), `dark` where a channel is black even in the
    longest, `ghosts` where shots disagree and the minority was left out. `ghost_share` (n,): share of
    pixels at which each shot was left out.
    """

    radiance: np.ndarray
    clipped: np.ndarray
    dark: np.ndarray
    ghosts: np.ndarray
    ghost_share: np.ndarray


def measure_noise(
    codes: Sequence[np.ndarray], curve: ResponseCurve, seconds: np.ndarray, clip: int, *, even: bool = False
) -> np.ndarray:
    """(codes,) float32 standard deviation of a code, from how neighbouring exposures differ.

    Sensor noise, rounding and what JPEG does, together; measured in `_NOISE_BINS` ranges of codes. `even`:
    one number for all codes, as JPEG pictures call for: the steps that a JPEG rounds to are the same for dark
    and bright blocks. What it loses depends on the place, which all shots share, and a table by codes takes
    dark and bright places for dark and bright codes.
    """
    order = np.argsort(seconds)
    edges = np.linspace(0.0, clip, _NOISE_BINS + 1)
    found: list[list[float]] = [[] for _ in range(_NOISE_BINS)]
    step = max(1, codes[0].shape[0] // 256)
    for i, j in zip(order, order[1:]):
        # The darker shot as the longer one predicts it: rounding of the longer one hardly shows there.
        a, b = codes[i][::step], codes[j][::step]
        exposure = curve.exposure(b) * np.float32(seconds[i] / seconds[j])
        code = curve.code(exposure)
        gain = curve.slope(b) * np.float32(seconds[i] / seconds[j]) / curve.slope(code)
        usable = (b < 0.95 * clip) & (b > 0.05 * clip) & (code > 0.004 * clip)
        residual = (a - code) / np.sqrt(1.0 + gain**2)
        slot = np.clip(np.digitize(code, edges) - 1, 0, _NOISE_BINS - 1)
        for k in range(_NOISE_BINS):
            inside = residual[usable & (slot == k)]
            if inside.size >= 100:
                found[k].append(1.4826 * float(np.median(np.abs(inside - np.median(inside)))))
    known = [k for k in range(_NOISE_BINS) if found[k]]
    everywhere = np.arange(int(np.iinfo(codes[0].dtype).max) + 1)
    if not known:
        return np.full(everywhere.size, 1.0, dtype=np.float32)
    centres = 0.5 * (edges[1:] + edges[:-1])
    # Half a code at least: rounding, and medians that come out as 0.
    values = [max(0.5, float(np.median(found[k]))) for k in known]
    if even:
        return np.full(everywhere.size, np.median(values), dtype=np.float32)
    return np.interp(everywhere, centres[known], values).astype(np.float32)


def merge_shots(
    codes: Sequence[np.ndarray],
    curve: ResponseCurve,
    seconds: np.ndarray,
    clip: int,
    noise: np.ndarray,
    *,
    there: Sequence[np.ndarray | None] | None = None,
    ghosts: bool = True,
    lossy: Sequence[tuple[float, float, float] | None] | None = None,
) -> Merged:
    """Merges shots (height, width, 3) of one size and number type.

    `noise` (codes,) standard deviation of each code. `there` (height, width) of each shot: where it has
    pixels, None for all. `ghosts`: whether shots that disagree with the majority are left out. `lossy`: of
    each JPEG shot the standard deviations (3) of codes in a busy block, by which it errs beside clipped ones.
    """
    order = np.argsort(seconds)
    stack = [codes[i] for i in order]
    times = np.asarray(seconds, dtype=np.float64)[order]
    where = [None] * len(stack) if there is None else [there[i] for i in order]
    busy = np.array([(lossy[i] if lossy is not None else None) or (0.0, 0.0, 0.0) for i in order], np.float32)
    height, width = stack[0].shape[:2]
    result = Merged(
        np.empty((height, width, 3), dtype=np.float32),
        np.empty((height, width), dtype=bool),
        np.empty((height, width), dtype=bool),
        np.empty((height, width), dtype=bool),
        np.zeros(len(stack)),
    )
    rows = max(2 * HALO, BAND // width)
    for top in range(0, height, rows):
        bottom = min(top + rows, height)
        low, high = max(0, top - HALO), min(height, bottom + HALO)
        band = _Band(
            np.stack([c[low:high] for c in stack]),
            np.stack([np.ones((high - low, width), bool) if w is None else w[low:high] for w in where]),
            curve,
            times,
            clip,
            noise,
            busy,
        )
        use = band.there
        moved = np.zeros(use.shape[1:], dtype=bool)
        if ghosts and len(stack) > 2:
            use, moved = band.without_ghosts()
        cut = slice(top - low, top - low + bottom - top)
        radiance, clipped, dark = band.merge(use)
        result.radiance[top:bottom] = radiance[cut]
        result.clipped[top:bottom], result.dark[top:bottom] = clipped[cut], dark[cut]
        result.ghosts[top:bottom] = moved[cut]
        left_out = (band.there & ~use)[:, cut]
        result.ghost_share[order] += left_out.sum(axis=(1, 2)) / (height * width)
    return result


class _Band:
    """Some rows of all shots, shortest exposure first."""

    def __init__(
        self, codes, there, curve: ResponseCurve, times, clip: int, noise: np.ndarray, busy: np.ndarray
    ):
        self.codes, self.there = codes, there  # (n, h, w, 3), (n, h, w)
        self.curve, self.times, self.clip, self.noise = curve, times.astype(np.float32), clip, noise
        # (n, 1, 1, 3): from there up a code may be a clipped one that noise, or ringing, took down.
        spread = np.maximum(noise[min(clip, len(noise) - 1)], busy[:, None, None])
        self.top = (clip - np.maximum(0.5, 2.5 * spread)).astype(np.float32)
        self.samples = np.stack([curve.exposure(c) / t for c, t in zip(codes, self.times)])
        self.open = codes < self.top  # (n, h, w, 3): not clipped
        # Noise and JPEG take some clipped codes below the top: what clips in the shorter shot clips here.
        longer = self.times[1:] > 1.2 * self.times[:-1]
        self.open[1:] &= self.open[:-1] | ~there[:-1, ..., None] | ~longer[:, None, None, None]

        self.ringing = np.zeros((len(codes), 1, 1, 3), dtype=np.float32)
        if busy.any():
            self.ringing = busy[:, None, None] * self._beside_clipped()[..., None]

    def _beside_clipped(self) -> np.ndarray:
        """(n, h, w) whether a pixel may share a JPEG block with a clipped one, and ring with it."""
        import cv2

        block = np.ones((2 * _BLOCK - 1, 2 * _BLOCK - 1), np.uint8)
        clipped = (~self.open).any(axis=-1).astype(np.uint8)
        return np.stack([cv2.dilate(one, block) for one in clipped]).astype(bool)

    def _sigma(self, code: np.ndarray) -> np.ndarray:
        return self.noise[np.clip(np.rint(code), 0, len(self.noise) - 1).astype(np.int32)]

    def merge(self, use: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Radiance (h, w, 3), clipped (h, w), dark (h, w) from the shots in `use` (n, h, w)."""
        usable = self.open & use[..., None]
        radiance, weight = self._weighted(usable, self.codes.astype(np.float32))
        for _ in range(2):
            predicted = np.stack([self.curve.code(radiance * t) for t in self.times])
            again, total = self._weighted(usable & (predicted < self.top), predicted)
            radiance = np.where(total > 0, again, radiance)
        clipped = weight <= 0
        if clipped.any():
            # The shortest exposure that is there: at least so much light.
            first = np.argmax(use, axis=0)
            bound = np.take_along_axis(self.samples, first[None, ..., None], axis=0)[0]
            radiance = np.where(clipped, bound, radiance)
        last = len(use) - 1 - np.argmax(use[::-1], axis=0)
        longest = np.take_along_axis(self.codes, last[None, ..., None], axis=0)[0]
        dark = np.asarray(longest <= self.noise[0]).any(axis=-1)
        return radiance, np.any(np.asarray(clipped), axis=-1), np.asarray(dark)

    def _weighted(self, usable: np.ndarray, code: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        total = np.zeros(usable.shape[1:], dtype=np.float32)
        value = np.zeros_like(total)
        for i, t in enumerate(self.times):
            sigma = self.curve.slope(code[i]) * self._sigma(code[i])
            weight = np.where(usable[i], (t / self.times[-1] / sigma) ** 2, np.float32(0.0))
            total += weight
            value += weight * self.samples[i]
        return value / np.where(total > 0, total, np.float32(1.0)), total

    def _disagrees(self, radiance: np.ndarray, at: tuple | None = None) -> np.ndarray:
        """(n, ...) whether each shot's codes contradict a radiance (..., 3), clipped codes included."""
        result = []
        for i, t in enumerate(self.times):
            code = self.codes[i] if at is None else self.codes[i][at]
            predicted = np.minimum(self.curve.code(radiance * t), np.float32(self.clip))
            light = np.minimum(radiance * t, np.float32(1.0))
            ringing = self.ringing[i] if at is None or len(self.ringing[i]) == 1 else self.ringing[i][at]
            sigma = np.maximum(self._sigma(predicted), ringing.reshape(-1, 3) if at is not None else ringing)
            allowed = np.hypot(GHOST_SIGMAS * sigma, GHOST_CHANGE * light / self.curve.slope(predicted))
            excess = np.abs(np.minimum(code, self.clip) - predicted) - allowed
            # Near the top a code may be clipped noise.
            top = self.top[i, 0, 0]
            both_clip = (code >= top) & (predicted >= top)
            result.append((np.where(both_clip, -1.0, excess) > 0).any(axis=-1))
        return np.stack(result)

    def without_ghosts(self) -> tuple[np.ndarray, np.ndarray]:
        """(n, h, w) which shots to use, and (h, w) where some were left out.

        Where shots contradict their mean, each shot's own radiance is tried: the one that most others
        agree with stays, with those others.
        """
        import cv2

        # A coarse look first: areas in which at least one shot contradicts the mean of all.
        mean, _, _ = self.merge(self.there)
        suspect = (self._disagrees(mean) & self.there).any(axis=0).astype(np.float32)
        patch = cv2.blur(suspect, (3, 3)) > 0.6  # single pixels are JPEG's, not a person's
        moved = cv2.dilate(patch.astype(np.uint8), np.ones((9, 9), np.uint8)).astype(bool)
        if not moved.any():
            return self.there, moved
        at = np.nonzero(moved)
        there = self.there[:, *at]  # (n, m)
        best = np.full(len(at[0]), -1.0)
        keep = there.copy()
        exposed = self.open.mean(axis=(1, 2, 3)) * (self.codes > 0.05 * self.clip).mean(axis=(1, 2, 3))
        for i in range(len(self.times)):
            candidate = self.samples[i][at]
            agrees = ~self._disagrees(candidate, at) & there
            # Of equals, the shot that is best exposed over the picture.
            votes = np.where(there[i] & agrees[i], agrees.sum(axis=0) + 0.5 * exposed[i], -1.0)
            better = votes > best
            best[better] = votes[better]
            keep[:, better] = agrees[:, better]
        use = self.there.copy()
        use[:, *at] = keep
        gone = moved.copy()
        gone[at] = (there & ~keep).any(axis=0)
        return use, gone
