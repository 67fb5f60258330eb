"""Hard cases of environment maps (ENV): poles, seams, odd sizes, lamps on black, values that are no light."""

from __future__ import annotations

import numpy as np

from mrbatch.contracts import Case, Measurement
from mrbatch.errors import InputError
from mrbatch.metrics.judging import mean_within, none, same_bits, together, within
from mrbatch.scene.environment import Environment, rotation_from_yaw
from mrbatch.stability.map_draws import draw, lamp, look
from mrbatch.stability.map_statistics import (
    directions,
    house_uv,
    mean_and_error,
    random_map,
    reference,
    sphere_grid,
)

SHAPES = [(1, 1), (1, 2), (5, 3), (1, 7), (2, 2), (8, 16), (33, 65)]
SPECIAL = np.array(
    [[0, 0, 1], [0, 0, -1], [1, 0, 0], [-1, 0, 0], [-1, 1e-7, 0], [-1, -1e-7, 0], [0, 1, 0], [1e-4, 0, 1]]
)
DRAWS = 400_000


def strong_texels(
    seed: int, *, normals: tuple[tuple[float, ...], ...] = ((0, 0, 1), (0.6, 0, 0.8))
) -> Measurement:
    """ENV-01: irradiance by drawn directions against a float64 sum on a dense grid."""
    image = np.full((32, 64, 3), 1e-3, dtype=np.float32)
    image[6, 31] = image[9, 33] = 1e5
    d, light, density = draw(Environment(image), DRAWS, seed)
    grid, weight = sphere_grid(512, 1024)
    seen = reference(image, "centres", grid)[:, 0] * weight
    judged = []
    for normal in normals:
        n = np.asarray(normal, np.float32)
        mean, error = mean_and_error(light[:, 0] * np.maximum(d @ n, 0.0) / density.astype(np.float64))
        truth = float((seen * np.maximum(grid @ np.asarray(normal, np.float64), 0.0)).sum())
        judged.append(mean_within(mean, error, truth, 1e-3 * truth, observations=DRAWS, radiance=(light,)))
    return together(*judged)


def black_parts(seed: int) -> Measurement:
    """ENV-02: black rows and columns are never drawn, u = 0 included; a black map gives nothing at all."""
    image = random_map(16, 32)
    image[:5] = 0.0
    image[12:] = 0.0
    image[:, :7] = 0.0
    u = np.random.default_rng(seed).random((50_000, 2))
    u[:200, 0] = 0.0
    u[100:300, 1] = 0.0
    u[300:400] = 1.0 - 2.0**-33
    d, light, density = draw(Environment(image, "centres"), u)
    x, v = house_uv(d)
    inside = (v > 4.5 / 16 - 1e-6) & (v < 12.5 / 16 + 1e-6)
    inside &= (x > 6.5 / 32 - 1e-6) | (x < 0.5 / 32 + 1e-6)
    dark = Environment(np.zeros((4, 8, 3), dtype=np.float32))
    drawn, seen = draw(dark, 1000, seed), look(dark, directions(100, seed))
    return together(
        none(~inside, "directions into the dark"),
        none(~(density > 0.0), "draws without a density"),
        # u = 0 is the rim of the first lit cell, where the tent is still 0.
        within(np.mean(light[400:].max(axis=1) > 0.0), 1.0, 1e-3, what="share of draws that meet light"),
        none(~np.isfinite(np.concatenate([drawn[0], light])), "values that are no numbers"),
        within(np.concatenate([a.ravel() for a in (*drawn[1:], *seen)]), 0.0, 0.0, what="a black map"),
    )


def odd_sizes(
    seed: int,
    *,
    shapes: list[tuple[int, int]] = SHAPES,
    interpolations: tuple[str, ...] = ("bilinear", "nearest"),
) -> Measurement:
    """ENV-04: a constant map of any size has the density 1 / 4 pi, at the poles too, and E = pi L."""
    judged = []
    value = float(np.float32(0.7))
    for interpolation in interpolations:
        for shape in shapes:
            image = np.full((*shape, 3), 0.7, np.float32)
            environment = Environment(image, interpolation=interpolation)  # type: ignore[arg-type]
            d, light, density = draw(environment, 20_000, seed)
            everywhere = look(environment, np.concatenate([directions(2000, seed), SPECIAL]))[1]
            normals = np.concatenate([np.eye(3), -np.eye(3), directions(4, seed)])
            judged += [
                within(np.concatenate([density, everywhere]) * 4.0 * np.pi, 1.0, 1e-6, what="4 pi p"),
                within(light, value, 1e-6, relative=True, what="radiance"),
                within(np.linalg.norm(d, axis=1), 1.0, 3e-7, what="length"),
                within(environment.irradiance(normals) / (np.pi * value), 1.0, 1e-6, what="E / pi L"),
                within(environment.fluence() / (4.0 * np.pi * value), 1.0, 1e-12, what="fluence"),
            ]
    return together(*judged)


def wide_range(seed: int) -> Measurement:
    """ENV-05: one texel 1e9 times as bright as others: stored widths equal the float64 weights."""
    image = random_map(128, 256, seed, contrast=1.0)
    image[50, 60] = 1e9
    t = Environment(image, interpolation="nearest").tables()
    share = t.weight / t.weight.sum(axis=1, keepdims=True)
    row_share = t.weight.sum(axis=1) / t.weight.sum()
    return together(
        within(np.diff(t.column_cdf, axis=1), share, 1e-6, relative=True, what="columns"),
        within(np.diff(t.row_cdf), row_share, 1e-6, relative=True, what="rows"),
    )


def lamp_on_black(seed: int) -> Measurement:
    """ENV-06: a lamp of one texel near the equator has the tent's integral, by drawn directions alone."""
    height, width, row = 65, 128, 32
    d, light, density = draw(Environment(lamp(height, width, row, 40, 7.0)), DRAWS, seed)
    # The tent over theta against sine: a second difference of the sine.
    step = np.pi / height
    centre = (row + 0.5) * step
    omega = 2 * np.pi / width * (2 * np.sin(centre) - np.sin(centre - step) - np.sin(centre + step)) / step
    mean, error = mean_and_error(light[:, 0] / density.astype(np.float64))
    return mean_within(mean, error, 7.0 * omega, 7e-3 * omega, observations=DRAWS, radiance=(light,))


def turned(seed: int, *, degrees: tuple[float, ...] = (90.0, 37.3)) -> Measurement:
    """ENV-07: a turned map, with a lamp across the seam, is a turned world: look-ups and draws."""
    image = random_map(16, 31) + lamp(16, 31, 8, 0, 5.0) + lamp(16, 31, 8, 30, 5.0)
    d = directions(20_000, seed).astype(np.float64)
    u = np.random.default_rng(seed + 1).random((5000, 2))
    plain, before = look(Environment(image), d)[0], draw(Environment(image), u)
    judged = []
    for angle in degrees:
        yaw = np.radians(angle)
        c, s = np.cos(yaw), np.sin(yaw)
        turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        after = draw(Environment(image, world_from_map=turn), u)
        there = look(Environment(image, world_from_map=rotation_from_yaw(yaw)), d @ turn.T)[0]
        judged += [
            within(there, plain, 2e-4, what="look-ups"),
            within(after[0], before[0] @ turn.T, 1e-6, what="directions"),
            within(after[1], before[1], 1e-4 + 1e-4 * np.abs(before[1]), what="radiance"),
            same_bits(after[2], before[2]),
        ]
    return together(*judged)


def lamp_direction(seed: int) -> Measurement:
    """ENV-08: no flip in either axis: the look-up peaks where the formula of directions says, draws gather
    round it."""
    judged = []
    for rows in ("centres", "endpoints"):
        for row, column in ((3, 0), (20, 63), (31, 12)):
            environment = Environment(lamp(32, 64, row, column), rows)  # type: ignore[arg-type]
            phi = 2.0 * np.pi * (0.5 - (column + 0.5) / 64)
            theta = np.pi * ((row + 0.5) / 32 if rows == "centres" else row / 31)
            d = np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
            found = draw(environment, 4000, seed)[0].astype(np.float64)
            judged += [
                within(look(environment, d[None])[0][0, 0], 1.0, 2e-5, what="peak"),
                none(found @ d < np.cos(2.0 * np.sqrt(2.0) * np.pi / 32), "draws elsewhere"),
            ]
    return together(*judged)


def pole(seed: int) -> Measurement:
    """ENV-03: one texel in the row at the pole: E = L (pi / W) sin^2(pi / H), in float64."""
    height, width = 16, 24
    light = Environment(lamp(height, width, 0, 5, 3.0), interpolation="nearest")
    oracle = 3.0 * np.pi / width * np.sin(np.pi / height) ** 2
    return within(light.irradiance(np.array([[0.0, 0.0, 1.0]])), oracle, 1e-9, relative=True)


def poison(seed: int) -> Measurement:
    """ENV-09: NaN, negative and infinite texels are refused, with their number and places."""
    image = np.ones((4, 6, 3), dtype=np.float32)
    image[1, 2, 0], image[3, 5, 2], image[0, 0, 1] = np.nan, -1.0, np.inf
    wanted = ("3 texels", "1 NaN", "1 infinite", "1 negative", "(2, 1)", "(5, 3)", "sky.exr")
    try:
        Environment(image, source="sky.exr")
    except InputError as error:
        missing = [text for text in wanted if text not in str(error)]
        told = f"refused, without {', '.join(missing)}" if missing else "refused, with number and places"
        return Measurement(not missing, told, "refused, with number and places", "exact")
    return Measurement(False, "taken", "refused, with number and places", "exact")


def seam(seed: int) -> Measurement:
    """TRAP-2b: draws from two lamps beside the seam lie on the lamps, none on the long way between them."""
    width = 360
    image = lamp(180, width, 90, 0) + lamp(180, width, 90, width - 1)
    d, light, density = draw(Environment(image), 20_000, seed)
    azimuth = np.degrees(np.arctan2(d[:, 1].astype(np.float64), d[:, 0]))
    return together(
        none(np.abs(azimuth) < 178.0 - 1e-4, "draws away from the lamps"),
        none(~(density > 0.0) | ~(light.max(axis=1) >= 0.0), "draws without light or density"),
    )


CASES: tuple[Case, ...] = (
    Case(
        "ENV-01",
        "two strong texels give their irradiance",
        strong_texels,
        setup="two texels of 1e5 on .001, 400,000 drawn directions",
        statistical=True,
    ),
    Case("ENV-02", "what is black is never drawn", black_parts, setup="map with black rows; a black map"),
    Case("ENV-03", "a texel at the pole gives what its solid angle says", pole, setup="one texel in row 0"),
    Case(
        "ENV-04",
        "a constant map of any size is constant",
        odd_sizes,
        setup="1 x 1 to 65 x 33 texels, look-ups, draws, sums",
        rows=("TRAP-2d",),
    ),
    Case(
        "ENV-05",
        "sums keep a range of 1e9",
        wide_range,
        setup="one texel of 1e9 among 32,768",
        rows=("TRAP-2e",),
    ),
    Case(
        "ENV-06",
        "a lamp on black by drawn directions alone",
        lamp_on_black,
        setup="one texel, 400,000 directions",
        rows=("TRAP-2c",),
        statistical=True,
    ),
    Case(
        "ENV-07", "a turned map is a turned world", turned, setup="lamp across the seam, 90 and 37.3 degrees"
    ),
    Case(
        "ENV-08", "a lamp is where the formula says", lamp_direction, setup="three texels, both kinds of rows"
    ),
    Case(
        "ENV-09", "texels that are no light are refused", poison, setup="one NaN, one negative, one infinite"
    ),
    Case("TRAP-2b", "draws beside the seam lie on the lamps", seam, setup="two lamps at +-179.5 degrees"),
)
