"""From the pictures of an exposure bracket to a map of radiance, with an account of every shot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from mrbatch.capture.marker_video.bracket import Bracket, Shot, read_bracket
from mrbatch.capture.marker_video.exposure_fit import CURVE_MISFIT, ExposureFit, fit_exposures
from mrbatch.capture.marker_video.hdr_file import HALF_MAX, NumberType, choose_number_type, write_map
from mrbatch.capture.marker_video.hdr_merge import Merged, measure_noise, merge_shots
from mrbatch.capture.marker_video.opencv_merge import merge_opencv
from mrbatch.capture.marker_video.response_curve import CURVES, ResponseCurve, known_curve, recovered_curve
from mrbatch.capture.marker_video.shot_alignment import (
    Shift,
    measure_shifts,
    moved_back,
    turned_shots,
)
from mrbatch.errors import InputError, JobError, Place
from mrbatch.kernels.transfer import to_rec709

Method = Literal["variance", "debevec", "robertson"]
Align = Literal["correct", "refuse", "off"]
_GAP = 1.6
"""A step this many times the usual one looks like a shot that is missing."""


@dataclass(frozen=True)
class ShotAccount:
    """What became of one shot. `tagged`, `seconds`: exposure as tagged (or given) and as used; `stops_off`:
    tag against picture; `shift`: pixels right and down that were taken back; `clipped`: share of pixels with
    a clipped channel; `left_out`: share of pixels where it was left out as a ghost."""

    file: str
    tagged: float | None
    seconds: float
    sigma: float
    stops_off: float | None
    shift: tuple[float, float]
    clipped: float
    left_out: float


@dataclass(frozen=True)
class MergeReport:
    """A merged map. `shots` from the shortest exposure up; shares are of all pixels; `warnings` want a
    look, `notes` say what was done."""

    output: str
    width: int
    height: int
    method: str
    curve: str
    number_type: str
    relative: bool
    peak: float
    mean: float
    clipped: float
    dark: float
    ghosts: float
    shots: tuple[ShotAccount, ...]
    warnings: tuple[str, ...]
    notes: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)


def merge_hdr(
    pictures: Sequence[str | Path],
    output: str | Path,
    *,
    times: Sequence[float] | None = None,
    method: Method = "variance",
    curve: str = "auto",
    align: Align = "correct",
    ghosts: bool = True,
    number_type: NumberType = "auto",
    width: int | None = None,
) -> MergeReport:
    """Merges an exposure bracket (8-bit JPEG or PNG, 16-bit PNG or TIFF) into a linear EXR.

    `times`: seconds of each picture, else EXIF's, else relative. Exposures are measured in the pictures
    and checked against these. `curve`: auto (sRGB unless tagged linear), srgb, bt709, gamma22, linear, or
    recover. `width`: of the map, smaller than the pictures' (by area, in linear light).

    Radiance 1 is what full scale shows in one second (relative: in the best exposed shot). Raises JobError:
    wrong arguments; InputError: pictures that cannot be merged; ResourceError: no room for the file.
    """
    paths, target = [Path(p) for p in pictures], Path(output)
    _check_arguments(paths, target, times)
    bracket = read_bracket(paths)
    warnings: list[str] = []
    notes = list(bracket.notes)
    shots = _telling(bracket, notes)
    tagged = [s.tagged if times is None else times[s.index] for s in shots]
    names = [s.name for s in shots]
    codes = [s.codes for s in shots]
    response, fit = _curve_and_exposures(curve, shots, bracket.clip, tagged, notes)
    exposed = [float(np.mean((c > 0.1 * bracket.clip) & (c < 0.9 * bracket.clip))) for c in codes]
    best = int(np.argmax(exposed))
    if fit.relative:
        fit = replace(fit, seconds=fit.seconds / fit.seconds[best])
    _judge(fit, response, shots, tagged, warnings, notes)
    shifts, there = [Shift(0.0, 0.0)] * len(shots), _everywhere(shots)
    if align != "off":
        codes, shifts, there = _aligned(codes, names, response, fit, best, align, warnings)
    lossy = [s.lossy for s in shots]
    noise = measure_noise(codes, response, fit.seconds, bracket.clip, even=any(lossy))
    plain = method != "variance"
    merged = merge_shots(
        codes,
        response,
        fit.seconds,
        bracket.clip,
        noise,
        there=there,
        ghosts=ghosts and not plain,
        lossy=lossy,
    )
    radiance = merge_opencv(codes, response, fit.seconds, method) if plain else merged.radiance
    radiance = np.maximum(to_rec709(radiance, bracket.rec709_from_source), np.float32(0.0))
    _judge_pixels(merged, warnings)
    masks = {"clipped": merged.clipped, "dark": merged.dark, "ghost": merged.ghosts}
    if width is not None:
        radiance, masks = _smaller(radiance, masks, width)
    kind, reason = choose_number_type(radiance) if number_type == "auto" else (number_type, "as asked")
    notes.append(f"{kind}: {reason}")
    if kind == "half" and radiance.max() > HALF_MAX:
        warnings.append(f"light of {radiance.max():.4g} is cut to {HALF_MAX:.0f}, half's largest number")
        radiance = np.minimum(radiance, np.float32(HALF_MAX))
    accounts = _accounts(shots, tagged, fit, shifts, merged, bracket.clip)
    luminance = radiance @ np.array([0.2126, 0.7152, 0.0722], dtype=np.float32)
    report = MergeReport(
        output=str(target),
        width=radiance.shape[1],
        height=radiance.shape[0],
        method=method,
        curve=response.name,
        number_type=kind,
        relative=fit.relative,
        peak=float(radiance.max()),
        mean=float(luminance.mean(dtype=np.float64)),
        clipped=float(merged.clipped.mean()),
        dark=float(merged.dark.mean()),
        ghosts=float(merged.ghosts.mean()),
        shots=accounts,
        warnings=tuple(warnings),
        notes=tuple(notes),
    )
    about = {key: value for key, value in report.as_dict().items() if key != "output"}
    write_map(target, radiance, masks, about, kind)
    return report


def _check_arguments(paths: Sequence[Path], target: Path, times: Sequence[float] | None) -> None:
    if target.suffix.lower() != ".exr":
        raise JobError(f"the map is written as EXR, but the output is called {target.name}")
    if target.resolve() in [p.resolve() for p in paths]:
        raise JobError("the output is one of the pictures", place=Place(file=str(target)))
    if not target.parent.is_dir():
        raise JobError("the output's folder does not exist", place=Place(file=str(target)))
    if times is not None:
        if len(times) != len(paths):
            raise JobError(f"{len(times)} exposure times are given for {len(paths)} pictures")
        if not all(0.0 < t < 1e9 for t in times):
            raise JobError("exposure times must be positive seconds")


def _telling(bracket: Bracket, notes: list[str]) -> list[Shot]:
    """Shots with at least some pixels neither black nor clipped. Raises InputError for fewer than two."""
    kept = []
    for shot in bracket.shots:
        if np.any((shot.codes > 0.02 * bracket.clip) & (shot.codes < 0.98 * bracket.clip)):
            kept.append(shot)
        else:
            what = "black" if shot.codes.mean() < 0.5 * bracket.clip else "clipped"
            notes.append(f"{shot.name} is {what} all over: left out")
    if len(kept) < 2:
        raise InputError(
            f"of {len(bracket.shots)} pictures only {len(kept)} show anything between black and white",
            hint="take shorter exposures where all is white, longer ones where all is black",
        )
    return kept


def _curve(name: str, shots: Sequence[Shot], tagged: Sequence[float | None]) -> ResponseCurve:
    if name == "auto":
        name = "linear" if all(s.linear_tag for s in shots) else "srgb"
    if name != "recover":
        return known_curve(name, 8 * shots[0].codes.dtype.itemsize)
    times = [t for t in tagged if t is not None]
    if len(times) < len(shots) or len(set(times)) < 2:
        raise InputError(
            "recovering the curve needs the exposure times, which the pictures do not tell",
            hint="give --times",
        )
    return recovered_curve([s.codes for s in shots], times)


def _curve_and_exposures(
    name: str, shots: Sequence[Shot], clip: int, tagged: Sequence[float | None], notes: list[str]
) -> tuple[ResponseCurve, ExposureFit]:
    """The curve that was asked for; for `auto` sRGB (or linear where tagged), unless the pictures plainly
    follow another of the known ones."""
    codes, names = [s.codes for s in shots], [s.name for s in shots]

    def fitted(one: str) -> tuple[ResponseCurve, ExposureFit]:
        response = _curve(one, shots, tagged)
        return response, fit_exposures(codes, response, clip, tagged, names)

    first = fitted(name)
    if name != "auto" or first[1].misfit < CURVE_MISFIT:
        return first
    best = min((fitted(other) for other in CURVES if other != first[0].name), key=lambda f: f[1].misfit)
    if best[1].misfit > 0.4 * first[1].misfit or best[1].misfit > CURVE_MISFIT:
        return first
    notes.append(f"the pictures follow {best[0].name}, not {first[0].name}")
    return best


def _judge(
    fit: ExposureFit,
    curve: ResponseCurve,
    shots: Sequence[Shot],
    tagged: Sequence[float | None],
    warnings: list[str],
    notes: list[str],
) -> None:
    """What the exposures say of tags, of the curve, and of shots that are missing."""
    warnings += fit.notes
    if fit.exact:
        notes.append("exposure times agree with the pictures and are used as they are")
    elif fit.relative:
        notes.append("exposures are measured in the pictures; radiance is relative to the best exposed shot")
    else:
        notes.append("exposures are measured in the pictures; the times give the unit")
    if fit.reordered:
        warnings.append("the exposure times belong to other pictures: they were put in the pictures' order")
    elif fit.wrong and fit.misfit < CURVE_MISFIT:
        for i, stops in fit.wrong.items():
            t = tagged[i]
            warnings.append(
                f"{shots[i].name}: its time {t:.4g} s is off by {stops:+.2f} stops; "
                f"{fit.seconds[i]:.4g} s is used"
            )
    for i in fit.unlinked:
        warnings.append(f"{shots[i].name}: shares no well exposed pixels with others; its time is trusted")
    if fit.misfit > CURVE_MISFIT:
        steps = f", and steps are {fit.slope:.2f} times the times'" if abs(fit.slope - 1.0) > 0.02 else ""
        warnings.append(
            f"ratios of exposures change by {100 * fit.bend:.0f} % between dark and bright pixels{steps}: "
            f"the pictures do not follow {curve.name}; try --curve recover"
        )
    order = np.argsort(fit.seconds)
    steps = np.diff(np.log2(fit.seconds[order]))
    usual = float(np.median(steps[steps > 0.2])) if np.any(steps > 0.2) else 0.0
    for i, j, step in zip(order, order[1:], steps):
        if len(steps) > 2 and step > _GAP * usual:
            warnings.append(
                f"{step:.1f} stops between {shots[i].name} and {shots[j].name}, {usual:.1f} elsewhere: "
                "an exposure is missing"
            )
        if step < 0.1:
            notes.append(f"{shots[i].name} and {shots[j].name} have one exposure: they are averaged")


def _aligned(codes, names, curve, fit: ExposureFit, best: int, align: Align, warnings: list[str]):
    """Shots put back in place: codes, shifts, and where each has pixels."""
    shifts = measure_shifts(codes, curve, fit.seconds, best)
    for i in turned_shots(codes, curve, fit.seconds):
        told = f"{names[i]} is turned or bent against its neighbours, which moving cannot mend"
        if align == "refuse":
            raise InputError(told, hint="leave it out, or align the pictures first")
        warnings.append(told)
    still = _majority(shifts)
    shifts = [Shift(s.x - still.x, s.y - still.y) for s in shifts]
    result, there = list(codes), _everywhere(codes)
    for i, shift in enumerate(shifts):
        if shift.length == 0.0:
            continue
        told = f"{names[i]} is moved by ({shift.x:+.1f}, {shift.y:+.1f}) pixels"
        if align == "refuse":
            raise InputError(told, hint="leave it out, or let it be moved back: --align correct")
        result[i], there[i] = moved_back(codes[i], shift, names[i])
        warnings.append(f"{told}: moved back")
    return result, shifts, there


def _everywhere(shots: Sequence[Any]) -> list[np.ndarray | None]:
    return [None] * len(shots)


def _majority(shifts: Sequence[Shift]) -> Shift:
    """The place that most shots share: if it was the reference that moved, the others stay."""

    def company(one: Shift) -> int:
        return sum(abs(one.x - s.x) < 0.5 and abs(one.y - s.y) < 0.5 for s in shifts)

    # The first of equals is preferred to be unmoved.
    return max(shifts, key=lambda s: (company(s), s.length == 0.0))


def _smaller(
    radiance: np.ndarray, masks: Mapping[str, np.ndarray], width: int
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Area averages at the width; a mask holds where any pixel of the area has it. Raises JobError."""
    import cv2

    old_height, old_width = radiance.shape[:2]
    if not 1 <= width <= old_width:
        raise JobError(f"a map {width} pixels wide of pictures of {old_width}: it can only become smaller")
    size = (width, max(1, round(old_height * width / old_width)))

    def shrunk(values: np.ndarray) -> np.ndarray:
        return cv2.resize(values, size, interpolation=cv2.INTER_AREA)

    return shrunk(radiance), {name: shrunk(m.astype(np.float32)) > 1e-6 for name, m in masks.items()}


def _judge_pixels(merged: Merged, warnings: list[str]) -> None:
    import cv2

    clipped, ghosts = float(merged.clipped.mean()), float(merged.ghosts.mean())
    # What JPEG leaves along edges is thin; what moved has a body.
    body = cv2.erode(merged.ghosts.astype(np.uint8), np.ones((11, 11), np.uint8)).any()
    if clipped > 0:
        warnings.append(
            f"{_percent(clipped)} of the pixels clip even in the shortest exposure: they hold a lower bound "
            "(channel flag.clipped)"
        )
    if body:
        warnings.append(
            f"something moved in {_percent(ghosts)} of the pixels: the minority of shots was left out there "
            "(channel flag.ghost)"
        )


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %"


def _accounts(shots, tagged, fit: ExposureFit, shifts, merged: Merged, clip: int) -> tuple[ShotAccount, ...]:
    result = []
    for i in np.argsort(fit.seconds):
        t = tagged[i]
        result.append(
            ShotAccount(
                file=shots[i].name,
                tagged=t,
                seconds=float(fit.seconds[i]),
                sigma=float(fit.sigma[i]),
                stops_off=None if t is None or fit.relative else float(np.log2(t / fit.seconds[i])),
                shift=(shifts[i].x, shifts[i].y),
                clipped=float(np.mean((shots[i].codes >= clip).any(axis=-1))),
                left_out=float(merged.ghost_share[i]),
            )
        )
    return tuple(result)
