"""Pages drawn from the model: safe against hostile text, self-contained, complete."""

from __future__ import annotations

import base64
import math
import re
from html.parser import HTMLParser
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest

from mrbatch.report import numbers
from mrbatch.report.gallery import MAX_FRAMES_SHOWN, MAX_PICTURE_BYTES
from mrbatch.report.html import link, render_html, timing_rows, write_html
from mrbatch.report.junit import render_junit
from mrbatch.report.markdown import render_markdown
from mrbatch.report.model import (
    Attempt,
    Effect,
    Fact,
    File,
    Frame,
    Gate,
    HardCase,
    Job,
    Note,
    Picture,
    Plan,
    Report,
    Run,
    Score,
    TimingNode,
    Totals,
    Value,
)
from mrbatch.report.plots import bar_chart
from mrbatch.report.scores import score_table

HOSTILE = (
    "\"'><script>alert(1)</script><img src=http://evil.example/x onerror=alert(2)>"
    " | `x` [a](http://evil.example) {{ 7*7 }} \x00\x1b"
)


def hostile_report() -> Report:
    value = Value(value=1.5, unit=HOSTILE)
    frame = Frame(
        number=1,
        state="failed",
        message=HOSTILE,
        hint=HOSTILE,
        flags=(HOSTILE,),
        seconds=value,
        files=(File(path=HOSTILE, hash=HOSTILE),),
        counters={HOSTILE: 1},
        scores=(Score(metric=HOSTILE, scope="frame", value=value),),
        numbers={HOSTILE: value},
        error=Value(value=0.01, unit="relMSE"),
    )
    effect = Effect(name=HOSTILE, state="needed", why=HOSTILE, meaning=HOSTILE, frames=HOSTILE)
    return Report(
        job=Job(name=HOSTILE, hash=HOSTILE, method=HOSTILE, capture=HOSTILE, settings={HOSTILE: [HOSTILE]}),
        versions={HOSTILE: HOSTILE},
        machine={HOSTILE: HOSTILE},
        created=HOSTILE,
        facts=(Fact(name=HOSTILE, text=HOSTILE, meaning=HOSTILE),),
        files=(File(path=HOSTILE),),
        runs=(Run(created=HOSTILE, seconds=value, message=HOSTILE),) * 2,
        plan=Plan(effects=(effect.model_copy(update={"numbers": {HOSTILE: 1.0}, "cost": value}),)),
        frames=(frame,),
        timing=TimingNode(name=HOSTILE, seconds=1.0, counters={HOSTILE: 1}, launches=1),
        totals=Totals(seconds=value, counters={HOSTILE: 3}),
        notes=(Note(level="error", text=HOSTILE),),
        pictures=(Picture(role="composite", path=HOSTILE, frame=1, view=HOSTILE, caption=HOSTILE),),
        gates=(Gate(name=HOSTILE, passed=False, text=HOSTILE, measured=value, limit=value),),
        cases=tuple(hostile_case(outcome) for outcome in ("failed", "inconclusive", "passed", "skipped")),
    )


def hostile_case(outcome) -> HardCase:
    texts = dict.fromkeys(("name", "owner", "title", "setup", "oracle", "tolerance", "measured"), HOSTILE)
    attempts = (Attempt(seed=1, outcome=outcome, measured=HOSTILE),) * 2
    return HardCase(
        outcome=outcome,
        reason=HOSTILE,
        rows=(HOSTILE,),
        tests=(HOSTILE,),
        seconds=Value(value=1, unit=HOSTILE),
        attempts=attempts,
        **texts,
    )


class Tags(HTMLParser):
    def __init__(self):
        super().__init__()
        self.tags, self.attributes, self.text = [], [], []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += [(tag, name, value) for name, value in attrs]

    def handle_data(self, data):
        self.text.append(data)


def parsed(page: str) -> Tags:
    tags = Tags()
    tags.feed(page)
    return tags


def test_page_escapes_hostile_strings():
    picture = np.zeros((40, 60, 3), np.uint8)
    page = parsed(render_html(hostile_report(), images={HOSTILE: picture}, linked=True))
    assert "script" not in page.tags
    assert [t for t in page.tags if t == "img"] == ["img"]  # the one picture
    assert not [a for a in page.attributes if a[1].startswith("on")]
    assert "49" not in "".join(page.text)


def test_page_fetches_nothing():
    picture = np.zeros((40, 60, 3), np.uint8)
    page = render_html(hostile_report(), images={HOSTILE: picture}, linked=True)
    for tag, name, value in parsed(page).attributes:
        if (tag, name) == ("a", "href") and value != "#frames":
            # A link is followed by a person's click only, and leads to a file beside the page.
            assert re.fullmatch(r"\./[\w.%/-]*", value), value
        elif value != "#frames" and name in (
            "src",
            "href",
            "srcset",
            "action",
            "data",
            "poster",
            "background",
        ):
            assert value.startswith("data:image/"), (tag, name, value)
    assert not {"link", "script", "iframe", "object", "embed", "base", "form"} & set(parsed(page).tags)
    for style in re.findall(r"<style>.*?</style>", page, flags=re.DOTALL):
        assert "url(" not in style and "@import" not in style
    assert "default-src 'none'" in page


def test_page_says_what_was_skipped_and_why_and_where_time_went():
    report = Report(
        job=Job(name="desk"),
        plan=Plan(
            effects=(Effect(name="caustics", state="absent", why="no material is specular", bound=0.0),)
        ),
        timing=TimingNode(
            name="render",
            seconds=10.0,
            children=(TimingNode(name="trace", seconds=6.0), TimingNode(name="write", seconds=1.0)),
        ),
        frames=(Frame(number=12, state="done", flags=("pose-held",)),),
        totals=Totals(frames_done=1, counters={"camera rays": 1_234_567}),
    )
    text = re.sub(r"\s+", " ", " ".join(parsed(render_html(report)).text))
    for words in (
        "caustics",
        "absent",
        "no material is specular",
        "trace",
        "pose-held",
        "1.23 M",
        "all good",
    ):
        assert words in text, words


def test_timing_rows_account_for_every_second():
    tree = TimingNode(
        name="render",
        seconds=10.0,
        children=(
            TimingNode(name="a", seconds=4.0, children=(TimingNode(name="aa", seconds=1.0),)),
            TimingNode(name="b", seconds=2.0),
        ),
    )
    rows = timing_rows(tree)
    assert [(r.node.name, r.depth) for r in rows] == [
        ("render", 0), ("a", 1), ("aa", 2), ("(the rest)", 2), ("b", 1), ("(the rest)", 1),
    ]  # fmt: skip
    assert [round(r.share) for r in rows] == [100, 40, 10, 30, 20, 40]
    assert sum(r.node.seconds for r in rows if r.node.name in ("aa", "(the rest)", "b")) == pytest.approx(
        10.0
    )
    assert timing_rows(None) == () and timing_rows(TimingNode(name="x", seconds=0.0))[0].share == 0.0


def test_pictures_are_embedded_and_readable():
    codes = np.random.default_rng(0).integers(0, 255, (300, 1600, 3), dtype=np.uint8)
    codes[:] = codes.mean(axis=(0, 1)).astype(np.uint8) // 2 * 2
    report = Report(job=Job(name="x"), pictures=(Picture(role="composite", path="p", frame=3),))
    page = render_html(report, images={"p": codes})
    data = re.search(r'src="data:image/jpeg;base64,([^"]+)"', page).group(1)
    back = cv2.imdecode(np.frombuffer(base64.b64decode(data), np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
    assert back.shape == (135, 720, 3)
    assert np.abs(back.astype(int) - codes[0, 0].astype(int)).max() <= 3


def test_pictures_outside_the_folder_are_not_followed(tmp_path):
    inside = tmp_path / "job"
    inside.mkdir()
    for path in (tmp_path / "secret.png", inside / "fine.png"):
        cv2.imwrite(str(path), np.full((64, 900, 3), 90, np.uint8))
    (inside / "link.png").symlink_to(tmp_path / "secret.png")
    (inside / "broken.png").write_bytes(b"\x89PNG nonsense")
    paths = ["fine.png", "../secret.png", str(tmp_path / "secret.png"), "link.png", "broken.png", "none.png"]
    report = Report(
        job=Job(name="x"), pictures=tuple(Picture(role="composite", path=p, frame=1) for p in paths)
    )
    page = render_html(report, folder=inside)
    assert page.count("<img") == 1
    assert page.count("lies outside the report") == 3
    assert "no such picture" in page and "damaged from the start" in page


def test_many_frames_stay_one_small_page():
    rng = np.random.default_rng(1)
    noise = rng.integers(0, 255, (400, 720, 3), dtype=np.uint8)
    n = 1000
    report = Report(
        job=Job(name="long"),
        frames=tuple(
            Frame(number=i, state="done", seconds=Value(value=1 + i % 7, unit="s")) for i in range(n)
        ),
        pictures=tuple(Picture(role="composite", path=f"{i}", frame=i) for i in range(n)),
    )
    page = render_html(report, images={f"{i}": noise for i in range(n)})
    # As many as fit, spread over the shot.
    shown = [int(number) for number in re.findall(r"<h3>Frame (\d+)</h3>", page)]
    assert page.count("<img") == len(shown) and 12 <= len(shown) <= MAX_FRAMES_SHOWN
    assert max(b - a for a, b in zip(shown, shown[1:])) <= 2 * n / len(shown)
    assert f"{len(shown)} of 1000 frames are shown" in page
    assert "Frame 0<" in page and f"Frame {n - 1}<" in page
    assert len(page) < MAX_PICTURE_BYTES + 1_000_000
    chart = bar_chart(report.frames, "seconds")
    assert 200 <= len(chart.bars) <= 240 and max(b.height for b in chart.bars) == 100.0
    assert chart.top == "7 s"


def test_pictures_of_all_frames_are_shown_where_they_fit():
    codes = np.full((90, 160, 3), 120, np.uint8)
    roles = ("composite", "photo", "delta", "error")
    report = Report(
        job=Job(name="x"),
        pictures=tuple(Picture(role=r, path=f"{r}{i}", frame=i) for i in range(16) for r in roles),
    )
    page = render_html(report, images={p.path: codes for p in report.pictures})
    assert page.count("<img") == 64 and len(page) < MAX_PICTURE_BYTES
    assert page.count('type="radio"') == 16 and "frames are shown" not in page


def test_files_are_linked_where_the_page_lies_beside_them(tmp_path):
    frame = Frame(number=3, state="done", files=(File(path="desk 3.exr"),))
    report = Report(job=Job(name="x"), frames=(frame,), files=(File(path="preview.mp4"),))
    (tmp_path / "elsewhere").mkdir()
    for place, linked in ((tmp_path / "report.html", True), (tmp_path / "elsewhere" / "r.html", False)):
        write_html(report, place, folder=tmp_path)
        page = place.read_text(encoding="utf-8")
        assert ('href="./preview.mp4"' in page) is linked
        assert ('href="./desk%203.exr"' in page) is linked


@pytest.mark.parametrize(
    ("path", "address"),
    [
        ("a/b.exr", "./a/b.exr"),
        ("javascript:alert(1)", "./javascript%3Aalert%281%29"),
        ("//evil.example/x", "./evil.example/x"),
        ("../../etc/passwd", "./etc/passwd"),
        ("http:\\\\evil.example", "./http%3A/evil.example"),
    ],
)
def test_links_lead_nowhere_but_below_the_page(path, address):
    assert link(path) == address


def test_the_noise_is_said_in_words_with_interval_and_samples():
    def frame(number, error):
        value = Value(value=error, unit="relMSE", low=error / 4, high=4 * error, repetitions=48)
        return Frame(number=number, state="done", seconds=Value(value=2, unit="s"), error=value, samples=48)

    report = Report(job=Job(name="x"), frames=tuple(frame(i, e) for i, e in enumerate((4e-3, 1e-2, 9e-2))))
    text = " ".join(" ".join(parsed(render_html(report)).text).split())
    for words in (
        "10 % noise left: visible grain, good enough to judge light and placement",
        "over the pixels that virtual objects change",
        "two independent halves of the 48 samples a pixel differ",
        "10 % [5, 20] (n = 48)",
        "worst, frame 2 30 % [15, 60] (n = 48)",
        # (10 % / 2 %)^2 = 25 times the samples
        "up to 1,200 samples a pixel and 25 times the time",
    ):
        assert words in text, words
    assert "noise left: 10 % \\[5, 20\\] (n = 48), visible grain" in render_markdown(report)


def test_what_failed_stands_first():
    frames = tuple(
        Frame(number=i, state="failed", message=f"broken {i}", hint="repair it", exit=3) for i in range(8)
    )
    page = render_html(Report(job=Job(name="x"), frames=frames, exit=3))
    first = page[: page.index('id="frames"')]
    assert "broken 0" in first and "broken 4" in first and "broken 5" not in first
    assert "3 more stand in the table" in first and page.count("broken 7") == 1


def test_states_of_effects_and_facts_are_explained():
    effect = Effect(name="caustics", state="absent", why="no material is specular", bound=0.0)
    fact = Fact(name="camera track", text="16 of 16 frames", meaning="from the marker")
    page = render_html(Report(job=Job(name="x"), plan=Plan(effects=(effect,)), facts=(fact,)))
    text = " ".join(" ".join(parsed(page).text).split())
    assert "absent proved: nothing of it exists in this scene" in text and ">forced-on<" not in page
    assert "camera track 16 of 16 frames from the marker" in text


def test_junit_counts_gates_and_frames():
    report = Report(
        job=Job(name="x"),
        gates=(
            Gate(name="a", passed=True, text="fine", measured=Value(value=1.0, unit="1")),
            Gate(name="b", passed=False, text="too large", limit=Value(value=1.0, unit="dB"), frame=4),
        ),
        frames=(
            Frame(number=1, state="done", seconds=Value(value=1.25, unit="s")),
            Frame(number=2, state="failed", message="broken", hint="repair it", exit=3),
            Frame(number=3, state="skipped"),
        ),
    )
    root = ElementTree.fromstring(render_junit(report).encode())
    assert (root.get("tests"), root.get("failures"), root.get("skipped")) == ("5", "2", "1")
    failures = {
        c.get("name"): c.find("failure") for c in root.iter("testcase") if c.find("failure") is not None
    }
    assert set(failures) == {"b (frame 4)", "frame 2"}
    assert failures["frame 2"].get("message") == "broken" and failures["frame 2"].text == "repair it"
    times = [c.get("time") for c in root.iter("testcase") if c.get("time")]
    assert times == ["1.250000"]


def test_junit_of_hostile_text_is_well_formed():
    root = ElementTree.fromstring(render_junit(hostile_report()).encode())
    known = {"testsuites", "testsuite", "testcase", "failure", "system-out", "skipped"}
    assert {e.tag for e in root.iter()} <= known


def test_markdown_of_hostile_text_adds_no_markup():
    text = render_markdown(hostile_report())
    assert "<script" not in text and "<img" not in text
    assert not re.search(r"(?<!\\)\]\(", text) and "\x1b" not in text
    assert not re.search(r"https?://", text)
    lines = text.splitlines()
    for before, line in zip(lines, lines[1:]):
        if line.startswith("|"):
            # A row has exactly the cells of the row above it: hostile bars are escaped.
            above, here = (len(re.findall(r"(?<!\\)\|", row)) for row in (before, line))
            assert above in (0, here), line


def test_markdown_names_metrics_and_gates():
    score = Score(metric="psnr", scope="region", value=Value(value=31.25, unit="dB"))
    report = Report(
        job=Job(name="x"),
        frames=(Frame(number=7, state="done", scores=(score,)),),
        gates=(Gate(name="min PSNR", passed=False, text="low"),),
        exit=1,
    )
    text = render_markdown(report)
    assert "| PSNR | 31.2 dB |" in text
    assert "| min PSNR | **failed** |" in text and "exit code 1" in text


@pytest.mark.parametrize(
    "value, text",
    [(0, "0"), (0.00123, "0.00123"), (1.234e-5, "1.23e-5"), (123456, "123,456"), (1e9, "1.00e9"),
     (float("inf"), "∞"), (float("nan"), "NaN"), (-0.5, "-0.5")],
)  # fmt: skip
def test_numbers_are_written_alike(value, text):
    assert numbers.number(value) == text


@pytest.mark.parametrize(
    "value, text",
    [(0.0032, "3.2 ms"), (12.44, "12.4 s"), (59.99, "60 s"), (200, "3 min 20 s"), (7500, "2 h 05 min")],
)
def test_durations_are_written_for_people(value, text):
    assert numbers.seconds(value) == text


def test_quantities_carry_unit_interval_and_repetitions():
    value = Value(value=1.5, unit="dB", low=1.0, high=2.0, repetitions=5)
    assert numbers.quantity(value) == "1.5 dB [1, 2] (n = 5)"
    assert numbers.quantity(None) == ""
    assert [numbers.count(n) for n in (999, 9999, 12_345, 1_234_567, 2_500_000_000)] == [
        "999", "9,999", "12.3 k", "1.23 M", "2.5 G",
    ]  # fmt: skip


def test_scores_of_several_frames_are_their_mean_and_the_worst():
    def frame(number, psnr, relmse):
        values = {"psnr": Value(value=psnr, unit="dB"), "relmse": Value(value=relmse, unit="1")}
        scores = tuple(Score(metric=m, scope="frame", value=v) for m, v in values.items())
        return Frame(number=number, state="done", scores=scores)

    report = Report(job=Job(name="x"), frames=(frame(5, 30.0, 0.1), frame(6, 40.0, 0.3)))
    table = score_table(report)
    assert table.columns == ("frame",) and table.frames == 2
    assert dict(table.rows) == {
        "relMSE": ("0.2 (worst 0.3, frame 6)",),
        "PSNR": ("35 dB (worst 30, frame 5)",),
    }
    assert "0.2 (worst 0.3, frame 6)" in render_html(report)
    assert "| relMSE | 0.2 (worst 0.3, frame 6) |" in render_markdown(report)


def test_where_all_frames_are_alike_none_is_the_worst():
    def frame(number, psnr):
        score = Score(metric="psnr", scope="frame", value=Value(value=psnr, unit="dB"))
        return Frame(number=number, state="done", scores=(score,))

    alike = Report(job=Job(name="x"), frames=(frame(1, math.inf), frame(2, math.inf)))
    assert score_table(alike).rows == (("PSNR", ("∞ dB",)),)
