"""`mrbatch render JOB`: renders the frames that are not there yet."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from mrbatch.cli.job_options import job_options, load
from mrbatch.errors import EXIT_INTERNAL, EXIT_INTERRUPTED, EXIT_RESOURCES, MrbatchError

if TYPE_CHECKING:
    from mrbatch.batch.request import RunResult

SHOWN = 10
"""Failed frames that are named on the screen; the report has all."""


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
@click.option(
    "--replay",
    metavar="DIR",
    type=click.Path(path_type=Path, exists=True, file_okay=False),
    help="Frames of this job that a time limit ended: the same samples, the same bits.",
)
@click.option("--no-report", is_flag=True, help="Write no report and no previews.")
def command(
    job: Path,
    threads: int | None,
    overwrite: bool,
    mode: Any,
    replay: Path | None,
    no_report: bool,
    **options: Any,
) -> int:
    """Render a job: EXR frames, previews and a report in the output folder.

    Frames that are there already are kept. Exit code 0: done; 1: a target error was missed; 2: wrong job;
    3: wrong input; 4: some frames failed, the others are there; 5: out of disk, memory or rights; 130:
    interrupted.
    """
    import threading
    import time

    from mrbatch.batch.interrupt import interrupts
    from mrbatch.batch.progress import progress

    began = time.perf_counter()
    stop = threading.Event()
    with interrupts.caught(stop), progress(mode) as events:
        from mrbatch.batch import events as tell

        try:
            settled = load(job, **options)
            events(tell.Note("reading the capture"))
            from mrbatch.batch.job_run import PAGE, render_job

            outcome = render_job(
                settled,
                threads=threads,
                overwrite=overwrite,
                events=events,
                stop=stop,
                report=not no_report,
                began=began,
                replay=replay,
            )
        except BaseException as error:
            events(tell.Failed(str(error) or type(error).__name__, _code(error)))
            raise
    result = outcome.result
    if mode not in ("json", "none"):
        _conclude(result, outcome.directory, None if no_report else outcome.directory / PAGE)
    if result.error is not None:
        raise result.error
    return outcome.exit_code


def _code(error: BaseException) -> int:
    """What the command will end with (`mrbatch.cli.show_error`)."""
    if isinstance(error, MrbatchError):
        return error.exit_code
    if isinstance(error, (KeyboardInterrupt, click.Abort)):
        return EXIT_INTERRUPTED
    return EXIT_RESOURCES if isinstance(error, MemoryError) else EXIT_INTERNAL


def _conclude(result: RunResult, directory: Path, page: Path | None) -> None:
    """What a person looks for last: how many frames are where, what failed, where the report is."""
    there = len(result.rendered) + len(result.kept)
    asked = there + len(result.failed) + len(result.undone)
    if result.interrupted:
        words = f"interrupted: the same command goes on; {there} of {asked} frames are there"
        click.echo(words, err=True)
        return
    click.echo(f"{there} of {asked} {'frame' if asked == 1 else 'frames'} in {directory}", err=True)
    for broken in result.failed[:SHOWN]:
        click.echo(f"error: {broken.error}", err=True)
    if len(result.failed) > SHOWN:
        click.echo(f"and {len(result.failed) - SHOWN} more frames that failed", err=True)
    if page is not None and page.is_file():
        click.echo(f"report: {page}", err=True)
