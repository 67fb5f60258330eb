"""A job file of a desk set (`markers/mitsuba_desk_*`), as a user would write it.

    python tests/desk_job.py SHARED_DATA mitsuba_desk_window metal FOLDER

writes FOLDER/<set>_<kind>.yaml and the print on the paper, and says where. The photos are the 8-bit ones,
the poses the true ones.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
from desk_scene import paper_texture


def desk_job(shared_data: Path, name: str, kind: str, folder: Path) -> Path:
    from PIL import Image

    source = shared_data / "markers" / name
    given = json.loads((source / "scene.json").read_text())
    real, bunny = given["real"], given["virtual"]["bunny"]
    folder.mkdir(parents=True, exist_ok=True)
    picture = folder / f"{name}_paper.tif"
    codes = paper_texture(given["marker"]["id"])[..., 0] * 65535 + 0.5
    Image.fromarray(codes.astype(np.uint16)).save(picture)
    metal = bunny["metal"]
    material = (
        {"type": "diffuse", "reflectance": list(bunny["diffuse"])}
        if kind == "diffuse"
        else {"type": "conductor", "reflectance": list(metal["tint"]), "roughness": metal["ggx_alpha"]}
    )

    def raised(z: float) -> dict:
        return {"translate": ["0 m", "0 m", f"{z} m"]}

    def size(metres) -> list[str]:
        return [f"{side} m" for side in metres]

    job = {
        "name": f"{name}_{kind}",
        "capture": {
            "kind": "marker-video",
            "frames": str(source / "photo_0*.png"),
            "camera": {"file": str(source / "scene.json"), "pixel_centres": "half"},
            "poses": str(source / "scene.json"),
            "gain": given["exposure"],
        },
        "environment": {"file": str(source / "environment.exr"), "rows": "endpoints"},
        "real": [
            {
                "name": "table",
                "plane": {"size": size(real["table"]["size"])},
                "transform": raised(real["table"]["z"]),
                "reflectance": list(real["table"]["reflectance"]),
            },
            {
                "name": "paper",
                "plane": {"size": size(real["paper"]["size"])},
                "transform": raised(real["paper"]["z"]),
                "reflectance": {"texture": str(picture), "colour": "linear"},
            },
            {
                "name": "head",
                "mesh": str(shared_data / "meshes" / "suzanne.ply"),
                "transform": {"matrix": real["suzanne"]["world_from_object"]},
                "reflectance": list(real["suzanne"]["reflectance"]),
            },
        ],
        "virtual": [
            {
                "name": "bunny",
                "mesh": str(shared_data / "meshes" / "bunny.ply"),
                "normals": "smooth",
                "transform": {"matrix": bunny["world_from_object"]},
                "material": material,
            }
        ],
        "method": {"name": "delta-path-tracing", "spp": 64},
        "output": {"directory": str(folder / f"out_{name}_{kind}")},
    }
    path = folder / f"{name}_{kind}.yaml"
    path.write_text(json.dumps(job, indent=1), encoding="utf-8")
    return path


if __name__ == "__main__":
    print(desk_job(Path(sys.argv[1]).resolve(), sys.argv[2], sys.argv[3], Path(sys.argv[4]).resolve()))
