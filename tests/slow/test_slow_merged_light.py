"""Composites lit by the map merged from JPEG files, against the same lit by the map they were made from."""

from __future__ import annotations

from dataclasses import replace

import pytest
from desk_scene import SETS, desk, region_window, render

import mrbatch
from mrbatch.film.composite import composite
from mrbatch.methods.delta_path_tracing import METHOD
from mrbatch.metrics.errors import image_errors
from mrbatch.metrics.region import noisy_region_of_interest
from mrbatch.scene.environment import load_environment

pytestmark = [pytest.mark.slow, pytest.mark.data]


@pytest.mark.parametrize("kind", ["diffuse", "metal"])
@pytest.mark.parametrize("name", SETS)
def test_a_merged_map_lights_as_the_true_one(tmp_path, shared_data, name, kind, capsys):
    """HDR-FLIP below 0.02 over the pixels that the bunny changes; what another seed gives is noise.

    A map half as bright again fails, so the figure can tell.
    """
    scene = desk(shared_data, name, kind)
    times = [4.0**k / 4096.0 for k in range(9)]
    brackets = [scene.folder / f"bracket_{k}.jpg" for k in range(9)]
    mrbatch.merge_hdr(brackets, tmp_path / "merged.exr", times=times)
    merged = load_environment(tmp_path / "merged.exr", rows="endpoints")
    photo = scene.photo(0)
    region = noisy_region_of_interest(scene.truth(0), photo)
    window = region_window(region)
    part = region[window.y : window.y + window.height, window.x : window.x + window.width]

    def picture(light, seed=0, brighter=1.0):
        lit = replace(scene, scene=replace(scene.scene, environment=light), gain=scene.gain * brighter)
        found = render(METHOD, lit, 0, window, spp=256, seed=seed)
        d = found.developed
        return composite(d.P, d.a, found.background, d.D)

    true = load_environment(scene.folder / "environment.exr", rows="endpoints")
    reference = picture(true)

    def flip(light, **changed):
        return image_errors(picture(light, **changed), reference, region=part, flip=True).region.flip_hdr

    found, noise, half_again = flip(merged), flip(true, seed=1), flip(true, brighter=1.5)
    with capsys.disabled():
        figures = f"{found:.4f}, other seed {noise:.4f}, half as bright again {half_again:.4f}"
        print(f"\n{name} {kind}: HDR-FLIP {figures}")
    assert found < 0.02 < half_again
