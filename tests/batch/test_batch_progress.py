"""Progress: what is shown, and that nobody who listens can hold up or break a run."""

from __future__ import annotations

import io
import json
import os
import threading
import time

import pytest

from mrbatch.batch import events as tell
from mrbatch.batch.progress import PlainLines, duration_text, progress

STORY = [
    tell.Started("desk [red]", "out", 4, 1, "found 1 finished, 1 corrupt"),
    tell.Note("`a.exr` is corrupt: rendered again", 2),
    tell.FrameKept(1, "out/1.exr"),
    tell.Prediction(30.0, 10.0, "price list"),
    tell.FrameStarted(2),
    tell.FrameProgress(2, 0.5),
    tell.FrameDone(2, "out/2.exr", 12.345, {"rays": 7}),
    tell.Prediction(24.7, 12.3, "1 frame"),
    tell.FrameFailed(3, "marker never seen"),
    tell.FrameFailed(3, "marker never seen", 2),
    tell.Waiting(1, "host-12-ab"),
    tell.Done(1, 1, 1, 14.2, 30.0, 4, frame_seconds=13.0),
]


def test_json_lines_carry_every_event_in_order():
    stream = io.StringIO()
    with progress("json", stream) as sink:
        for event in STORY:
            sink(event)
    records = [json.loads(line) for line in stream.getvalue().splitlines()]
    assert [record["event"] for record in records] == [event.kind for event in STORY]
    assert records[6] == {
        "event": "frame-done",
        "frame": 2,
        "file": "out/2.exr",
        "seconds": 12.345,
        "counters": {"rays": 7},
    }
    assert records[-1]["exit_code"] == 4


def test_plain_lines_say_what_a_log_should_say():
    stream = io.StringIO()
    sink = PlainLines(stream, clock=lambda: 0.0)
    for event in STORY:
        sink(event)
    assert stream.getvalue().splitlines() == [
        "desk [red]: 4 frames to `out`",
        "found 1 finished, 1 corrupt",
        "frame 2: `a.exr` is corrupt: rendered again",
        "about 0:00:30 left (from price list)",
        "frame 2 done in 12.35 s (2/4)",
        "frame 3 failed: marker never seen",
        "frame 3: shows frame 2 instead",
        "waiting: 1 frame is with host-12-ab",
        "1 rendered, 1 kept, 1 failed in 14.2 s (frames: 13.0 s, predicted 30.0 s)",
    ]


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_a_terminal_gets_a_bar_with_the_remaining_time(monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "140")
    stream = Terminal()
    with progress("auto", stream) as sink:
        for event in STORY:
            sink(event)
            if isinstance(event, tell.Prediction):
                # The bar is drawn four times a second.
                time.sleep(0.4)
    text = stream.getvalue()
    assert "about 0:00:25 left (from 1 frame)" in text
    assert "found 1 finished, 1 corrupt" in text
    assert "frame 3 failed: marker never seen" in text
    assert "desk [red]" in text


def test_a_terminal_sees_how_far_preparing_is(monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "140")
    stream = Terminal()
    with progress("auto", stream) as sink:
        sink(tell.Preparing("looking for the target", 3, 16, "seen in [2]"))
        time.sleep(0.4)  # the bar is drawn four times a second
        sink(STORY[0])
    text = stream.getvalue()
    assert "looking for the target, seen in [2]" in text and "3/16" in text
    last = text.rpartition("\x1b[2K")[2]
    assert "desk [red]" in last


def test_a_log_hears_of_long_preparations_now_and_then():
    stream, now = io.StringIO(), [0.0]
    sink = PlainLines(stream, clock=lambda: now[0])
    for second in range(25):
        now[0] = float(second)
        sink(tell.Preparing("reading inputs", second, 25))
    assert stream.getvalue().splitlines() == ["reading inputs: 10 of 25", "reading inputs: 20 of 25"]


def test_a_file_gets_plain_lines(tmp_path):
    with (tmp_path / "log").open("w") as stream, progress("auto", stream) as sink:
        sink(STORY[0])
    assert (tmp_path / "log").read_text().startswith("desk [red]: 4 frames")


def test_silence():
    stream = io.StringIO()
    with progress("none", stream) as sink:
        for event in STORY:
            sink(event)
    assert stream.getvalue() == ""


@pytest.mark.skipif(os.name != "posix", reason="pipes of a known size are POSIX")
def test_a_reader_that_stops_reading_holds_up_nothing():
    reading, writing = os.pipe()
    done = threading.Event()

    def work():
        with os.fdopen(writing, "w") as stream:
            background = tell.Background(lambda event: stream.write("x" * 100_000), patience=0.05)
            with background:
                for _ in range(5000):
                    background(STORY[0])
                done.set()
            os.close(reading)

    # Far more than a pipe holds, and nobody reads: a direct write would never return.
    worker = threading.Thread(target=work, daemon=True)
    worker.start()
    assert done.wait(30.0)


def test_a_sink_that_raises_is_left_alone():
    calls = []

    def broken(event):
        calls.append(event)
        raise BrokenPipeError

    with tell.Background(broken) as background:
        for event in STORY:
            background(event)
    assert len(calls) == 1


def test_a_backlog_drops_progress_first():
    gate = threading.Event()
    seen = []

    def slow(event):
        gate.wait(30.0)
        seen.append(event)

    background = tell.Background(slow, limit=10, patience=30.0)
    with background:
        for _ in range(100):
            background(tell.FrameProgress(1, 0.1))
        dropped = background.dropped
        background(STORY[-1])
        gate.set()
    assert dropped >= 90
    assert seen[-1] == STORY[-1]


def test_the_forecast_rests_on_the_price_list_then_on_frames():
    forecast = tell.Forecast(2.0)
    assert forecast.predict(10) == tell.Prediction(20.0, 2.0, "price list")
    for seconds in (4.0, 4.0):
        forecast.add(seconds)
    assert forecast.predict(3) == tell.Prediction(12.0, 4.0, "2 frames")
    assert forecast.first == 20.0
    # Frames that became dearer count for more: (1 + 3 + 3) / 3.
    forecast = tell.Forecast()
    assert forecast.predict(3) is None
    forecast.add(1.0)
    forecast.add(3.0)
    assert forecast.predict(3).seconds_per_frame == pytest.approx(7.0 / 3.0)


def test_durations_read_well():
    assert [duration_text(s) for s in (-1.0, 3.25, 65.4, 3700.0)] == ["0.0 s", "3.2 s", "0:01:05", "1:01:40"]
