"""Differential rendering with Mitsuba 3, as a job of its own: two renderings a frame and their difference.

    python mitsuba_difference.py SCENE OUTPUT --spp N --seed N [--variant llvm_ad_rgb]

SCENE is a folder that `export` wrote. Needs `mitsuba` and NumPy and nothing of this project, so that all it
takes, from the first import on, is its own. Lens distortion is left out.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np


def bsdf(given: dict[str, Any], number: int, folder: Path, mi: Any) -> dict[str, Any]:
    colour: dict[str, Any] = {"type": "rgb", "value": given["reflectance"]}
    if given["texture"]:
        pixels = np.load(folder / f"texture{number}.npy")
        colour = {"type": "bitmap", "bitmap": mi.Bitmap(pixels), "raw": True}
    if given["kind"] == "diffuse":
        inner = {"type": "diffuse", "reflectance": colour}
    else:
        inner = {"type": "roughconductor", "material": "none", "distribution": "ggx", "alpha": given["alpha"]}
        inner["specular_reflectance"] = colour
    return {"type": "twosided", "bsdf": inner}


def shape(given: dict[str, Any], number: int, folder: Path, mi: Any) -> Any:
    arrays = np.load(folder / f"object{number}.npz")
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(bsdf(given, number, folder, mi))
    mesh = mi.Mesh(
        given["name"],
        len(arrays["vertices"]),
        len(arrays["faces"]),
        props=properties,
        has_vertex_normals="normals" in arrays,
        has_vertex_texcoords="uvs" in arrays,
    )
    values = mi.traverse(mesh)
    values["vertex_positions"] = arrays["vertices"].astype(np.float32).ravel()
    values["faces"] = arrays["faces"].astype(np.uint32).ravel()
    if "normals" in arrays:
        values["vertex_normals"] = arrays["normals"].astype(np.float32).ravel()
    if "uvs" in arrays:
        values["vertex_texcoords"] = arrays["uvs"].astype(np.float32).ravel()
    values.update()
    return mesh


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("scene", type=Path)
    parser.add_argument("output", type=Path)
    parser.add_argument("--spp", type=int, required=True)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--variant", default="llvm_ad_rgb")
    arguments = parser.parse_args()

    import mitsuba as mi

    mi.set_variant(arguments.variant)
    folder: Path = arguments.scene
    told = json.loads((folder / "scene.json").read_text())
    arguments.output.mkdir(parents=True, exist_ok=True)
    shapes = [shape(given, number, folder, mi) for number, given in enumerate(told["objects"])]
    # Its y is up, and its columns start at -z: a cyclic exchange of the axes makes them ours.
    turn: Any = np.eye(4)
    turn[:3, :3] = np.array(told["world_from_map"]) @ np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]], float)
    light = {
        "type": "envmap",
        "bitmap": mi.Bitmap(np.load(folder / "environment.npy")),
        "to_world": mi.ScalarTransform4f(turn),
    }
    width, height = told["width"], told["height"]

    def scene(virtual: bool) -> Any:
        entries: dict[str, Any] = {"type": "scene", "light": light}
        for given, item in zip(told["objects"], shapes):
            if virtual or not given["virtual"]:
                entries[f"shape_{given['name'].replace(' ', '_')}"] = item
        return mi.load_dict(entries)

    scenes = [scene(True), scene(False)]
    virtual_names = {f"shape_{o['name'].replace(' ', '_')}" for o in told["objects"] if o["virtual"]}
    path = mi.load_dict({"type": "path", "max_depth": -1, "rr_depth": 5})
    coverage = mi.load_dict({"type": "aov", "aovs": "shape:shape_index"})
    for count, frame in enumerate(told["frames"]):
        k = np.array(frame["matrix"])
        flip = np.array(frame["world_from_camera"]) @ np.diag([-1.0, -1.0, 1.0, 1.0])
        film = {
            "type": "hdrfilm",
            "width": width,
            "height": height,
            "rfilter": {"type": "box"},
            "pixel_format": "rgb",
        }
        sensor = mi.load_dict(
            {
                "type": "perspective",
                "fov": float(np.degrees(2 * np.arctan(width / 2 / k[0, 0]))),
                "fov_axis": "x",
                "principal_point_offset_x": float(k[0, 2] / width - 0.5),
                "principal_point_offset_y": float(k[1, 2] / height - 0.5),
                "to_world": mi.ScalarTransform4f(flip),
                "film": film,
                "sampler": {"type": "independent"},
            }
        )
        seed = arguments.seed * 1000 + 10 * count
        mixed, real = (
            np.array(mi.render(s, sensor=sensor, integrator=path, spp=arguments.spp, seed=seed + n))
            for n, s in enumerate(scenes)
        )
        indices = np.array(mi.render(scenes[0], sensor=sensor, integrator=coverage, spp=16, seed=seed + 2))
        order = [s.id() for s in scenes[0].shapes()]
        wanted = [i for i, name in enumerate(order) if name in virtual_names]
        # A mean of numbers that is one of them: no edge runs through the pixel.
        index = indices[..., -1]
        inside = np.isin(np.round(index), wanted) & (np.abs(index - np.round(index)) < 1e-4)
        gain = np.array(frame["gain"], dtype=np.float32)
        photo = np.load(folder / f"photo_{frame['number']:04d}.npy")
        changed = photo + gain * (mixed - real)
        composite = np.where(inside[..., None], gain * mixed, np.maximum(changed, 0.0))
        picture = mi.Bitmap(composite.astype(np.float32))
        picture.write(str(arguments.output / f"{frame['number']:04d}.exr"))


if __name__ == "__main__":
    main()
