"""Hard cases of delta path tracing in whole pictures: untouched photos, hidden things, edges, odd sizes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from mrbatch.contracts import Case, Measurement
from mrbatch.film.accumulator import Developed
from mrbatch.film.composite import composite
from mrbatch.film.window import Window
from mrbatch.methods.delta_path_tracing.delta_probe import delta_probe
from mrbatch.methods.estimate import Estimated, estimate
from mrbatch.methods.invariance_cases import same_pictures, small_picture
from mrbatch.methods.registry import method as find_method
from mrbatch.metrics.judging import mean_within, none, same_bits, together, within
from mrbatch.scene.closed_forms import ball, corner, floor, lamp_sky, look_at, real, scene_of, sky, virtual
from mrbatch.scene.environment import Environment, rotation_from_yaw
from mrbatch.scene.mesh import Mesh, box, plane
from mrbatch.scene.scene import SceneObject

LAYERS = ("P", "a", "D")
COVERAGE = 0.37


def delta_estimate(*given: Any, **options: Any) -> Estimated:
    """`estimate` of this method."""
    return estimate(find_method("delta-path-tracing"), *given, **options)


def delta_picture(
    objects: Sequence[SceneObject],
    *,
    light: Environment | None = None,
    size: int = 32,
    spp: int = 8,
    eye: Sequence[float] = (2.0, -3.0, 2.5),
    target: Sequence[float] = (0, 0, 0.3),
    **options: Any,
) -> Estimated:
    """A square picture of the objects over an even photo."""
    view = look_at(eye, target, width=size, height=size, focal=1.2 * size)
    photo = np.full((size, size, 3), 0.3, np.float32)
    return delta_estimate(scene_of(objects, light), view, spp=spp, background=photo, **options)


def shown(*pictures: Developed) -> Measurement:
    """Passes, with the layers of the pictures for the runner to look at."""
    radiance = tuple(a for d in pictures for a in (d.P, d.a, d.variance))
    return Measurement(
        True, "sound", "sound", "exact", radiance=radiance, signed=tuple(d.D for d in pictures)
    )


def untouched(seed: int, *, extra: Sequence[SceneObject] | None = None) -> Measurement:
    """DPT-01: without virtual objects, or with one that nothing can see, every bit of a noisy photo stays,
    minus zero too, and no ray is traced."""
    ghost = virtual("ghost", ball(0.5, at=(1, 0, 0.5)), camera=False, cast_shadow=False)
    camera = look_at((3, -2, 2), (0, 0, 0), width=40, height=24, focal=40)
    photo = np.random.default_rng(seed).normal(0.4, 0.5, (24, 40, 3)).astype(np.float32)
    photo[0, 0] = -0.0
    judged = []
    for more in ([], [ghost]) if extra is None else (extra,):
        scene = scene_of([*corner(0.5, size=64.0), *more])
        result = delta_estimate(scene, camera, spp=4, seed=seed, background=photo)
        d = result.developed
        out = composite(d.P, d.a, photo, d.D).astype(np.float32)
        judged += [
            same_bits(out, photo),
            within([sum(result.counters.values())], 0, 0, what="rays and look-ups"),
            none(result.plan.effects["light-change"].state != "absent", "plans that do something"),
            shown(d),
        ]
    return together(*judged)


def wider_frame(seed: int) -> Measurement:
    """DPT-10: the shadow in the frame of a thing outside is that of a wider frame."""
    thing = virtual("ball", ball(0.4, at=(-1.1, 0, 0.4), subdivisions=4), 0.3)
    objects = [real("floor", floor(16.0), 0.5), thing]
    options: dict[str, Any] = dict(
        light=lamp_sky(), size=64, eye=(0, -3.0, 3.0), target=(0, 0, 0), half_code=1e-4, seed=seed
    )
    whole = delta_picture(objects, **options)
    first = int(np.nonzero(whole.developed.a.any(axis=0))[0].max()) + 2
    part = delta_picture(objects, window=Window(first, 0, 64 - first, 64), **options)
    return together(
        same_pictures(whole, part, (slice(None), slice(first, None)), LAYERS),
        none(part.developed.a.any(), "frames that show the thing"),
        none(np.abs(part.developed.D).max() < 0.02, "frames without its shadow"),
    )


def card_edge(seed: int, *, spp: int = 4096) -> Measurement:
    """DPT-11: a card covers .37 of each of a column of pixels: a is its share, P its light, and D the change
    of what stays visible, weighted once: that of the pixels narrowed to their visible part."""
    count = 64
    card = plane(2.0, 2.0, centre=(-1.0 - 0.005 + 0.01 * COVERAGE, 0, 0.5))
    objects = [real("floor", floor(), 0.5), virtual("card", card, 0.2)]
    # One pixel is 1 cm wide on the card's plane, seen from 2 m above it, and a hundredth of that high.
    view = look_at((0, 0, 2.5), (0, 0, 0), width=1, height=count, focal=200.0)
    matrix = view.matrix.copy()
    matrix[1, 1] *= 100.0
    view = replace(view, matrix=matrix)
    d = delta_estimate(scene_of(objects), view, spp=spp, seed=seed).developed
    hidden = [objects[0], replace(objects[1], camera=False)]
    matrix = view.matrix.copy()
    matrix[0, 0] /= 1 - COVERAGE
    matrix[0, 2] = 0.5 - COVERAGE / (2 * (1 - COVERAGE))
    narrow = delta_estimate(
        scene_of(hidden), replace(view, matrix=matrix), spp=spp, seed=seed + 100
    ).developed

    def mean(values: np.ndarray) -> tuple[float, float]:
        return float(values.mean()), float(values.std(ddof=1)) / np.sqrt(count)

    (a, ea), (P, eP), (D, eD) = mean(d.a), mean(d.P[..., 0]), mean(d.D[..., 0])
    part, error = mean(narrow.D[..., 0])
    oracle, spread = (1 - COVERAGE) * part, float(np.hypot(eD, (1 - COVERAGE) * error))
    squared = abs(D - (1 - COVERAGE) ** 2 * part)
    return together(
        mean_within(a, ea, COVERAGE, 0.0),
        mean_within(D, spread, oracle, 1e-4, sees=0.05 * abs(oracle)),
        mean_within(P, eP, COVERAGE * 0.2, 1e-5),
        none(squared < 10 * spread, "changes that may be weighted twice"),
        shown(d, narrow),
    )


def real_pole(seed: int) -> Measurement:
    """DPT-14: a real pole hides what stands behind it, pixel by pixel, and has its own light change."""
    pole = real("pole", box((0.2, 0.2, 2.0), centre=(0.4, -1.0, 1.0)), 0.5)
    thing = virtual("thing", box((1.5, 0.3, 1.0), centre=(0, 0, 0.5)), 0.5)
    options: dict[str, Any] = dict(size=48, eye=(0.4, -4.0, 1.2), target=(0.4, 0, 0.7), spp=16, seed=seed)
    held = delta_picture([real("floor", floor()), pole, thing], **options).developed
    alone = delta_picture([real("floor", floor()), thing], **options).developed
    pictured = delta_picture([replace(pole, virtual=True)], **options).developed.a
    covered, free = pictured == 1, pictured == 0
    return together(
        within(held.a[covered], 0.0, 0.0, what="coverage where the pole is"),
        within(held.P[covered], 0.0, 0.0, what="light there"),
        same_bits(held.a[free], alone.a[free]),
        none(covered.sum() < 40 or not alone.a[covered].any(), "poles that hide nothing"),
        none(not held.D[covered].any(), "poles without a change of their own"),
        shown(held, alone),
    )


def black_photo(seed: int) -> Measurement:
    """DPT-20: the change stays signed; the composite alone is cut at 0."""
    scene = scene_of([real("floor", floor()), virtual("ball", ball(), 0.0, camera=False)])
    found = delta_probe(scene, (1, 0, 0), spp=16, seed=seed)
    shape = found.pixels.reshape(8, 8, 3)
    out = composite(np.zeros_like(shape), np.zeros((8, 8)), np.zeros_like(shape), shape)
    return together(
        none(found.pixels > 0, "changes that brighten"),
        none(found.pixels.min() > -0.05, "shadows that were cut"),
        within(out, 0.0, 0.0, what="composite"),
    )


def odd_size(
    seed: int, *, sizes: Sequence[tuple[int, int]] = ((1, 1), (1279, 719), (1, 4096))
) -> Measurement:
    """IO-07: pixel (x, y) is the same whatever the frame's size: odd ones are crops of larger ones."""
    ground = real("floor", floor(16.0), 0.5)
    scene = scene_of([ground, virtual("ball", ball(0.4, at=(0, 0, 0.4), subdivisions=3), 0.6)], sky())
    judged = []
    for width, height in sizes:
        focal = max(width, height, 40)
        larger = look_at((0, -0.4, 3), (0, 0, 0.2), width=width + 3, height=height + 5, focal=focal)
        smaller = replace(larger, width=width, height=height)
        options: dict[str, Any] = dict(spp=2, half_code=1e-3, seed=seed)
        part = delta_estimate(scene, smaller, **options)
        whole = delta_estimate(scene, larger, window=Window(0, 0, width, height), **options)
        empty = not (part.developed.D.any() or part.developed.P.any())
        judged += [
            same_pictures(part, whole, names=(*LAYERS, "variance", "samples")),
            none(empty or part.developed.P.shape[:2] != (height, width), "pictures that are empty or cut"),
        ]
    return together(*judged)


def shadow_tip(
    seed: int, *, lamps: Sequence[tuple[int, int, float]] = ((44, 37, 0.0), (36, 300, 0.37))
) -> Measurement:
    """ENV-08: the tip of a card's shadow is where the one lit texel (row, column, yaw) throws it, by the
    formula of directions in float64; nor is the shadow anywhere else."""
    height, width, size = 128, 384, 96
    off, elsewhere, pictures = [], [], []
    for row, column, yaw in lamps:
        image = np.full((height, width, 3), 1e-4, np.float32)
        image[row, column] = 1e3
        turn = rotation_from_yaw(yaw)
        light = Environment(image, world_from_map=turn, interpolation="nearest")
        phi = 2 * np.pi * (0.5 - (column + 0.5) / width)
        theta = np.pi * (row + 0.5) / height
        d = turn @ np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
        # The card faces the lamp, a metre high and half a metre wide.
        across, up = np.array([-d[1], d[0], 0]) / np.hypot(d[0], d[1]) * 0.25, np.array([0, 0, 1.0])
        mesh = Mesh(
            np.array([-across, across, across + up, up - across]), np.array([[0, 1, 2], [0, 2, 3]], np.int32)
        )
        objects = [real("floor", floor(8.0), 0.5), virtual("card", mesh, 0.0, camera=False)]
        view = look_at((0, 0, 6), (0, 0, 0), width=size, height=size, focal=1.2 * size)
        found = delta_estimate(scene_of(objects, light), view, spp=64, seed=seed).developed
        depth = -found.D[..., 0] / -found.D[..., 0].min()
        tip = up - d / d[2]
        # Along the shadow's middle line: it ends where half of the lamp is seen.
        steps = np.linspace(0.2, 1.4, 1201)
        pixels, _ = view.project(steps[:, None] * tip)
        i = np.floor(pixels - 0.5).astype(int)
        f, (x, y) = pixels - 0.5 - i, i.T
        along = (depth[y, x] * (1 - f[:, 0]) + depth[y, x + 1] * f[:, 0]) * (1 - f[:, 1])
        along += (depth[y + 1, x] * (1 - f[:, 0]) + depth[y + 1, x + 1] * f[:, 0]) * f[:, 1]
        plateau = np.median(along[(steps > 0.4) & (steps < 0.8)])
        end = steps[np.nonzero(along > 0.5 * plateau)[0].max()]
        seen, truth = view.project(np.array([end * tip, tip]))[0]
        off.append(np.linalg.norm(seen - truth) if plateau > 0.8 else np.inf)
        # The middle of the shadow's mass is the middle of what the card hides.
        y, x = np.indices(depth.shape) + 0.5
        strong = np.where(depth > 0.1, depth, 0.0)
        middle = np.array([(strong * x).sum(), (strong * y).sum()]) / strong.sum()
        elsewhere.append(np.linalg.norm(middle - view.project(0.5 * tip[None])[0][0]))
        pictures.append(found)
    return together(
        within(np.array(off), 0.0, 0.5, what="tip, pixels"),
        within(elsewhere, 0.0, 1.0, what="middle, pixels"),
        shown(*pictures),
    )


def split_layers(seed: int) -> Measurement:
    """RNG-01: a pixel's numbers do not depend on which other effects are on: one split in parts, one not."""
    method = find_method("delta-path-tracing")
    plain = small_picture(method, seed=seed)
    split = small_picture(method, seed=seed, needs=frozenset({"D_indirect"}))
    d = split.developed
    assert d.blocked is not None and d.indirect is not None
    parts = d.blocked + d.indirect
    return together(
        same_pictures(plain, split),
        within(parts, d.D, 1e-7 + 1e-5 * np.abs(d.D), what="sum of the parts"),
        none(d.blocked > 0.0, "shadows that brighten"),
    )


CASES: tuple[Case, ...] = (
    Case(
        "DPT-01",
        "where nothing is virtual no bit changes",
        untouched,
        setup="noisy photo of a corner, without objects and with one that nothing sees",
        rows=("TRAP-1",),
    ),
    Case(
        "DPT-10",
        "a thing outside the frame throws its shadow into it",
        wider_frame,
        setup="a crop beside a ball, and the frame with the ball, under a lamp",
    ),
    Case(
        "DPT-11",
        "an edge in the pixel weights the change once",
        card_edge,
        quick=False,
        setup="card over .37 of 64 pixels of 4096 samples",
        rows=("TRAP-3e",),
        statistical=True,
    ),
    Case("DPT-14", "a real pole hides what stands behind it", real_pole, setup="pole before a wide box"),
    Case(
        "DPT-20",
        "a black photo stays black, its change signed",
        black_photo,
        setup="black photo under a black ball's shadow",
        rows=("TRAP-3c",),
    ),
    Case(
        "ENV-08",
        "the tip of a shadow is where the lamp's texel throws it",
        shadow_tip,
        setup="card of 1 m, one lit texel of 384 x 128, the map turned or not",
        statistical=True,
    ),
    Case(
        "IO-07",
        "odd sizes are crops of larger pictures",
        odd_size,
        quick=False,
        setup="1 x 1, 1279 x 719 and 1 x 4096 pixels",
    ),
    Case(
        "RNG-01",
        "another layer changes no number",
        split_layers,
        setup="the change of light, whole and split into parts",
    ),
)
