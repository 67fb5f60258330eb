"""The sweep as one self-contained page: what accuracy costs, and pictures to compare.

Nothing is fetched, and the only script is the comparer's own, whose hash the page's content policy names.
"""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path

import numpy as np

from mrbatch.report import numbers
from mrbatch.report.model import Report, write_text
from mrbatch.report.pictures import data_uri, png_uri
from mrbatch.report.scores import SCOPES
from mrbatch.report.sweep import Sweep
from mrbatch.report.sweep_plots import cost_plot, parts_chart, ratio, ratio_scale, target_bars
from mrbatch.report.sweep_table import headline, price_list, ranked, times
from mrbatch.report.template import template

MOST_BYTES = 6_000_000
"""Pictures that would take more become JPEG."""
WIDEST = 960
SCORES = ("relmse", "relmse_trimmed", "rmse", "psnr", "ssim", "flip_hdr")


def render_sweep_html(report: Report, images: Mapping[str, np.ndarray] | None = None) -> str:
    """The page as text; `images`: uint8 RGB (height, width, 3) by the report's paths, to be compared.

    Raises ValueError for a report without a sweep.
    """
    from markupsafe import Markup

    told = report.sweep
    if told is None:
        raise ValueError("the report holds no sweep")
    filters = {
        "number": numbers.number,
        "quantity": numbers.quantity,
        "seconds": numbers.seconds,
        "count": numbers.count,
        "times": times,
    }
    script = (files("mrbatch.report") / "templates" / "sweep.js").read_text(encoding="utf-8")
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii")
    scales = {kind: ratio_scale(told, kind) for kind in ("time", "error")}
    return template("sweep.html.j2", filters).render(
        report=report,
        told=told,
        script=Markup(script),
        script_hash=digest,
        headline=headline(told),
        sections=price_list(told),
        scales=scales,
        ratio=ratio,
        plot=cost_plot(told),
        small=cost_plot(told, width=360, height=330),
        parts=parts_chart(told),
        bars=target_bars(told),
        shown=_shown(told, images or {}),
        crops=[
            (crop, _uri(images[crop.path], False)) for crop in told.crops if images and crop.path in images
        ],
        ranked={kind: ranked(told, kind) for kind in ("time", "error")},
        made=[c for c in told.claims if c.outcome != "undecided"],
        scores={p.name: {(s.metric, s.scope): s.value for s in p.scores} for p in told.points},
        score_names=SCORES,
        scopes=SCOPES,
        legend=next((p.legend for p in report.pictures if p.legend is not None), None),
        settings=json.dumps(report.job.settings, indent=2, ensure_ascii=False, default=str),
    )


def write_sweep_html(report: Report, path: Path, images: Mapping[str, np.ndarray] | None = None) -> None:
    """Writes the page in one step. Raises ResourceError where it cannot be written."""
    write_text(Path(path), render_sweep_html(report, images))


def _shown(told: Sweep, images: Mapping[str, np.ndarray]) -> list[tuple[str, str, str, str]]:
    """Name, words, address of the picture and of its map of errors (empty for the truth)."""
    named = [("truth", f"Truth: {told.truth.source}")]
    named += [(p.name, "The job as it is" if p.own else f"{p.axis} {p.value}") for p in told.points]
    there = [(name, words) for name, words in named if name in images]
    keys = [key for name, _ in there for key in (name, f"{name}#error") if key in images]
    lossless = sum(images[key].size for key in keys) < MOST_BYTES
    return [
        (
            name,
            words,
            _uri(images[name], lossless),
            _uri(images[f"{name}#error"], lossless) if f"{name}#error" in images else "",
        )
        for name, words in there
    ]


def _uri(codes: np.ndarray, lossless: bool) -> str:
    return png_uri(codes) if lossless else data_uri(codes, width=WIDEST, quality=92)
