"""The report as one self-contained HTML page: no script, nothing fetched, pictures inside.

A person sees pictures first; then what was simulated, what was not, and why; then where the time
went. The page forbids itself every connection by its own content policy.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

import numpy as np

from mrbatch.report import numbers
from mrbatch.report.gallery import MAX_FRAMES_SHOWN, picture_groups
from mrbatch.report.model import Report, TimingNode, Value, write_text
from mrbatch.report.plots import bar_chart, noise_plot
from mrbatch.report.quality import amplitude, quality_of
from mrbatch.report.scores import score_table
from mrbatch.report.template import template

STATE_MEANING = {
    "needed": "the scene calls for it: simulated",
    "unresolved": "how much it matters could not be bounded: simulated, to be safe",
    "forced-on": "simulated, because the job says so",
    "negligible": "there, but proved smaller than its share of the error budget: left out",
    "absent": "proved: nothing of it exists in this scene, so leaving it out changes no pixel",
    "forced-off": "left out, because the job says so",
}
SIMULATED = ("needed", "unresolved", "forced-on")


@dataclass(frozen=True)
class Row:
    """A line of the timing tree: depth of indent, share of the whole in per cent."""

    node: TimingNode
    depth: int
    share: float

    @property
    def work(self) -> str:
        """The rays of all kinds together, in a few letters."""
        rays = sum(n for name, n in self.node.counters.items() if name.endswith("rays"))
        return f"{numbers.count(rays)} rays" if rays else ""

    @property
    def details(self) -> str:
        """Calls, launches and every counter."""
        parts = [f"{self.node.calls:,} calls"] if self.node.calls > 1 else []
        parts += [f"{self.node.launches:,} launches"] if self.node.launches else []
        return ", ".join(parts + [f"{name} {n:,}" for name, n in sorted(self.node.counters.items())])


def render_html(
    report: Report,
    *,
    folder: Path | None = None,
    images: Mapping[str, np.ndarray] | None = None,
    max_frames: int = MAX_FRAMES_SHOWN,
    linked: bool = False,
) -> str:
    """The page as text.

    `folder`: where the report's pictures lie; paths that leave it are not followed. `images`: uint8
    RGB pictures (height, width, 3) by the path that the report calls them, used before any file.
    A picture that cannot be read costs its place on the page, never the page. `linked`: the page lies in the
    report's folder, so that files are linked to by their names.
    """

    filters = {
        "number": numbers.number,
        "count": numbers.count,
        "roughly": numbers.roughly,
        "seconds": numbers.seconds,
        "quantity": numbers.quantity,
        "noise": _noise,
        "link": link,
        "short": numbers.short_hash,
    }
    effects = sorted(report.plan.effects, key=lambda e: (e.state not in SIMULATED, e.name))
    return template("report.html.j2", filters).render(
        report=report,
        linked=linked,
        frame_files=[file.path for f in report.frames for file in f.files],
        groups=picture_groups(report, folder, images or {}, max_frames=max_frames),
        quality=quality_of(report),
        plot=noise_plot(report),
        frames_with_pictures=len({p.frame for p in report.pictures if p.frame is not None}),
        effects=effects,
        simulated=SIMULATED,
        state_meaning=STATE_MEANING,
        timing=timing_rows(report.timing),
        counters=sorted(report.totals.counters.items()),
        charts={name: bar_chart(report.frames, name) for name in ("error", "seconds")},
        scores=score_table(report),
        timed=any(f.seconds is not None for f in report.frames),
        estimated=any(f.error is not None for f in report.frames),
        measured=sorted({name for f in report.frames for name in f.numbers}),
        outcomes=any(f.outcome not in ("fixed", "none") for f in report.frames),
        leading=_leading(report),
        tried=sorted((c for c in report.cases if c.outcome != "skipped"), key=lambda c: c.passed),
        untried=[c for c in report.cases if c.outcome == "skipped"],
        settings=json.dumps(report.job.settings, indent=2, ensure_ascii=False, default=str),
    )


def write_html(
    report: Report,
    path: Path,
    *,
    folder: Path | None = None,
    images: Mapping[str, np.ndarray] | None = None,
) -> None:
    """Write the page in one step. Raises ResourceError where it cannot be written."""
    path = Path(path)
    linked = folder is not None and path.resolve().parent == Path(folder).resolve()
    write_text(path, render_html(report, folder=folder, images=images, linked=linked))


def link(path: str) -> str:
    """An address for a file beside the page: whatever the name is, it leads nowhere but below the page."""
    parts = [part for part in path.replace("\\", "/").split("/") if part not in ("", ".", "..")]
    return "./" + "/".join(quote(part, safe="") for part in parts)


def _noise(error: Value | None) -> str:
    """An estimated error as people read it: a relative amplitude in per cent."""
    return numbers.quantity(amplitude(error) or error)


def timing_rows(root: TimingNode | None) -> tuple[Row, ...]:
    """The tree as lines; what a node spent outside its children stands as a line of its own."""
    if root is None:
        return ()
    whole = root.seconds or sum(child.seconds for child in root.children) or 1.0
    rows: list[Row] = []

    def visit(node: TimingNode, depth: int) -> None:
        rows.append(Row(node, depth, 100.0 * min(1.0, max(0.0, node.seconds / whole))))
        for child in node.children:
            visit(child, depth + 1)
        rest = node.seconds - sum(child.seconds for child in node.children)
        if node.children and rest > 0.02 * whole:
            rows.append(Row(TimingNode(name="(the rest)", seconds=rest), depth + 1, 100.0 * rest / whole))

    visit(root, 0)
    return tuple(rows)


def _leading(report: Report) -> tuple[str, dict[int, Value]]:
    """The figure that the table of frames shows: relMSE, of the region where there is one."""
    for scope in ("region", "frame"):
        found = {
            f.number: s.value
            for f in report.frames
            for s in f.scores
            if s.metric == "relmse" and s.scope == scope
        }
        if found:
            return f"relMSE ({scope})", found
    return "", {}
