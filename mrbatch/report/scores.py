"""The errors of all frames as one small table: a line a metric, a column a part of the frame."""

from __future__ import annotations

from dataclasses import dataclass

from mrbatch.metrics.errors import METRICS
from mrbatch.report.model import Report
from mrbatch.report.numbers import number
from mrbatch.report.values import Scope, Score

SCOPES: tuple[tuple[Scope, str], ...] = (
    ("frame", "frame"),
    ("region", "region"),
    ("tile", "worst tile"),
)


@dataclass(frozen=True)
class ScoreTable:
    """`columns`: headings; `rows`: title and one text a column. `frames`: how many were measured."""

    columns: tuple[str, ...]
    rows: tuple[tuple[str, tuple[str, ...]], ...]
    frames: int


def score_table(report: Report) -> ScoreTable:
    """One frame: its figures. Several: the mean, and where they differ the worst frame's beside it."""
    found: dict[tuple[str, str], list[tuple[int, Score]]] = {}
    measured = [f for f in report.frames if f.scores]
    for frame in measured:
        for score in frame.scores:
            found.setdefault((score.metric, score.scope), []).append((frame.number, score))
    scopes = [(scope, title) for scope, title in SCOPES if any(key[1] == scope for key in found)]
    names = [n for n in METRICS if any(key[0] == n for key in found)]
    names += sorted({key[0] for key in found} - set(names))
    rows = []
    for name in names:
        title = METRICS[name].title if name in METRICS else name
        higher = name in METRICS and METRICS[name].higher_is_better
        rows.append((title, tuple(_cell(found.get((name, scope), []), higher) for scope, _ in scopes)))
    return ScoreTable(tuple(title for _, title in scopes), tuple(rows), len(measured))


def _cell(scores: list[tuple[int, Score]], higher_is_better: bool) -> str:
    if not scores:
        return ""
    unit = scores[0][1].value.unit
    unit = "" if unit in ("1", "", "radiance") else f" {unit}"
    pick = min if higher_is_better else max
    frame, worst = pick(scores, key=lambda entry: entry[1].value.value)
    if len(scores) == 1:
        at = f" at {worst.at[0]}, {worst.at[1]}" if worst.at else ""
        return f"{number(worst.value.value)}{unit}{at}"
    mean = sum(score.value.value for _, score in scores) / len(scores)
    if number(mean) == number(worst.value.value):
        return f"{number(mean)}{unit}"
    return f"{number(mean)}{unit} (worst {number(worst.value.value)}, frame {frame})"
