"""Materials of glTF files: factors, textures and what is left out, and how they look when rendered."""

from __future__ import annotations

import io
import json

import numpy as np
import pytest
from PIL import Image

from mrbatch.errors import InputError
from mrbatch.kernels.transfer import to_linear
from mrbatch.scene.build import build_scene, scene_files
from mrbatch.scene.settings import VirtualObject

COLOURS = np.array([[[255, 0, 0], [0, 128, 0]], [[0, 0, 64], [200, 200, 200]]], np.uint8)
"""Rows from the top: glTF's v runs downwards."""
SURFACE = np.array([[[9, 0, 0], [9, 255, 0]], [[9, 128, 255], [9, 51, 128]]], np.uint8)


def picture(codes: np.ndarray) -> Image.Image:
    image = Image.fromarray(codes)
    image.format = "PNG"
    return image


def card(**material):
    """A unit square in the xy plane with uv 0..1 and a material of its own."""
    import trimesh

    look = trimesh.visual.material.PBRMaterial(**material)
    vertices = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    # trimesh counts v upwards and turns it when it writes.
    visual = trimesh.visual.TextureVisuals(uv=vertices[:, :2], material=look)
    return trimesh.Trimesh(vertices, [[0, 1, 2], [0, 2, 3]], visual=visual, process=False)


def write(path, **cards):
    import trimesh

    path.write_bytes(trimesh.Scene(cards).export(file_type="glb"))
    return path


def built(path, **keys):
    item = VirtualObject.model_validate({"name": "thing", "mesh": str(path), **keys})
    return build_scene(None, [], [item])


def test_factors_alone(tmp_path):
    path = write(
        tmp_path / "a.glb",
        one=card(
            baseColorFactor=[0.5, 0.25, 1.0, 1.0], metallicFactor=0.75, roughnessFactor=0.5, name="paint"
        ),
    )
    (item,) = built(path).objects
    m = item.material
    assert (item.name, m.name, m.kind, m.f0) == ("thing", "paint", "principled", 0.04)
    # trimesh keeps factors as bytes.
    np.testing.assert_allclose(m.reflectance, [0.5, 0.25, 1.0], atol=1 / 255)
    assert m.metalness == pytest.approx(0.75) and m.alpha == pytest.approx(0.25)
    assert m.texture is None and m.surface_texture is None


def test_textures(tmp_path):
    path = write(
        tmp_path / "a.glb",
        one=card(
            baseColorTexture=picture(COLOURS),
            baseColorFactor=[1.0, 1.0, 0.2, 1.0],
            metallicRoughnessTexture=picture(SURFACE),
            roughnessFactor=0.5,
            metallicFactor=1.0,
        ),
    )
    (item,) = built(path).objects
    linear = to_linear(COLOURS, "srgb", 8)
    np.testing.assert_allclose(item.material.texture.pixels, linear * [1.0, 1.0, 0.2], atol=2e-3)
    found = item.material.surface_texture.pixels
    np.testing.assert_allclose(found[..., 0], (SURFACE[..., 1] / 255 * 0.5) ** 2, rtol=1e-5)
    np.testing.assert_allclose(found[..., 1], SURFACE[..., 2] / 255, rtol=1e-5)
    assert item.mesh.uvs is not None


def test_each_material_is_an_object_of_the_same_name(tmp_path):
    path = write(
        tmp_path / "a.glb",
        one=card(baseColorFactor=[1.0, 0.0, 0.0, 1.0], name="red"),
        two=card(baseColorFactor=[0.0, 0.0, 1.0, 0.5], name="blue", alphaMode="BLEND"),
    )
    scene = built(path)
    assert [o.name for o in scene.objects] == ["thing", "thing"]
    assert {o.material.name for o in scene.objects} == {"red", "blue"}
    assert sorted(o.material.opacity for o in scene.objects) == pytest.approx([0.5, 1.0], abs=1 / 255)
    # A material of the job stands for all of the file's.
    (alone,) = built(path, material={"type": "diffuse", "reflectance": 0.3}).objects
    assert alone.material.kind == "diffuse" and len(alone.mesh.faces) == 4
    # Other files have no material.
    import trimesh

    stl = tmp_path / "b.stl"
    trimesh.creation.box().export(stl)
    assert built(stl).objects[0].material.kind == "diffuse"


ALPHA = np.array([[0, 64], [128, 255]], np.uint8)
LEAF = np.dstack([COLOURS, ALPHA])


def test_alpha_counts_as_its_mode_says(tmp_path):
    """glTF 2.0, 3.9.4: OPAQUE ignores alpha, BLEND takes it, MASK cuts at alphaCutoff (0.5)."""
    looks = {"baseColorTexture": picture(LEAF), "baseColorFactor": [1.0, 1.0, 1.0, 0.5]}
    for mode in (None, "OPAQUE"):
        (item,) = built(write(tmp_path / "a.glb", one=card(**looks, alphaMode=mode))).objects
        assert not item.material.see_through and item.material.opacity_texture is None
    (item,) = built(write(tmp_path / "a.glb", one=card(**looks, alphaMode="BLEND"))).objects
    found = item.material
    # trimesh keeps factors as bytes.
    np.testing.assert_allclose(found.opacity_texture.pixels[..., 0], ALPHA / 255 / 2, atol=1 / 255)
    assert found.opacity_cutoff == 0.0
    np.testing.assert_allclose(found.texture.pixels, to_linear(COLOURS, "srgb", 8), atol=1e-6)
    del looks["baseColorFactor"]
    (item,) = built(write(tmp_path / "a.glb", one=card(**looks, alphaMode="MASK"))).objects
    np.testing.assert_allclose(item.material.opacity_texture.pixels[..., 0], ALPHA / 255, rtol=1e-6)
    assert item.material.opacity_cutoff == 0.5 and item.material.opacity == 0.5
    # A cut that no texel fails, and one that all do.
    for cutoff, opacity in ((0.0, 1.0), (1.1, 0.0)):
        path = write(tmp_path / "a.glb", one=card(**looks, alphaMode="MASK", alphaCutoff=cutoff))
        (item,) = built(path).objects
        assert item.material.opacity == opacity and item.material.opacity_texture is None
        assert item.camera == (opacity > 0)
    # The job's word stands for the file's.
    path = write(tmp_path / "a.glb", one=card(**looks, alphaMode="MASK"))
    assert built(path, opacity=0.25).objects[0].material.opacity == 0.25


def with_extensions(path, extensions, **material):
    """A glTF file whose one material has these extensions."""
    import trimesh

    files = trimesh.exchange.gltf.export_gltf(trimesh.Scene({"one": card(name="glass", **material)}))
    for name, data in files.items():
        (path / name).write_bytes(data)
    header = json.loads((path / "model.gltf").read_text())
    header["materials"][0]["extensions"] = extensions
    (path / "model.gltf").write_text(json.dumps(header))
    return path / "model.gltf"


def test_transmission_is_glass(tmp_path):
    """KHR_materials_transmission alone is thin; with a thickness of KHR_materials_volume it is solid."""
    passing = {"KHR_materials_transmission": {"transmissionFactor": 1.0}}
    colour = [0.5, 1.0, 1.0, 1.0]
    path = with_extensions(tmp_path, passing, baseColorFactor=colour, roughnessFactor=0.0)
    scene = built(path)
    look = scene.objects[0].material
    assert look.kind == "thin_dielectric" and look.ior == 1.5 and scene.notes == ()
    np.testing.assert_allclose(look.reflectance, colour[:3], atol=1 / 255)
    volume = {"thicknessFactor": 0.01, "attenuationColor": [0.25, 1.0, 1.0], "attenuationDistance": 0.02}
    solid = {**passing, "KHR_materials_volume": volume, "KHR_materials_ior": {"ior": 1.33}}
    scene = built(with_extensions(tmp_path, solid, roughnessFactor=0.5))
    look = scene.objects[0].material
    assert look.kind == "dielectric" and look.ior == 1.33 and look.alpha == pytest.approx(0.25)
    np.testing.assert_allclose(look.absorption, [np.log(4.0) / 0.02, 0.0, 0.0], atol=1e-9)
    flat = {**passing, "KHR_materials_volume": {"thicknessFactor": 0.0}}
    assert built(with_extensions(tmp_path, flat)).objects[0].material.kind == "thin_dielectric"


def test_the_jobs_opacity_and_a_files_glass(tmp_path):
    passing = {"KHR_materials_transmission": {"transmissionFactor": 1.0}}
    path = with_extensions(tmp_path, passing, roughnessFactor=0.0)
    scene = built(path, opacity=0.5, emission=1.0)
    look = scene.objects[0].material
    assert look.kind == "thin_dielectric" and not look.cut_out and not look.most_emission.any()
    assert "what the job says of opacity" in scene.notes[0]


def test_what_of_glass_is_left_out_is_told(tmp_path):
    half = {"KHR_materials_transmission": {"transmissionFactor": 0.3}}
    scene = built(with_extensions(tmp_path, half))
    assert scene.objects[0].material.kind == "principled"
    assert scene.notes == ("model.gltf: the part that lets light through of its material left out",)
    rough = {"KHR_materials_transmission": {"transmissionFactor": 1.0}}
    assert "roughness" in built(with_extensions(tmp_path, rough, roughnessFactor=0.5)).notes[0]
    # Nonsense is no glass, and no crash.
    for wrong in ({"transmissionFactor": "much"}, {"transmissionFactor": None}, {}):
        path = with_extensions(tmp_path, {"KHR_materials_transmission": wrong})
        assert built(path).objects[0].material.kind == "principled"
    odd = {"thicknessFactor": 1, "attenuationColor": [1, "x", None], "attenuationDistance": 0}
    path = with_extensions(tmp_path, {**rough, "KHR_materials_volume": odd, "KHR_materials_ior": {"ior": []}})
    assert built(path).objects[0].material.absorption == (0.0, 0.0, 0.0)
    path = with_extensions(tmp_path, {**rough, "KHR_materials_volume": {**odd, "attenuationColor": "red"}})
    assert built(path).objects[0].material.ior == 1.5
    path = with_extensions(tmp_path, {"KHR_materials_transmission": 5})
    assert built(path).objects[0].material.kind == "principled"


def test_emission(tmp_path):
    path = write(
        tmp_path / "a.glb", one=card(emissiveTexture=picture(COLOURS), emissiveFactor=[1.0, 0.5, 0.0])
    )
    (item,) = built(path).objects
    linear = to_linear(COLOURS, "srgb", 8)
    np.testing.assert_allclose(item.material.emission_texture.pixels, linear * [1.0, 0.5, 0.0], atol=1e-6)
    (item,) = built(path, emission=[2.0, 3.0, 4.0]).objects
    assert item.material.emission == (2.0, 3.0, 4.0) and item.material.emission_texture is None
    (item,) = built(path, emission=0, material={"type": "diffuse"}).objects
    assert not item.material.most_emission.any()


def test_normal_maps_are_vectors(tmp_path):
    codes = np.array([[[128, 128, 255], [255, 128, 128]]], np.uint8)
    (item,) = built(write(tmp_path / "a.glb", one=card(normalTexture=picture(codes)))).objects
    found = item.material.normal_texture.pixels
    np.testing.assert_allclose(found, [[[0, 0, 1], [1, 0, 0]]], atol=1.01 / 255)


def test_a_damaged_texture_is_refused(tmp_path):
    good = io.BytesIO()
    noise = np.random.default_rng(0).integers(0, 256, (64, 64, 3), np.uint8)
    Image.fromarray(noise).save(good, "PNG")
    path = write(tmp_path / "a.glb", one=card(baseColorTexture=picture(noise)))
    data = path.read_bytes()
    start = data.index(b"\x89PNG")
    broken = data[: start + 200] + bytes(len(data) - start - 200)
    path.write_bytes(broken)
    with pytest.raises(InputError, match="texture of the file"):
        built(path)


def test_pictures_beside_a_gltf_belong_to_it(tmp_path):
    import trimesh

    files = trimesh.exchange.gltf.export_gltf(trimesh.Scene({"one": card(baseColorTexture=picture(COLOURS))}))
    for name, data in files.items():
        (tmp_path / name).write_bytes(data)
    path = tmp_path / "model.gltf"
    header = json.loads(path.read_text())
    Image.fromarray(COLOURS).save(tmp_path / "colours.png")
    header["images"] = [{"uri": "colours.png"}]
    path.write_text(json.dumps(header))
    item = VirtualObject.model_validate({"name": "thing", "mesh": str(path)})
    (found,) = build_scene(None, [], [item]).objects
    linear = to_linear(COLOURS, "srgb", 8)
    np.testing.assert_allclose(found.material.texture.pixels, linear, atol=1e-6)
    assert {p.name for p in scene_files(None, [], [item])} >= {"model.gltf"}
    assert any(p.suffix == ".png" for p in scene_files(None, [], [item]))


def test_roughness_and_metalness_vary_over_the_surface():
    """A card half mirror, half black plastic under a white sky: what the camera sees on either side."""
    from mrbatch.methods.delta_path_tracing import METHOD
    from mrbatch.methods.estimate import estimate
    from mrbatch.scene.closed_forms import look_at, scene_of, sky
    from mrbatch.scene.mesh import plane
    from mrbatch.scene.scene import Material, SceneObject, Texture

    surface = np.zeros((1, 8, 3), np.float32)
    surface[..., 0] = 1e-6
    surface[:, :4, 1] = 1.0
    colour = np.ones((1, 8, 3), np.float32)
    colour[:, 4:] = 0.0
    look = Material(
        "principled", alpha=0.5, f0=0.04, texture=Texture(colour), surface_texture=Texture(surface)
    )
    scene = scene_of([SceneObject("card", plane(2, 2), look, True)], sky())
    camera = look_at((0, 0, 4.0), (0, 0, 0), width=16, height=16, focal=24)
    found = estimate(METHOD, scene, camera, spp=64).developed
    assert camera.world_from_camera[0, 0] == 1.0, "u runs right"
    assert (found.a[4:12, 3:13] == 1).all()
    assert found.P[6:10, 4:6].mean() == pytest.approx(1.0, abs=0.01), "the mirror shows the sky"
    assert found.P[6:10, 10:12].mean() == pytest.approx(0.04, abs=0.005), "the gloss alone"


@pytest.mark.parametrize(("name", "metal"), [("avocado_512", False), ("water_bottle_512", True)])
@pytest.mark.data
def test_real_files(shared_data, name, metal):
    (item,) = built(shared_data / "meshes" / f"{name}.glb").objects
    assert item.material.texture.pixels.shape == (512, 512, 3)
    found = item.material.surface_texture.pixels
    assert (found[..., 1].max() > 0.9) == metal
    assert found.min() >= 0.0 and found.max() <= 1.0
