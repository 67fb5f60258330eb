"""Pictures of a sweep's page: every point and the truth, error maps, crops at equal time and equal error."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mrbatch.bench.sweep_report import Outcome
from mrbatch.bench.sweep_targets import samples_slope, times_the_samples
from mrbatch.report.gallery import magnitude_legend
from mrbatch.report.model import Picture, Report
from mrbatch.report.pictures import display_codes, magnitude_picture, map_scale
from mrbatch.report.sweep import SweepCrop, SweepPoint

CROPPED = ("method.name", "method.strategy")
"""Axes whose values are also shown at equal time and at equal error."""
MARGIN = 12
MOST = 64
"""Samples of a crop: at most so many times the job's own."""


@dataclass(frozen=True)
class Detail:
    report: Report
    images: dict[str, np.ndarray]


def details(outcome: Outcome, report: Report) -> Detail:
    """Adds the pictures: the region of interest of each, in the truth's resolution, errors on one scale."""
    told = report.sweep
    assert told is not None
    truth = outcome.truth
    window = _window(truth.changed)
    images = {"truth": display_codes(truth.picture[window])}
    pictures = [Picture(role="reference", path="truth", frame=told.frame)]
    maps: dict[str, np.ndarray] = {}
    shown: dict[str, np.ndarray] = {}
    for point in told.points:
        found = outcome.own if point.own else outcome.measured(point.name)
        shown[point.name] = truth.fit(found.picture)
        maps[point.name] = np.sqrt(truth.errors(found.picture).maps["relmse"])
    scale = map_scale(maps[told.own.name][truth.changed])
    legend = magnitude_legend(100 * scale, " %")
    for name, picture in shown.items():
        images[name] = display_codes(picture[window])
        images[f"{name}#error"] = magnitude_picture(maps[name][window], scale)
        pictures.append(Picture(role="composite", path=name, frame=told.frame))
        pictures.append(Picture(role="error", path=f"{name}#error", frame=told.frame, legend=legend))
    crops = []
    for crop, codes in _crops(outcome, report, window):
        crops.append(crop)
        images[crop.path] = codes
    swept = told.model_copy(update={"crops": tuple(crops)})
    changed = report.model_copy(update={"pictures": tuple(pictures), "sweep": swept})
    return Detail(changed, images)


def _window(changed: np.ndarray) -> tuple[slice, slice]:
    """The box around the region of interest."""
    rows, columns = np.flatnonzero(changed.any(axis=1)), np.flatnonzero(changed.any(axis=0))
    return (
        slice(max(0, int(rows[0]) - MARGIN), int(rows[-1]) + MARGIN + 1),
        slice(max(0, int(columns[0]) - MARGIN), int(columns[-1]) + MARGIN + 1),
    )


def _crops(
    outcome: Outcome, report: Report, window: tuple[slice, slice]
) -> list[tuple[SweepCrop, np.ndarray]]:
    told = report.sweep
    assert told is not None and told.own.relmse is not None
    slope, goal = samples_slope(told), told.own.relmse.value
    along = {c.axis.name: c.axis.setting for c in outcome.chosen}
    found = []
    for point in told.points:
        if along.get(point.axis) not in CROPPED or point.noise is None or point.bias is None:
            continue
        factors = {
            "equal time": 1.0 / point.time.value,
            "equal error": times_the_samples(
                point.noise.value, point.bias.value if (point.bias.low or 0.0) > 0.0 else 0.0, goal, slope
            ),
        }
        for kind, factor in factors.items():
            if np.isfinite(factor):
                found.append(_crop(outcome, point, kind, factor, window))
    return found


def _crop(
    outcome: Outcome, point: SweepPoint, kind: str, factor: float, window: tuple[slice, slice]
) -> tuple[SweepCrop, np.ndarray]:
    one, own = outcome.choices[point.name], point.samples or 2
    spp = int(min(MOST * own, max(2, 2 * round(own * factor / 2))))
    with outcome.variants.subject(*one.settings, f"method.spp={spp}", threads=one.threads) as subject:
        subject.run()
        run = subject.run()
    errors = outcome.truth.errors(run.composite)
    crop = SweepCrop(
        point=point.name,
        kind=kind,  # type: ignore[arg-type]
        path=f"{point.name}#{kind}",
        samples=spp,
        seconds=run.frame_seconds,
        relmse=errors.region.relmse if errors.region else 0.0,
    )
    return crop, display_codes(outcome.truth.fit(run.composite)[window])
