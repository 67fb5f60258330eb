"""Pictures against references as a report: one pair of files, or two folders with the same names."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np

from mrbatch import __version__
from mrbatch.errors import EXIT_FRAMES, EXIT_GATE, InputError, MrbatchError, Place, worst_exit_code
from mrbatch.metrics.errors import METRICS, Exposures, ImageErrors, Projection, Scores, image_errors
from mrbatch.metrics.region import noisy_region_of_interest, region_of_interest
from mrbatch.report import numbers
from mrbatch.report.gallery import MAX_FRAMES_SHOWN, magnitude_legend, signed_legend
from mrbatch.report.model import (
    File,
    Frame,
    Gate,
    Job,
    Legend,
    Note,
    Picture,
    Report,
    Role,
    Score,
    Totals,
    Value,
)
from mrbatch.report.pairs import Pair, Pairs
from mrbatch.report.pictures import (
    LinearPicture,
    display_codes,
    magnitude_picture,
    map_scale,
    read_picture,
    signed_picture,
)
from mrbatch.report.values import Scope

GateScope = Literal["auto", "frame", "region", "tile"]
_PARTS = {"frame": "the whole frame", "region": "the region of interest", "tile": "the worst tile"}
MOSTLY_REGION = 0.9
"""A region of interest that covers more than this share of the frame is probably noise."""


@dataclass(frozen=True)
class CompareSettings:
    """How pictures are compared; see `mrbatch.metrics.errors.image_errors`.

    `region`: `auto` or `noisy` (both need references without the objects), the path of a mask picture
    (not black is region), or None. `gates`: limit by metric name; the worst frame counts.
    """

    layer: str = ""
    gain: float | tuple[float, float, float] = 1.0
    projection: Projection = "perspective"
    region: Literal["auto", "noisy"] | Path | None = None
    flip: bool = True
    exposures: Exposures | None = None
    gates: Mapping[str, float] | None = None
    gate_scope: GateScope = "auto"
    pictures: bool = False


def compare(several: Pairs, settings: CompareSettings) -> tuple[Report, dict[str, np.ndarray]]:
    """Compare all pairs. Gives the report and its pictures (uint8 RGB by the report's paths).

    One pair that cannot be compared is an InputError; of several it is a failed frame, exit code 4.
    """
    pairs = several.found
    frames: list[Frame] = []
    notes = [Note(level="warning", text=text) for text in several.notes()]
    pictures: list[Picture] = []
    images: dict[str, np.ndarray] = {}
    exposures: dict[str, Any] = {}
    shown = set(np.linspace(0, len(pairs) - 1, min(len(pairs), MAX_FRAMES_SHOWN)).round())
    for i, pair in enumerate(pairs):
        try:
            test, reference, errors = _compare_one(pair, settings)
        except MrbatchError as error:
            if len(pairs) == 1:
                raise
            frames.append(
                Frame(
                    number=pair.number,
                    state="failed",
                    files=(File(path=pair.name),),
                    message=str(error).split("\n")[0],
                    hint=error.hint or "",
                    exit=error.exit_code,
                )
            )
            continue
        frames.append(
            Frame(number=pair.number, state="done", files=(File(path=pair.name),), scores=scores_of(errors))
        )
        if errors.exposures:
            exposures[pair.name] = [errors.exposures.start, errors.exposures.stop, errors.exposures.count]
        if settings.region == "auto" and (errors.region_share or 0.0) > MOSTLY_REGION:
            text = (
                f"{100 * (errors.region_share or 0.0):.0f} % of the frame is region of interest: "
                "if the references carry noise of their own, use `--roi noisy`"
            )
            notes.append(Note(level="warning", text=text, frame=pair.number))
        if settings.pictures and i in shown:
            for picture, codes in _pictures(pair, settings, test, reference, errors):
                pictures.append(picture)
                images[picture.path] = codes
    done = [f for f in frames if f.state == "done"]
    if not done:
        raise InputError(f"no pair could be compared: {frames[0].message}", hint=frames[0].hint)
    gates = _gates(done, settings)
    outcomes = [EXIT_GATE for gate in gates if not gate.passed]
    outcomes += [EXIT_FRAMES for frame in frames if frame.state == "failed"]
    report = Report(
        kind="metrics",
        job=Job(
            name=pairs[0].name if len(pairs) == 1 else pairs[0].test.parent.name or "pictures",
            settings={
                "layer": settings.layer or "RGB",
                "gain": np.atleast_1d(settings.gain).tolist(),
                "projection": settings.projection,
                "region": "none" if settings.region is None else str(settings.region),
                "exposures": exposures,
            },
        ),
        versions={"mrbatch": __version__},
        frames=tuple(frames),
        totals=Totals(frames_done=len(done), frames_failed=len(frames) - len(done)),
        notes=tuple(notes),
        pictures=tuple(pictures),
        gates=gates,
        exit=worst_exit_code(outcomes),
    )
    return report, images


def scores_of(errors: ImageErrors) -> tuple[Score, ...]:
    """All figures of a comparison as the report's scores."""
    scores = []
    parts: tuple[tuple[Scope, Scores | None], ...] = (
        ("frame", errors.frame),
        ("region", errors.region),
        ("tile", errors.tile),
    )
    for scope, values in parts:
        for name, value in values.items() if values else ():
            at = errors.tile_at[name] if scope == "tile" else None
            scores.append(
                Score(metric=name, scope=scope, value=Value(value=value, unit=METRICS[name].unit), at=at)
            )
    return tuple(scores)


def _compare_one(pair: Pair, settings: CompareSettings) -> tuple[LinearPicture, LinearPicture, ImageErrors]:
    test = read_picture(pair.test, settings.layer)
    reference = _aligned(read_picture(pair.reference, settings.layer), test, pair.reference)
    region: np.ndarray | None = None
    if isinstance(settings.region, Path):
        mask = _aligned(read_picture(settings.region), test, settings.region)
        region = np.any(mask.values > 0, axis=2)
    elif settings.region is not None:
        if pair.without is None:
            raise InputError(
                "the region of interest needs a reference without the virtual objects",
                hint="give it with `--without`, or a mask with `--roi FILE`",
            )
        without = _aligned(read_picture(pair.without, settings.layer), test, pair.without)
        find = region_of_interest if settings.region == "auto" else noisy_region_of_interest
        region = find(reference.values, without.values, projection=settings.projection)
    try:
        errors = image_errors(
            _three(test.values, reference.values),
            _three(reference.values, test.values),
            gain=settings.gain,
            projection=settings.projection,
            region=region,
            flip=settings.flip,
            exposures=settings.exposures,
            origin=test.origin,
            full_size=test.full_size,
        )
    except InputError as error:
        raise InputError(error.message, place=Place(file=str(pair.test)), hint=error.hint) from error
    return test, reference, errors


def _aligned(picture: LinearPicture, test: LinearPicture, path: Path) -> LinearPicture:
    """`picture` on the pixels of `test`, which may be a crop of the frame."""
    cut = picture.cut_to(test) if picture.full_size == test.full_size else None
    if cut is None:
        sizes = [f"{p.values.shape[1]}x{p.values.shape[0]} at {p.origin}" for p in (picture, test)]
        raise InputError(
            f"the picture is {sizes[0]}, the one it is compared with {sizes[1]} pixels",
            place=Place(file=str(path)),
            hint="compare pictures of the same frame in the same resolution",
        )
    return cut


def _three(values: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Grey beside colour becomes colour."""
    return np.repeat(values, 3, axis=2) if values.shape[2] == 1 and other.shape[2] == 3 else values


def _both(
    test: LinearPicture, reference: LinearPicture, gain: float | tuple[float, float, float]
) -> list[tuple[Role, Legend | None, np.ndarray]]:
    """Picture and reference as a person sees them; signed ones (a light change) on one scale around grey."""
    values = {"composite": test.values, "reference": reference.values}
    found: list[tuple[Role, Legend | None, np.ndarray]] = []
    if min(float(np.min(v)) for v in values.values()) < 0:
        scale = max(map_scale(v) for v in values.values())
        for role, v in values.items():
            found.append((cast(Role, role), signed_legend(scale), signed_picture(v, scale)))
    else:
        found += [(cast(Role, role), None, display_codes(v, gain)) for role, v in values.items()]
    return found


def _gates(frames: Sequence[Frame], settings: CompareSettings) -> tuple[Gate, ...]:
    gates = []
    for name, limit in (settings.gates or {}).items():
        info = METRICS[name]
        scope = settings.gate_scope
        if scope == "auto":
            scope = "frame" if settings.region is None else "region"
        found = [(s.value, f) for f in frames for s in f.scores if s.metric == name and s.scope == scope]
        if not found:
            raise InputError(
                f"the gate on {info.title} has no figure to judge: nothing was measured on the {scope}",
                hint="give `--roi`, or choose another part with `--on`; FLIP gates need FLIP",
            )
        pick = min if info.higher_is_better else max
        value, frame = pick(found, key=lambda entry: entry[0].value)
        passed = value.value >= limit if info.higher_is_better else value.value <= limit
        part = _PARTS[scope]
        side = "at least" if info.higher_is_better else "at most"
        gates.append(
            Gate(
                name=f"{'min' if info.higher_is_better else 'max'} {info.title}",
                passed=passed,
                text=f"{info.title} of {part} must be {side} {numbers.number(limit)} in every frame",
                measured=value,
                limit=Value(value=limit, unit=info.unit),
                frame=frame.number if len(frames) > 1 else None,
            )
        )
    return tuple(gates)


def _pictures(
    pair: Pair,
    settings: CompareSettings,
    test: LinearPicture,
    reference: LinearPicture,
    errors: ImageErrors,
) -> list[tuple[Picture, np.ndarray]]:
    found = _both(test, reference, settings.gain)
    difference = test.values.astype(np.float64) - reference.values
    scale, relmse = map_scale(difference), errors.maps["relmse"]
    found.append(("difference", signed_legend(scale), signed_picture(difference, scale)))
    if "flip_hdr" in errors.maps:
        found.append(("flip", magnitude_legend(1.0), magnitude_picture(errors.maps["flip_hdr"], 1.0)))
    scale = map_scale(np.sqrt(relmse))
    found.append(("error", magnitude_legend(100 * scale, " %"), magnitude_picture(np.sqrt(relmse), scale)))
    return [
        (Picture(role=role, path=f"{pair.name}#{role}", frame=pair.number, legend=legend), codes)
        for role, legend, codes in found
    ]
