"""`mrbatch merge-hdr PICTURES...`: an exposure bracket becomes an HDR environment map."""

from __future__ import annotations

import json
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from mrbatch.capture.marker_video.bracket_merge import MergeReport

_FILE = click.Path(path_type=Path)


class Times(click.ParamType):
    """Exposure times in seconds, separated by commas: `1/1000,1/500,0.004`."""

    name = "times"

    def convert(self, value, param, ctx):
        if isinstance(value, tuple):
            return value
        try:
            return tuple(float(Fraction(part.strip())) for part in str(value).split(","))
        except (ValueError, ZeroDivisionError, OverflowError):
            self.fail(f"cannot read `{value}`: expected times such as 1/1000,1/500,2", param, ctx)


@click.command("merge-hdr")
@click.argument("pictures", nargs=-1, required=True, type=_FILE)
@click.option("--output", required=True, type=_FILE, metavar="MAP.exr", help="The map to write.")
@click.option(
    "--times", type=Times(), metavar="T,T,...", help="Seconds of each picture, in order; else EXIF's."
)
@click.option(
    "--method",
    type=click.Choice(["variance", "debevec", "robertson"]),
    default="variance",
    show_default=True,
    help="variance: each sample by its noise, ghosts left out; the others are OpenCV's.",
)
@click.option(
    "--curve",
    type=click.Choice(["auto", "srgb", "bt709", "gamma22", "linear", "recover"]),
    default="auto",
    show_default=True,
    help="From light to codes; auto: sRGB unless tagged linear; recover: the camera's own, from the bracket.",
)
@click.option(
    "--align",
    type=click.Choice(["correct", "refuse", "off"]),
    default="correct",
    show_default=True,
    help="What to do with shots that are shifted.",
)
@click.option("--ghosts/--no-ghosts", default=True, help="Leave out what moved (method variance).")
@click.option(
    "--dtype", "number_type", type=click.Choice(["auto", "half", "float"]), default="auto", show_default=True
)
@click.option("--width", type=click.IntRange(min=1), help="Make the map smaller, by area, in linear light.")
@click.option("--json", "json_file", type=_FILE, help="Write the account of all shots as JSON.")
def command(pictures: tuple[Path, ...], json_file: Path | None, **options: Any) -> None:
    """Merge an exposure bracket, 8-bit JPEG or PNG or 16-bit PNG or TIFF, into a linear EXR map.

    Exposures are measured in the pictures and checked against their times. Shots may come in any order.
    """
    import mrbatch

    report = mrbatch.merge_hdr(pictures, **options)
    if json_file:
        json_file.write_text(json.dumps(report.as_dict(), indent=2) + "\n", encoding="utf-8")
    _show(report)


def _show(report: MergeReport) -> None:
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    table = Table()
    table.add_column("shot", no_wrap=True)
    unit = "" if report.relative else " (s)"
    for column in ("time (s)", f"used{unit}", "off (stops)", "moved (px)", "clipped (%)", "left out (%)"):
        table.add_column(column, justify="right")
    for s in report.shots:
        table.add_row(
            escape(s.file),
            "-" if s.tagged is None else f"{s.tagged:.4g}",
            f"{s.seconds:.4g}",
            "-" if s.stops_off is None else f"{s.stops_off:+.2f}",
            "-" if s.shift == (0.0, 0.0) else f"{s.shift[0]:+.1f}, {s.shift[1]:+.1f}",
            f"{100 * s.clipped:.2g}",
            f"{100 * s.left_out:.2g}",
        )
    console = Console()
    console.print(table)
    for text in report.warnings:
        console.print(f"[yellow]warning[/] {escape(text)}", highlight=False)
    for text in report.notes:
        console.print(f"[dim]note[/] {escape(text)}", highlight=False)
    console.print(
        f"{escape(report.output)}: {report.width}x{report.height} {report.number_type}, "
        f"mean {report.mean:.4g}, peak {report.peak:.4g}",
        highlight=False,
    )
