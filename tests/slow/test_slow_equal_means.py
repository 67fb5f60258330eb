"""Delta path tracing, one-pass and two-pass differential path tracing have the same mean, for every material.

Compared is the light change D on real surfaces, averaged over the region that virtual things change: the
99 % interval of the difference lies within half a per cent of the region's mean radiance, and blocks of the
picture differ by no more than their noise, so that a shadow too deep here cannot make up for light too strong
there.

What the methods share, and what this comparison is therefore blind to: cameras, random numbers, ray engines,
scattering (`kernels.bsdf`), the map's sampler, and the leg of a path among one set of objects
(`light_paths`), which two-pass uses for everything, one-pass and delta path tracing from the first virtual
hit on. What each has for itself is how the change on a real surface is put together: two independent pictures
and their difference; two paths from one camera ray, with visibilities of their own; or the change alone,
followed from real surface to real surface, with what was blocked taken off and what was hidden traced anew.
Scattering and legs are held against another renderer (`test_slow_mitsuba`) and closed forms
(`methods/test_delta_analytic`).

All scenes hold the same small things beside the one under test, so that few kernels are compiled: a matt and
a metal pebble, a lacquered one with a normal map, a dim lamp, and a table with a texture.
"""

from __future__ import annotations

import functools
import zlib
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy import stats

from mrbatch.methods.delta_path_tracing import METHOD as DELTA
from mrbatch.methods.estimate import estimate
from mrbatch.methods.one_pass import METHOD as ONE_PASS
from mrbatch.methods.two_pass import METHOD as TWO_PASS
from mrbatch.metrics.region import region_of_interest
from mrbatch.metrics.statistics import equivalence_test
from mrbatch.scene.closed_forms import ball, everything_virtual, look_at, real, scene_of, virtual
from mrbatch.scene.environment import Environment
from mrbatch.scene.mesh import box, icosphere, plane
from mrbatch.scene.scene import Material, SceneObject, Texture

pytestmark = pytest.mark.slow

SIDE, BLOCK = 24, 6
SHARE = 0.005
"""Of the region's mean radiance: what the interval of a difference must lie within."""
AIM = 0.0004
"""Standard error, as a share of the same, for which samples are taken: the interval's half is 0.15 %."""
PILOT, FEWEST, MOST = 256, 1024, 1 << 15
"""Samples a pixel: those that tell the noise, fewest and most."""
LEAST = 1e-6
"""Chance below which blocks differ: all cases together compare some 4000."""
METHODS = (DELTA, ONE_PASS, TWO_PASS)


# --- light, places, materials ---------------------------------------------------------------------


def soft() -> Environment:
    """Brighter and bluer above, with a broad bright side: what glass gathers stays finite."""
    theta = np.pi * (np.arange(16) + 0.5) / 16
    phi = 2 * np.pi * (0.5 - (np.arange(32) + 0.5) / 32)
    up = 0.6 + 0.4 * np.cos(theta)[:, None]
    side = 1.5 * np.exp(2.0 * (np.sin(theta)[:, None] * np.cos(phi - 0.7) - 1.0))
    return Environment(
        (up[..., None] * [0.8, 0.9, 1.1] + side[..., None] * [1.1, 1.0, 0.8]).astype(np.float32)
    )


def sun() -> Environment:
    """A blue sky over brown ground, with a sun of some 6 degrees that sends as much as all of the sky."""
    radiance = np.empty((32, 64, 3), np.float32)
    radiance[:16], radiance[16:] = (0.5, 0.6, 0.8), (0.25, 0.2, 0.15)
    radiance[8, 36] = (260.0, 240.0, 200.0)
    return Environment(radiance)


LIGHTS = {"soft": soft(), "sun": sun()}


def checks() -> Texture:
    cells = np.indices((8, 8)).sum(axis=0) % 2
    return Texture(np.where(cells[..., None], [0.8, 0.7, 0.6], [0.3, 0.2, 0.1]).astype(np.float32))


def dents() -> Texture:
    """Normals that lean up to 35 degrees to all sides."""
    a = 2 * np.pi * np.indices((8, 8)) / 8
    return Texture(np.stack([0.5 * np.sin(a[1]), 0.5 * np.cos(a[0]), np.ones((8, 8))], -1).astype(np.float32))


def with_uv(mesh):
    """Latitude and longitude as texture coordinates, good enough for what has no seam to hide."""
    n = mesh.vertices - mesh.vertices.mean(axis=0)
    n = n / np.linalg.norm(n, axis=1, keepdims=True)
    return replace(mesh, uvs=np.stack([0.5 + 0.45 * n[:, 0], 0.5 + 0.45 * n[:, 2]], -1).astype(np.float32))


def bumpy(radius: float, at, seed: int = 4):
    """A ball with hollows that see themselves; smooth normals."""
    mesh = icosphere(1.0, subdivisions=3)
    axes = np.random.default_rng(seed).normal(size=(6, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    depth = sum(np.exp(12.0 * (mesh.vertices @ axis - 1.0)) for axis in axes)
    shaped = replace(mesh, vertices=mesh.vertices * (radius * (1 - 0.4 * depth))[:, None] + at)
    return shaped.with_angle_weighted_normals()


def table() -> SceneObject:
    return replace(real("table", plane(6.0, 6.0)), material=Material(texture=checks()))


PLACES: dict[str, list[SceneObject]] = {
    "plane": [table()],
    "box": [table(), real("box", box((0.5, 0.9, 0.7), centre=(-0.75, 0.1, 0.35)), (0.7, 0.3, 0.2))],
    "mesh": [table(), real("stone", bumpy(0.5, (-0.75, 0.1, 0.4)), (0.3, 0.6, 0.4))],
}
GLASS = Material("dielectric", (1.0,) * 3, 0.0, ior=1.5, priority=2)
MATERIALS = {
    "diffuse": Material(reflectance=(0.8, 0.5, 0.2)),
    "textured": Material(texture=checks()),
    "normal-mapped": Material(reflectance=(0.8, 0.5, 0.2), normal_texture=dents()),
    "polished metal": Material("conductor", (0.95, 0.7, 0.3), 0.0),
    "rough metal": Material("conductor", (0.95, 0.7, 0.3), 0.3),
    "plastic": Material("principled", (0.6, 0.2, 0.1), 0.1, f0=0.04),
    "principled metal": Material(
        "principled", (0.9, 0.6, 0.3), 0.25, metalness=1.0, f0=0.04, edge=(0.8, 0.9, 1)
    ),
    "glowing": Material(reflectance=(0.3, 0.3, 0.3), emission=(1.5, 1.0, 0.4)),
    "glass": GLASS,
    "frosted glass": replace(GLASS, alpha=0.3),
    "coloured glass": replace(GLASS, absorption=(0.5, 2.0, 4.0)),
}
NESTED = "water in glass"
REAL = {
    "polished table": Material("conductor", (0.6, 0.55, 0.5), 0.02),
    "brushed table": Material("conductor", (0.6, 0.55, 0.5), 0.3),
    "lacquered table": Material("principled", (0.4, 0.3, 0.2), 0.15, f0=0.04, texture=checks()),
}
IN_SUN = ("diffuse", "textured", "normal-mapped", "rough metal", "plastic", "glowing", "brushed table")
"""Those which find the sun by directions drawn to it; what polished metal and glass throw of it is left to
chance, and no number of samples that a test has time for tells its mean to half a per cent."""


def pebbles() -> list[SceneObject]:
    """What all scenes hold, at the rim."""
    made = [
        ("matt", (0.75, -0.6), Material(reflectance=(0.2, 0.4, 0.7))),
        ("metal", (0.9, 0.3), Material("conductor", (0.8, 0.8, 0.9), 0.4)),
        (
            "lacquer",
            (0.2, -0.85),
            Material("principled", (0.5, 0.1, 0.1), 0.3, f0=0.04, normal_texture=dents()),
        ),
        ("lamp", (-0.5, -0.8), Material(reflectance=(0.2,) * 3, emission=(0.8, 0.6, 0.4))),
    ]
    return [
        replace(virtual(name, with_uv(ball(0.09, at=(x, y, 0.09), subdivisions=3))), material=look)
        for name, (x, y), look in made
    ]


def objects_of(place: str, material: str) -> list[SceneObject]:
    """The real things first, then the one under test."""
    there = list(PLACES[place])
    middle = with_uv(bumpy(0.42, (0.05, 0.05, 0.42), 9))
    if material in REAL:
        there[0] = replace(there[0], material=REAL[material])
        tested = [virtual("thing", middle, (0.8, 0.4, 0.2))]
    elif material == NESTED:
        outside, inside = (icosphere(r, subdivisions=4, centre=(0.05, 0.05, 0.45)) for r in (0.42, 0.3))
        tested = [
            replace(virtual("glass", outside), material=GLASS),
            replace(virtual("water", inside), material=replace(GLASS, ior=1.33, priority=3)),
        ]
    else:
        tested = [replace(virtual("thing", middle), material=MATERIALS[material])]
    return [*there, *tested, *pebbles()]


# --- measuring ------------------------------------------------------------------------------------


def view():
    return look_at((1.5, -2.3, 2.2), (0.0, 0.0, 0.2), width=SIDE, height=SIDE, focal=1.25 * SIDE)


@functools.cache
def photo(place: str, material: str, light: str) -> np.ndarray:
    """What a camera takes without virtual objects: their absence, not the code under test."""
    shown = everything_virtual(objects_of(place, material), with_virtual=False)
    found = estimate(ONE_PASS, scene_of(shown, LIGHTS[light]), view(), spp=256, seed=99)
    return found.developed.P.astype(np.float32)


@dataclass(frozen=True)
class Case:
    place: str
    material: str
    light: str

    @property
    def name(self) -> str:
        return f"{self.place}, {self.material}, {self.light}"

    def developed(self, method, seed, spp, **options):
        objects = objects_of(self.place, self.material)
        b = photo(self.place, self.material, self.light)
        return estimate(
            method, scene_of(objects, LIGHTS[self.light]), view(), spp=spp, background=b, seed=seed, **options
        ).developed

    def region(self) -> tuple[np.ndarray, float]:
        """(h, w) what virtual things change of real surfaces, and the mean radiance there."""
        found = self.developed(DELTA, 7, 256)
        b = photo(self.place, self.material, self.light)
        changed = region_of_interest(b + found.D, b, dilation=1)
        shown = found.P + (1 - found.a)[..., None] * b + found.D
        return changed, float(shown[changed].mean())


@dataclass(frozen=True)
class Change:
    """D (h, w, 3) of one long run, and the variance of each of its numbers: a quarter of the square of what
    the two halves of the film differ by, which have scrambles of their own."""

    D: np.ndarray
    variance: np.ndarray
    spp: int


def change(case: Case, method, seed: int, spp: int, **options) -> Change:
    halves = case.developed(method, seed, spp, **options).halves[..., 4:7]
    return Change(halves.mean(axis=0), 0.25 * (halves[0] - halves[1]) ** 2, spp)


def mean_of(found: Change, region, scale) -> tuple[float, float]:
    """Mean over region and channels, and its standard error, as shares of `scale`. Channels go together."""
    error = np.sqrt(found.variance[region]).mean(axis=1)
    return found.D[region].mean() / scale, float(np.sqrt((error**2).sum()) / len(error) / scale)


def long_enough(case: Case, method, number: int, region, scale, **options) -> Change:
    """As many samples as a pilot, which is thrown away, says that the standard error needs.

    Raises AssertionError where that is more than `MOST`.
    """
    seed = zlib.crc32(case.name.encode()) % 1_000_000 + 1_000_000 * (1 + number)
    pilot = mean_of(change(case, method, seed, PILOT, **options), region, scale)[1]
    wanted = int(np.ceil(PILOT / 2 * (pilot / AIM) ** 2)) * 2
    assert wanted <= MOST, f"{method.name} would need {wanted} samples: the scene is too noisy to tell"
    return change(case, method, seed + 500_000, max(wanted, FEWEST), **options)


def blocks(values: np.ndarray, region: np.ndarray) -> np.ndarray:
    """(n, 3) sums over blocks, of what lies in the region."""
    n = SIDE // BLOCK
    return (values * region[..., None]).reshape(n, BLOCK, n, BLOCK, 3).sum(axis=(1, 3)).reshape(-1, 3)


def judged(a: Change, b: Change, region, scale):
    """Equivalence of two changes on the region, and the least probability that chance moves any block and
    channel as far apart as they are (Student's law, of as many degrees as the block has pixels)."""
    (one, first), (other, second) = (mean_of(found, region, scale) for found in (a, b))
    shown = equivalence_test(
        float(one - other), float(np.hypot(first, second)), SHARE, observations=int(region.sum())
    )
    pixels = blocks(np.ones((SIDE, SIDE, 3)), region)[:, 0]
    some = pixels >= 8
    # A block that no noise reaches is not a measurement: nor is a difference below the float's own.
    floor = 1e-4 * scale * BLOCK**2
    error = np.sqrt(blocks(a.variance + b.variance, region) + floor**2)
    z = (blocks(a.D, region) - blocks(b.D, region)) / error
    return shown, float((2 * stats.t.sf(np.abs(z), pixels[:, None] - 1))[some].min())


CASES = [
    *(Case(place, material, "soft") for place in PLACES for material in (*MATERIALS, NESTED, *REAL)),
    *(Case(place, material, "sun") for place in ("box",) for material in IN_SUN),
]


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_methods_have_the_same_mean(case):
    region, scale = case.region()
    assert region.mean() > 0.2
    found = [long_enough(case, m, n, region, scale) for n, m in enumerate(METHODS)]
    size = float(np.abs(found[0].D)[region].mean()) / scale
    for method, other in zip(METHODS[1:], found[1:]):
        shown, chance = judged(found[0], other, region, scale)
        print(
            f"{case.name}: {method.name} {100 * shown.difference.low:+.3f} .. "
            f"{100 * shown.difference.high:+.3f} % of the radiance; change {100 * size:.1f} %; "
            f"blocks {chance:.1e}; {found[0].spp}, {other.spp} samples"
        )
        assert shown.passed, (method.name, shown)
        # Not half a per cent of much light that nothing changes: the change itself is measured.
        assert size > 10 * shown.difference.half_width
        assert chance > LEAST, (method.name, chance)
    # What virtual surfaces show is one code for all, and says so.
    layers = [case.developed(m, 3, 4) for m in METHODS]
    for other in layers[1:]:
        assert np.array_equal(layers[0].P, other.P) and np.array_equal(layers[0].a, other.a)


@pytest.mark.parametrize("wrong", ["bleeding", "real-on-real"])
def test_a_change_without_one_of_its_parts_is_found(wrong):
    """Power: without light that virtual things send, or without real things in the way, it shows."""
    case = Case("box", "diffuse", "soft")
    region, scale = case.region()
    cut = long_enough(case, DELTA, 5, region, scale, forced={wrong: "off"})
    whole = long_enough(case, TWO_PASS, 6, region, scale)
    shown, chance = judged(cut, whole, region, scale)
    print(f"{wrong}: {shown.outcome}, blocks {chance:.1e}")
    assert not shown.passed or chance < LEAST
