"""How good the frames are, in words: the noise that is left, whether it is much, what less would cost."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median

from mrbatch.report.model import Frame, Report, TimingNode, Value

GOAL = 0.02
"""A relative amplitude that a final picture may keep: about one 8-bit code in the middle greys."""
VERDICTS: tuple[tuple[float, str, str], ...] = (
    (GOAL, "clean", "about one 8-bit code or less"),
    (0.05, "light grain", "close to final"),
    (0.15, "visible grain", "good enough to judge light and placement"),
    (math.inf, "strong grain", "a preview"),
)
"""Up to which amplitude, a word for it, and what it means."""


def amplitude(error: Value | None) -> Value | None:
    """A relMSE as relative amplitude in per cent, its interval too; None where there is none."""
    if error is None or error.unit != "relMSE":
        return None

    def root(value: float | None) -> float | None:
        return None if value is None else 100.0 * math.sqrt(max(0.0, value))

    return error.model_copy(
        update={"value": root(error.value), "low": root(error.low), "high": root(error.high), "unit": "%"}
    )


@dataclass(frozen=True)
class Quality:
    """`noise` of the middle frame and `worst` of all, in per cent; `samples` a pixel of the middle frame.

    `share`: part of a frame's time that grows with the samples. `more_samples`, `more_time`: what `GOAL` asks
    for, as factors; None where it is met.
    """

    noise: Value
    worst: Value
    worst_frame: int
    frames: int
    relmse: float
    samples: int | None
    share: float
    word: str
    meaning: str
    more_samples: float | None
    more_time: float | None


def quality_of(report: Report) -> Quality | None:
    """None where no frame has an estimate. Noise falls at least with the root of the samples."""
    known = [(a, f) for f in report.frames if (a := amplitude(f.error)) is not None]
    if not known:
        return None
    known.sort(key=lambda entry: entry[0].value)
    noise, middle = known[(len(known) - 1) // 2]
    worst, worst_frame = known[-1]
    share = sampling_share(report.timing)
    word, meaning = next((w, m) for most, w, m in VERDICTS if noise.value <= 100 * most)
    more = (noise.value / (100 * GOAL)) ** 2
    return Quality(
        noise=noise,
        worst=worst,
        worst_frame=worst_frame.number,
        frames=len(known),
        relmse=middle.error.value if middle.error else 0.0,
        samples=middle.samples,
        share=share,
        word=word,
        meaning=meaning,
        more_samples=more if more > 1 else None,
        more_time=1 - share + share * more if more > 1 else None,
    )


def sampling_share(timing: TimingNode | None) -> float:
    """The part of the frames' time in steps that trace rays; all of it where the tree does not tell."""
    frames = next((c for c in timing.children if c.name == "frames"), None) if timing else None
    if frames is None or frames.seconds <= 0:
        return 1.0
    traced = sum(c.seconds for c in frames.children if any(n.endswith("rays") for n in c.counters))
    return min(1.0, traced / frames.seconds) if traced > 0 else 1.0


def middle_seconds(frames: Sequence[Frame]) -> float | None:
    """The median of the frames' seconds."""
    known = [f.seconds.value for f in frames if f.seconds is not None]
    return median(known) if known else None
