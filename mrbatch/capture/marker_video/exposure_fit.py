"""Exposures of a bracket from the pictures themselves, and what the tags get wrong.

Two shots of one scene differ by one factor wherever both are well exposed. The median of the log ratio
over small blocks of pixels is that factor: whatever moved, clipped or drowned in noise in the minority
of blocks does not shift it. All pairs together give the exposures by least squares; tags then say only
what pictures cannot: the unit, and the step to a shot that shares no well exposed pixel with another.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from mrbatch.capture.marker_video.response_curve import ResponseCurve
from mrbatch.errors import InputError

WRONG_LABEL = 0.2
"""Stops between tag and fit from which a tag is called wrong: nominal times (1/60 for 1/64) stay below."""
SAME_LABEL = 0.03
"""Stops within which all tags must lie for them to be used as they are: an electronic shutter keeps its steps
better than a fit through JPEG pictures measures them."""
MIN_BLOCKS = 24
"""Blocks that a pair must share to be compared."""
CURVE_MISFIT = 0.05
"""Relative change of ratios (with the brightness, or against the tags) from which a curve is called wrong."""


@dataclass(frozen=True)
class ExposureFit:
    """`seconds` (n,) of each shot: exposure 1 (full scale) is radiance 1 / seconds. `sigma` (n,): its
    relative standard deviation from the fit.

    `relative`: no tags gave the unit; the median shot has 1. `exact`: tags and fit agree, and `seconds` are
    the tags. `wrong`: shots by index whose tag is off, with the stops. `reordered`: the tags are right as a
    set but belong to other shots. `unlinked`: shots by index whose exposure is the tag's alone. `bend`:
    relative change of ratios between dark and bright pixels, 0 for the right curve. `slope`: steps in the
    pictures over steps of the tags, 1 for the right curve; NaN where tags do not tell.
    """

    seconds: np.ndarray
    sigma: np.ndarray
    relative: bool
    exact: bool
    wrong: dict[int, float]
    reordered: bool
    unlinked: tuple[int, ...]
    bend: float
    slope: float = np.nan
    notes: tuple[str, ...] = ()

    @property
    def misfit(self) -> float:
        """How far the pictures are from following the curve: 0 for the right one."""
        return self.bend + (abs(self.slope - 1.0) if np.isfinite(self.slope) else 0.0)


@dataclass(frozen=True)
class _Pair:
    first: int
    second: int
    log_ratio: float
    sigma: float
    bend: float
    blocks: int


def fit_exposures(
    codes: Sequence[np.ndarray],
    curve: ResponseCurve,
    clip: int,
    tagged: Sequence[float | None],
    names: Sequence[str],
) -> ExposureFit:
    """Exposures of shots (height, width, 3) with the same `clip` code, in the order given.

    Raises InputError where shots share no well exposed pixels and tags do not tell their step either.
    """
    blocks = [_blocks(c, curve) for c in codes]
    pairs = [p for i, j in combinations(range(len(codes)), 2) if (p := _compare(i, j, blocks, curve, clip))]
    groups = _groups(len(codes), pairs)
    logs, sigma = _least_squares(len(codes), pairs, groups)
    tags = np.array([np.nan if t is None else np.log(t) for t in tagged])
    told = [i for i in range(len(codes)) if np.isfinite(tags[i])]
    # Equal tags on shots that differ tell nothing: a camera that writes one time into all its files.
    silent = len(told) < 2 or (np.ptp(tags[told]) < 1e-6 and np.ptp(logs[groups[0]]) > np.log(1.3))
    notes = []
    if len(told) >= 2 and silent:
        notes.append("all exposure times are the same though the pictures are not: they are not used")
    reordered, exact, wrong = False, False, {}
    unlinked: list[int] = []
    main = max(groups, key=len)
    used = [] if silent else [i for i in main if np.isfinite(tags[i])]
    if used:
        difference = logs[used] - tags[used]
        wrong = _wrong_labels(used, difference)
        if len(wrong) > 1 and len(used) > 2:
            by_size = np.sort(logs[used]) - np.sort(tags[used])
            sorted_wrong = _wrong_labels(used, by_size)
            reordered = len(sorted_wrong) <= 1 and len(sorted_wrong) < len(wrong)
            difference = by_size if reordered else difference
        exact = not reordered and float(np.ptp(difference)) < 2.0 * SAME_LABEL * np.log(2.0)
        logs[main] -= np.median(difference)
    for group in groups:
        if group is main:
            continue
        known = [] if silent or reordered else [i for i in group if np.isfinite(tags[i])]
        if not known or not used:
            several = ", ".join(names[i] for i in group)
            raise InputError(
                f"no well exposed pixels are shared between {several} and the other pictures, and no "
                "exposure times tell the step between them",
                hint="leave these out, add the exposures between, or give --times",
            )
        logs[group] -= np.median(logs[known] - tags[known])
        unlinked += group
    if not used:
        logs -= np.median(logs)
    slope = _slope(logs[used], tags[used]) if not reordered else np.nan
    if exact:
        logs[told] = tags[told]
    return ExposureFit(
        np.exp(logs),
        sigma,
        relative=not used,
        exact=exact,
        wrong=wrong,
        reordered=reordered,
        unlinked=tuple(sorted(unlinked)),
        bend=float(np.median([p.bend for p in pairs if np.isfinite(p.bend)] or [0.0])),
        slope=slope,
        notes=tuple(notes),
    )


def _slope(logs: np.ndarray, tags: np.ndarray) -> float:
    """Median slope over all pairs of shots (Theil and Sen): one wrong tag does not turn it."""
    if len(logs) < 3:
        return np.nan
    i, j = np.triu_indices(len(logs), k=1)
    apart = np.abs(tags[j] - tags[i]) > 0.1
    slopes = (logs[j] - logs[i])[apart] / (tags[j] - tags[i])[apart]
    return float(np.median(slopes)) if slopes.size and np.median(slopes) > 0.0 else np.nan


def _wrong_labels(used: Sequence[int], difference: np.ndarray) -> dict[int, float]:
    stops = (difference - np.median(difference)) / np.log(2.0)
    return {i: float(-s) for i, s in zip(used, stops) if abs(s) > WRONG_LABEL}


@dataclass(frozen=True)
class _Blocks:
    mean: np.ndarray  # (n, 3) exposure
    low: np.ndarray  # (n, 3) smallest code
    high: np.ndarray


def _blocks(codes: np.ndarray, curve: ResponseCurve) -> _Blocks:
    """Means and ranges of square blocks: averages are less noisy, and ranges tell where they are clipped."""
    pixels = codes.shape[0] * codes.shape[1]
    side = 8 if pixels > 4_000_000 else 4 if pixels > 100_000 else 2
    side = min(side, *codes.shape[:2])
    height, width = (n // side * side for n in codes.shape[:2])
    shape = (height // side, side, width // side, side, 3)
    cut = codes[:height, :width].reshape(shape)
    mean = curve.exposure(codes[:height, :width]).reshape(shape).mean(axis=(1, 3), dtype=np.float64)
    return _Blocks(
        mean.reshape(-1, 3),
        cut.min(axis=(1, 3)).reshape(-1, 3),
        cut.max(axis=(1, 3)).reshape(-1, 3),
    )


def _compare(i: int, j: int, blocks: Sequence[_Blocks], curve: ResponseCurve, clip: int) -> _Pair | None:
    """log(exposure i / exposure j) over blocks well exposed in both; None where too few are.

    Blocks are chosen by the product of both exposures, never by one shot's own noise, which would bias the
    ratio. Dark blocks are taken only where brighter ones are too few.
    """
    a, b = blocks[i], blocks[j]
    inside = (np.maximum(a.high, b.high) < 0.98 * clip) & (np.minimum(a.low, b.low) > 0.004 * clip)
    good = inside & (np.minimum(a.mean, b.mean) > 0.0)
    level = np.sqrt(np.where(good, a.mean * b.mean, 1.0))
    ratio = a.mean / np.where(good, b.mean, 1.0)
    for floor in (0.16, 0.06, 0.02):
        least, most = curve.table[int(floor * clip), 1], curve.table[int(0.85 * clip), 1]
        chosen = good
        for _ in range(2):
            if np.count_nonzero(chosen) < MIN_BLOCKS:
                break
            half = np.exp(0.5 * abs(np.log(np.median(ratio[chosen]))))
            chosen = good & (level / half >= least) & (level * half <= most)
        if np.count_nonzero(chosen) >= 8 * MIN_BLOCKS:
            break
    good = chosen
    count = int(np.count_nonzero(good))
    if count < MIN_BLOCKS:
        return None
    ratios = np.log(a.mean[good] / b.mean[good])
    middle = float(np.median(ratios))
    spread = 1.4826 * float(np.median(np.abs(ratios - middle)))
    dark = level[good] < np.median(level[good])
    bend = abs(float(np.median(ratios[dark]) - np.median(ratios[~dark]))) if dark.any() else np.nan
    weak = count < 8 * MIN_BLOCKS or abs(middle) < 0.1
    sigma = float(np.hypot(1.2533 * spread / np.sqrt(count), 0.002))
    return _Pair(i, j, middle, sigma, np.nan if weak else bend, count)


def _groups(count: int, pairs: Sequence[_Pair]) -> list[list[int]]:
    """Shots that are linked by pairs, the largest group first."""
    label = list(range(count))
    for pair in pairs:
        old, new = label[pair.second], label[pair.first]
        label = [new if value == old else value for value in label]
    groups = [[i for i in range(count) if label[i] == value] for value in sorted(set(label))]
    return sorted(groups, key=lambda group: -len(group))


def _least_squares(
    count: int, pairs: Sequence[_Pair], groups: Sequence[Sequence[int]]
) -> tuple[np.ndarray, np.ndarray]:
    """Log exposures (n,), the mean of each group 0, and their standard deviations."""
    rows, right = [], []
    for pair in pairs:
        row = np.zeros(count)
        row[pair.first], row[pair.second] = 1.0 / pair.sigma, -1.0 / pair.sigma
        rows.append(row)
        right.append(pair.log_ratio / pair.sigma)
    for group in groups:
        row = np.zeros(count)
        row[list(group)] = 1e4
        rows.append(row)
        right.append(0.0)
    matrix = np.array(rows)
    inverse = np.linalg.pinv(matrix.T @ matrix)
    return inverse @ (matrix.T @ np.array(right)), np.sqrt(np.abs(np.diag(inverse)))
