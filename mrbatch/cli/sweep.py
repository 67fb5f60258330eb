"""`mrbatch sweep`: what accuracy costs."""

from __future__ import annotations

from pathlib import Path

import click

_FILE = click.Path(path_type=Path)


@click.command("sweep")
@click.argument("job", type=_FILE)
@click.option(
    "--axis",
    "axes",
    multiple=True,
    metavar="NAME[=A,B,..]",
    help="A setting to vary and its values: `method.spp=4,16,64`; or the name of an axis. Default: all.",
)
@click.option(
    "--grid",
    multiple=True,
    metavar="NAME[=A,B,..]",
    help="Twice: two axes in all combinations, beside these.",
)
@click.option("--set", "settings", multiple=True, metavar="KEY=VALUE", help="As in `mrbatch render`.")
@click.option("--confine", metavar="DIR", type=_FILE, help="Refuse paths that lead out of DIR.")
@click.option("--frame", type=int, help="Default: the job's first.")
@click.option(
    "--threads", default=1, show_default=True, type=click.IntRange(1), help="Of the job's own settings."
)
@click.option(
    "--repeats",
    type=click.IntRange(3),
    help="Turns of each axis. Default: as many as the claims and the noise of this machine ask for.",
)
@click.option("--truth", type=_FILE, help="Picture of the frame as it should be; default: rendered in full.")
@click.option("--truth-deviation", type=_FILE, help="Picture of the truth's standard deviation.")
@click.option(
    "--reference-spp",
    type=click.IntRange(8),
    help="Samples a pixel of a rendered truth. Default: 64 times the job's, 1024 to 16384.",
)
@click.option(
    "--target-error",
    type=click.FloatRange(0, min_open=True),
    help="relMSE of the region of interest that times are told for. Default: the job's own settings'.",
)
@click.option("--json", "json_file", type=_FILE, help="Write all that was measured as a report.json.")
@click.option("--csv", "csv_file", type=_FILE, help="Write a line for each value measured.")
@click.option("--junit", type=_FILE, help="Write JUnit XML, a test case a check.")
@click.option("--html", type=_FILE, help="Write one page.")
@click.option("--markdown", type=_FILE, help="Write the price list as Markdown.")
@click.pass_context
def command(
    ctx,
    job,
    axes,
    grid,
    settings,
    confine,
    frame,
    threads,
    repeats,
    truth,
    truth_deviation,
    reference_spp,
    target_error,
    json_file,
    csv_file,
    junit,
    html,
    markdown,
):
    """Say what accuracy costs: renders a frame of JOB over and over, in its own and in other settings.

    One setting at a time is changed from what the job has. What is claimed holds for a second sweep, too.
    """
    from mrbatch.bench.sweep import SweepRequest, sweep
    from mrbatch.report.junit import write_junit
    from mrbatch.report.model import save_report
    from mrbatch.report.sweep_markdown import write_price_list
    from mrbatch.report.sweep_page import write_sweep_html
    from mrbatch.report.sweep_table import print_sweep, write_csv

    request = SweepRequest(
        settings=settings,
        axes=axes,
        grid=grid,
        frame=frame,
        threads=threads,
        repeats=repeats,
        truth=truth,
        deviation=truth_deviation,
        reference_spp=reference_spp,
        target=target_error,
        pictures=html is not None,
        confine=confine,
    )
    report, images = sweep(job, request, said=_told())
    print_sweep(report)
    written = (
        (json_file, save_report),
        (csv_file, write_csv),
        (junit, write_junit),
        (markdown, write_price_list),
    )
    for path, write in written:
        if path:
            write(report, path)
    if html:
        write_sweep_html(report, html, images)
    ctx.exit(report.exit)


def _told():
    """Steps on standard error; turns are counted on one line where that is a terminal, and else not told."""
    import sys

    live = sys.stderr.isatty()

    def told(text: str) -> None:
        if ": turn " not in text:
            click.echo(f"{text} ...", err=True)
        elif live:
            whole, _, of = text.rpartition(" of ")
            click.echo(f"\x1b[2K{text}\r", nl=whole.endswith(f" {of}"), err=True)

    return told
