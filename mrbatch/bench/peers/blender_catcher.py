"""The artist's own way, as a job of its own: Blender's Cycles with what is real as a shadow catcher.

    python blender_catcher.py SCENE OUTPUT --spp N --seed N

SCENE is a folder that `export` wrote. Needs `bpy` and NumPy, in an environment of their own, and nothing of
this project. A frame gives a multilayer EXR, whose catcher pass a compositor multiplies into the photo and
lays `Combined` over; no denoiser, box filter. Lens distortion is left out.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np


def material(given: dict[str, Any], number: int, folder: Path, bpy: Any) -> Any:
    made = bpy.data.materials.new(given["name"])
    made.use_nodes = True
    nodes, links = made.node_tree.nodes, made.node_tree.links
    nodes.clear()
    kind = "ShaderNodeBsdfDiffuse" if given["kind"] == "diffuse" else "ShaderNodeBsdfAnisotropic"
    surface, out = nodes.new(kind), nodes.new("ShaderNodeOutputMaterial")
    if given["kind"] != "diffuse":
        surface.distribution = "GGX"
        surface.inputs["Roughness"].default_value = float(np.sqrt(given["alpha"]))
    surface.inputs["Color"].default_value = (*given["reflectance"], 1.0)
    if given["texture"]:
        picture = nodes.new("ShaderNodeTexImage")
        picture.image = image(np.load(folder / f"texture{number}.npy"), given["name"], bpy)
        links.new(picture.outputs["Color"], surface.inputs["Color"])
    links.new(surface.outputs["BSDF"], out.inputs["Surface"])
    return made


def image(pixels: np.ndarray, name: str, bpy: Any) -> Any:
    height, width = pixels.shape[:2]
    made = bpy.data.images.new(name, width, height, float_buffer=True, is_data=True)
    rgba = np.ones((height, width, 4), np.float32)
    rgba[..., :3] = pixels[::-1]
    made.pixels.foreach_set(rgba.ravel())
    made.pack()
    return made


def build(given: dict[str, Any], number: int, folder: Path, bpy: Any) -> None:
    arrays = np.load(folder / f"object{number}.npz")
    mesh = bpy.data.meshes.new(given["name"])
    faces = arrays["faces"]
    mesh.from_pydata(arrays["vertices"].tolist(), [], faces.tolist())
    if "uvs" in arrays:
        # Its v counts from the bottom, as the house's does.
        layer = mesh.uv_layers.new()
        layer.data.foreach_set("uv", arrays["uvs"][faces.ravel()].astype(np.float32).ravel())
    if "normals" in arrays:
        mesh.polygons.foreach_set("use_smooth", np.ones(len(faces), dtype=bool))
        mesh.normals_split_custom_set_from_vertices(arrays["normals"].tolist())
    mesh.materials.append(material(given, number, folder, bpy))
    item = bpy.data.objects.new(given["name"], mesh)
    item.is_shadow_catcher = not given["virtual"]
    bpy.context.scene.collection.objects.link(item)


def world(told: dict[str, Any], folder: Path, bpy: Any) -> None:
    made = bpy.data.worlds.new("light")
    bpy.context.scene.world = made
    made.use_nodes = True
    nodes, links = made.node_tree.nodes, made.node_tree.links
    nodes.clear()
    place, turn = nodes.new("ShaderNodeTexCoord"), nodes.new("ShaderNodeMapping")
    picture = nodes.new("ShaderNodeTexEnvironment")
    light, out = nodes.new("ShaderNodeBackground"), nodes.new("ShaderNodeOutputWorld")
    picture.image = image(np.load(folder / "environment.npy"), "environment", bpy)
    # The node turns directions from the world into the map.
    from mathutils import Matrix

    turn.vector_type = "POINT"
    turn.inputs["Rotation"].default_value = Matrix(np.array(told["world_from_map"]).T.tolist()).to_euler()
    links.new(place.outputs["Generated"], turn.inputs["Vector"])
    links.new(turn.outputs["Vector"], picture.inputs["Vector"])
    links.new(picture.outputs["Color"], light.inputs["Color"])
    links.new(light.outputs["Background"], out.inputs["Surface"])


def look(camera: Any, frame: dict[str, Any], width: int, height: int) -> None:
    from mathutils import Matrix

    k = np.array(frame["matrix"])
    longer = max(width, height)
    camera.data.sensor_fit = "HORIZONTAL"
    camera.data.sensor_width = 36.0
    camera.data.lens = 36.0 * k[0, 0] / width
    camera.data.shift_x = (width / 2 - k[0, 2]) / longer
    camera.data.shift_y = (k[1, 2] - height / 2) / longer
    camera.data.clip_start, camera.data.clip_end = 1e-3, 1e3
    pose = np.array(frame["world_from_camera"]) @ np.diag([1.0, -1.0, -1.0, 1.0])
    camera.matrix_world = Matrix(pose.tolist())


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("scene", type=Path)
    parser.add_argument("output", type=Path)
    parser.add_argument("--spp", type=int, required=True)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()

    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    folder: Path = arguments.scene
    told = json.loads((folder / "scene.json").read_text())
    arguments.output.mkdir(parents=True, exist_ok=True)
    for number, given in enumerate(told["objects"]):
        build(given, number, folder, bpy)
    world(told, folder, bpy)
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene = bpy.context.scene
    scene.collection.objects.link(camera)
    scene.camera = camera
    scene.render.engine = "CYCLES"
    scene.render.resolution_x, scene.render.resolution_y = told["width"], told["height"]
    scene.render.resolution_percentage = 100
    scene.render.film_transparent = True
    cycles = scene.cycles
    cycles.device, cycles.samples = "CPU", arguments.spp
    cycles.use_denoising, cycles.use_adaptive_sampling = False, False
    cycles.pixel_filter_type = "BOX"
    cycles.sample_clamp_indirect = 0.0
    cycles.max_bounces = cycles.diffuse_bounces = cycles.glossy_bounces = 32
    layer = scene.view_layers[0]
    layer.cycles.use_pass_shadow_catcher = True
    layer.update_render_passes()
    if hasattr(scene.render.image_settings, "media_type"):  # from version 5 on it comes before the format
        scene.render.image_settings.media_type = "MULTI_LAYER_IMAGE"
    scene.render.image_settings.file_format = "OPEN_EXR_MULTILAYER"
    scene.render.image_settings.color_depth = "32"
    for count, frame in enumerate(told["frames"]):
        look(camera, frame, told["width"], told["height"])
        cycles.seed = arguments.seed * 1000 + count
        scene.render.filepath = str((arguments.output / f"{frame['number']:04d}.exr").resolve())
        bpy.ops.render.render(write_still=True)


if __name__ == "__main__":
    main()
