"""`mrbatch doctor`: checks what this machine can do."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from mrbatch.batch.doctor import Finding


@click.command("doctor")
@click.option("--all", "thorough", is_flag=True, help="With the heavy checks: Open3D.")
@click.option(
    "--output", metavar="DIR", type=click.Path(path_type=Path), help="Where frames would go; default: here."
)
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def command(thorough: bool, output: Path | None, as_json: bool) -> int:
    """Check what jobs lean on: libraries, kernels, ray engines, EXR, video, markers, disk, memory.

    Takes some seconds, most of them to compile a kernel. Exit code 0: jobs can run; 5: they cannot,
    and the lines marked `failed` say what to do.
    """
    from mrbatch.batch.doctor import examine, exit_code

    findings: list[Finding] = []
    for finding in examine(thorough=thorough, folder=output):
        findings.append(finding)
        if not as_json:
            _show(finding)
    code = exit_code(findings)
    if as_json:
        told = {"can_run": code == 0, "findings": [dataclasses.asdict(f) for f in findings]}
        click.echo(json.dumps(told, indent=2, ensure_ascii=False))
        return code
    bad = sum(f.verdict == "failed" for f in findings)
    click.echo(f"\njobs cannot run here: {bad} checks failed" if bad else "\njobs can run here")
    return code


_COLOURS = {"ok": "green", "warning": "yellow", "failed": "red"}
_INDENT = 28


def _show(finding: Finding) -> None:
    from textwrap import fill

    verdict = click.style(f"{finding.verdict:<8}", fg=_COLOURS[finding.verdict])
    margin = " " * _INDENT
    options = {"width": 108, "subsequent_indent": margin, "break_on_hyphens": False}
    # Wrapped with a blank margin first: colour codes would count as width.
    text = fill(finding.detail, initial_indent=margin, break_long_words=False, **options)  # type: ignore[arg-type]
    click.echo(f"{finding.name:<20}{verdict}{text[_INDENT:]}")
    if finding.hint and finding.verdict != "ok":
        click.echo(
            fill(f"do: {finding.hint}", initial_indent=margin, break_long_words=False, **options)  # type: ignore[arg-type]
        )
