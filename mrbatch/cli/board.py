"""`mrbatch board`: a target to print."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import click


class PrintedLength(click.ParamType):
    """A length with its unit, in metres: `60 mm`, `2.5cm`."""

    name = "length"

    def convert(self, value, param, ctx):
        if isinstance(value, float):
            return value
        from mrbatch.quantities import LENGTH_UNITS, parse_quantity

        try:
            length = parse_quantity(value, LENGTH_UNITS, "a length")
        except ValueError as error:
            self.fail(str(error), param, ctx)
        if length <= 0.0:
            self.fail(f"`{value}` is not a positive length", param, ctx)
        return length


class Columns(click.ParamType):
    """Columns and rows: `7x5`."""

    name = "squares"

    def convert(self, value, param, ctx):
        if isinstance(value, tuple):
            return value
        match = re.fullmatch(r"(\d{1,3})\s*[x,]\s*(\d{1,3})", str(value).strip())
        if not match:
            self.fail(f"cannot read `{value}`: expected columns x rows, such as 7x5", param, ctx)
        return int(match[1]), int(match[2])


@click.command("board")
@click.option(
    "--type",
    "kind",
    type=click.Choice(["marker", "charuco", "aprilgrid", "grid"]),
    required=True,
    help="One marker; a chessboard with markers (to calibrate with); a grid of AprilTags or markers.",
)
@click.option(
    "--output",
    "outputs",
    multiple=True,
    required=True,
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="A .pdf (to print) or a .png; may be given twice.",
)
@click.option(
    "--size",
    "paper",
    default="A4",
    show_default=True,
    metavar="PAPER",
    help="A5 to A0, letter, legal, tabloid, or 300x200mm.",
)
@click.option("--dictionary", help="Such as DICT_4X4_50 or tag36h11; a default for each type.")
@click.option("--id", "marker_id", type=click.IntRange(min=0), default=0, help="Id of the (first) marker.")
@click.option("--squares", type=Columns(), metavar="CxR", help="Columns and rows of a board.")
@click.option(
    "--square", type=PrintedLength(), help="Side of a chessboard square; of a grid, marker to marker."
)
@click.option("--side", type=PrintedLength(), help="Side of a marker's black square: `60 mm`.")
@click.option("--dpi", type=click.FloatRange(20, 2400), default=300.0, show_default=True, help="Of a PNG.")
def command(kind: str, outputs: tuple[Path, ...], **options: Any) -> None:
    """Make a target to print, true to scale, and print the `target` that a job needs for it.

    Where no size is given the target fills the page. Print at 100 % and measure the line of 100 mm.
    """
    import mrbatch

    sheet = mrbatch.make_board(kind, outputs, **options)  # type: ignore[arg-type]
    for path in outputs:
        click.echo(f"{path}: {sheet.width:g} x {sheet.height:g} mm", err=True)
    click.echo(sheet.yaml, nl=False)
