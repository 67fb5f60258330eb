"""How comparisons are told: a table for a person, and JSON with every number behind it."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np

from mrbatch.bench.bounces import OURS, Bounces
from mrbatch.bench.flicker import BLUR, FlickerComparison
from mrbatch.bench.peers.comparison import PeerComparison
from mrbatch.bench.samplers import Samplers
from mrbatch.bench.strategies import Strategies
from mrbatch.bench.variants import Reference
from mrbatch.metrics.statistics import Interval
from mrbatch.report.model import write_text
from mrbatch.report.numbers import count, number, seconds


def draw_bounces(found: Bounces) -> None:
    """Prints the table of a comparison by bounces."""
    rows = [
        (
            str(row.bounces),
            row.method,
            seconds(float(np.median(row.seconds))),
            "" if row.method == OURS else interval(row.ratio),
            number(row.rmse),
            count(row.counters.get("lookups", 0)),
            count(_rays(row.counters)),
        )
        for row in found.rows
    ]
    heads = ("bounces", "method", "seconds", f"over {OURS}", "RMSE", "look-ups", "rays")
    _draw(heads, rows, f"{_setting(found)}; {OURS} over itself: {interval(found.same)}", breaks=3)


def draw_strategies(found: Strategies) -> None:
    """Prints the table of a comparison of sampling strategies."""
    rows = [
        (
            row.strategy,
            seconds(float(np.median(row.seconds))),
            "" if row.strategy == "mis" else interval(row.ratio),
            number(row.rmse),
            number(row.rmse_real),
            number(row.rmse_virtual),
            count(row.counters.get("lookups", 0)),
            count(_rays(row.counters)),
        )
        for row in found.rows
    ]
    heads = ("strategy", "seconds", "over mis", "RMSE", "on real", "on virtual", "look-ups", "rays")
    _draw(heads, rows, f"{found.method}; {_setting(found)}")


def draw_samplers(found: Samplers) -> None:
    """Prints the table of a comparison of samplers."""
    rows = [
        (
            row.kind,
            row.sampler,
            seconds(float(np.median(row.seconds))),
            interval(row.ratio),
            number(row.rmse),
            number(row.rmse_real),
            number(row.rmse_virtual),
            f"{row.cost:.2f}",
        )
        for row in found.rows
    ]
    heads = ("of", "sampler", "seconds", "over the first", "RMSE", "on real", "on virtual", "time x error^2")
    _draw(heads, rows, f"{found.method}; {_setting(found)}")


def draw_flicker(found: FlickerComparison) -> None:
    """Prints how much still pictures vary, in 8-bit code values."""
    rows = [
        (
            row.kind,
            part,
            count(value.pixels),
            f"{value.fine:.2f}",
            f"{value.coarse:.2f}",
            f"{100 * value.above:.1f} %",
            f"{value.rare:.1f}",
        )
        for row in found.rows
        for part, value in (("real", row.real), ("virtual", row.virtual), ("edges", row.edges))
        if value.pixels
    ]
    heads = ("filter", "part", "pixels", "codes", "blurred", "above 1 code", "one in 1,000 above")
    note = (
        f"{found.method}; frame {found.frame}, {found.spp} samples a pixel, {found.pictures} pictures; "
        f"standard deviation over time of luma in 8-bit codes, as it is and blurred by {BLUR:.0f} pixels"
    )
    if found.missing:
        note += f"; not installed: {', '.join(found.missing)}"
    _draw(heads, rows, note, breaks=len(rows) // max(len(found.rows), 1))


def interval(value: Interval) -> str:
    """A ratio with its interval."""
    return f"{value.value:.2f} [{value.low:.2f}, {value.high:.2f}]"


def draw_peers(found: PeerComparison) -> None:
    """Prints how long both take."""
    rows = [
        (
            side.name,
            str(side.spp),
            number(side.noise),
            seconds(float(np.median(side.seconds))),
        )
        for side in (found.ours, found.peer)
    ]
    note = (
        f"{len(found.frames)} frames, {len(found.ours.seconds)} pairs of whole jobs; noise on "
        f"{found.region:.0f} pixels a frame. {found.peer.name} takes "
        f"{interval(found.ratio)} times as long, at equal noise "
        f"{interval(found.at_equal_noise)} times. Their means are {number(found.apart)} apart (relMSE)."
    )
    _draw(("renderer", "samples", "relMSE", "seconds"), rows, note)


def as_json(found: Bounces | Samplers | Strategies) -> dict[str, Any]:
    """Everything but the pictures; what is not a number is null."""
    plain = {f.name: getattr(found, f.name) for f in fields(found) if f.name not in ("rows", "reference")}
    plain = {name: asdict(value) if isinstance(value, Interval) else value for name, value in plain.items()}
    rows = [
        {
            name: _finite(value)
            for name, value in {**asdict(row), "median": float(np.median(row.seconds))}.items()
        }
        for row in found.rows
    ]
    reference = {
        "spp": found.reference.spp,
        "rmse": found.reference.error,
        "pixels": int(found.reference.changed.sum()),
    }
    return {**plain, "reference": reference, "rows": rows}


def write_json(found: Bounces | Samplers | Strategies, path: Path) -> None:
    """Writes `as_json`. Raises ResourceError where the file cannot be written."""
    write_text(path, json.dumps(as_json(found), indent=2, allow_nan=False) + "\n")


def _finite(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _rays(counters: dict[str, int]) -> int:
    return sum(n for name, n in counters.items() if name.endswith("rays"))


def _setting(found: Bounces | Samplers | Strategies) -> str:
    reference: Reference = found.reference
    threads = "1 thread" if found.threads == 1 else f"{found.threads} threads"
    return (
        f"frame {found.frame}, {found.spp} samples a pixel, {threads}, {found.repeats} pairs; "
        f"RMSE on {int(reference.changed.sum()):,} pixels against {reference.spp} samples a pixel, "
        f"whose own is {number(reference.error)}"
    )


def _draw(heads: Sequence[str], rows: Sequence[Sequence[str]], note: str, *, breaks: int = 0) -> None:
    from rich.box import SIMPLE
    from rich.console import Console
    from rich.table import Table

    table = Table(box=SIMPLE)
    for place, head in enumerate(heads):
        words = place == 0 or head in ("method", "sampler", "part")
        table.add_column(head, justify="left" if words else "right", no_wrap=True)
    for place, row in enumerate(rows):
        table.add_row(*row, end_section=bool(breaks) and place % breaks == breaks - 1)
    # A table that is piped into a file is as wide as it needs to be.
    console = Console(markup=False, highlight=False)
    if not console.is_terminal:
        console.width = 200
    console.print(table)
    console.print(note)
