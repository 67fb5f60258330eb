"""`mrbatch plan JOB`: which effects a job calls for, and why."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from mrbatch.cli.job_options import job_options, load

if TYPE_CHECKING:
    from rich.table import Table

    from mrbatch.batch.prepare import Prepared
    from mrbatch.effects.plan import Plan

COLOURS = {
    "absent": "dim",
    "negligible": "dim",
    "needed": "green",
    "unresolved": "yellow",
    "forced-on": "cyan",
    "forced-off": "magenta",
}


MOST = 10
"""Frames of which each gets a row; of more there is a summary."""


@click.command("plan")
@click.argument("job", metavar="JOB", type=click.Path(path_type=Path))
@job_options
@click.option("--json", "as_json", is_flag=True, help="Print the plan as JSON, with the tiles of each frame.")
@click.option("--verbose", is_flag=True, help=f"A row for each frame, also where they are more than {MOST}.")
@click.option(
    "--mask",
    metavar="FILE.png",
    type=click.Path(path_type=Path),
    help="Draw which tiles of the first frame are traced.",
)
def command(job: Path, as_json: bool, verbose: bool, mask: Path | None, **options: Any) -> None:
    """Say which effects a job's frames call for, and why; and which tiles of each frame are traced.

    Nothing is rendered, and nothing written but the picture that --mask names. JSON: `frames` holds the
    `ids` of the tiles traced, `grid` by view where they lie: id = row * columns + column, tile (0, 0) of
    `size` pixels from pixel `first`.
    """
    if mask is not None and mask.suffix.lower() != ".png":
        raise click.BadParameter("the file must end in .png", param_hint="--mask")
    settled = load(job, **options)
    from mrbatch.batch import events as tell
    from mrbatch.batch.job_run import plan_job
    from mrbatch.batch.progress import progress
    from mrbatch.job import select_frames

    with progress("plain") as events:
        prepared = plan_job(
            settled,
            progress=lambda step, done, total, detail="": events(tell.Preparing(step, done, total, detail)),
        )
    chosen = select_frames(settled.frames, prepared.shot.frames, place=settled.place("frames"))
    if mask is not None:
        _draw(prepared, chosen[0], mask)
    if as_json:
        click.echo(json.dumps(_as_json(prepared, chosen), indent=2))
        return
    _show(prepared, chosen, verbose)


def _as_json(prepared: Prepared, chosen: Sequence[int]) -> dict[str, Any]:
    plan = prepared.shot.plan
    data = plan.as_dict()
    data["frames"] = [
        frame | {"ids": plan.tiles[frame["frame"], frame["view"]].tolist()}
        for frame in data["frames"]
        if frame["frame"] in set(chosen)
    ]
    data["grid"] = {}
    for name, window in prepared.windows.items():
        x0, y0, x1, _ = window.tile_rectangles()[0].tolist()
        columns, rows = window.tiles
        data["grid"][name] = {"first": [x0, y0], "size": x1 - x0, "columns": columns, "rows": rows}
    return data


def _draw(prepared: Prepared, number: int, path: Path) -> None:
    from mrbatch.batch.mask_picture import mask_picture
    from mrbatch.film.preview import write_picture

    write_picture(path, mask_picture(prepared, number))
    click.echo(f"frame {number}: the tiles that are traced stand out in {path}", err=True)


def _show(prepared: Prepared, chosen: Sequence[int], verbose: bool) -> None:
    from rich.console import Console
    from rich.table import Table

    console, job, plan = Console(), prepared.job, prepared.shot.plan
    table = Table(title=f"effects of {job.name} ({job.method_name})", title_justify="left")
    for head in ("effect", "state", "why"):
        table.add_column(head, overflow="fold")
    for name, effect in plan.effects.items():
        table.add_row(name, f"[{COLOURS[effect.state]}]{effect.state}[/]", effect.why)
    console.print(table)
    total = {name: window.domain().units for name, window in prepared.windows.items()}
    if len(chosen) > 1:
        console.print(_summary(plan, set(chosen), total))
    if not verbose and len(chosen) > MOST:
        hint = f"{len(chosen)} frames; --verbose or --frames shows each, --mask FILE.png draws one"
        console.print(hint, style="dim", highlight=False)
        return
    table = Table(title="influence", title_justify="left")
    for head in ("frame", "tiles to trace", "why"):
        table.add_column(head, overflow="fold")
    for (number, view), ids in plan.tiles.items():
        if number in set(chosen):
            count = f"{len(ids)} of {total[view]}"
            table.add_row(f"{number} {view}".strip(), count, plan.influence[number, view])
    console.print(table)


def _summary(plan: Plan, chosen: set[int], total: Mapping[str, int]) -> Table:
    """Fewest, median and most tiles over the frames, for each view."""
    from statistics import median

    from rich.table import Table

    table = Table(title="tiles to trace, over all frames asked for", title_justify="left")
    for head in (*(["view"] if len(total) > 1 else []), "fewest", "median", "most", "of"):
        table.add_column(head)
    for view, units in total.items():
        counts = {
            number: len(ids) for (number, of), ids in plan.tiles.items() if of == view and number in chosen
        }
        if not counts:
            continue
        least, most = min(counts, key=counts.__getitem__), max(counts, key=counts.__getitem__)
        cells = [
            f"{counts[least]} (frame {least})",
            f"{median(counts.values()):g}",
            f"{counts[most]} (frame {most})",
            f"{units}",
        ]
        table.add_row(*([view] if len(total) > 1 else []), *cells)
    return table
