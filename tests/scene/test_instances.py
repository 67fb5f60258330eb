"""Shapes that a file places through several nodes: against the product of the matrices in float64."""

from __future__ import annotations

import base64
import json

import numpy as np
import pytest
import warp as wp
from scipy.spatial.transform import Rotation

from mrbatch.device.rays import FAR, rays
from mrbatch.scene.closed_forms import scene_of, virtual
from mrbatch.scene.mesh import icosphere
from mrbatch.scene.mesh_file import load_mesh
from mrbatch.scene.scene_data import SceneData, surface_point, upload


def nested(path, mesh, matrices):
    """A glTF file: a mesh under as many nodes, each inside the one before."""
    parts = [
        (mesh.vertices.astype("<f4").tobytes(), 5126, "VEC3", len(mesh.vertices)),
        (mesh.normals.astype("<f4").tobytes(), 5126, "VEC3", len(mesh.vertices)),
        (mesh.faces.astype("<u4").tobytes(), 5125, "SCALAR", mesh.faces.size),
    ]
    blob, views, accessors = b"", [], []
    for data, component, kind, count in parts:
        views.append({"buffer": 0, "byteOffset": len(blob), "byteLength": len(data)})
        accessors.append(
            {"bufferView": len(views) - 1, "componentType": component, "type": kind, "count": count}
        )
        blob += data
    accessors[0] |= {"min": [-1, -1, -1], "max": [1, 1, 1]}
    nodes = [
        {"matrix": m.T.ravel().tolist()} | ({"children": [k + 1]} if k + 1 < len(matrices) else {"mesh": 0})
        for k, m in enumerate(matrices)
    ]
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": nodes,
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "NORMAL": 1}, "indices": 2}]}],
        "buffers": [
            {
                "byteLength": len(blob),
                "uri": "data:application/octet-stream;base64," + base64.b64encode(blob).decode(),
            }
        ],
        "bufferViews": views,
        "accessors": accessors,
    }
    path.write_text(json.dumps(document))
    return path


def four_deep(seed, mirrored):
    """Four affine matrices with scales from 1e-3 to 1e3, and their product, which mirrors where asked."""
    random = np.random.default_rng(seed)
    scales = ([1e-3, 1, 1e3], [1, 1e3, 1e-3], [1e3, 1e-3, 1], [-1 if mirrored else 1, 2.0, 0.5])
    found = []
    for k, scale in enumerate(scales):
        m = np.eye(4)
        turn = Rotation.from_rotvec(random.normal(size=3)).as_matrix() if k == 3 else np.eye(3)
        m[:3, :3] = turn @ np.diag(scale)
        m[:3, 3] = random.normal(size=3) * (1e-3 if k < 3 else 1)
        found.append(m)
    # The last is innermost: what is stretched last is turned first.
    return found, found[0] @ found[1] @ found[2] @ found[3]


@wp.kernel(enable_backward=False, module="unique")
def cast(
    scene: SceneData,
    o: wp.array(dtype=wp.vec3),
    d: wp.array(dtype=wp.vec3),
    t: wp.array(dtype=float),
    triangle: wp.array(dtype=int),
    ng: wp.array(dtype=wp.vec3),
    ns: wp.array(dtype=wp.vec3),
):
    i = wp.tid()
    hit = wp.static(rays("embree").trace)(scene.camera_set, o[i], d[i], FAR)
    t[i] = hit.t
    triangle[i] = hit.triangle
    if hit.triangle >= 0:
        p = surface_point(scene, hit.triangle, hit.u, hit.v, d[i])
        ng[i] = p.ng
        ns[i] = p.ns


@pytest.mark.case("GEO-07")
@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_rays_meet_what_four_nodes_place_where_float64_says(tmp_path, seed, mirrored):
    """Distance to 1e-5, geometric and shading normals to a hundredth of a degree, facing the viewer."""
    ball = icosphere(1.0, subdivisions=2)
    matrices, product = four_deep(seed, mirrored)
    assert (np.linalg.det(product[:3, :3]) < 0) == mirrored
    mesh = load_mesh(nested(tmp_path / "nested.gltf", ball, matrices))
    local = ball.vertices.astype(np.float32).astype(np.float64)
    vertices = local @ product[:3, :3].T + product[:3, 3]
    device = upload(scene_of([virtual("ball", mesh)]), "embree")
    corners = vertices[ball.faces]
    # Twice as far out as the ball reaches, along the way from its middle to a point of a facet.
    random = np.random.default_rng(seed + 10)
    n = 4000
    face = random.integers(0, len(corners), n)
    b = random.dirichlet([2, 2, 2], n)
    target = (b[:, :, None] * corners[face]).sum(axis=1)
    middle = vertices.mean(axis=0)
    o = (middle + 3.0 * (target - middle) - device.scene.origin).astype(np.float32)
    d = (target - device.scene.origin - o.astype(np.float64)).astype(np.float32)
    out = [wp.zeros(n, dtype=kind, device="cpu") for kind in (float, int, wp.vec3, wp.vec3)]
    wp.launch(
        cast,
        n,
        [device.data, *(wp.array(a, dtype=wp.vec3, device="cpu") for a in (o, d)), *out],
        device="cpu",
    )
    t, triangle, ng, ns = (a.numpy() for a in out)
    assert (triangle >= 0).all()
    # Exactly the facet that was aimed at, but at its rims; there its neighbour.
    same = triangle == np.arange(len(ball.faces))[face]
    assert same.mean() > 0.99
    a, e1, e2 = corners[face, 0], corners[face, 1] - corners[face, 0], corners[face, 2] - corners[face, 0]
    normal = np.cross(e1, e2)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    start = o.astype(np.float64) + device.scene.origin
    along = d.astype(np.float64)
    truth = ((a - start) * normal).sum(1) / (along * normal).sum(1)
    assert np.abs(t / truth - 1)[same].max() < 1e-5
    normal *= -np.sign((normal * along).sum(1))[:, None]
    limit = np.radians(0.01)
    assert np.linalg.norm(ng - normal, axis=1)[same].max() < limit
    # Shading: the ball's own normals by the inverse transpose, mixed at the hit.
    inverse = np.linalg.inv(product[:3, :3]).T
    own = local[ball.faces] @ inverse.T
    own /= np.linalg.norm(own, axis=2, keepdims=True)
    hit = start + truth[:, None] * along
    m = np.stack([e1, e2], axis=-1)
    uv = np.stack([np.linalg.lstsq(m[i], (hit - a)[i], rcond=None)[0] for i in range(n)])
    weights = np.column_stack([1 - uv.sum(axis=1), uv])
    shading = (weights[:, :, None] * own[face]).sum(axis=1)
    shading /= np.linalg.norm(shading, axis=1, keepdims=True)
    shading *= np.sign((shading * normal).sum(1))[:, None]
    assert np.linalg.norm(ns - shading, axis=1)[same].max() < limit
