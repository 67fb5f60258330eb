"""A glTF file's meshes, joined where they share how they look and how they move."""

from __future__ import annotations

from pathlib import Path

from mrbatch.errors import InputError, Place
from mrbatch.scene import settings as given
from mrbatch.scene.channel import Fixed, Placement
from mrbatch.scene.gltf_animation import load_animation, node_names
from mrbatch.scene.gltf_header import read_gltf_header
from mrbatch.scene.mesh import Mesh, concatenate
from mrbatch.scene.mesh_file import Part, load_parts
from mrbatch.scene.motion import Clip

Playing = tuple[tuple[Placement | Fixed, ...], Clip]
"""Placements of the nodes from the object's own frame to a mesh's, and what they follow."""


def moving_parts(
    path: Path, clip: given.Clip | None, *, by_material: bool
) -> list[tuple[Part, Mesh, Playing | None]]:
    """A part for its material, the mesh, and how it moves in the object; None where it does not, and is then
    placed. `by_material`: a mesh for each material, and its textures are read. Raises InputError.
    """
    parts = [part for part in load_parts(path, pictures=by_material) if len(part.mesh.faces)]
    names: list[str] = []
    chains: dict[str, tuple[Placement | Fixed, ...]] = {}
    played = None
    if clip is not None:
        found = load_animation(path, clip.name)
        names = node_names(read_gltf_header(path, Place(file=str(path))))
        chains = {names[index]: chain for index, chain in found.nodes.items()}
        played = Clip(found.length, clip.start, clip.repeat, clip.speed)
    groups: dict[tuple[int, str], list[Part]] = {}
    for part in parts:
        node = _node(part, names, chains)
        groups.setdefault((id(part.material) if by_material else 0, node), []).append(part)
    result: list[tuple[Part, Mesh, Playing | None]] = []
    for (_, node), held in groups.items():
        if node and played is not None:
            mesh, motion = concatenate([part.local for part in held]), (chains[node], played)
            result.append((held[0], mesh, motion))
        else:
            result.append((held[0], concatenate([part.mesh for part in held]), None))
    if chains and not any(motion for _, _, motion in result):
        raise InputError("the glTF's animation moves no mesh", place=Place(file=str(path)))
    return result


def _node(part: Part, names: list[str], chains: dict[str, tuple[Placement | Fixed, ...]]) -> str:
    """The moving node that a part hangs on, or nothing. Of several primitives of one mesh each has a node of
    its own in the reader's graph, with something after the name."""
    name = part.node if part.node in names else part.node.rsplit("_", 1)[0]
    return name if name in chains else ""
