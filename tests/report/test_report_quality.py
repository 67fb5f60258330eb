"""What the page says of the noise, and the plot of noise against seconds: against closed forms."""

from __future__ import annotations

import math
import re

import pytest

from mrbatch.report.model import Frame, Job, Report, TimingNode, Value
from mrbatch.report.plots import bar_chart, noise_plot
from mrbatch.report.quality import amplitude, quality_of, sampling_share


def report(errors, seconds=2.0, samples=16, timing=None):
    frames = tuple(
        Frame(
            number=10 + i,
            state="done",
            seconds=Value(value=seconds, unit="s"),
            error=Value(value=error, unit="relMSE"),
            samples=samples,
        )
        for i, error in enumerate(errors)
    )
    return Report(job=Job(name="x"), frames=frames, timing=timing)


def tree(traced, other):
    steps = (
        TimingNode(name="paths", seconds=traced, counters={"shadow rays": 5}),
        TimingNode(name="read", seconds=other, counters={"files": 1}),
    )
    return TimingNode(
        name="x", seconds=20.0, children=(TimingNode(name="frames", seconds=traced + other, children=steps),)
    )


def test_an_amplitude_is_the_root_in_per_cent():
    found = amplitude(Value(value=0.04, unit="relMSE", low=0.01, high=0.09, repetitions=8))
    assert found is not None and (found.value, found.low, found.high) == (20.0, 10.0, pytest.approx(30.0))
    assert found.unit == "%" and found.repetitions == 8
    assert amplitude(Value(value=1.0, unit="dB")) is None and amplitude(None) is None


@pytest.mark.parametrize(
    ("error", "word"),
    [(0, "clean"), (3.9e-4, "clean"), (4.1e-4, "light grain"), (0.01, "visible grain"), (1, "strong grain")],
)
def test_words_for_noise(error, word):
    found = quality_of(report([error]))
    assert found is not None and found.word == word
    assert (found.more_samples is None) == (word == "clean")


def test_median_and_worst_frame():
    found = quality_of(report([0.04, 0.01, 0.09]))
    assert found is not None and found.noise.value == pytest.approx(20.0)
    assert found.worst.value == pytest.approx(30.0) and found.worst_frame == 12
    assert quality_of(Report(job=Job(name="x"), frames=(Frame(number=1, state="failed"),))) is None


def test_less_noise_costs_samples_where_rays_are_traced_only():
    assert sampling_share(tree(3.0, 1.0)) == 0.75
    assert sampling_share(None) == 1.0
    found = quality_of(report([0.04], timing=tree(3.0, 1.0)))
    # 20 % to 2 %: 100 times the samples, for three quarters of the time.
    assert found is not None and found.more_samples == pytest.approx(100)
    assert found.more_time == pytest.approx(0.25 + 75)


def test_the_plot_is_logarithmic_and_its_line_has_the_slope_of_noise():
    plot = noise_plot(report([0.04, 0.01, 0.0025], seconds=0.1))
    assert plot is not None
    ys = [mark.y for mark in plot.frames]
    assert ys[1] - ys[0] == pytest.approx(ys[2] - ys[1])  # 20, 10, 5 %
    assert len({mark.x for mark in plot.frames}) == 1
    # All time is sampling: half the noise for four times the seconds. In the drawing's units a decade is:
    per_x = (plot.xs[-1].at - plot.xs[0].at) / math.log10(seconds(plot.xs[-1]) / seconds(plot.xs[0]))
    per_y = (plot.ys[0].at - plot.ys[-1].at) / math.log10(percent(plot.ys[-1]) / percent(plot.ys[0]))
    (x0, y0), (x1, y1) = plot.line[0], plot.line[-1]
    assert (y1 - y0) / per_y == pytest.approx(0.5 * (x1 - x0) / per_x)
    inside = [m for m in (*plot.frames, *plot.steps)]
    assert all(plot.left <= m.x <= plot.right and plot.top <= m.y <= plot.bottom for m in inside)
    assert "64 samples a pixel" in " ".join(m.text for m in plot.steps)


def seconds(tick):
    number, unit = tick.text.split()
    return float(number) * (1e-3 if unit == "ms" else 1.0)


def percent(tick):
    return float(tick.text.split()[0])


def test_no_plot_without_noise_or_times():
    assert noise_plot(report([0.0])) is None
    assert noise_plot(Report(job=Job(name="x"))) is None
    timeless = Frame(number=1, state="done", error=Value(value=0.1, unit="relMSE"))
    assert noise_plot(Report(job=Job(name="x"), frames=(timeless,))) is None


def test_bars_of_noise_are_amplitudes():
    chart = bar_chart(report([0.04, 0.01, 0.0025]).frames, "error")
    assert [round(b.height) for b in chart.bars] == [100, 50, 25] and chart.top == "20 %"
    assert chart.bars[1].text == "frame 11: 10 %"


@pytest.mark.parametrize("taken", [1e-4, 0.02, 3.0, 50.0, 1000.0, 3e4, 1e6])
def test_times_on_the_axis_are_round(taken):
    plot = noise_plot(report([0.04], seconds=taken))
    assert plot is not None and 2 <= len(plot.xs) <= 7
    for tick in plot.xs:
        assert re.fullmatch(r"\d+ (µs|ms|s|min|h)", tick.text), tick.text
    assert [tick.at for tick in plot.xs] == sorted(tick.at for tick in plot.xs)
