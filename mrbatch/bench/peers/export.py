"""A prepared job as plain arrays that any renderer's script can read with NumPy alone.

`scene.json` names the objects, cameras and frames; `objectN.npz` holds `vertices` (n, 3) and `faces` (m, 3)
in the world, and `normals` (n, 3), `uvs` (n, 2) where there are any; `textureN.npy` (h, w, 3) linear;
`environment.npy` (h, w, 3) in the house's layout (+X in the middle, +Z up), its rotation in `scene.json`;
`photo_NNNN.npy` (h, w, 3) linear, in the photo's units, with the gain of the frame in `scene.json`.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mrbatch.batch.framing import framed
from mrbatch.batch.prepare import Prepared
from mrbatch.errors import InputError
from mrbatch.film.window import Window
from mrbatch.scene.scene import SceneObject

MATERIALS = ("diffuse", "conductor")
"""What all of them have, with the same meaning."""


def export(prepared: Prepared, frames: Sequence[int], folder: Path) -> list[tuple[np.ndarray, np.ndarray]]:
    """Writes the scene as it is at the first of `frames` and what each frame has of its own; gives the photo
    (h, w, 3) and the gain (3,) of each.

    Raises InputError for what has no exact counterpart: moving objects, other materials, several views.
    """
    scene = prepared.scene
    if scene.moves:
        raise InputError("objects that move are not exported")
    if len(prepared.windows) != 1:
        raise InputError("only jobs of one view are exported")
    folder.mkdir(parents=True, exist_ok=True)
    ((view, _),) = prepared.windows.items()
    size = prepared.display[view]
    told: dict[str, Any] = {
        "width": size[0],
        "height": size[1],
        "world_from_map": np.asarray(scene.environment.world_from_map).tolist(),
        "objects": [_object(number, item, folder) for number, item in enumerate(scene.objects)],
        "frames": [],
    }
    written: list[tuple[np.ndarray, np.ndarray]] = []
    np.save(folder / "environment.npy", scene.environment.radiance)
    for number in frames:
        given = prepared.capture.frame(number, prepared.shot.table).views[view]
        camera = given.camera.scaled(*size)
        photo = framed(given.background, size, Window(0, 0, *size))
        gain = np.broadcast_to(np.asarray(given.gain, dtype=np.float64), (3,))
        np.save(folder / f"photo_{number:04d}.npy", photo)
        told["frames"].append(
            {
                "number": number,
                "matrix": camera.matrix.tolist(),
                "world_from_camera": camera.world_from_camera.tolist(),
                "gain": gain.tolist(),
            }
        )
        written.append((photo, gain))
    (folder / "scene.json").write_text(json.dumps(told, indent=1))
    return written


def _object(number: int, item: SceneObject, folder: Path) -> dict[str, Any]:
    material = item.material
    if material.kind not in MATERIALS or material.from_photo or material.most_emission.any():
        raise InputError(
            f"`{item.name}` is {material.kind}: only {' and '.join(MATERIALS)} surfaces of given reflectance "
            "are compared"
        )
    arrays: dict[str, Any] = {"vertices": item.mesh.vertices, "faces": item.mesh.faces}
    if item.mesh.normals is not None and not item.mesh.normals_are_flat():
        arrays["normals"] = item.mesh.normals
    if item.mesh.uvs is not None:
        arrays["uvs"] = item.mesh.uvs
    np.savez(folder / f"object{number}.npz", **arrays)
    if material.texture is not None:
        np.save(folder / f"texture{number}.npy", material.texture.pixels)
    return {
        "name": item.name,
        "virtual": item.virtual,
        "kind": material.kind,
        "reflectance": [float(c) for c in material.reflectance],
        "alpha": float(material.alpha),
        "texture": material.texture is not None,
    }
