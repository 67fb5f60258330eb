"""Guides of a filter, against geometry worked out by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mrbatch.contracts import Pipeline
from mrbatch.device.rays import resolve_engine
from mrbatch.device.runner import Runner
from mrbatch.device.timing import TimingNode
from mrbatch.film.binding import bind_view
from mrbatch.film.guides import NEED, guide_buffers, guide_pass, guides_of
from mrbatch.film.outputs import Outputs, ViewInput, ViewOutput
from mrbatch.film.rendering import FrameRenderer, Look, Source
from mrbatch.film.window import Window
from mrbatch.scene.closed_forms import floor, look_at, real, scene_of, virtual
from mrbatch.scene.mesh import plane
from mrbatch.scene.scene_data import upload
from mrbatch.scene.shading import ShadingFlags

WIDTH, HEIGHT = 24, 20


def guides(objects, *, needs=frozenset({NEED}), window=None, moments=0, **flags):
    engine = resolve_engine("auto")
    camera = look_at((0, 0, 5.0), (0, 0, 0), width=WIDTH, height=HEIGHT, focal=20.0)
    view = ViewOutput("", 0, window or Window(0, 0, WIDTH, HEIGHT))
    outputs = Outputs((view,), needs, 0, engine, shutter=moments > 0)
    scene = upload(scene_of(objects), engine)
    step = guide_pass(scene, view, outputs, ShadingFlags(**flags), False, "box")
    if step is None:
        return None, guide_buffers(view, outputs)
    pipeline = Pipeline(
        finish=(step,),
        buffers=guide_buffers(view, outputs),
        bind=lambda frame: {"": bind_view(scene, outputs, view, frame, photo=False)},
    )
    black = np.zeros((view.window.height, view.window.width, 3), np.float32)
    with Runner(1) as runner:
        renderer = FrameRenderer(runner, [Source("method", pipeline)], outputs, TimingNode("test"))
        given = {"": ViewInput(camera, black, np.ones(3))}
        looks = [Look(lambda: None, given)] * moments
        rendered = renderer.render(0, given, 2 * max(1, moments), looks=looks)
        return guides_of(view, rendered.buffers), pipeline.buffers


def objects():
    """A floor of 0.5, and at z = 1 a virtual card of 0.8 over pixels with x > 0 (world)."""
    card = plane(2.0, 8.0, centre=(1.0, 0.0, 1.0))
    return [real("floor", floor(), 0.5), virtual("card", card, 0.8)]


def test_each_side_tells_its_own_object_place_and_reflectance():
    found, _ = guides(objects())
    # The card's edge x = 0 falls on the border of columns 11 and 12; its other, x = 2, on column 22.
    assert (found.virtual.object[:, 12:22] == 2).all() and (found.virtual.object[:, :12] == 0).all()
    assert (found.real.object[:, :12] == 1).all() and (found.real.object[:, 12:22] == 0).all()
    assert np.allclose(found.virtual.normal[:, 12:22], [0, 0, 1], atol=1e-6)
    assert np.allclose(found.virtual.reflectance[:, 12:22], 0.8) and np.allclose(
        found.real.reflectance[:, :12], 0.5
    )
    # Pixel (x, y) sees (x + 1/2 - 12) / 20 of the distance to the side: 4 m to the card, 5 m to the floor.
    assert np.allclose(found.virtual.position[5, 12:22, 0], (np.arange(12, 22) - 11.5) / 20 * 4, atol=0.02)
    assert np.allclose(found.real.position[5, :12, 0], (np.arange(12) - 11.5) / 20 * 5, atol=0.02)
    assert np.ptp(found.real.position[..., 2][:, :12]) < 1e-5


def test_a_pixel_that_shows_two_objects_says_so():
    left, right = (plane(8.0, 16.0, centre=(x + 0.06, 0, 0)) for x in (-4.0, 4.0))
    found, _ = guides([real("left", left), real("right", right)])
    assert (found.real.object[:, :12] == 1).all() and (found.real.object[:, 13:] == 2).all()
    assert (found.real.object[:, 12] == -1).all()


def test_moments_of_an_exposure_add_up():
    """Four looks at what does not move share the samples of one, and give the same guides."""
    once, often = guides(objects())[0], guides(objects(), moments=4)[0]
    for side in ("virtual", "real"):
        for part in ("object", "normal", "position", "reflectance"):
            assert np.array_equal(getattr(getattr(once, side), part), getattr(getattr(often, side), part))


def test_a_crop_has_the_guides_of_the_whole():
    whole, _ = guides(objects())
    part, _ = guides(objects(), window=Window(7, 3, 11, 9))
    for side in ("virtual", "real"):
        for name in ("object", "normal", "position", "reflectance"):
            a, b = (getattr(getattr(g, side), name) for g in (whole, part))
            assert np.array_equal(a[3:12, 7:18], b)


@pytest.mark.parametrize("needs", [frozenset(), frozenset({"depth"})])
def test_without_a_filter_there_is_neither_pass_nor_buffer(needs):
    step, buffers = guides(objects(), needs=needs)
    assert step is None and buffers == ()


def test_behind_a_veil_both_sides_are_seen():
    """A card of opacity 1/2: its own guide, and the floor's where rays pass it."""
    ground, card = objects()
    veil = replace(card, material=replace(card.material, opacity=0.5))
    found, _ = guides([ground, veil], cutouts=True)
    inside = np.s_[:, 12:22]
    assert (found.virtual.object[inside] == 2).all() and (found.real.object[inside] == 1).all()
    assert np.allclose(found.virtual.reflectance[inside], 0.8)
    assert np.allclose(found.real.reflectance[inside], 0.5)
    assert np.allclose(found.virtual.position[inside][..., 2], found.virtual.position[0, 13, 2], atol=1e-6)
    assert (found.virtual.position[inside][..., 2] > found.real.position[inside][..., 2] + 0.9).all()
