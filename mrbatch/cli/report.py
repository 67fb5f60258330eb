"""`mrbatch report`: draw a job's report again."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from mrbatch.report.model import Report

_FILE = click.Path(path_type=Path)


@click.command("report")
@click.argument("source", type=_FILE)
@click.option("--html", type=_FILE, help="Write the page; beside report.json where nothing is asked for.")
@click.option("--markdown", type=_FILE, help="Write Markdown.")
@click.option("--junit", type=_FILE, help="Write JUnit XML: gates and frames as test cases.")
def command(source, html, markdown, junit):
    """Draw pages from SOURCE, a job's output folder or a report.json. Nothing is measured again.

    Of a folder the report holds every frame that is there, whichever run rendered it.
    """
    from rich.console import Console
    from rich.markup import escape

    from mrbatch.report.html import write_html
    from mrbatch.report.junit import write_junit
    from mrbatch.report.markdown import write_markdown

    report = _report(source)
    folder = source if source.is_dir() else source.parent
    if not (html or markdown or junit):
        html = folder / "report.html"
    console = Console()
    if html:
        write_html(report, html, folder=folder)
    if markdown:
        write_markdown(report, markdown)
    if junit:
        write_junit(report, junit)
    for path in filter(None, (html, markdown, junit)):
        console.print(f"wrote {escape(str(path))}", highlight=False, soft_wrap=True)


def _report(source: Path) -> Report:
    """From the journal, where SOURCE is a folder that a job holds (and `report.json` is brought up to date);
    else from the file. Raises InputError."""
    from mrbatch.batch.job_report import report_of
    from mrbatch.report.model import load_report, save_report

    made = report_of(source) if source.is_dir() else None
    if made is None:
        return load_report(source)
    save_report(made, source / "report.json")
    return made
