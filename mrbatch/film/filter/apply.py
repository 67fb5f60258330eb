"""Applying a filter to what a film holds: P and D change, coverage and the photo's bits do not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from mrbatch.film.accumulator import Developed
from mrbatch.film.filter.residual import mean_kept
from mrbatch.film.filter.settings import Filter
from mrbatch.film.filter.signal import Signal, real_signal, virtual_signal
from mrbatch.film.filter.specks import without_specks
from mrbatch.film.guides import Guides

Smooth = Callable[[Signal, tuple[np.ndarray, ...]], tuple[np.ndarray, ...]]


def smoother(settings: Filter, threads: int = 1) -> Smooth:
    """The kind's function: from a signal and parts of its value to what is to be added to each.

    Lone bright samples are taken out before (`specks.py`). Raises ResourceError where what the kind needs is
    not installed.
    """
    smooth = _kind(settings, threads)

    def without_dots(signal: Signal, also: tuple[np.ndarray, ...]) -> tuple[np.ndarray, ...]:
        clean = without_specks(signal, threads)
        if clean is None:
            return smooth(signal, also)
        taken = clean.value - signal.value
        # A speck came with one of D's parts: the larger one.
        parts = [np.where(np.abs(part) >= np.abs(signal.value - part), taken, 0.0) for part in also]
        changes = smooth(clean, tuple(part + less for part, less in zip(also, parts)))
        spread = (mean_kept(less, signal.weight, signal.group) for less in (taken, *parts))
        return tuple(change + less for change, less in zip(changes, spread))

    return without_dots


def _kind(settings: Filter, threads: int) -> Smooth:
    if settings.kind == "bilateral":
        from mrbatch.film.filter.bilateral import bilateral

        return lambda signal, also: bilateral(signal, settings.reach, also, threads)
    if settings.kind == "variance":
        from mrbatch.film.filter.variance import variance_guided

        return lambda signal, also: variance_guided(signal, settings.reach, also, threads)
    if settings.kind == "oidn":
        from mrbatch.film.filter.oidn import denoise, load_oidn

        library = load_oidn()
        return lambda signal, also: denoise(library, signal, also, threads)
    raise ValueError(f"no filter is called {settings.kind}")


def filtered(developed: Developed, guides: Guides | None, smooth: Smooth) -> Developed:
    """P and D, and D's parts, filtered; all else as it was: the halves and the variance, and with them the
    noise that a report tells, are those of the samples.

    Where D and a are 0 both stay so, to the bit: there the composite is the photo. P stays 0 where a is.
    """
    if guides is None:
        return developed
    (virtual,) = smooth(virtual_signal(developed, guides), ())
    indirect = developed.indirect
    real, *parts = smooth(real_signal(developed, guides), () if indirect is None else (indirect,))
    given: dict[str, Any] = {"P": developed.P + virtual, "D": developed.D + real}
    if indirect is not None:
        given["indirect"] = indirect + parts[0]
        given["blocked"] = given["D"] - given["indirect"]
    return replace(developed, **given)
