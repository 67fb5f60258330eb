"""Light that virtual objects send of themselves, against closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from held import holds

from mrbatch.methods.light_change_cases import glowing_ball
from mrbatch.methods.probe import probe
from mrbatch.methods.registry import method as get_method
from mrbatch.scene.closed_forms import ball, placed, scene_of, sky, virtual
from mrbatch.scene.mesh import plane
from mrbatch.scene.scene import Material, SceneObject, Texture

TRACERS = ["delta-path-tracing", "one-pass", "two-pass"]


def agrees(found, error, oracle, tolerance):
    room = tolerance + 4 * np.asarray(error)
    assert np.all(np.abs(np.asarray(found) - oracle) <= room), (found, oracle, room)


def glowing(emission, reflectance=0.0, **more):
    grey = (reflectance,) * 3
    return Material(reflectance=grey, emission=tuple(np.broadcast_to(emission, 3).tolist()), **more)


@pytest.mark.case("DPT-09", "TRAP-1f")
@pytest.mark.parametrize("name", TRACERS)
def test_dpt_09_black_ball_that_glows(name):
    """DPT-09, TRAP-1f: rr F (L_e - 1); a ball as bright as the sky cannot be told from it."""
    holds(glowing_ball(get_method(name), 0))


@pytest.mark.parametrize("name", [*TRACERS, "image-based-lighting"])
@pytest.mark.parametrize("depth", [None, 2])
def test_what_glows_is_seen_glowing(name, depth):
    """What is sent of itself beside what is reflected of the sky."""
    item = SceneObject("lamp", plane(2, 2), glowing((2.0, 3.0, 4.0), 0.5), True)
    settings = {"max_depth": depth} if name != "image-based-lighting" else {}
    shown = probe(get_method(name), scene_of([item]), (0, 0, 0), spp=64, settings=settings)
    agrees(shown.virtual, shown.virtual_error, np.array([2.5, 3.5, 4.5]), 1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("name", TRACERS)
def test_a_mirror_shows_the_lamp(name):
    mirror = SceneObject("mirror", plane(1, 1), Material("conductor", (0.5,) * 3, 0.0), True)
    above = placed(plane(400, 400), at=(0, 0, 10.0), normal=(0, 0, -1))
    lamp = SceneObject("lamp", above, glowing((2.0, 3.0, 4.0)), True)
    shown = probe(get_method(name), scene_of([mirror, lamp], sky(0.0)), (0, 0, 0), distance=1.0, spp=64)
    agrees(shown.virtual, shown.virtual_error, np.array([1.0, 1.5, 2.0]), 5e-3)


def test_lamp_in_a_white_room_adds_up():
    """Two large parallel walls of reflectance r, one glowing: e / (1 - r^2) and r e / (1 - r^2)."""
    e, r, size = 1.0, 0.6, 2.0**12
    lower = SceneObject("lamp", plane(size, size), glowing(e, r), True)
    upper = SceneObject(
        "wall", placed(plane(size, size), at=(0, 0, 1.0), normal=(0, 0, -1)), glowing(0, r), True
    )
    scene = scene_of([lower, upper], sky(0.0))
    method = get_method("delta-path-tracing")
    shown = probe(method, scene, (0, 0, 0), distance=0.5, spp=512)
    agrees(shown.virtual[0], shown.virtual_error[0], e / (1 - r * r), 2e-3)
    shown = probe(method, scene, (0, 0, 1.0), distance=0.5, spp=512, normal=(0, 0, -1))
    agrees(shown.virtual[0], shown.virtual_error[0], r * e / (1 - r * r), 2e-3)


def test_emission_varies_with_its_texture():
    half = np.zeros((1, 8, 3), np.float32)
    half[:, :4] = 3.0
    look = glowing(1.0, emission_texture=Texture(half))
    scene = scene_of([SceneObject("lamp", plane(2, 2), look, True)], sky(0.0))
    for x, expected in ((-0.5, 3.0), (0.5, 0.0)):
        shown = probe(get_method("delta-path-tracing"), scene, (x, 0, 0), spp=16)
        agrees(shown.virtual, shown.virtual_error, expected, 1e-5)


def test_the_mask_holds_what_a_lamp_lights():
    """A bright speck lights a table far around: no tile that it changes may be left out."""
    from test_influence import camera, skipped_change, table

    lamp = replace(virtual("lamp", ball(0.05, at=(0, 0, 0.3), subdivisions=2)), material=glowing(50.0))
    skipped, excess = skipped_change([table(40.0), lamp], sky(0.2), camera(), 0.02, spp=512)
    assert excess <= 0.0
    dim = replace(lamp, material=glowing(0.1))
    fewer, excess = skipped_change([table(40.0), dim], sky(0.2), camera(), 0.02, spp=512)
    assert excess <= 0.0 and fewer > skipped
