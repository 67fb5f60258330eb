"""The command line: parse, call one function of the API, print.

`mrbatch --help` imports no command; each command is loaded when it is called. This is the one
place where errors become messages and exit codes (docs/job.md lists the codes).
"""

from __future__ import annotations

import difflib
import sys
import traceback
from collections.abc import Sequence
from importlib import import_module
from typing import Any, NoReturn

import click

from mrbatch import __version__
from mrbatch.errors import (
    EXIT_INTERNAL,
    EXIT_INTERRUPTED,
    EXIT_RESOURCES,
    EXIT_USAGE,
    JobErrors,
    MrbatchError,
)

DEBUG_HELP = "Show the traceback of an error."

COMMANDS: dict[str, tuple[str, str]] = {
    "render": ("mrbatch.cli.render:command", "Render a job's frames."),
    "plan": ("mrbatch.cli.plan:command", "Say which effects a job's frames call for, and why."),
    "validate": ("mrbatch.cli.validate:command", "Check job files and show all errors at once."),
    "metrics": ("mrbatch.cli.metrics:command", "Compare pictures with a reference."),
    "sweep": ("mrbatch.cli.sweep:command", "Say what accuracy costs: seconds and errors by setting."),
    "stability": ("mrbatch.cli.stability:command", "Check that hard cases come out right on this machine."),
    "ci": ("mrbatch.cli.ci:command", "Check that jobs still render what they did."),
    "report": ("mrbatch.cli.report:command", "Draw the report of a rendered job."),
    "board": ("mrbatch.cli.board:command", "Make a marker or a board to print."),
    "calibrate": ("mrbatch.cli.calibrate:command", "Find a camera's intrinsics from pictures of a board."),
    "merge-hdr": ("mrbatch.cli.merge_hdr:command", "Merge an exposure bracket into an HDR map."),
    "info": ("mrbatch.cli.info:command", "Print what an EXR frame says of itself."),
    "schema": ("mrbatch.cli.schema:command", "Print the JSON Schema or the manual of the job file."),
    "doctor": ("mrbatch.cli.doctor:command", "Check what this machine can do."),
}
"""Command to where it lives and the line that help shows for it."""


class LazyGroup(click.Group):
    """A group whose commands are imported when they are called."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        if name not in COMMANDS:
            return None
        module, _, attribute = COMMANDS[name][0].partition(":")
        command: click.Command = getattr(import_module(module), attribute)
        if not any(option.name == "debug" for option in command.params):
            # Only for the help: `main` takes it out of the line wherever it stands.
            command.params.append(
                click.Option(
                    ["--debug"], is_flag=True, expose_value=False, help="Show the traceback of an error."
                )
            )
        return command

    def resolve_command(self, ctx: click.Context, args: list[str]) -> Any:
        if args and not args[0].startswith("-") and args[0] not in COMMANDS:
            near = difflib.get_close_matches(args[0], COMMANDS, n=1)
            hint = f"did you mean `{near[0]}`?" if near else f"commands: {', '.join(COMMANDS)}"
            ctx.fail(f"there is no command `{args[0]}`; {hint}")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, short) for name, (_, short) in COMMANDS.items()])

    def main(
        self,
        args: Sequence[str] | None = None,
        prog_name: str | None = None,
        complete_var: str | None = None,
        standalone_mode: bool = True,
        **extra: Any,
    ) -> Any:
        arguments = list(sys.argv[1:] if args is None else args)
        options = arguments[: arguments.index("--")] if "--" in arguments else arguments
        debug = "--debug" in options
        # Taken wherever it stands, so that it can be added at the end of the line that failed.
        rest = [a for a in options if a != "--debug"] + arguments[len(options) :]
        try:
            value = super().main(rest, prog_name or "mrbatch", complete_var, False, **extra)
            code = value if isinstance(value, int) and not isinstance(value, bool) else 0
        except Exception as error:
            code = show_error(error, debug=debug)
        except KeyboardInterrupt:
            code = show_error(click.Abort(), debug=debug)
        if standalone_mode:
            leave(code)
        return code


def leave(code: int) -> NoReturn:
    """Ends the process; a reader that has gone away (`| head`) is no error."""
    try:
        sys.stdout.flush()
    except OSError:
        sys.stdout = None  # type: ignore[assignment]
    sys.exit(code)


def show_error(error: BaseException, *, debug: bool = False) -> int:
    """Prints an error as a person should see it, on standard error; gives the exit code."""
    if debug and not isinstance(error, (click.Abort, click.ClickException)):
        traceback.print_exception(error)
    if isinstance(error, JobErrors):
        for one in error.errors:
            click.echo(f"error: {one}", err=True)
        count = len(error.errors)
        if count > 1:
            click.echo(f"{count} errors", err=True)
        return error.exit_code
    if isinstance(error, MrbatchError):
        click.echo(f"error: {error}", err=True)
        return error.exit_code
    if isinstance(error, click.ClickException):
        error.show()
        return EXIT_USAGE
    if isinstance(error, click.Abort):
        click.echo("interrupted", err=True)
        return EXIT_INTERRUPTED
    if isinstance(error, BrokenPipeError):
        return 0
    if isinstance(error, MemoryError):
        click.echo("error: out of memory\n  hint: fewer threads or a smaller picture need less", err=True)
        return EXIT_RESOURCES
    text = " ".join(str(error).split())
    click.echo(f"internal error: {type(error).__name__}{': ' + text if text else ''}", err=True)
    if not debug:
        click.echo("  This is a defect of mrbatch. The same command with --debug shows where.", err=True)
    return EXIT_INTERNAL


@click.command(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="mrbatch", message="%(prog)s %(version)s")
@click.option("--debug", is_flag=True, help=DEBUG_HELP)
def main(debug: bool) -> None:
    """Put virtual objects and volumes into captured datasets, lit by what was captured."""
