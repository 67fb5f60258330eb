"""Options that every command on a job shares; each is a short way to write a `--set`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from mrbatch.errors import JobError

if TYPE_CHECKING:
    from mrbatch.job.overrides import Override

_OPTIONS = (
    click.option("--set", "overrides", metavar="KEY=VALUE", multiple=True, help="Change a value: `seed=3`."),
    click.option(
        "--confine", metavar="DIR", type=click.Path(path_type=Path), help="Refuse paths that lead out of DIR."
    ),
    click.option("--frames", metavar="LIST", help="Frames to do: `1001-1100x2,1200`."),
    click.option(
        "--crop", metavar="X,Y,W,H", help="Render these pixels only: the full frame's, bit for bit."
    ),
    click.option("--scale", metavar="FRACTION", help="Output resolution over the capture's: `1/4`."),
    click.option("--overscan", metavar="PIXELS", type=int, help="Pixels beyond each edge."),
    click.option("--layers", metavar="A,B,...", help="Layers beside the composite."),
    click.option("--output", metavar="DIR", type=click.Path(path_type=Path), help="Folder for the frames."),
    click.option("--seed", metavar="N", type=int, help="Seed of all random choices."),
    click.option(
        "--target-error",
        metavar="E",
        type=float,
        help="Samples until the region of interest has this relMSE: `0.001`.",
    ),
    click.option(
        "--quality",
        type=click.Choice(["draft", "preview", "final", "reference"]),
        help="A target error by name.",
    ),
    click.option(
        "--time-limit",
        metavar="SECONDS",
        type=float,
        help="Time for the whole command; all frames are thinned.",
    ),
    click.option(
        "--force", metavar="on:NAME,off:NAME", help="Force effects on or off, whatever the plan says."
    ),
)


def job_options(function: Callable[..., Any]) -> Callable[..., Any]:
    """Adds the options to a command, which gets them as keyword arguments for `load`."""
    for option in reversed(_OPTIONS):
        function = option(function)
    return function


def load(
    path: Path,
    *,
    overrides: tuple[str, ...],
    confine: Path | None,
    frames: str | None,
    crop: str | None,
    scale: str | None,
    overscan: int | None,
    layers: str | None,
    output: Path | None,
    seed: int | None,
    target_error: float | None,
    quality: str | None,
    time_limit: float | None,
    force: str | None,
) -> Any:
    """The job with all options applied; its files are looked for too. Raises JobErrors."""
    from mrbatch.job import check_files, load_job

    changes: list[Override] = list(overrides)

    def change(option: str, given: object, text: str) -> None:
        if given is not None:
            changes.append((f"--{option} {given}", text))

    change("frames", frames, f"frames={frames}")
    change("crop", crop, f"output.crop=[{crop}]")
    change("scale", scale, f"output.scale={scale}")
    change("overscan", overscan, f"output.overscan={overscan}")
    change("layers", layers, f"output.layers=[{layers}]")
    change("output", output, f"output.directory={output.absolute().as_posix() if output else ''}")
    change("seed", seed, f"seed={seed}")
    change("target-error", target_error, f"accuracy.target_error={target_error}")
    change("quality", quality, f"accuracy.quality={quality}")
    change("time-limit", time_limit, f"accuracy.time_limit={time_limit} s")
    for part in filter(None, (force or "").split(",")):
        word, colon, name = part.strip().partition(":")
        if not colon or word not in ("on", "off") or not name:
            raise JobError(f"cannot read --force `{part}`", hint="write `on:NAME` or `off:NAME`, by commas")
        change("force", part.strip(), f'effects.{name}="{word}"')
    job = load_job(path, changes, confine=confine, files=True)
    check_files(job)
    return job
