"""Differential rendering with Mitsuba 3, as a job of its own: two renderings a frame and their difference.

    python mitsuba_difference.py SCENE OUTPUT --spp N --seed N [--variant llvm_ad_rgb]

SCENE is a folder that `export` wrote. Needs `mitsuba` and NumPy and nothing of this project, so that all it
takes, from the first import on, is its own. Lens distortion is left out, and pixels are square.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np


def rgb(colour: Any) -> dict[str, Any]:
    """A colour (3,), scene-linear Rec.709."""
    return {"type": "rgb", "value": [float(c) for c in colour]}


def matt(reflectance: dict[str, Any]) -> dict[str, Any]:
    """Diffuse on both sides; `reflectance` is a colour or a texture."""
    return {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": reflectance}}


def metal(tint: dict[str, Any], alpha: float) -> dict[str, Any]:
    """GGX facets that reflect all, times `tint`, a colour or a texture, on both sides."""
    inner = {"type": "roughconductor", "material": "none", "distribution": "ggx", "alpha": alpha}
    return {"type": "twosided", "bsdf": inner | {"specular_reflectance": tint}}


def texture(pixels: np.ndarray, mi: Any) -> dict[str, Any]:
    """A picture (h, w, 3), linear, row 0 at its top, for coordinates that count from the lower left."""
    # Its v counts from row 0 on.
    return {"type": "bitmap", "bitmap": mi.Bitmap(np.ascontiguousarray(pixels[::-1])), "raw": True}


def bsdf(given: dict[str, Any], number: int, folder: Path, mi: Any) -> dict[str, Any]:
    colour = rgb(given["reflectance"])
    if given["texture"]:
        colour = texture(np.load(folder / f"texture{number}.npy"), mi)
    return matt(colour) if given["kind"] == "diffuse" else metal(colour, given["alpha"])


def sensor(
    size: tuple[int, int],
    matrix: np.ndarray,
    world_from_camera: np.ndarray,
    mi: Any,
    sampler: str = "independent",
) -> dict[str, Any]:
    """A pinhole with square pixels. `size`: width, height; `matrix` (3, 3), pixel centres at half integers;
    `world_from_camera` (4, 4), x right, y down, z forward."""
    width, height = size
    # Its camera has x to the left and y up, and so its principal point is counted the other way.
    flip = np.asarray(world_from_camera) @ np.diag([-1.0, -1.0, 1.0, 1.0])
    film = {"type": "hdrfilm", "width": width, "height": height, "rfilter": {"type": "box"}}
    return {
        "type": "perspective",
        "fov": float(np.degrees(2 * np.arctan(width / 2 / matrix[0, 0]))),
        "fov_axis": "x",
        "principal_point_offset_x": float(0.5 - matrix[0, 2] / width),
        "principal_point_offset_y": float(0.5 - matrix[1, 2] / height),
        "to_world": mi.ScalarTransform4f(flip),
        "film": film | {"pixel_format": "rgb"},
        "sampler": {"type": sampler},
    }


def light_of_map(radiance: np.ndarray, world_from_map: Any, mi: Any) -> dict[str, Any]:
    """A map (h, w, 3) with +x in the picture's middle and z up, its rows at the end points; turned (3, 3)."""
    # Its y is up, and its columns start at -z: a cyclic exchange of the axes makes them ours.
    turn: Any = np.eye(4)
    turn[:3, :3] = np.array(world_from_map) @ np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]], float)
    # A copy, for it takes no array that must not be written to.
    bitmap = mi.Bitmap(np.array(radiance, np.float32))
    return {"type": "envmap", "bitmap": bitmap, "to_world": mi.ScalarTransform4f(turn)}


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
    light = light_of_map(np.load(folder / "environment.npy"), told["world_from_map"], mi)
    size = (told["width"], told["height"])

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
        eye = mi.load_dict(sensor(size, np.array(frame["matrix"]), frame["world_from_camera"], mi))
        seed = arguments.seed * 1000 + 10 * count
        mixed, real = (
            np.array(mi.render(s, sensor=eye, integrator=path, spp=arguments.spp, seed=seed + n))
            for n, s in enumerate(scenes)
        )
        indices = np.array(mi.render(scenes[0], sensor=eye, integrator=coverage, spp=16, seed=seed + 2))
        order = [s.id() for s in scenes[0].shapes()]
        # Counted from 1; 0 is where nothing is.
        wanted = [i for i, name in enumerate(order, start=1) if name in virtual_names]
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
