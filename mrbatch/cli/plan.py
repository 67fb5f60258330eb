"""`mrbatch plan JOB`: which effects a job calls for, and why."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from mrbatch.cli.job_options import job_options, load

COLOURS = {
    "absent": "dim",
    "negligible": "dim",
    "needed": "green",
    "unresolved": "yellow",
    "forced-on": "cyan",
    "forced-off": "magenta",
}


@click.command("plan")
@click.argument("job", metavar="JOB", type=click.Path(path_type=Path))
@job_options
@click.option("--json", "as_json", is_flag=True, help="Print the plan as JSON.")
def command(job: Path, as_json: bool, **options: Any) -> None:
    """Say which effects a job's frames call for, and why; and which tiles of each frame are done.

    Nothing is rendered and nothing written.
    """
    settled = load(job, **options)
    from mrbatch.batch.job_run import plan_job
    from mrbatch.job import select_frames

    prepared = plan_job(settled)
    shot = prepared.shot
    chosen = set(select_frames(settled.frames, shot.frames, place=settled.place("frames")))
    data = shot.plan.as_dict()
    data["frames"] = [f for f in data["frames"] if f["frame"] in chosen]
    if as_json:
        click.echo(json.dumps(data, indent=2))
        return
    from rich.console import Console
    from rich.table import Table

    console = Console()
    table = Table(title=f"effects of {settled.name} ({settled.method_name})", title_justify="left")
    for head in ("effect", "state", "why"):
        table.add_column(head, overflow="fold")
    for name, effect in data["effects"].items():
        table.add_row(name, f"[{COLOURS[effect['state']]}]{effect['state']}[/]", effect["why"])
    console.print(table)
    total = {name: w.domain().units for name, w in prepared.windows.items()}
    table = Table(title="influence", title_justify="left")
    for head in ("frame", "tiles done", "why"):
        table.add_column(head, overflow="fold")
    for frame in data["frames"][:40]:
        label = f"{frame['frame']} {frame['view']}".strip()
        table.add_row(label, f"{frame['tiles']} of {total[frame['view']]}", frame["why"])
    if len(data["frames"]) > 40:
        table.add_row("...", "", f"{len(data['frames']) - 40} more frames: --json shows all")
    console.print(table)
