"""`mrbatch calibrate FILES...`: a camera's intrinsics from pictures or a video of a board."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from mrbatch.capture.marker_video.calibrate import CalibrationReport

_FILE = click.Path(path_type=Path)


@click.command("calibrate")
@click.argument("files", nargs=-1, required=True, type=_FILE)
@click.option(
    "--board",
    required=True,
    metavar="FILE|YAML",
    help="What `mrbatch board` printed, as a file; or `{type: charuco, squares: [7, 5], ...}`.",
)
@click.option(
    "--output", required=True, type=_FILE, metavar="FILE.yaml", help="The calibration file to write."
)
@click.option("--report", "picture", type=_FILE, metavar="FILE.png", help="A picture of the residuals.")
@click.option(
    "--distortion",
    type=click.Choice(["auto", "0", "2", "4", "5", "8"]),
    default="auto",
    show_default=True,
    help="How many coefficients; auto: as many as the views call for, 5 at most.",
)
@click.option(
    "--max-views", type=click.IntRange(3, 400), default=40, show_default=True, help="The most different ones."
)
@click.option("--json", "json_file", type=_FILE, help="Write everything that was found as JSON.")
def command(files: tuple[Path, ...], distortion: str, json_file: Path | None, **options: Any) -> None:
    """Calibrate a camera from pictures of a board, or from one video of it.

    Film as for the job: same size, zoom and focus. Move the board, or the camera, so that the board comes
    into every corner of the picture and is tilted to all sides.
    """
    from rich.console import Console
    from rich.progress import Progress

    import mrbatch

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("looking for the board", total=None)
        report = mrbatch.calibrate_camera(
            files,
            coefficients=None if distortion == "auto" else int(distortion),
            progress=lambda done, total: bar.update(task, completed=done, total=total),
            **options,
        )
    if json_file:
        json_file.write_text(json.dumps(report.as_dict(), indent=2) + "\n", encoding="utf-8")
    _show(report)


def _show(report: CalibrationReport) -> None:
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    fit = report.fit
    table = Table()
    table.add_column("")
    table.add_column("value", justify="right")
    table.add_column("+- (corners)", justify="right")
    table.add_column("+- (views)", justify="right")
    values = (fit.matrix[0, 0], fit.matrix[1, 1], fit.matrix[0, 2], fit.matrix[1, 2])
    titles = ("fx (px)", "fy (px)", "cx (px)", "cy (px)")
    for name, value, sigma, views in zip(titles, values, fit.sigma, fit.sigma_views):
        table.add_row(name, f"{value:.2f}", f"{sigma:.2f}", f"{views:.2f}")
    names = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
    lens = zip(names, fit.distortion, fit.sigma_distortion, fit.sigma_views_distortion)
    for name, value, sigma, views in lens:
        table.add_row(name, f"{value:.5f}", f"{sigma:.5f}", f"{views:.5f}")
    console = Console()
    console.print(table)
    corners = sum(len(v.points) for v in fit.views)
    console.print(
        f"rms {fit.rms:.3f} px over {corners} corners in {len(fit.views)} views; "
        f"{report.views.looked_at} pictures looked at",
        highlight=False,
    )
    for what, names_ in (("no board seen", report.views.unseen), ("blurred", report.views.blurred)):
        if names_:
            some = ", ".join(names_[:6]) + (", ..." if len(names_) > 6 else "")
            console.print(f"[dim]{what} in {len(names_)}: {escape(some)}[/]", highlight=False)
    for name, error in fit.dropped:
        console.print(f"[yellow]left out[/] {escape(name)}: off by {error:.2f} px", highlight=False)
    for text in report.warnings:
        console.print(f"[yellow]warning[/] {escape(text)}", highlight=False)
