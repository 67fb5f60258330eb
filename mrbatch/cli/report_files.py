"""The files that commands which judge write beside what they print, and the options that ask for them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    import numpy as np

    from mrbatch.report.model import Report

_FILE = click.Path(path_type=Path)
_Command = Callable[..., Any]


def report_options(judged: str, page: str = "Write one page.") -> Callable[[_Command], _Command]:
    """Adds `--json`, `--junit`, `--html` and `--markdown` to a command, which hands them to `write_reports`;
    `judged`: what a test case of JUnit is; `page`: what help says of the page."""
    options = (
        click.option("--json", "json_file", type=_FILE, help="Write all figures as a report.json."),
        click.option("--junit", type=_FILE, help=f"Write JUnit XML, a test case a {judged}."),
        click.option("--html", type=_FILE, help=page),
        click.option("--markdown", type=_FILE, help="Write Markdown."),
    )

    def add(function: _Command) -> _Command:
        for option in reversed(options):
            function = option(function)
        return function

    return add


def write_reports(
    report: Report,
    *,
    json_file: Path | None,
    junit: Path | None,
    html: Path | None,
    markdown: Path | None,
    images: Mapping[str, np.ndarray] | None = None,
) -> None:
    """Writes those that were asked for; `images`: the page's pictures by the report's names."""
    from mrbatch.report.html import write_html
    from mrbatch.report.junit import write_junit
    from mrbatch.report.markdown import write_markdown
    from mrbatch.report.model import save_report

    for path, write in ((json_file, save_report), (junit, write_junit), (markdown, write_markdown)):
        if path:
            write(report, path)
    if html:
        write_html(report, html, images=images)
