"""Opacity from a job: numbers, pictures, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from mrbatch.errors import InputError
from mrbatch.scene.build import build_scene, scene_files
from mrbatch.scene.opacity import with_opacity
from mrbatch.scene.scene import Material, Texture
from mrbatch.scene.settings import RealObject, VirtualObject

CODES = np.array([[0, 51], [204, 255]], np.uint8)


def built(opacity, **more):
    item = {"name": "leaf", "plane": {"size": ["1 m", "1 m"]}, "opacity": opacity, **more}
    return build_scene(None, [], [VirtualObject.model_validate(item)])


def with_alpha(path):
    pixels = np.full((2, 2, 4), 77, np.uint8)
    pixels[..., 3] = CODES
    Image.fromarray(pixels).save(path)
    return str(path)


def test_a_number():
    (item,) = built(0.25).objects
    assert item.material.opacity == 0.25 and item.material.cut_out and item.material.see_through
    (item,) = built(1).objects
    assert not item.material.cut_out
    # What is not there is neither seen nor throws a shadow, and that is said.
    scene = built(0)
    assert not scene.objects[0].camera and not scene.objects[0].cast_shadow
    assert "cannot be seen" in scene.notes[0]


def test_a_picture(tmp_path):
    """Code values as they are: opacity is no light, and has no transfer function."""
    path = with_alpha(tmp_path / "leaf.png")
    (item,) = built({"texture": path}).objects
    np.testing.assert_allclose(item.material.opacity_texture.pixels[..., 0], CODES / 255, rtol=1e-6)
    assert item.material.opacity == pytest.approx(CODES.mean() / 255) and item.material.opacity_cutoff == 0
    (item,) = built({"texture": path, "channel": "red"}).objects
    assert item.material.opacity_texture is None and item.material.opacity == pytest.approx(77 / 255)
    (item,) = built({"texture": path, "cutoff": 0.5}).objects
    assert item.material.opacity_cutoff == 0.5 and item.material.opacity == 0.5
    grey = tmp_path / "grey.png"
    Image.fromarray(CODES).save(grey)
    (item,) = built({"texture": str(grey)}).objects
    np.testing.assert_allclose(item.material.opacity_texture.pixels[..., 0], CODES / 255, rtol=1e-6)


def test_its_file_belongs_to_the_job(tmp_path):
    path = with_alpha(tmp_path / "leaf.png")
    item = {"name": "leaf", "plane": {"size": ["1 m", "1 m"]}, "opacity": {"texture": path}}
    files = scene_files(None, [], [VirtualObject.model_validate(item)])
    assert [p.name for p in files] == ["leaf.png"]


def test_what_cannot_be_is_refused(tmp_path):
    with pytest.raises(ValueError, match="less than or equal to 1"):
        built(1.5)
    path = with_alpha(tmp_path / "leaf.png")
    with pytest.raises(ValueError, match="greater than 0"):
        built({"texture": path, "cutoff": 0.0})
    grey = tmp_path / "grey.png"
    Image.fromarray(CODES).save(grey)
    with pytest.raises(InputError, match="no alpha channel"):
        built({"texture": str(grey), "channel": "alpha"})
    with pytest.raises(InputError, match="no such texture"):
        built({"texture": str(tmp_path / "none.png")})
    stl = tmp_path / "box.stl"
    import trimesh

    trimesh.creation.box().export(stl)
    with pytest.raises(InputError, match="no texture coordinates"):
        item = {"name": "leaf", "mesh": str(stl), "opacity": {"texture": path}}
        build_scene(None, [], [VirtualObject.model_validate(item)])
    real = {"name": "table", "plane": {"size": ["1 m", "1 m"]}, "reflectance": 0.5, "opacity": 0.5}
    with pytest.raises(ValueError, match="opacity"):
        RealObject.model_validate(real)


def test_pictures_that_say_the_same_all_over_are_numbers():
    look = Material()
    assert with_opacity(look, np.ones((3, 3))) == look
    assert with_opacity(look, np.full((3, 3), 0.7), cutoff=0.5) == look
    assert with_opacity(look, np.full((3, 3), 0.3), cutoff=0.5).opacity == 0.0
    assert with_opacity(look, 0.5).opacity == 0.5
    # Made by hand, a texture of ones is no cut-out either; nor is one whose every value is beyond the cut.
    ones = Texture(np.ones((2, 2, 3), np.float32))
    assert not Material(opacity_texture=ones).cut_out
    assert not Material(opacity_texture=Texture(ones.pixels * 0.6), opacity_cutoff=0.5).cut_out
    assert Material(opacity_texture=Texture(ones.pixels * 0.4), opacity_cutoff=0.5).cut_out
