"""`mrbatch metrics`: pictures against references."""

from __future__ import annotations

from pathlib import Path

import click

from mrbatch.cli.report_files import report_options, write_reports

_FILE = click.Path(path_type=Path)
_GATES = {
    "max_relmse": "relmse",
    "max_rmse": "rmse",
    "min_psnr": "psnr",
    "min_ssim": "ssim",
    "max_flip": "flip_hdr",
    "max_flip_ldr": "flip_ldr",
}


class Floats(click.ParamType):
    """Numbers separated by commas."""

    name = "numbers"

    def __init__(self, *counts: int):
        self.counts = counts

    def convert(self, value, param, ctx):
        if isinstance(value, tuple):
            return value
        try:
            found = tuple(float(part) for part in str(value).split(","))
        except ValueError:
            self.fail(f"cannot read `{value}`: expected numbers separated by commas", param, ctx)
        if len(found) not in self.counts or not all(abs(f) < float("inf") for f in found):
            wanted = " or ".join(str(c) for c in self.counts)
            self.fail(f"expected {wanted} finite numbers separated by commas, got `{value}`", param, ctx)
        return found


@click.command("metrics")
@click.argument("test", type=_FILE)
@click.argument("reference", type=_FILE)
@click.option("--without", type=_FILE, help="Reference without the virtual objects (file or folder).")
@click.option(
    "--roi",
    metavar="auto|noisy|FILE",
    help="Region of interest: where the references with and without objects differ (`noisy`: with "
    "noise of their own), or a mask picture. `auto` where --without is given.",
)
@click.option(
    "--gain",
    type=Floats(1, 3),
    default="1",
    help="photo = gain x radiance; one number or three.",
    show_default=True,
)
@click.option(
    "--projection",
    type=click.Choice(["perspective", "equirectangular"]),
    default="perspective",
    show_default=True,
    help="360-degree pictures are weighted by solid angle.",
)
@click.option("--layer", default="", help="Layer of EXR files, such as `delta`; by default R, G, B.")
@click.option(
    "--exposures",
    type=Floats(3),
    help="HDR-FLIP's START,STOP,COUNT in stops; by default taken from each reference.",
)
@click.option("--flip/--no-flip", default=True, help="Compute FLIP (slower than all others together).")
@click.option("--all", "every", is_flag=True, help="Folders: an error where one lacks a picture of another.")
@report_options("gate", page="Write one page with pictures and error maps.")
@click.option("--max-relmse", type=float, help="Gate: exit code 1 where relMSE is larger.")
@click.option("--max-rmse", type=float, help="Gate on RMSE, linear.")
@click.option("--min-psnr", type=float, help="Gate on PSNR, dB.")
@click.option("--min-ssim", type=float, help="Gate on SSIM.")
@click.option("--max-flip", type=float, help="Gate on HDR-FLIP.")
@click.option("--max-flip-ldr", type=float, help="Gate on LDR-FLIP.")
@click.option(
    "--on",
    "gate_scope",
    type=click.Choice(["auto", "frame", "region", "tile"]),
    default="auto",
    help="What gates judge; auto: the region of interest where there is one, else the frame.",
)
@click.pass_context
def command(
    ctx,
    test,
    reference,
    without,
    roi,
    gain,
    projection,
    layer,
    exposures,
    flip,
    every,
    gate_scope,
    json_file,
    junit,
    html,
    markdown,
    **gates,
):
    """Compare TEST with REFERENCE: two pictures (EXR, PNG, ...), or the pictures of two folders that
    have the same names (EXR files where both hold some; previews never).

    relMSE, RMSE, PSNR, SSIM and FLIP of the whole frame, of the region of interest and of the worst
    16x16 tile. Gates judge the worst frame.
    """
    from mrbatch.metrics.errors import Exposures
    from mrbatch.report.comparison import CompareSettings, compare
    from mrbatch.report.pairs import find_pairs

    if roi is None and without is not None:
        roi = "auto"
    settings = CompareSettings(
        layer=layer,
        gain=gain[0] if len(gain) == 1 else gain,
        projection=projection,
        region=roi if roi in ("auto", "noisy", None) else Path(roi),
        flip=flip,
        exposures=Exposures(exposures[0], exposures[1], int(exposures[2])) if exposures else None,
        gates={metric: gates[key] for key, metric in _GATES.items() if gates[key] is not None},
        gate_scope=gate_scope,
        pictures=html is not None,
    )
    report, images = compare(find_pairs(test, reference, without, every=every), settings)
    print_scores(report)
    write_reports(report, json_file=json_file, junit=junit, html=html, markdown=markdown, images=images)
    ctx.exit(report.exit)


def print_scores(report) -> None:
    """The figures, gates, notes and failed frames."""
    from rich.box import SIMPLE
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    from mrbatch.report.numbers import quantity
    from mrbatch.report.scores import score_table

    scores = score_table(report)
    many = f", mean of {scores.frames} frames" if scores.frames > 1 else ""
    table = Table(title=f"{escape(report.job.name)}{many}", title_justify="left", box=SIMPLE)
    table.add_column("")
    for column in scores.columns:
        table.add_column(column, justify="right", no_wrap=True)
    for title, cells in scores.rows:
        table.add_row(title, *(cell.replace(" (worst", "\n(worst") for cell in cells))
    console = Console()
    console.print(table)
    for gate in report.gates:
        mark = "[green]passed[/]" if gate.passed else "[red]failed[/]"
        where = f" (frame {gate.frame})" if gate.frame is not None else ""
        console.print(f"{mark} {escape(gate.text)}: {quantity(gate.measured)}{where}", highlight=False)
    for note in report.notes:
        where = f"frame {note.frame}: " if note.frame is not None else ""
        console.print(f"[yellow]{note.level}[/] {where}{escape(note.text)}", highlight=False)
    for frame in report.frames:
        if frame.state == "failed":
            console.print(f"[red]failed[/] frame {frame.number}: {escape(frame.message)}", highlight=False)
