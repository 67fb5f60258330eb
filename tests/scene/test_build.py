"""From the job's words to the scene: textures, the turn of the map, and what is refused."""

from __future__ import annotations

import cv2
import numpy as np
import OpenImageIO as oiio
import pytest

from mrbatch.errors import InputError
from mrbatch.scene import settings as given
from mrbatch.scene.build import build_scene

RNG = np.random.default_rng(11)


def scene_with(texture, **look):
    item = given.RealObject.model_validate(
        {
            "name": "floor",
            "plane": {"size": ["1 m", "1 m"]},
            "reflectance": {"texture": str(texture), **look},
        }
    )
    return build_scene(None, [item], [])


def write(path, values, kind, names=None, **attributes):
    spec = oiio.ImageSpec(values.shape[1], values.shape[0], values.shape[2], kind)
    if names:
        spec.channelnames = names
    for name, value in attributes.items():
        spec.attribute(name, oiio.TypeDesc("float[8]"), value)
    out = oiio.ImageOutput.create(str(path))
    assert out.open(str(path), spec) and out.write_image(values) and out.close()
    return path


def test_textures_are_read_by_their_curve(tmp_path):
    codes = RNG.integers(0, 256, (6, 5, 3)).astype(np.uint8)
    path = write(tmp_path / "t.png", codes, "uint8")
    v = codes / 255.0
    truth = np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4)
    pixels = scene_with(path).objects[0].material.texture.pixels
    np.testing.assert_allclose(pixels, truth, rtol=1e-6)
    np.testing.assert_allclose(
        scene_with(path, colour="linear").objects[0].material.texture.pixels, v, rtol=1e-6
    )


def test_a_texture_that_is_cut_short_is_refused(tmp_path):
    """Decoders fill the missing half with grey and report it beside the picture."""
    path = tmp_path / "t.jpg"
    cv2.imwrite(str(path), RNG.integers(0, 256, (64, 64, 3)).astype(np.uint8))
    scene_with(path)
    data = path.read_bytes()
    cut = tmp_path / "cut.jpg"
    for share in (0.3, 0.6, 0.9):
        cut.write_bytes(data[: int(share * len(data))])
        with pytest.raises(InputError, match="damaged or cut short"):
            scene_with(cut)


P3 = (0.680, 0.320, 0.265, 0.690, 0.150, 0.060, 0.3127, 0.3290)


def test_primaries_that_a_texture_names_are_converted_and_noted(tmp_path):
    values = np.full((2, 2, 3), 0.5, np.float32)
    values[0, 0] = (1.0, 0.0, 0.0)
    scene = scene_with(write(tmp_path / "t.exr", values, "float", chromaticities=P3))
    pixels = scene.objects[0].material.texture.pixels
    np.testing.assert_allclose(pixels[1, 1], 0.5, atol=1e-6)
    np.testing.assert_array_equal(pixels[0, 0], [1.0, 0.0, 0.0])  # 1.22 of Rec.709's red is no reflectance
    assert len(scene.notes) == 1 and "t.exr" in scene.notes[0] and "1 texels" in scene.notes[0]


def test_a_texture_of_other_channels_is_refused(tmp_path):
    path = write(tmp_path / "t.exr", np.zeros((2, 2, 3), np.float32), "float", ("X", "Y", "Z"))
    with pytest.raises(InputError, match="channels"):
        scene_with(path)


@pytest.mark.parametrize(
    ("yaw", "row"),
    [
        ("90 deg", [0.0, -1.0, 0.0]),
        ("180 deg", [-1.0, 0.0, 0.0]),
        ("-90 deg", [0.0, 1.0, 0.0]),
        ("270 deg", [0.0, 1.0, 0.0]),
        ("450 deg", [0.0, -1.0, 0.0]),
        ("0.25 turn", [0.0, -1.0, 0.0]),
        ("3600 deg", [1.0, 0.0, 0.0]),
    ],
)
def test_quarter_turns_of_a_job_are_exact(tmp_path, yaw, row):
    path = write(tmp_path / "sky.exr", np.ones((2, 4, 3), np.float32), "float")
    light = given.Environment.model_validate({"file": str(path), "yaw": yaw})
    np.testing.assert_array_equal(build_scene(light, [], []).environment.world_from_map[0], row)


def test_other_turns_and_matrices_of_a_job(tmp_path):
    path = write(tmp_path / "sky.exr", np.ones((2, 4, 3), np.float32), "float")
    light = given.Environment.model_validate({"file": str(path), "yaw": "30 deg"})
    got = build_scene(light, [], []).environment.world_from_map
    np.testing.assert_allclose(got, [[0.75**0.5, -0.5, 0], [0.5, 0.75**0.5, 0], [0, 0, 1]], atol=1e-15)
    matrix = [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
    light = given.Environment.model_validate({"file": str(path), "world_from_map": matrix})
    np.testing.assert_array_equal(build_scene(light, [], []).environment.world_from_map, matrix)


@pytest.mark.parametrize("switch", ["camera", "cast_shadow", "receive", "holdout"])
def test_every_object_has_every_switch(switch):
    usual = switch != "holdout"
    shape = {"plane": {"size": ["1 m", "1 m"]}}
    for word in ({}, {switch: not usual}):
        items = [
            given.RealObject.model_validate({"name": "a", "reflectance": 0.5, **shape, **word}),
            given.VirtualObject.model_validate({"name": "b", **shape, **word}),
        ]
        scene = build_scene(None, items[:1], items[1:])
        wanted = word.get(switch, usual)
        assert [getattr(o, switch) for o in scene.objects] == [wanted, wanted]


def test_a_real_surface_has_a_reflectance_or_a_material():
    base = {"name": "floor", "plane": {"size": ["1 m", "1 m"]}}
    look = {"type": "principled", "reflectance": 0.4, "roughness": 0.2}
    scene = build_scene(None, [given.RealObject.model_validate(base | {"material": look})], [])
    material = scene.objects[0].material
    assert (material.kind, material.alpha, material.f0) == ("principled", 0.2, pytest.approx(0.04))
    for wrong in (base, base | {"material": look, "reflectance": 0.5}):
        with pytest.raises(ValueError, match="one of `reflectance` and `material`"):
            given.RealObject.model_validate(wrong)
