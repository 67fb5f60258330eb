"""`python -m mrbatch.bench COMMAND JOB`: what one frame of a job takes, and why."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from mrbatch.batch.prepare import Prepared, prepare
from mrbatch.bench.bounces import bounces as compare_bounces
from mrbatch.bench.flicker import KINDS
from mrbatch.bench.flicker import flicker as compare_flicker
from mrbatch.bench.peers.comparison import compare as compare_with_peer
from mrbatch.bench.ray_share import ray_share
from mrbatch.bench.samplers import samplers as compare_samplers
from mrbatch.bench.strategies import strategies as compare_strategies
from mrbatch.bench.tables import (
    draw_bounces,
    draw_flicker,
    draw_peers,
    draw_samplers,
    draw_strategies,
    write_json,
)
from mrbatch.bench.thread_scaling import thread_scaling
from mrbatch.bench.time_to_error import time_to_error
from mrbatch.bench.variants import Variants
from mrbatch.device.timing import TimingNode
from mrbatch.errors import MrbatchError
from mrbatch.job import load_job
from mrbatch.metrics.statistics import Interval


def _prepared(job: Path, settings: tuple[str, ...]) -> Prepared:
    try:
        return prepare(load_job(job, list(settings)), TimingNode("bench"))
    except MrbatchError as error:
        raise click.ClickException(str(error)) from error


def _text(interval: Interval) -> str:
    span = f"[{interval.low:.3f}, {interval.high:.3f}]"
    return f"{interval.value:.3f} {span} (95 %, {interval.repetitions} pairs)"


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
def main() -> None:
    """Paired timings of one frame; run them on a machine that does nothing else."""


def _subject(command):
    for option in (
        click.option("--repeats", default=9, show_default=True, type=click.IntRange(3)),
        click.option("--frame", type=int, help="Default: the job's first."),
        click.option("--set", "settings", multiple=True, metavar="KEY=VALUE", help="As in `mrbatch render`."),
        click.argument("job", type=click.Path(path_type=Path)),
    ):
        command = option(command)
    return command


@main.command()
@_subject
def rays(job: Path, settings: tuple[str, ...], frame: int | None, repeats: int) -> None:
    """Seconds of a bare loop over the pass's own rays, over seconds of the pass."""
    prepared = _prepared(job, settings)
    found = ray_share(prepared, prepared.shot.frames[0] if frame is None else frame, repeats=repeats)
    click.echo(f"rays       {found.rays}")
    click.echo(f"pass       {sorted(found.pass_seconds)[repeats // 2]:.3f} s on one thread (median)")
    click.echo(f"bare loop  {sorted(found.loop_seconds)[repeats // 2]:.3f} s")
    click.echo(f"share      {_text(found.share)}")


@main.command()
@_subject
@click.option("--threads", default=2, show_default=True, type=click.IntRange(2))
def threads(job: Path, settings: tuple[str, ...], frame: int | None, repeats: int, threads: int) -> None:
    """Seconds on one thread over seconds on several."""
    prepared = _prepared(job, settings)
    number = prepared.shot.frames[0] if frame is None else frame
    found = thread_scaling(prepared, number, threads=threads, repeats=repeats)
    click.echo(f"one thread  {sorted(found.one)[repeats // 2]:.3f} s (median)")
    click.echo(f"{threads} threads   {sorted(found.many)[repeats // 2]:.3f} s")
    click.echo(f"speed-up    {_text(found.speedup)}; same pixels: {'yes' if found.same else 'NO'}")


def _told(text: str) -> None:
    click.echo(f"{text} ...", err=True)


@main.command()
@_subject
@click.option("--threads", default=1, show_default=True, type=click.IntRange(1))
@click.option(
    "--relmse",
    default=1e-3,
    show_default=True,
    type=click.FloatRange(0, min_open=True),
    help="Error to reach on the region of interest.",
)
@click.option(
    "--reference-spp",
    default=4096,
    show_default=True,
    type=click.IntRange(8),
    help="Samples a pixel of the converged picture.",
)
def target(
    job: Path,
    settings: tuple[str, ...],
    frame: int | None,
    repeats: int,
    threads: int,
    relmse: float,
    reference_spp: int,
) -> None:
    """Seconds of the pass until the picture's error is as small as asked."""
    try:
        found = time_to_error(
            Variants(job, settings, frame=frame),
            relmse,
            repeats=repeats,
            reference_spp=reference_spp,
            threads=threads,
            said=_told,
        )
    except (MrbatchError, ValueError) as error:
        raise click.ClickException(str(error)) from error
    spent = sorted(found.seconds)
    click.echo(f"samples    {found.spp} a pixel")
    click.echo(
        f"relMSE     {found.relmse:.3g} on {int(found.reference.changed.sum())} pixels"
        f" (the reference's own: {found.reference_relmse:.2g})"
    )
    click.echo(
        f"pass       {spent[len(spent) // 2]:.3f} s [{spent[0]:.3f}, {spent[-1]:.3f}] on {threads} thread(s)"
    )


def _comparison(command):
    for option in (
        click.option("--threads", default=1, show_default=True, type=click.IntRange(1)),
        click.option(
            "--reference-spp",
            default=4096,
            show_default=True,
            type=click.IntRange(8),
            help="Samples a pixel of the converged picture.",
        ),
        click.option(
            "--json", "json_file", type=click.Path(path_type=Path), help="Also write every number here."
        ),
    ):
        command = option(command)
    return _subject(command)


def _compare(
    compare: Callable[..., Any],
    draw: Callable[[Any], None],
    *given: Any,
    job: Path,
    settings: tuple[str, ...],
    frame: int | None,
    json_file: Path | None,
    **options: Any,
) -> None:
    """Compares, prints the table and writes the numbers."""
    try:
        found = compare(Variants(job, settings, frame=frame), *given, said=_told, **options)
        draw(found)
        if json_file is not None:
            write_json(found, json_file)
    except MrbatchError as error:
        raise click.ClickException(str(error)) from error


@main.command()
@_comparison
@click.option("--most", default=10, show_default=True, type=click.IntRange(1, 1000), help="Bounces.")
def bounces(most: int, **options: Any) -> None:
    """Delta path tracing and its baselines, from 1 bounce on: seconds, error, look-ups of the map."""
    _compare(compare_bounces, draw_bounces, range(1, most + 1), **options)


@main.command()
@_comparison
def strategies(**options: Any) -> None:
    """The map's light sampled by the map, by surfaces, or both weighted: error at equal samples."""
    _compare(compare_strategies, draw_strategies, **options)


@main.command()
@_comparison
def samplers(**options: Any) -> None:
    """Ways to draw directions from the map, and sequences of random numbers: error at equal samples."""
    _compare(compare_samplers, draw_samplers, **options)


@main.command()
@click.option("--pictures", default=16, show_default=True, type=click.IntRange(2), help="Of the frame.")
@click.option(
    "--kind", "kinds", multiple=True, type=click.Choice(KINDS), help="A filter; default: all, and none."
)
@click.option("--threads", default=1, show_default=True, type=click.IntRange(1))
@click.option("--frame", type=int, help="Default: the job's first.")
@click.option("--set", "settings", multiple=True, metavar="KEY=VALUE", help="As in `mrbatch render`.")
@click.argument("job", type=click.Path(path_type=Path))
def flicker(
    job: Path,
    settings: tuple[str, ...],
    frame: int | None,
    pictures: int,
    kinds: tuple[str, ...],
    threads: int,
) -> None:
    """How much a still film flickers, in code values as shown, with each filter."""
    try:
        found = compare_flicker(
            Variants(job, settings, frame=frame),
            pictures=pictures,
            kinds=kinds or KINDS,
            threads=threads,
            said=_told,
        )
    except (MrbatchError, ValueError) as error:
        raise click.ClickException(str(error)) from error
    draw_flicker(found)


@main.command()
@click.option("--peer", type=click.Choice(["mitsuba", "blender"]), required=True)
@click.option("--python", default=sys.executable, help="That has the peer; default: this one.")
@click.option("--relmse", default=1e-3, show_default=True, type=click.FloatRange(0, min_open=True))
@click.option("--repeats", default=3, show_default=True, type=click.IntRange(1))
@click.option(
    "--noise-of",
    multiple=True,
    metavar="FRAME",
    type=int,
    help="Frames whose noise stands for all; default: every frame.",
)
@click.option(
    "--spp", nargs=2, default=(16, 64), show_default=True, type=click.IntRange(2), help="To begin at."
)
@click.option("--threads", default=2, show_default=True, type=click.IntRange(1), help="Ours.")
@click.option(
    "--set", "settings", multiple=True, metavar="KEY=VALUE", help="As in `mrbatch render`: `frames=0-3`."
)
@click.argument("job", type=click.Path(path_type=Path))
def peers(job: Path, **options: Any) -> None:
    """Whole jobs, start included, against another renderer's at the same noise."""
    try:
        with tempfile.TemporaryDirectory() as folder:
            found = compare_with_peer(job, folder=Path(folder), said=_told, **options)
    except MrbatchError as error:
        raise click.ClickException(str(error)) from error
    draw_peers(found)


if __name__ == "__main__":
    main()
