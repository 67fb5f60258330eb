"""Camera poses of a whole shot from its printed target.

Each frame is looked at once; all its poses are kept (`pose_solver`). Which root is the true one is chosen
over the whole shot, as the path through the frames that explains the pictures best and moves
least (Viterbi). Frames without a pose are treated as the job says.
"""

from __future__ import annotations

import os
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from mrbatch.capture.marker_video.calibration import Calibration
from mrbatch.capture.marker_video.lost_frames import LostPolicy, fill_lost
from mrbatch.capture.marker_video.markers import (
    Detection,
    TargetDetector,
    other_dictionaries,
    srgb_to_linear,
)
from mrbatch.capture.marker_video.pose_solver import (
    Root,
    angle_between,
    pose_covariance,
    reprojection_rms,
    solve,
)
from mrbatch.capture.marker_video.pose_table import FramePose, PoseTable
from mrbatch.capture.marker_video.tag_layout import estimate_layout, place
from mrbatch.capture.marker_video.target_settings import TargetSettings
from mrbatch.errors import InputError, Place

AMBIGUOUS_RATIO = 2.0
"""Two roots whose rms differ by less than this factor are not told apart by one picture."""
AMBIGUOUS_ANGLE = np.radians(2.0)
"""Roots closer than this are no flip: either serves, and the covariance says how well."""
POOR_SHARE = 0.02
"""rms over the target's extent in the picture (and above a pixel): a bent print or a wrong calibration."""
REFUSED_SHARE = 0.06
"""... and from here on it is not this target."""
_JUMP_CAP = 16.0
"""What the largest jump may cost, in units of chi^2 (four sigma): cuts and stills stay possible."""
MOST_AT_ONCE = 8
"""Pictures that are looked at, and held, at the same time."""
_SEEN_FRAMES = 5
"""How many frames are searched for other dictionaries when the target is never seen."""


def solve_poses(
    frames: Iterable[tuple[int, float, Callable[[], np.ndarray]]],
    calibration: Calibration,
    target: TargetSettings,
    *,
    lost: LostPolicy = "stop",
    smoothing: int | None = None,
    transfer: Callable[[np.ndarray], np.ndarray] = srgb_to_linear,
    progress: Callable[[int, bool], None] | None = None,
) -> PoseTable:
    """Poses of all frames of a shot.

    `frames`: number, time in seconds, and a call that gives the grey picture (height, width), as uint8
    or uint16 codes of `transfer` or as linear floats; pictures are asked for in order, and a few are held
    at a time. `lost`: what happens to frames without a usable pose: `stop` (error), `skip` (no pose),
    `hold-last` (the pose before), `interpolate` (between the neighbours; held at the ends). `smoothing`:
    order of the model of motion by which poses are smoothed (`pose_smoothing`). `progress` is called with
    each frame number done and whether the target is seen in it.

    A frame in which a marker is seen twice gets a row with its `fault` and no pose. Raises InputError: the
    target is never seen (the hint names dictionaries that do see markers), or only in frames with a fault;
    a picture has another size than the calibration; poses are missing under `stop`.
    """
    looked: list[tuple[int, float, Detection]] = []
    first: list[np.ndarray] = []
    faults: dict[int, InputError] = {}
    detectors = threading.local()

    def detect(grey: np.ndarray) -> Detection:
        # OpenCV does not say that threads may share one.
        if not hasattr(detectors, "own"):
            detectors.own = TargetDetector(target, calibration, transfer=transfer)
        found: Detection = detectors.own.detect(grey)
        return found

    for number, time, grey, detection in _detected(frames, calibration, detect):
        if detection.duplicates:
            faults[number] = _seen_twice(detection, number)
        if len(detection) == 0 and len(first) < _SEEN_FRAMES:
            first.append(grey)
        looked.append((number, time, detection))
        if progress:
            progress(number, len(detection) > 0)
    if not looked:
        raise InputError("there are no frames to find the target in")
    whole = [row for row in looked if row[0] not in faults]
    if faults and not any(len(d) for _, _, d in whole):
        raise next(iter(faults.values()))
    if not any(len(d) for _, _, d in whole):
        raise _never_seen(target, looked, first)
    layout = None
    if target.tags and target.tags.layout is None:
        layout = estimate_layout([(n, d) for n, _, d in whole], calibration, target.tags)
        whole = [(n, t, place(d, layout)) for n, t, d in whole]
    table = _table(whole, calibration, lost, layout, smoothing)
    rows = {row.number: row for row in table.frames}
    for number, time, detection in looked:
        if number in faults:
            rows[number] = FramePose(number, time, None, points=len(detection), fault=faults[number].message)
    return replace(table, frames=tuple(rows[number] for number, _, _ in looked))


_Looking = tuple[int, float, np.ndarray, "Future[Detection]"]


def _done(looking: _Looking) -> tuple[int, float, np.ndarray, Detection]:
    number, time, grey, found = looking
    return number, time, grey, found.result()


def _detected(
    frames: Iterable[tuple[int, float, Callable[[], np.ndarray]]],
    calibration: Calibration,
    detect: Callable[[np.ndarray], Detection],
) -> Iterator[tuple[int, float, np.ndarray, Detection]]:
    """Frames in their order, each with its picture and what is seen in it; a few are looked at at a time."""
    workers = min(MOST_AT_ONCE, os.cpu_count() or 1)
    with ThreadPoolExecutor(workers) as pool:
        ahead: deque[_Looking] = deque()
        try:
            for number, time, load in frames:
                grey = load()
                if grey.ndim != 2:
                    raise InputError(
                        f"expected a grey picture, got shape {grey.shape}", place=Place(frame=number)
                    )
                calibration.check_size(grey.shape[1], grey.shape[0], Place(frame=number))
                ahead.append((number, time, grey, pool.submit(detect, grey)))
                if len(ahead) > workers:
                    yield _done(ahead.popleft())
            while ahead:
                yield _done(ahead.popleft())
        finally:
            for _, _, _, found in ahead:
                found.cancel()


def _seen_twice(detection: Detection, number: int) -> InputError:
    marker, centres = next(iter(detection.duplicates.items()))
    places = " and ".join(f"({x:.0f}, {y:.0f})" for x, y in centres)
    return InputError(
        f"marker {marker} is seen {len(centres)} times, at pixels {places}",
        place=Place(frame=number),
        hint="each id may lie on the scene once: cover one of them or print another id",
    )


def _never_seen(target: TargetSettings, looked, pictures: list[np.ndarray]) -> InputError:
    what = f"marker {target.marker.id}" if target.marker else ("the board" if target.board else "a tag")
    hints = []
    beside = sorted({i for _, _, d in looked for i in d.others})
    if beside:
        hints.append(f"{target.dictionary} shows the ids {', '.join(map(str, beside))}")
    else:
        for name, ids in list(other_dictionaries(pictures, target.dictionary).items())[:3]:
            hints.append(f"{name} sees the ids {', '.join(map(str, ids[:8]))}")
    hint = (
        "; ".join(hints) if hints else "no dictionary sees a marker: is the print sharp and wholly in view?"
    )
    return InputError(f"{what} of {target.dictionary} is seen in none of the {len(looked)} frames", hint=hint)


def _table(
    looked: list[tuple[int, float, Detection]],
    calibration: Calibration,
    lost: LostPolicy,
    layout: dict[int, np.ndarray] | None,
    smoothing: int | None = None,
) -> PoseTable:
    roots = [_usable(solve(d, calibration), d) for _, _, d in looked]
    noise2, own = _noise([d for _, _, d in looked], roots)
    measured = [i for i, r in enumerate(roots) if r]
    choice, ambiguous = choose_roots([roots[i] for i in measured], [own[i] for i in measured])
    rows = [
        FramePose(number, time, None, flags=("lost",), points=len(d), repaired=tuple(d.repaired))
        for number, time, d in looked
    ]
    for i, chosen, doubtful in zip(measured, choice, ambiguous, strict=True):
        root = roots[i][chosen]
        rows[i] = replace(
            rows[i],
            world_from_camera=None if doubtful else root.world_from_camera,
            roots=tuple(roots[i]),
            chosen=chosen,
            rms=root.rms,
            covariance=own[i] * pose_covariance(root, looked[i][2], calibration),
            flags=_flags(root, looked[i][2], doubtful),
        )
    report = None
    if smoothing is not None:
        from mrbatch.capture.marker_video.pose_smoothing import smooth_poses

        smoothed = smooth_poses(rows, order=smoothing, fill=lost == "interpolate")
        report = smoothed.as_json()
        rows = [
            replace(row, rms=reprojection_rms(row.world_from_camera, detection, calibration))
            if row.number in smoothed.shifts and row.world_from_camera is not None
            else row
            for row, (_, _, detection) in zip(smoothed.rows, looked, strict=True)
        ]
    good = [row.rms for row in rows if row.world_from_camera is not None and row.rms is not None]
    if not good:
        raise InputError(
            "the target is seen, but no frame gives a pose: "
            + ("two poses explain it equally well" if measured else "its points do not fit its shape"),
            hint="film it larger and at a slant, or use a board"
            if measured
            else "check the target's size, layout and the calibration",
        )
    rows = fill_lost(rows, lost)
    return PoseTable(tuple(rows), float(np.median(good)), float(np.sqrt(noise2)), layout, report)


def _noise(detections: list[Detection], roots: list[list[Root]]) -> tuple[float, list[float]]:
    """Variance of detected points relative to their stated covariance: the shot's median, and each frame's.

    A pose has 6 numbers; what is left of the residuals follows a chi^2 with 2n - 6 degrees of freedom.
    A frame that fits worse than the shot as a whole counts with its own misfit.
    """
    from scipy.stats import chi2

    freedom = [2 * len(d) - 6 for d in detections]
    shares = [r[0].chi2 / chi2.median(k) for r, k in zip(roots, freedom, strict=True) if r and k > 0]
    shot = float(np.median(shares)) if shares else 1.0
    # A marker alone leaves 2 degrees of freedom, too few to say that its corners are better than
    # stated; and the other pictures of a set of stills need not be as bad as this one, or as good.
    floor = float(np.clip(shot, 1.0, 4.0)) if min(freedom, default=0) < 20 else shot
    own = [max(floor, r[0].chi2 / k) if r and k > 0 else floor for r, k in zip(roots, freedom, strict=True)]
    return shot, own


def _extent(detection: Detection) -> float:
    return float(np.ptp(detection.points_2d, axis=0).max())


def _usable(roots: list[Root], detection: Detection) -> list[Root]:
    """The two best roots, or none where even the best does not fit the target's shape."""
    if not roots:
        return []
    return roots[:2] if roots[0].rms <= max(1.0, REFUSED_SHARE * _extent(detection)) else []


def _flags(root: Root, detection: Detection, doubtful: bool) -> tuple[str, ...]:
    poor = root.rms > max(1.0, POOR_SHARE * _extent(detection))
    return ("ambiguous",) * doubtful + ("poor-fit",) * poor


def choose_roots(roots: list[list[Root]], noise2: list[float]) -> tuple[list[int], list[bool]]:
    """For each frame in order: the index of its chosen root, and whether the choice is doubtful.

    Minimises sum chi^2 / noise2 + sum of jumps between neighbours, min((jump / usual)^2, cap), over
    all paths; a jump is the turn in radians plus the shift over the distance, `usual` the shot's own
    median of the smallest jump between neighbours. A frame is doubtful where the other of two distinct
    roots is within three sigma on the whole path, or has nearly the same rms and the neighbours do not
    speak against it. `noise2`: for each
    frame, variance of its points relative to what their covariance says.
    """
    if not roots:
        return [], []
    single = [[r.chi2 / n for r in frame] for frame, n in zip(roots, noise2, strict=True)]
    jumps = [np.array([[_jump(a, b) for b in roots[i + 1]] for a in roots[i]]) for i in range(len(roots) - 1)]
    usual = 0.02 + (float(np.median([j.min() for j in jumps])) if jumps else 0.0)
    costs = [np.minimum((j / usual) ** 2, _JUMP_CAP) for j in jumps]
    forward = [np.array(single[0])]
    for i, cost in enumerate(costs):
        forward.append((forward[-1][:, None] + cost).min(axis=0) + single[i + 1])
    backward = [np.zeros(len(single[-1]))]
    for i in range(len(costs) - 1, -1, -1):
        backward.append((costs[i] + (single[i + 1] + backward[-1])[None, :]).min(axis=1))
    backward.reverse()
    choice: list[int] = []
    doubt: list[bool] = []
    for i, frame in enumerate(roots):
        if not choice:
            best = int(np.argmin(forward[0] + backward[0]))
        else:
            best = int(np.argmin(costs[i - 1][choice[-1]] + single[i] + backward[i]))
        choice.append(best)
        doubt.append(_doubtful(frame, best, forward[i] + backward[i], single[i]))
    return choice, doubt


def _doubtful(frame: list[Root], best: int, total: np.ndarray, single: list[float]) -> bool:
    if len(frame) < 2:
        return False
    other = 1 - best
    if angle_between(frame[0].world_from_camera, frame[1].world_from_camera) < AMBIGUOUS_ANGLE:
        return False
    margin = total[other] - total[best]
    context = margin - (single[other] - single[best])
    alike = frame[other].rms < AMBIGUOUS_RATIO * frame[best].rms
    # Nine is three sigma. The ratio alone is not enough: a marker's four corners may fit one root well by
    # luck. Where the rms are alike, the neighbours must speak for the choice, not this picture.
    return bool(margin < 9.0 or (alike and context < 4.0))


def _jump(a: Root, b: Root) -> float:
    p, q = a.world_from_camera, b.world_from_camera
    distance = 0.5 * float(np.linalg.norm(p[:3, 3]) + np.linalg.norm(q[:3, 3]))
    shift = float(np.linalg.norm(p[:3, 3] - q[:3, 3]))
    return angle_between(p, q) + shift / max(distance, 1e-12)
