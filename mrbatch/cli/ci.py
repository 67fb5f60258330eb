"""`mrbatch ci`: whether jobs still render what they did."""

from __future__ import annotations

from pathlib import Path

import click

from mrbatch.cli.report_files import report_options, write_reports

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
@report_options("gate")
@click.pass_context
def command(ctx, jobs, update, store, settings, seed, threads, **files):
    """Render each JOB's first, middle and last frame, tiny, under 16 seeds, and judge by its baseline.

    Exact: all numbers are finite, the plan calls for the same effects, the work is the same. By statistics:
    means of layers and of 16x16 tiles. A baseline is a small file to keep under version control; `--update`
    makes it, or makes it anew where a change was meant. Exit code 1 where something changed.
    """
    from mrbatch.bench.regression import check_jobs, failures

    report, pictures = check_jobs(
        jobs,
        store=store,
        update=update,
        settings=settings,
        seed=seed,
        threads=threads,
        told=lambda text: click.echo(text, err=True),
    )
    write_reports(report, images=pictures, **files)
    for note in report.notes:
        click.echo(note.text if note.frame is None else f"{note.text} (frame {note.frame})")
    for text in failures(report):
        click.echo(f"failed: {text}")
    passed = sum(gate.passed for gate in report.gates)
    click.echo(f"{passed} of {len(report.gates)} gates passed")
    ctx.exit(report.exit)
