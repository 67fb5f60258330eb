"""Geometry that a light change must get right: doubled and broken surfaces, facets, mirrors, edges of the
frame; against closed forms, and against scenes that must give the same bits."""

from __future__ import annotations

import numpy as np
import pytest
from held import holds

from mrbatch.methods.delta_path_tracing import mesh_cases, picture_cases, shadow_cases
from mrbatch.methods.delta_path_tracing.cases import delta_probe as probe
from mrbatch.scene.closed_forms import (
    ball,
    ball_share,
    floor,
    real,
    scene_of,
    upright_share,
    virtual,
)

# --- meshes -----------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.case("GEO-04")
def test_broken_triangles_show_in_no_bit():
    """A file with triangles of no area, repeated corners and vertices that are no numbers; one without."""
    holds(mesh_cases.broken_mesh(0))


@pytest.mark.slow
@pytest.mark.case("GEO-06", "TRAP-3i")
def test_a_surface_that_is_there_twice_is_there_once():
    """Real and virtual surfaces doubled in place: rays that meet both and leave either give the same bits."""
    holds(mesh_cases.doubled(0))


@pytest.mark.case("GEO-09")
def test_a_coarse_smooth_ball_takes_no_light_from_below_its_facets():
    """A ball of 16 x 8 facets with smooth normals, which does not shade itself: shading normals see beyond
    the facet's horizon, and what they see there must not count."""
    _, _, normal, smooth = mesh_cases.facet_point(40, (0.9, 0.05, 0.05))
    assert mesh_cases.lit_below(normal).irradiance(smooth[None])[0, 0] > 0.01, "printed form: a leak"
    holds(mesh_cases.terminator(0))


# --- closed forms -----------------------------------------------------------------------------------


@pytest.mark.case("DPT-02")
@pytest.mark.parametrize("s", [0.25, 0.5, 1.0, 2.0, 4.0])
def test_black_ball_on_a_plane_to_a_thousandth(s):
    """-rr F with F = (1 + s^2)^-1.5: .913, .716, .354, .0894, .0143 at a quarter to four radii."""
    table = {0.25: 0.913, 0.5: 0.716, 1.0: 0.354, 2.0: 0.0894, 4.0: 0.0143}
    share = float(ball_share(1.0, 1.0, s))
    assert share == pytest.approx(table[s], abs=6e-4)
    scene = scene_of([real("floor", floor(), 0.5), virtual("ball", ball(), 0.0, camera=False)])
    found = probe(scene, (s, 0, 0), spp=2048)
    assert np.all(np.abs(found.delta + 0.5 * share) < 1e-3 * 0.5 * share + 4 * found.delta_error)
    assert np.all(found.delta_error < 1e-2 * 0.5 * share)


@pytest.mark.case("DPT-04", "TRAP-1e")
@pytest.mark.parametrize("name", shadow_cases.white_things())
def test_any_white_thing_on_a_white_floor_changes_nothing(name):
    holds(shadow_cases.white_meshes(0, names=(name,)))


@pytest.mark.slow
@pytest.mark.case("DPT-06")
def test_upright_mirror_takes_what_it_does_not_mirror():
    assert upright_share(1.0, 1.0, 0.5) == pytest.approx(0.12427, abs=1e-5)
    holds(shadow_cases.upright_mirror(0, reflectances=(0.0, 0.4, 1.0)))


# --- in front and behind ----------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.case("DPT-07")
def test_what_stands_in_a_closed_real_box_changes_nothing_outside():
    holds(shadow_cases.closed_box(0))


@pytest.mark.case("DPT-10")
def test_a_shadow_in_the_frame_of_a_thing_outside_is_that_of_a_wider_frame():
    holds(picture_cases.wider_frame(0))


@pytest.mark.case("DPT-14")
def test_a_real_pole_hides_what_stands_behind_it():
    """M is 0 where the pole is: exactly, pixel by pixel, and the pole has its own light change."""
    holds(picture_cases.real_pole(0))


@pytest.mark.case("ENV-08")
def test_the_tip_of_a_shadow_is_where_the_lamps_texel_throws_it():
    holds(picture_cases.shadow_tip(0, lamps=((40, 300, 0.0), (44, 37, 0.0), (36, 300, 0.37))))


@pytest.mark.case("IO-07")
@pytest.mark.parametrize("size", [(1, 1), (1279, 719), (1, 4096)])
def test_odd_sizes_are_crops_of_larger_pictures(size):
    holds(picture_cases.odd_size(0, sizes=(size,)))


@pytest.mark.case("DPT-18")
def test_a_virtual_lamp_behind_a_virtual_blocker_lights_nothing():
    """What is behind takes no part: rr (F_lamp (L_e - 1) - F_black) over what the floor sees of each."""
    holds(shadow_cases.lamp_and_blocker(0))
