"""`mrbatch stability`: hard cases with known answers."""

from __future__ import annotations

from pathlib import Path

import click

from mrbatch.cli.report_files import report_options, write_reports

_FILE = click.Path(path_type=Path)


@click.command("stability")
@click.option(
    "--case",
    "patterns",
    multiple=True,
    metavar="GLOB",
    help="Only cases of these rows (`MIS-*`) or methods (`*@one-pass`).",
)
@click.option(
    "--set",
    "cases",
    type=click.Choice(["quick", "full"]),
    default="quick",
    show_default=True,
    help="The full set takes several minutes.",
)
@click.option(
    "--seed",
    type=click.IntRange(0, 2**31 - 1),
    default=0,
    show_default=True,
    help="Of all cases, or the first job's.",
)
@click.option(
    "--fuzz",
    "jobs",
    type=click.IntRange(1, 1_000_000),
    metavar="N",
    help="In place of the cases: N small random jobs, those of the seeds from --seed on.",
)
@report_options("hard case")
@click.pass_context
def command(ctx, patterns, cases, seed, jobs, **files):
    """Run small set-ups whose answer is known, and say for each whether it came out.

    Exit code 1 where one failed, or could not tell. A random job fails where it crashes, hangs, or gives a
    pixel that is no number; the seed that is told repeats it.
    """
    from mrbatch.stability.fuzz import fuzz
    from mrbatch.stability.run import check_stability

    if jobs:
        if patterns:
            raise click.UsageError("--fuzz takes no --case: it runs random jobs in place of the cases")
        report = fuzz(jobs, seed=seed, told=_fuzzed(jobs, seed))
    else:
        report = check_stability(patterns, cases=cases, seed=seed, told=_told)
    print_cases(report)
    write_reports(report, **files)
    ctx.exit(report.exit)


def _told(case) -> None:
    """One line as soon as a case is judged, beside the table: on standard error."""
    again = ", second seed" if len(case.attempts) > 1 else ""
    click.echo(f"{case.outcome:12} {_label(case)} ({case.seconds.value:.1f} s{again})", err=True)


def _fuzzed(jobs, first):
    """What is wrong with a job at once, and how far it is from time to time, on standard error."""

    def told(seed, wrong):
        done = seed - first + 1
        if wrong:
            click.echo(f"seed {seed}: {wrong}", err=True)
        if done % 100 == 0 or done == jobs:
            click.echo(f"{done:,} of {jobs:,} jobs", err=True)

    return told


def print_cases(report) -> None:
    """The table of cases, then what was not run by its reasons, then how many there are of each verdict."""
    from rich.box import SIMPLE
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    colour = {"passed": "green", "failed": "red", "inconclusive": "yellow", "skipped": "dim"}
    console = Console()
    table = Table("case, set-up", "measured, oracle, tolerance", "verdict", box=SIMPLE, pad_edge=False)
    for case in report.cases:
        if case.outcome == "skipped":
            continue
        parts = {"measured": case.measured, "oracle": case.oracle, "tolerance": case.tolerance}
        figures = [f"[dim]{name}[/] {escape(text)}" for name, text in parts.items() if text]
        figures += [escape(case.reason)] if case.reason else []
        name = f"[bold]{escape(_label(case))}[/] {escape(case.title)}\n[dim]{escape(case.setup)}[/]"
        table.add_row(name, "\n".join(figures), f"[{colour[case.outcome]}]{case.outcome}[/]")
    if table.row_count:
        console.print(table)
    reasons: dict[str, list] = {}
    for case in report.cases:
        if case.outcome == "skipped":
            reasons.setdefault(case.reason, []).append(case)
    for reason, rows in reasons.items():
        console.print(f"[yellow]skipped[/], {escape(reason)}:", highlight=False)
        for case in rows:
            tests = f" [dim]({escape(', '.join(case.tests))})[/]" if case.tests else ""
            console.print(f"  [bold]{escape(_label(case))}[/] {escape(case.title)}{tests}", highlight=False)
    counts = {outcome: sum(c.outcome == outcome for c in report.cases) for outcome in colour}
    text = ", ".join(f"[{colour[outcome]}]{count} {outcome}[/]" for outcome, count in counts.items() if count)
    console.print(f"{text} in {report.totals.seconds.value:.1f} s", highlight=False)


def _label(case) -> str:
    return f"{case.name}@{case.owner}" if case.owner else case.name
