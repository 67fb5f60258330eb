"""The report as Markdown, for a pull request or a terminal."""

from __future__ import annotations

from pathlib import Path

from mrbatch.report import numbers
from mrbatch.report.html import SIMULATED, timing_rows
from mrbatch.report.model import Report, write_text
from mrbatch.report.quality import amplitude, quality_of
from mrbatch.report.scores import score_table
from mrbatch.report.template import template

MAX_FRAMES = 200


def render_markdown(report: Report) -> str:
    """The text. Whatever came from outside is escaped: it can neither add markup nor break a table."""
    filters = {
        "md": escape,
        "number": numbers.number,
        "count": numbers.count,
        "seconds": numbers.seconds,
        "quantity": lambda value: escape(numbers.quantity(value)),
        "noise": lambda error: escape(numbers.quantity(amplitude(error) or error)),
        "short": numbers.short_hash,
    }
    text = template("report.md.j2", filters, autoescape=False).render(
        report=report,
        effects=sorted(report.plan.effects, key=lambda e: (e.state not in SIMULATED, e.name)),
        timing=timing_rows(report.timing),
        max_frames=MAX_FRAMES,
        quality=quality_of(report),
        scores=score_table(report),
    )
    return text.rstrip() + "\n"


def write_markdown(report: Report, path: Path) -> None:
    """Write the text in one step. Raises ResourceError where it cannot be written."""
    write_text(Path(path), render_markdown(report))


def escape(text: object) -> str:
    """One line of plain text inside Markdown: markup characters lose their meaning."""
    line = "".join(c if c.isprintable() else " " for c in str(text))
    line = " ".join(line.split())
    line = line.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
    for character in "\\`*_{}[]|#!~":
        line = line.replace(character, "\\" + character)
    # A colon that is no link's: renderers make links of bare addresses.
    return line.replace("://", ":&#8203;//")
