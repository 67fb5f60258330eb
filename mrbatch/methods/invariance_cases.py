"""Hard cases of every method: what must not show in any bit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from mrbatch.contracts import Case, Measurement, Method
from mrbatch.film.window import Window
from mrbatch.methods.estimate import Estimated, estimate
from mrbatch.methods.registry import method as find_method
from mrbatch.metrics.judging import none, same_bits, together
from mrbatch.scene.camera import Camera
from mrbatch.scene.closed_forms import ball, corner, lamp_sky, look_at, real, scene_of, virtual
from mrbatch.scene.mesh import box
from mrbatch.scene.scene import Material, Scene

WIDTH, HEIGHT = 70, 50
FIELDS = ("P", "a", "D", "variance", "samples", "halves")
WINDOWS = (Window(0, 0, 16, 16), Window(13, 9, 31, 27), Window(69, 49, 1, 1))


def small_scene() -> Scene:
    """A corner with a box, a matt and a metal ball under a lamp."""
    shiny = replace(
        virtual("metal", ball(0.3, at=(1.4, 0.6, 0.3), subdivisions=3)),
        material=Material("conductor", (0.9, 0.7, 0.3), 0.2),
    )
    objects = [
        *corner(0.5, size=16.0),
        real("box", box((0.4, 0.4, 0.4), centre=(0.8, -0.8, 0.2)), (0.2, 0.5, 0.7)),
        virtual("ball", ball(0.4, at=(0.7, 0.1, 0.4), subdivisions=3), (0.8, 0.4, 0.3)),
        shiny,
    ]
    return scene_of(objects, lamp_sky())


def small_camera() -> Camera:
    return look_at((3.5, -2.5, 2.0), (0.7, 0, 0.3), width=WIDTH, height=HEIGHT, focal=70)


def small_photo() -> np.ndarray:
    """(HEIGHT, WIDTH, 3) noise for a photo."""
    return np.random.default_rng(5).uniform(0, 1, (HEIGHT, WIDTH, 3)).astype(np.float32)


def small_picture(method: Method, **options: Any) -> Estimated:
    """`estimate` of the small scene; `options` go to it."""
    given = {"spp": 8, "background": small_photo(), "seed": 11, "frame": 3, "engine": "auto", **options}
    return estimate(method, small_scene(), small_camera(), **given)


def same_pictures(
    one: Estimated, other: Estimated, part: tuple[slice, slice] | None = None, names: Sequence[str] = FIELDS
) -> Measurement:
    """Whether two estimates have the same bits; `part`: rows and columns of the first that the other is."""

    def cut(name: str) -> np.ndarray:
        values: np.ndarray = getattr(one.developed, name)
        if part is None:
            return values
        return values[:, part[0], part[1]] if name == "halves" else values[part]

    told = same_bits([cut(name) for name in names], [getattr(other.developed, name) for name in names])
    pictures = [one.developed, other.developed]
    return replace(
        told,
        radiance=tuple(a for d in pictures for a in (d.P, d.a, d.variance)),
        signed=tuple(d.D for d in pictures),
    )


def threads_and_launches(
    method: Method, seed: int, *, ways: Sequence[tuple[int, int]] = ((2, 1), (4, 3), (1, 5))
) -> Measurement:
    """RNG-01: threads and the size of launches."""
    base = small_picture(method, seed=seed, threads=1)
    judged = [none(not base.developed.P.any(), "empty pictures")]
    for threads, units in ways:
        other = small_picture(method, seed=seed, threads=threads, units_per_launch=units)
        judged += [same_pictures(base, other), none(other.counters != base.counters, "other counts of work")]
    return together(*judged)


def crops(method: Method, seed: int, *, windows: Sequence[Window] = WINDOWS) -> Measurement:
    """RNG-01, IO-07: a crop is the crop of the whole."""
    whole, judged = small_picture(method, seed=seed), []
    for w in windows:
        part = small_picture(method, seed=seed, window=w)
        cut = slice(w.y, w.y + w.height), slice(w.x, w.x + w.width)
        judged.append(same_pictures(whole, part, cut))
    return together(*judged)


def batches(method: Method, seed: int, *, sizes: Sequence[int] = (1, 3, 64)) -> Measurement:
    """MC-04: how many samples are taken in a row."""
    base = small_picture(method, seed=seed, spp=16, settings={"batch": 8})
    others = (small_picture(method, seed=seed, spp=16, settings={"batch": size}) for size in sizes)
    return together(*(same_pictures(base, other) for other in others))


def invariance_cases(name: str, *, quick: bool = True) -> tuple[Case, ...]:
    """The cases for the method of this name in the registry."""

    def of(measure: Callable[[Method, int], Measurement]) -> Callable[[int], Measurement]:
        return lambda seed: measure(find_method(name), seed)

    setup = f"{WIDTH} x {HEIGHT} pixels of a corner with a box, a matt and a metal ball, "
    return (
        Case(
            "RNG-01",
            "threads and launches show in no bit",
            of(threads_and_launches),
            quick,
            setup=setup + "1 to 4 threads, launches of 1 to 5 tiles",
        ),
        Case(
            "IO-07",
            "a crop is the crop of the whole",
            of(crops),
            quick,
            setup=setup + "three windows, one of a single pixel",
            rows=("RNG-01",),
        ),
        Case(
            "MC-04",
            "batches of samples show in no bit",
            of(batches),
            quick,
            setup=setup + "batches of 1, 3, 8, 64",
        ),
    )
