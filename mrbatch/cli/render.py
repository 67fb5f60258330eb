"""`mrbatch render JOB`: renders the frames that are not there yet."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from mrbatch.cli.job_options import job_options, load


@click.command("render")
@click.argument("job", metavar="JOB", type=click.Path(path_type=Path))
@job_options
@click.option("--threads", metavar="N", type=click.IntRange(1), help="Threads; default: all cores.")
@click.option("--overwrite", is_flag=True, help="Take a folder that holds another job's frames.")
@click.option(
    "--progress",
    "mode",
    type=click.Choice(["auto", "bar", "plain", "json", "none"]),
    default="auto",
    help="How progress is shown.",
)
@click.option("--no-report", is_flag=True, help="Write no report and no previews.")
def command(
    job: Path, threads: int | None, overwrite: bool, mode: Any, no_report: bool, **options: Any
) -> int:
    """Render a job: EXR frames, previews and a report in the output folder.

    Frames that are there already are kept. Exit code 0: done; 2: wrong job; 3: wrong input; 4: some
    frames failed, the others are there; 5: out of disk, memory or rights; 130: interrupted.
    """
    import threading

    from mrbatch.batch.interrupt import interrupts
    from mrbatch.batch.progress import progress

    settled = load(job, **options)
    stop = threading.Event()
    with interrupts.caught(stop), progress(mode) as events:
        from mrbatch.batch import events as tell
        from mrbatch.batch.job_run import PAGE, render_job

        events(tell.Note("reading the capture"))
        outcome = render_job(
            settled, threads=threads, overwrite=overwrite, events=events, stop=stop, report=not no_report
        )
    if outcome.result.error is not None:
        raise outcome.result.error
    if mode != "json" and mode != "none":
        n = len(outcome.result.rendered) + len(outcome.result.kept)
        click.echo(f"{n} of {len(outcome.report.frames)} frames in {outcome.directory}", err=True)
        for broken in outcome.result.failed:
            click.echo(f"error: {broken.error}", err=True)
        if not no_report:
            click.echo(f"report: {outcome.directory / PAGE}", err=True)
    return outcome.exit_code
