"""A sweep's price list as Markdown, for a page or a pull request."""

from __future__ import annotations

from pathlib import Path

from mrbatch.report.markdown import escape
from mrbatch.report.model import Report, write_text
from mrbatch.report.numbers import number, quantity
from mrbatch.report.sweep_table import headline, price_list, target_words, times


def render_price_list(report: Report) -> str:
    """The text: what it hangs on, a table an axis, slopes, times to the target. Names are escaped.

    Raises ValueError for a report without a sweep.
    """
    told = report.sweep
    if told is None:
        raise ValueError("the report holds no sweep")
    lines = [f"- {escape(line)}" for line in headline(told)]
    for section in price_list(told):
        same = "" if section.setting == section.name else f" `{section.setting}`"
        lines += ["", f"**{escape(section.name)}**{same}, own: {escape(section.own)}", ""]
        lines += ["| value | time | error | claimed |", "| --- | --- | --- | --- |"]
        for row in section.rows:
            cells = (row.point.value, row.time, row.error, ", ".join(row.says) or "not ranked")
            lines.append("| " + " | ".join(escape(cell) for cell in cells) + " |")
        apart = f"; x {number(section.told_apart)} is told apart" if section.told_apart else ""
        lines += [
            "",
            f"{section.repeats} turns; the own settings over themselves: {times(section.again)}{apart}.",
        ]
        lines += [f"Left out: {escape(value)} ({escape(why)})." for value, why in section.left_out]
    if told.slopes:
        lines.append("")
        lines += [f"- {s.of} goes with {s.against} to the power of {quantity(s.slope)}" for s in told.slopes]
    if told.knee:
        lines.append(f"- Knee of the front: {escape(told.knee)}")
    if told.target and told.targets:
        lines += ["", f"To relMSE {number(told.target)}:", "", "| settings | takes |", "| --- | --- |"]
        lines += [f"| {escape(t.point)} | {escape(target_words(t))} |" for t in told.targets]
    return "\n".join(lines) + "\n"


def write_price_list(report: Report, path: Path) -> None:
    """Writes `render_price_list` in one step. Raises ResourceError where it cannot be written."""
    write_text(Path(path), render_price_list(report))
