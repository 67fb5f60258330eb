"""How numbers are written on pages: three digits, unit, interval; one way for HTML, Markdown and text."""

from __future__ import annotations

import math

from mrbatch.report.model import Value

_SUFFIXES = ((1e12, "T"), (1e9, "G"), (1e6, "M"), (1e3, "k"))


def number(value: float) -> str:
    """Three significant digits: 0.00123, 1.23e-5, 1,234."""
    if math.isnan(value):
        return "NaN"
    if math.isinf(value):
        return "∞" if value > 0 else "-∞"
    if value == 0:
        return "0"
    size = abs(value)
    if size >= 1e7 or size < 1e-4:
        mantissa, exponent = f"{value:.2e}".split("e")
        return f"{mantissa}e{int(exponent)}"
    if size >= 100:
        return f"{value:,.0f}"
    return f"{value:.3g}"


def roughly(value: float) -> str:
    """Two significant digits, for what is foreseen and not measured: 2,000, 1.2."""
    return number(float(f"{value:.2g}")) if math.isfinite(value) else number(value)


def count(value: int) -> str:
    """A count with a suffix: 12.3 M; small ones in full."""
    for scale, suffix in _SUFFIXES:
        if abs(value) >= 10 * scale or (abs(value) >= scale and scale > 1e3):
            return f"{value / scale:.3g} {suffix}"
    return f"{value:,}"


def short_hash(text: str) -> str:
    """The first 12 digits of a hash, without the name of its kind."""
    return text.rpartition(":")[2][:12]


def seconds(value: float) -> str:
    """A duration: 3.2 ms, 12.4 s, 3 min 20 s, 2 h 05 min."""
    if not math.isfinite(value):
        return number(value)
    if value >= 3600:
        minutes = round(value / 60)
        return f"{minutes // 60} h {minutes % 60:02d} min"
    if value >= 60:
        whole = round(value)
        return f"{whole // 60} min {whole % 60:02d} s"
    if value >= 1 or value == 0:
        return f"{value:.3g} s"
    if value >= 1e-3:
        return f"{value * 1e3:.3g} ms"
    return f"{value * 1e6:.3g} µs"


def quantity(value: Value | None) -> str:
    """A value with its unit, its interval and its repetitions, as far as they are known."""
    if value is None:
        return ""
    write = seconds if value.unit == "s" else number
    text = write(value.value)
    if value.unit not in ("1", "s", ""):
        text += f" {value.unit}"
    if value.low is not None and value.high is not None:
        text += f" [{write(value.low)}, {write(value.high)}]"
    if value.repetitions is not None and value.repetitions > 1:
        text += f" (n = {value.repetitions})"
    return text
