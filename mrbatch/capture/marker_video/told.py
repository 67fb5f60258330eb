"""What the tables of a marker video tell a person: footage, lens, camera track, and each frame's fit."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import Any

from mrbatch.contracts import Told


def told(table: Mapping[str, Any]) -> Told:
    """From the table that `MarkerVideoCapture.prepare` gave."""
    facts = [("footage", _footage(table), ""), ("lens", _lens(table["camera"]), "")]
    report = table.get("pose_report") or {}
    rms = {
        int(row["frame"]): float(row["rms_px"])
        for row in report.get("frames", ())
        if row.get("rms_px") is not None
    }
    facts.append(("camera track", _track(table, report, rms), _TRACK_MEANING if rms else ""))
    smoothing = report.get("smoothing")
    if smoothing and smoothing["frames"]:
        facts.append(("smoothing", _moved(smoothing), "how far poses moved from where they were found"))
    flags = Counter(flag for several in table["flags"].values() for flag in several)
    if flags:
        words = ", ".join(f"{count} {flag}" for flag, count in sorted(flags.items()))
        facts.append(("flagged frames", words, "see the table of frames"))
    gains = {tuple(gain) for gain in table["gains"].values()}
    if gains:
        facts.append(("gain", _gain(gains), "photo = gain x radiance of the light"))
    frames = {number: {"marker rms": (value, "px")} for number, value in rms.items()}
    for number, shift in (smoothing or {"frames": {}})["frames"].items():
        frames.setdefault(int(number), {})["pose moved"] = (float(shift["mm"]), "mm")
    return Told(tuple(facts), frames)


def smoothing_notes(smoothing: Mapping[str, Any]) -> list[str]:
    """What has to be said of smoothed poses, from `Smoothed.as_json`."""
    if not smoothing["frames"]:
        return ["too few frames have a pose to smooth them"]
    notes = [f"smoothing moved poses by {_moved(smoothing)}"]
    starts, still, far = smoothing["segments"], smoothing["still"], smoothing["far"]
    if still:
        where = "" if len(starts) == 1 else f" from frame {_some(still)} on"
        notes.append(f"the camera stands still{where}: one pose serves")
    if len(starts) > 1:
        notes.append(f"poses jump, so nothing is smoothed across, at frame {_some(starts[1:])}")
    if far:
        notes.append(
            f"smoothing moved poses by more than three sigma of their covariance at frame {_some(far)}: "
            "they are worse than they claim, or the camera was pushed there"
        )
    return notes


def _moved(smoothing: Mapping[str, Any]) -> str:
    mm, deg = smoothing["mm"], smoothing["deg"]
    return (
        f"{mm['rms']:.2g} mm and {deg['rms']:.2g} deg (root mean square), at most "
        f"{mm['largest']:.2g} mm (frame {mm['largest_frame']}) and "
        f"{deg['largest']:.2g} deg (frame {deg['largest_frame']})"
    )


def _some(numbers: Sequence[int]) -> str:
    return ", ".join(map(str, numbers[:20])) + (f" and {len(numbers) - 20} more" if len(numbers) > 20 else "")


_TRACK_MEANING = "from where the marker's corners are to where the solved camera puts them, root mean square"


def _footage(table: Mapping[str, Any]) -> str:
    footage = table["footage"]
    colour = footage["colour"]
    words = [f"{footage['width']} x {footage['height']}"]
    words.append("float" if footage["float"] else f"{colour['bits']}-bit {colour['transfer']}")
    if table["frame_rate"] is not None:
        words.append(f"{float(Fraction(table['frame_rate'])):.6g} frames a second")
    return ", ".join(words)


def _lens(camera: Mapping[str, Any]) -> str:
    focal = camera["matrix"][0][0], camera["matrix"][1][1]
    angles = [
        math.degrees(2 * math.atan(size / 2 / f))
        for size, f in zip((camera["width"], camera["height"]), focal, strict=True)
    ]
    bent = "with" if any(camera["distortion"]) else "without"
    return f"{angles[0]:.1f} x {angles[1]:.1f} degrees, {bent} distortion"


def _track(table: Mapping[str, Any], report: Mapping[str, Any], rms: Mapping[int, float]) -> str:
    count = f"{len(table['poses'])} of {len(table['frames'])} frames have a camera"
    if report.get("source") != "target":
        return f"{count}, from the poses given"
    if not rms:
        return f"{count}, from the marker"
    worst = max(rms, key=lambda number: rms[number])
    ordered = sorted(rms.values())
    middle = ordered[len(ordered) // 2]
    return f"{count}, from the marker: median {middle:.2g} px off, worst {rms[worst]:.2g} px (frame {worst})"


def _gain(gains: set[tuple[float, ...]]) -> str:
    if len(gains) > 1:
        middle = sorted(sum(gain) / len(gain) for gain in gains)[len(gains) // 2]
        return f"one a frame, median {middle:.3g}"
    channels = next(iter(gains))
    same = len(set(channels)) == 1
    return f"{channels[0]:.3g}" if same else ", ".join(f"{c:.3g}" for c in channels)
