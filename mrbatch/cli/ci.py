"""`mrbatch ci`: whether jobs still render what they did."""

from __future__ import annotations

from pathlib import Path

import click

_FILE = click.Path(path_type=Path)


@click.command("ci")
@click.argument("jobs", metavar="JOB...", type=_FILE, nargs=-1, required=True)
@click.option("--update", is_flag=True, help="Write the baselines anew, and tell what has changed.")
@click.option(
    "--store",
    metavar="DIR",
    type=click.Path(path_type=Path, file_okay=False),
    help="Folder of the baselines; default: beside each job, `JOB.ci.json`.",
)
@click.option("--set", "settings", metavar="KEY=VALUE", multiple=True, help="Change a value of all jobs.")
@click.option("--seed", type=click.IntRange(0, 2**32 - 1), help="First seed, in place of the baseline's.")
@click.option("--threads", metavar="N", type=click.IntRange(1), help="Threads; default: all cores.")
@click.option("--json", "json_file", type=_FILE, help="Write all figures as a report.json.")
@click.option("--junit", type=_FILE, help="Write JUnit XML, a test case a gate.")
@click.option("--html", type=_FILE, help="Write one page.")
@click.option("--markdown", type=_FILE, help="Write Markdown.")
@click.pass_context
def command(ctx, jobs, update, store, settings, seed, threads, json_file, junit, html, markdown):
    """Render each JOB's first, middle and last frame, tiny, under 16 seeds, and judge by its baseline.

    Exact: all numbers are finite, the plan calls for the same effects, the work is the same. By statistics:
    means of layers and of 16x16 tiles. A baseline is a small file to keep under version control; `--update`
    makes it, or makes it anew where a change was meant. Exit code 1 where something changed.
    """
    from mrbatch.bench.regression import check_jobs, failures
    from mrbatch.report.html import write_html
    from mrbatch.report.junit import write_junit
    from mrbatch.report.markdown import write_markdown
    from mrbatch.report.model import save_report

    report, pictures = check_jobs(
        jobs,
        store=store,
        update=update,
        settings=settings,
        seed=seed,
        threads=threads,
        told=lambda text: click.echo(text, err=True),
    )
    for path, write in ((json_file, save_report), (junit, write_junit), (markdown, write_markdown)):
        if path:
            write(report, path)
    if html:
        write_html(report, html, images=pictures)
    for note in report.notes:
        click.echo(note.text if note.frame is None else f"{note.text} (frame {note.frame})")
    for text in failures(report):
        click.echo(f"failed: {text}")
    passed = sum(gate.passed for gate in report.gates)
    click.echo(f"{passed} of {len(report.gates)} gates passed")
    ctx.exit(report.exit)
