"""Clear objects: what is seen through them, what of light they keep, and media inside media."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from held import holds

from mrbatch.methods.delta_path_tracing import METHOD as DELTA
from mrbatch.methods.delta_path_tracing import glass_cases
from mrbatch.methods.delta_path_tracing.glass_cases import halves
from mrbatch.methods.estimate import estimate
from mrbatch.methods.one_pass import METHOD as ONE_PASS
from mrbatch.methods.probe import probe
from mrbatch.methods.two_pass import METHOD as TWO_PASS
from mrbatch.scene import settings as given
from mrbatch.scene.build import build_scene
from mrbatch.scene.closed_forms import ball, corner, floor, look_at, real, scene_of, sky, virtual
from mrbatch.scene.environment import Environment
from mrbatch.scene.mesh import box, icosphere
from mrbatch.scene.scene import Material

GLASS = Material("dielectric", (1.0,) * 3, 0.0, ior=1.5)


def of(material, mesh, name="glass", **switches):
    return replace(virtual(name, mesh, **switches), material=material)


def seen(objects, light, eye=(0, -4, 0), target=(0, 0, 0), spp=64, method=DELTA, **settings):
    """P in the middle of the picture: mean and standard error over its 8 x 8 pixels."""
    view = look_at(eye, target, width=8, height=8, focal=8 * 2**12)
    pixels = estimate(method, scene_of(objects, light), view, spp=spp, settings=settings).developed.P.reshape(
        -1, 3
    )
    return pixels.mean(axis=0), pixels.std(axis=0, ddof=1) / 8


@pytest.mark.case("BSDF-08", "MIS-02")
@pytest.mark.parametrize("alpha", [0.0, 0.02])
@pytest.mark.parametrize("mesh", [ball(at=(0, 0, 0)), box((1.0, 1.0, 1.0))], ids=["ball", "box"])
def test_bsdf_08_glass_under_an_even_sky_shows_the_sky(mesh, alpha):
    """What is divided by the index squared on the way in is multiplied on the way out."""
    for target in ((0, 0, 0), (0.4, 0, 0.3)):
        found, error = seen([of(replace(GLASS, alpha=alpha), mesh)], sky(), target=target, spp=256)
        loss = 0.03 if alpha else 0.0
        assert np.all(found > 1.0 - loss - 1e-4 - 4 * error) and np.all(found < 1.0 + 1e-4 + 4 * error)
    holds(glass_cases.glass_ball(0))


@pytest.mark.case("BSDF-07")
def test_bsdf_07_slab_lets_through_what_fresnel_says():
    assert pytest.approx(0.92308, abs=1e-5) == glass_cases.SLAB
    holds(glass_cases.slab(0))


def test_colour_is_left_after_depth():
    """Beer and Lambert: 0.5 m of a medium that leaves a half after 0.25 m leaves a quarter; and of what goes
    back and forth inside, less."""
    a = -np.log([0.5, 0.9, 1.0]) / 0.25
    slab = of(replace(GLASS, absorption=tuple(a)), box((8.0, 8.0, 0.5)))
    found, error = seen([slab], halves(0.0, 1.0), eye=(0, 0, 4), spp=4096)
    r, t = 0.04, np.exp(-a * 0.5)
    assert np.all(np.abs(found - (1 - r) ** 2 * t / (1 - (r * t) ** 2)) < 4 * error + 1e-4)


@pytest.mark.case("DPT-12")
def test_dpt_12_slab_shifts_what_lies_behind_by_snells_law():
    holds(glass_cases.slab_shift(0))


@pytest.mark.slow
@pytest.mark.case("BSDF-09")
def test_bsdf_09_water_in_glass_does_not_mind_an_overlap():
    """Water reaches into the glass, or its walls stand apart: what comes through two walls and the water is
    1 / (1 + sum R / (1 - R)) over the boundaries that are there (light that goes to and fro adds up)."""
    azimuth = 2 * np.pi * (0.5 - (np.arange(64) + 0.5) / 64)
    behind = np.where(np.cos(azimuth) < 0, 1.0, 0.0).astype(np.float32)
    light = Environment(np.broadcast_to(behind[None, :, None], (16, 64, 3)).copy())
    walls = [
        of(replace(GLASS, priority=2), box((0.1, 4.0, 4.0), centre=(x, 0, 0)), f"wall{x}")
        for x in (-0.55, 0.55)
    ]

    def through(*indices):
        n = np.array(indices)
        r = ((n[1:] - n[:-1]) / (n[1:] + n[:-1])) ** 2
        return 1 / (1 + np.sum(r / (1 - r)))

    wet = through(1, 1.5, 1.33, 1.5, 1)
    dry = through(1, 1.5, 1, 1.33, 1, 1.5, 1)
    assert wet - dry > 0.05
    for gap, truth in ((-1e-5, dry), (1e-5, wet), (1e-2, wet)):
        water = of(replace(GLASS, ior=1.33, priority=1), box((1.0 + 2 * gap, 4.0, 4.0)), "water")
        found, error = seen([*walls, water], light, eye=(4, 0, 0), spp=4096)
        assert np.all(np.abs(found - truth) < 4 * error + 1e-4)
    # Had the water the higher priority, the walls would be thinner, and nothing else.
    water = of(replace(GLASS, ior=1.33, priority=3), box((1.02, 4.0, 4.0)), "water")
    found, error = seen([*walls, water], light, eye=(4, 0, 0), spp=4096)
    assert np.all(np.abs(found - wet) < 4 * error + 1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("method", [ONE_PASS, TWO_PASS], ids=lambda m: m.name)
@pytest.mark.parametrize("alpha", [0.0, 0.3])
def test_baselines_have_the_same_mean(method, alpha):
    """Shadow and caustic of a glass ball in a corner."""
    scene = scene_of(
        [*corner(0.5), of(replace(GLASS, alpha=alpha), ball(0.5, at=(0.8, 0, 0.5)), camera=False)], sky()
    )
    ours, other = (probe(m, scene, (0.5, 0, 0), spp=2048, seed=s) for m, s in ((DELTA, 1), (method, 2)))
    error = np.hypot(ours.delta_error, other.delta_error)
    assert np.all(np.abs(ours.delta - other.delta) <= 4 * error + 1e-5)
    assert np.all(error < 0.05)


@pytest.mark.slow
def test_glass_ball_throws_a_caustic():
    """Light that a ball focuses under the sky's brighter half: brighter below it than beside its shadow."""
    light = halves(1.0, 0.0)
    lens = of(GLASS, icosphere(0.5, subdivisions=5, centre=(0, 0, 1.0)), camera=False)
    solid = virtual("solid", ball(0.5, at=(0, 0, 1.0)), 0.0, camera=False)
    clear, dark = (
        probe(DELTA, scene_of([real("floor", floor()), o], light), (0, 0, 0), spp=512) for o in (lens, solid)
    )
    assert np.all(clear.delta > dark.delta + 0.03)


@pytest.mark.case("DPT-16")
def test_dpt_16_what_has_the_index_of_air_changes_no_bit():
    holds(glass_cases.index_of_air(0))
    item = {"name": "bubble", "sphere": {"radius": "0.5 m"}, "material": {"type": "dielectric", "ior": 1.0}}
    assert "cannot be seen" in build_scene(None, [], [given.VirtualObject.model_validate(item)]).notes[0]
    coloured = item | {"material": {"type": "dielectric", "ior": 1.0, "colour": [1, 0.5, 0.5]}}
    scene = build_scene(None, [], [given.VirtualObject.model_validate(coloured)])
    assert not scene.notes and scene.objects[0].camera


def test_open_meshes_and_real_glass_are_told():
    open_sheet = {"name": "pane", "plane": {"size": ["1 m", "1 m"]}, "material": {"type": "dielectric"}}
    scene = build_scene(None, [], [given.VirtualObject.model_validate(open_sheet)])
    assert "not closed" in scene.notes[0]
    assert ball().is_closed() and box((1, 1, 1)).is_closed()
    with pytest.raises(ValueError, match="opaque"):
        given.RealObject.model_validate(open_sheet)
