"""`mrbatch schema`: the JSON Schema of the job file, for editors, and its manual."""

from __future__ import annotations

import json
from pathlib import Path

import click

from mrbatch.errors import ResourceError


@click.command("schema")
@click.option(
    "--output", metavar="FILE", type=click.Path(path_type=Path), help="Write there, not to the screen."
)
@click.option("--manual", is_flag=True, help="The manual (Markdown) in place of the schema.")
def command(output: Path | None, manual: bool) -> None:
    """Print the JSON Schema (draft 2020-12) of the job file.

    An editor with a YAML language server uses it when a job starts with the line
    `# yaml-language-server: $schema=job.schema.json`.
    """
    if manual:
        from mrbatch.job.manual import manual_text

        text = manual_text()
    else:
        from mrbatch.job.schema import job_schema

        text = json.dumps(job_schema(), indent=2, ensure_ascii=False) + "\n"
    if output is None:
        click.echo(text, nl=False)
        return
    try:
        output.write_text(text, encoding="utf-8", newline="\n")
    except OSError as error:
        raise ResourceError(f"cannot write {output}: {error.strerror}") from None
