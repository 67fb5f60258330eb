"""The sweep's page and table: what stands on it, that hostile names do no harm, how a browser shows it."""

from __future__ import annotations

import json
import re
import shutil
import subprocess

import numpy as np
import pytest

from mrbatch.report.model import Gate, Job, Report, parse_report
from mrbatch.report.sweep import (
    Sweep,
    SweepAxis,
    SweepClaim,
    SweepCrop,
    SweepGrid,
    SweepPoint,
    SweepSlope,
    SweepTarget,
    SweepTruth,
)
from mrbatch.report.sweep_markdown import render_price_list
from mrbatch.report.sweep_page import render_sweep_html, write_sweep_html
from mrbatch.report.sweep_plots import cost_plot, parts_chart, ratio_scale
from mrbatch.report.sweep_table import claims_on, headline, price_list, ranked, render_csv
from mrbatch.report.values import Score, Value

HOSTILE = '=1+1</script><img src=x onerror="alert(1)">'


def value(v: float, unit: str = "1", spread: float = 0.1) -> Value:
    return Value(
        value=v, unit=unit, low=v * (1 - spread), high=v * (1 + spread), confidence=0.95, repetitions=9
    )


def point(name: str, axis: str, text: str, time: float, error: float, **more) -> SweepPoint:
    return SweepPoint(
        name=name,
        axis=axis,
        value=text,
        samples=8,
        seconds=value(2 * time, "s"),
        pass_seconds=value(1.8 * time, "s"),
        time=value(time, "x"),
        error=value(error, "x"),
        relmse=value(0.01 * error),
        noise=value(0.008 * error),
        bias=value(0.002),
        scores=(Score(metric="psnr", scope="frame", value=value(30.0, "dB")),),
        counters={"camera rays": 1000},
        **more,
    )


def report(label: str = "16") -> Report:
    own = point("as the job has it", "", "", 1.0, 1.0, own=True, front=True)
    spp, two = (
        point(f"spp {label}", "spp", label, 2.0, 0.4, front=True),
        point("depth 2", "depth", "2", 1.1, 2.0),
    )
    claims = [
        ("spp", "time", own.name, spp.name, "less"),
        ("spp", "error", spp.name, own.name, "less"),
        ("depth", "time", two.name, own.name, "undecided"),
    ]
    told = Sweep(
        frame=3,
        width=64,
        height=48,
        seconds=value(60.0, "s"),
        truth=SweepTruth(source="full settings", samples=1024, own=Value(value=1e-4, unit="1"), pixels=700),
        axes=(
            SweepAxis(
                name="spp", setting="method.spp", own="8", repeats=9, again=value(1.0, "x"), told_apart=1.2
            ),
            SweepAxis(name="depth", setting="method.max_depth", own="none", left_out={label: label}),
        ),
        points=(own, spp, two),
        claims=tuple(
            SweepClaim(axis=a, kind=k, first=f, second=s, outcome=o, ratio=value(0.5, "x"), p=0.001)
            for a, k, f, s, o in claims
        ),
        again=value(1.0, "x"),
        slopes=(SweepSlope(of="relMSE", against="samples", slope=value(-1.1), points=3),),
        knee=spp.name,
        target=0.01,
        targets=(
            SweepTarget(point=spp.name, outcome="reached", samples=6, seconds=value(1.5, "s")),
            SweepTarget(point=two.name, outcome="converged-floor"),
        ),
        grid=SweepGrid(
            first="spp", second="depth", rows=("8",), columns=("none", label), points=((own.name, ""),)
        ),
        crops=(SweepCrop(point=two.name, kind="equal time", path="crop", samples=8, seconds=1, relmse=0.01),),
    )
    return Report(
        kind="sweep",
        job=Job(name=label, method="toy"),
        versions={"mrbatch": "0"},
        gates=(Gate(name="same bits", passed=True, text=label),),
        sweep=told,
    )


def images(found: Report) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(1)
    names = ["truth", "crop", *(n for p in found.sweep.points for n in (p.name, f"{p.name}#error"))]
    return {name: rng.integers(0, 255, (40, 60, 3), dtype=np.uint8) for name in names}


def test_the_page_tells_the_prices():
    page = render_sweep_html(report(), images(report()))
    for words in ("x 2 [1.8, 2.2]", "x 0.4 [0.36, 0.44]", "slower", "more exact", "knee", "relMSE goes with"):
        assert words in page, words
    assert "never: its bias is larger" in page and "1.5 s with 6 samples (foreseen)" in page
    # Undecided pairs get no word and no colour.
    row = page[page.index("<b>2</b>") :].partition('class="says"')[2].partition("</div>")[0]
    assert "state" not in row


def test_what_is_claimed_is_seen_from_the_point():
    told = report().sweep
    assert claims_on(told, told.point("spp 16")) == ("slower", "more exact")
    assert claims_on(told, told.point("depth 2")) == ()
    assert ranked(told, "time") == (1, 2) and ranked(told, "error") == (1, 1)
    assert [s.name for s in price_list(told)] == ["spp", "depth"]
    assert "2 of 3 pairs are ranked" in " ".join(headline(told))


def test_the_page_fetches_nothing_and_runs_its_own_script_alone():
    page = render_sweep_html(report(HOSTILE), images(report(HOSTILE)))
    assert "<img src=x" not in page and page.count("<script>") == 1
    assert not re.findall(r"(?:src|href)=\"(?!data:)[^\"]+\"", page.replace('src=""', ""))
    assert re.search(r"script-src 'sha256-[\w+/=]+'", page) and "default-src 'none'" in page


def test_a_page_without_pictures_has_no_comparer():
    page = render_sweep_html(report())
    assert 'id="comparer"' not in page and "Price list" in page
    with pytest.raises(ValueError, match="no sweep"):
        render_sweep_html(report().model_copy(update={"sweep": None}))


def test_csv_holds_every_figure_and_no_formula():
    lines = render_csv(report(HOSTILE)).splitlines()
    assert len(lines) == 4 and lines[0].startswith("axis,value") and "psnr_frame" in lines[0]
    assert "'=1+1" in lines[2] and ",=1+1" not in lines[2]


def test_markdown_holds_the_price_list():
    text = render_price_list(report(HOSTILE))
    assert (
        "| value | time | error | claimed |" in text and "slower, more exact" in text and "not ranked" in text
    )
    assert "<img" not in text and "<script" not in text


def test_json_round_trip():
    found = report(HOSTILE)
    assert parse_report(json.loads(found.to_json())) == found


def test_charts_hold_all_points():
    told = report().sweep
    plot = cost_plot(told)
    assert len(plot.dots) == 3 and len(plot.line) == 2 and sum(d.knee for d in plot.dots) == 1
    inside = [plot.left <= d.x <= plot.right and plot.top <= d.y <= plot.bottom for d in plot.dots]
    assert all(inside) and plot.dots[-1].kind == "own", "the own point is drawn over all others"
    # Slower is further right, more exact is further down.
    own, spp = (next(d for d in plot.dots if w in d.text) for w in ("job has", "spp 16"))
    assert spp.x > own.x and spp.y > own.y
    scale = ratio_scale(told, "time")
    assert scale.at(1.0) < scale.at(2.0) <= 100.0
    assert len(parts_chart(told).rows) == 3 and all(r.bias for r in parts_chart(told).rows)


@pytest.mark.slow
@pytest.mark.parametrize("width", [1200, 390])
def test_a_browser_shows_it_in_its_width(tmp_path, width):
    """Nothing sticks out, no script error, and the comparer is alive."""
    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if chromium is None:
        pytest.skip("Chromium is not installed")
    write_sweep_html(report(), tmp_path / "page.html", images(report()))
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    # The page's own policy forbids other scripts: the probe takes it off, and looks at the same layout.
    probe = (
        "<script>window.onerror = m => document.title = 'error ' + m;"
        "addEventListener('load', () => { const b = document.querySelector('#comparer');"
        "document.querySelector('[data-do=flip]').click();"
        "document.querySelector('[data-mode=beside]').click();"
        "document.title = [document.documentElement.scrollWidth, innerWidth, b.className, b.dataset.mode,"
        "document.querySelectorAll('.pane:not(.hidden)').length,"
        "document.querySelector('.pane img').naturalWidth].join(' '); });</script>"
    )
    text = re.sub(r"<meta http-equiv[^>]*>", "", text).replace("<script>", probe + "<script>", 1)
    frame = f'<iframe src="page.html" style="width:{width}px;height:3000px;border:0"></iframe>'
    (tmp_path / "page.html").write_text(text, encoding="utf-8")
    # Windows are at least 500 pixels wide: a frame of the page's width stands for a phone.
    outer = (
        f"<body style='margin:0'>{frame}<script>setTimeout(() => document.body.append("
        "document.querySelector('iframe').contentDocument.title), 2000)</script>"
    )
    (tmp_path / "outer.html").write_text(outer, encoding="utf-8")
    command = [chromium, "--headless=new", "--no-sandbox", "--disable-gpu", "--allow-file-access-from-files"]
    command += ["--virtual-time-budget=6000", "--dump-dom", (tmp_path / "outer.html").as_uri()]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    told = done.stdout.rpartition("</script>")[2].partition("</body>")[0].split()
    assert told, done.stderr[-500:]
    assert int(told[0]) <= int(told[1]) == width
    assert told[2:5] == ["live", "beside", "2"] and int(told[5]) == 60, told
