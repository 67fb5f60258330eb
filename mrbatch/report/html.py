"""The report as one self-contained HTML page: no script, nothing fetched, pictures inside.

A person sees pictures first; then what was simulated, what was not, and why; then where the time
went. The page forbids itself every connection by its own content policy.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mrbatch.errors import MrbatchError
from mrbatch.report import numbers
from mrbatch.report.model import Frame, Picture, Report, TimingNode, Value, write_text
from mrbatch.report.pictures import data_uri, draw, read_picture
from mrbatch.report.scores import score_table

MAX_FRAMES_SHOWN = 8
MAX_PICTURE_BYTES = 12_000_000
"""Pictures stop being embedded where the page would grow beyond this (base64 included)."""
ROLE_ORDER = (
    "sheet", "plot", "composite", "reference", "photo", "delta", "difference", "flip", "error", "other",
)  # fmt: skip
ROLE_TITLES = {
    "sheet": "All frames",
    "plot": "Plot",
    "composite": "Composite",
    "reference": "Reference",
    "photo": "Photo",
    "delta": "Light change",
    "difference": "Difference",
    "flip": "FLIP",
    "error": "Error estimate",
    "other": "Picture",
}
COMPARED_TITLES = {"composite": "Test", "error": "Relative error"}
"""Where a report compares pictures with references: nothing is estimated there."""
STATE_MEANING = {
    "absent": "nothing of it exists in this scene",
    "negligible": "bounded under its share of the error budget",
    "needed": "simulated",
    "unresolved": "no bound could be had, so it is simulated",
    "forced-on": "simulated because the job says so",
    "forced-off": "left out because the job says so",
}
SIMULATED = ("needed", "unresolved", "forced-on")


@dataclass(frozen=True)
class Shown:
    """A picture as the page draws it; `uri` is empty where it could not be embedded, `why` says why."""

    title: str
    caption: str
    uri: str
    why: str = ""


@dataclass(frozen=True)
class Group:
    """Pictures that belong together: those of one frame, or those of none."""

    frame: int | None
    pictures: tuple[Shown, ...]


@dataclass(frozen=True)
class Row:
    """A line of the timing tree: depth of indent, share of the whole in per cent."""

    node: TimingNode
    depth: int
    share: float


def render_html(
    report: Report,
    *,
    folder: Path | None = None,
    images: Mapping[str, np.ndarray] | None = None,
    max_frames: int = MAX_FRAMES_SHOWN,
) -> str:
    """The page as text.

    `folder`: where the report's pictures lie; paths that leave it are not followed. `images`: uint8
    RGB pictures (height, width, 3) by the path that the report calls them, used before any file.
    A picture that cannot be read costs its place on the page, never the page.
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("mrbatch.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {
        "number": numbers.number,
        "count": numbers.count,
        "seconds": numbers.seconds,
        "quantity": numbers.quantity,
    }
    effects = sorted(report.plan.effects, key=lambda e: (e.state not in SIMULATED, e.name))
    return environment.get_template("report.html.j2").render(
        report=report,
        groups=_groups(report, folder, images or {}, max_frames),
        frames_with_pictures=len({p.frame for p in report.pictures if p.frame is not None}),
        effects=effects,
        simulated=SIMULATED,
        state_meaning=STATE_MEANING,
        timing=timing_rows(report.timing),
        counters=sorted(report.totals.counters.items()),
        bars={"seconds": bars(report.frames, "seconds"), "error": bars(report.frames, "error")},
        scores=score_table(report),
        timed=any(f.seconds is not None for f in report.frames),
        estimated=any(f.error is not None for f in report.frames),
        outcomes=any(f.outcome not in ("fixed", "none") for f in report.frames),
        leading=_leading(report),
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
    write_text(Path(path), render_html(report, folder=folder, images=images))


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


@dataclass(frozen=True)
class Bar:
    """A bar of a frame chart: position and height in per cent, with the text that a pointer shows."""

    x: float
    width: float
    height: float
    text: str
    failed: bool


def bars(frames: Sequence[Frame], name: str, most: int = 240) -> tuple[Bar, ...]:
    """A chart of `seconds` or `error` over frames; neighbours share a bar (the largest) where too many."""
    if len([f for f in frames if getattr(f, name) is not None]) < 2:
        return ()
    step = -(-len(frames) // most)
    groups = [frames[i : i + step] for i in range(0, len(frames), step)]
    finite = [getattr(f, name).value for f in frames if getattr(f, name) is not None]
    top = max((v for v in finite if np.isfinite(v)), default=0.0) or 1.0
    out = []
    for i, group in enumerate(groups):
        known = [getattr(f, name) for f in group if getattr(f, name) is not None]
        largest = max(known, key=lambda v: v.value, default=None)
        first, last = group[0].number, group[-1].number
        label = f"frame {first}" if first == last else f"frames {first} to {last}"
        text = f"{label}: {numbers.quantity(largest) or 'not measured'}"
        height = 0.0 if largest is None else 100.0 * min(1.0, max(0.0, largest.value / top))
        failed = any(f.state == "failed" for f in group)
        if failed and largest is None:
            height, text = 100.0, f"{label}: failed"
        out.append(Bar(100.0 * i / len(groups), 80.0 / len(groups), height, text, failed))
    return tuple(out)


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


def _groups(
    report: Report, folder: Path | None, images: Mapping[str, np.ndarray], max_frames: int
) -> tuple[Group, ...]:
    numbers_shown = sorted({p.frame for p in report.pictures if p.frame is not None})
    if len(numbers_shown) > max_frames:
        # Evenly spread, first and last among them.
        places = np.linspace(0, len(numbers_shown) - 1, max_frames).round().astype(int)
        numbers_shown = [numbers_shown[i] for i in places]
    groups = []
    left = MAX_PICTURE_BYTES
    for frame in (None, *numbers_shown):
        chosen = sorted((p for p in report.pictures if p.frame == frame), key=_role)
        shown = []
        for picture in chosen:
            title = ROLE_TITLES[picture.role]
            if report.kind == "metrics":
                title = COMPARED_TITLES.get(picture.role, title)
            one = _shown(title, picture, folder, images, left)
            left -= len(one.uri)
            shown.append(one)
        if shown:
            groups.append(Group(frame, tuple(shown)))
    return tuple(groups)


def _role(picture: Picture) -> int:
    return ROLE_ORDER.index(picture.role)


def _shown(
    title: str, picture: Picture, folder: Path | None, images: Mapping[str, np.ndarray], left: int
) -> Shown:
    title += f" ({picture.view})" if picture.view else ""

    def without(why: str) -> Shown:
        return Shown(title, picture.caption, "", f"{picture.path}: {why}")

    if left <= 0:
        return without("left out, the page is full")
    codes = images.get(picture.path)
    if codes is None:
        if folder is None:
            return without("not at hand")
        root = Path(folder).resolve()
        path = (root / picture.path).resolve()
        if not path.is_relative_to(root):
            return without("lies outside the report's folder")
        try:
            codes = draw(read_picture(path, picture.layer), picture.role)
        except MrbatchError as error:
            return without(error.message)
    wide = picture.role in ("sheet", "plot")
    uri = data_uri(codes, width=1440 if wide else 720, max_bytes=900_000 if wide else 300_000)
    return Shown(title, picture.caption, uri) if len(uri) <= left else without("left out, the page is full")
