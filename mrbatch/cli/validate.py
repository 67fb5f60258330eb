"""`mrbatch validate JOB...`: checks job files, shows all errors at once."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from mrbatch.errors import JobErrors, MrbatchError

if TYPE_CHECKING:
    from mrbatch.job import Job


@click.command("validate")
@click.argument("jobs", metavar="JOB...", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--set", "overrides", metavar="KEY=VALUE", multiple=True, help="Change a value: `seed=3`.")
@click.option(
    "--confine", metavar="DIR", type=click.Path(path_type=Path), help="Refuse paths that lead out of DIR."
)
@click.option("--no-files", is_flag=True, help="Do not look whether the files are there.")
@click.option("--resolved", is_flag=True, help="Print the job with all defaults, as JSON.")
def command(
    jobs: Sequence[Path], overrides: Sequence[str], confine: Path | None, no_files: bool, resolved: bool
) -> None:
    """Check job files: keys, numbers, units, names, and that the files they read are there.

    Exit code 0: all are right; 2: some are not, and every error was shown with its place.
    """
    from mrbatch.job import check_files, load_job
    from mrbatch.job import resolved as resolve

    errors: list[MrbatchError] = []
    for path in jobs:
        try:
            job = load_job(path, overrides, confine=confine, files=not no_files)
            if not no_files:
                check_files(job)
        except JobErrors as several:
            errors.extend(several.errors)
            continue
        if resolved:
            click.echo(json.dumps(resolve(job), indent=2, ensure_ascii=False))
        else:
            _summary(job, path)
    if errors:
        raise JobErrors(errors)


_NUMBER_TYPES = {
    "auto": "half or float, decided when the footage has been looked at (`dtype: auto`)",
    "half": "half",
    "float": "float",
}


def _summary(job: Job, path: Path) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table.grid(padding=(0, 2))
    counts = {"virtual": len(job.virtual), "real": len(job.real), "participants": len(job.participants)}
    rows = {
        "name": job.name,
        "capture": job.capture_kind,
        "environment": job.environment.file.name if job.environment else "none",
        "objects": ", ".join(f"{count} {name}" for name, count in counts.items() if count) or "none",
        "method": job.method_name,
        "output": str(job.output.directory),
        "layers": ", ".join(dict.fromkeys(("composite", *(job.output.layers or ())))),
        "colour": _NUMBER_TYPES[job.output.dtype],
        "frames": job.frames,
    }
    for name, value in rows.items():
        table.add_row(Text(f"  {name}", style="dim"), Text(value))
    console = Console(soft_wrap=True)
    console.print(Text.assemble(("OK", "bold green"), f" {path}"))
    console.print(table)
