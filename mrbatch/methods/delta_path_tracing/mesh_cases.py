"""Hard cases of delta path tracing by meshes: doubled, broken, coarse with smooth normals."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from mrbatch.contracts import Case, Measurement
from mrbatch.methods.delta_path_tracing.delta_probe import delta_probe
from mrbatch.methods.delta_path_tracing.picture_cases import LAYERS, delta_picture, shown
from mrbatch.methods.invariance_cases import same_pictures
from mrbatch.metrics.judging import none, together, within
from mrbatch.scene.closed_forms import corner, floor, lamp_sky, real, scene_of, virtual
from mrbatch.scene.environment import Environment
from mrbatch.scene.mesh import Mesh, box, uv_sphere
from mrbatch.scene.mesh_file import load_mesh


def doubled(seed: int, *, grounds: Sequence[str] = ("plane", "corner")) -> Measurement:
    """GEO-06: real and virtual surfaces that are there twice are there once."""
    judged = []
    for name in grounds:
        ground = [real("floor", floor(16.0), 0.5)] if name == "plane" else corner(0.5, size=16.0)
        thing = virtual("thing", box((0.6, 0.6, 0.6), centre=(0.6, 0, 0.3)), (0.7, 0.4, 0.2))
        once = delta_picture([*ground, thing], light=lamp_sky(), seed=seed)
        more = [replace(ground[0], name="again"), *ground, thing, replace(thing, name="thing again")]
        twice = delta_picture(more, light=lamp_sky(), seed=seed)
        empty = not (once.developed.P.any() and once.developed.D.any())
        judged += [same_pictures(once, twice, names=LAYERS), none(empty, "empty pictures")]
    return together(*judged)


def broken_mesh(seed: int) -> Measurement:
    """GEO-04: triangles of no area, repeated corners and vertices that are no numbers show in no bit."""
    good = box((0.6, 0.6, 0.6), centre=(0, 0, 0.3))
    n = len(good.vertices)
    vertices = [*good.vertices.tolist(), [np.nan, 0, 0], [np.inf, 1, 0], [0.3, 0.3, 0.3]]
    junk = [[0, 1, n], [2, n + 1, 3], [4, 4, 5], [6, 6, 6], [0, n + 2, n + 2]]
    seen, dropped = [], []
    for faces in (good.faces.tolist(), [*junk, *good.faces.tolist(), *junk]):
        head = ["ply", "format ascii 1.0", f"element vertex {len(vertices)}"]
        head += [f"property double {c}" for c in "xyz"]
        head += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
        rows = [" ".join(repr(float(c)) for c in v) for v in vertices]
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "thing.ply"
            path.write_text("\n".join([*head, *rows, *(f"3 {a} {b} {c}" for a, b, c in faces)]) + "\n")
            mesh = load_mesh(path)
        dropped.append(mesh.dropped)
        objects = [*corner(0.5, size=16.0), virtual("thing", mesh, 0.6)]
        seen.append(delta_picture(objects, light=lamp_sky(), seed=seed))
    empty = not (seen[0].developed.P.any() and seen[0].developed.D.any())
    return together(
        same_pictures(seen[0], seen[1], names=LAYERS),
        within(dropped, [0, 2 * len(junk)], 0, what="triangles left out"),
        none(empty, "empty pictures"),
    )


def lit_below(normal: np.ndarray, height: int = 64, width: int = 128) -> Environment:
    """Radiance 1 in texels that lie wholly below the plane of `normal` and a little more, else 0."""
    theta = np.pi * np.arange(height + 1) / height
    phi = 2 * np.pi * (0.5 - np.arange(width + 1) / width)
    t, p = np.meshgrid(theta, phi, indexing="ij")
    d = np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], axis=-1) @ np.asarray(normal)
    most = np.maximum.reduce([d[:-1, :-1], d[1:, :-1], d[:-1, 1:], d[1:, 1:]])
    lit = np.where(most < -0.02, 1.0, 0.0).astype(np.float32)
    return Environment(np.repeat(lit[..., None], 3, axis=-1), interpolation="nearest")


def facet_point(face: int, weights: Sequence[float]) -> tuple[Mesh, np.ndarray, np.ndarray, np.ndarray]:
    """A coarse ball with smooth normals, a point of a facet, the facet's normal and the smooth one there."""
    mesh = uv_sphere(1.0, segments=16, rings=8)
    assert mesh.normals is not None
    smooth = np.asarray(weights) @ mesh.normals[mesh.faces[face]].astype(np.float64)
    point = np.asarray(weights) @ mesh.vertices[mesh.faces[face]]
    return mesh, point, mesh.face_normals()[face], smooth / np.linalg.norm(smooth)


def terminator(seed: int, *, faces: Sequence[int] = (40, 100, 170)) -> Measurement:
    """GEO-09: a ball of 16 x 8 facets takes no light from below its facets, though its smooth normals see
    some; white under the sky it gains nothing."""
    found = []
    for face in faces:
        for weights in ((0.9, 0.05, 0.05), (0.05, 0.05, 0.9)):
            mesh, point, normal, _ = facet_point(face, weights)
            item = virtual("ball", mesh, 1.0, cast_shadow=False)
            scene = scene_of([item], lit_below(normal))
            found.append(delta_probe(scene, point, normal=normal, distance=1.0, spp=64, seed=seed).seen)
    white = virtual("ball", uv_sphere(1.0, segments=16, rings=8), 1.0)
    d = delta_picture([white], spp=256, eye=(0, -4, 1), target=(0, 0, 0), seed=seed).developed
    inside, error = d.P[d.a == 1][:, 0], np.sqrt(d.variance[d.a == 1][:, 0])
    return together(
        within(np.concatenate(found), 0.0, 0.0, what="light from below"),
        none(inside > 1.0 + 5 * error + 1e-5, "pixels that gain light"),
        none(inside.mean() > 1.0 + 4 * inside.std() / np.sqrt(len(inside)), "means that gain light"),
        shown(d),
    )


CASES: tuple[Case, ...] = (
    Case(
        "GEO-04",
        "broken triangles show in no bit",
        broken_mesh,
        setup="a box in a file, with and without triangles of no area, repeated corners, NaN",
    ),
    Case(
        "GEO-06",
        "a surface that is there twice is there once",
        doubled,
        setup="floor and box doubled in place, under a lamp",
        rows=("TRAP-3i",),
    ),
    Case(
        "GEO-09",
        "a coarse smooth ball takes no light from below its facets",
        terminator,
        quick=False,
        setup="16 x 8 facets, light from below alone; white under the sky",
        statistical=True,
    ),
)
