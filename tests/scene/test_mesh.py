"""Meshes: files against their own bytes and headers, normals and transforms against closed forms."""

from __future__ import annotations

import base64
import json
import struct

import numpy as np
import pytest

from mrbatch.errors import InputError
from mrbatch.scene.mesh import Mesh, box, concatenate, icosphere, plane, uv_sphere
from mrbatch.scene.mesh_file import load_mesh

SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=np.float64)


def volume(mesh: Mesh) -> float:
    """Signed volume; positive where facets turn outward."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0)


def is_closed(mesh: Mesh) -> bool:
    """Each edge is used once in each direction, vertices at equal places taken as one."""
    _, same = np.unique(np.round(mesh.vertices, 9), axis=0, return_inverse=True)
    faces = same.reshape(-1)[mesh.faces]
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    forward = {tuple(e) for e in edges.tolist()}
    return len(forward) == len(edges) and all((b, a) in forward for a, b in forward)


def write_ply(path, vertices, faces, *, normals=None, uvs=None, binary=True):
    columns, names = [np.asarray(vertices, np.float32)], ["x", "y", "z"]
    if normals is not None:
        columns.append(np.asarray(normals, np.float32))
        names += ["nx", "ny", "nz"]
    if uvs is not None:
        columns.append(np.asarray(uvs, np.float32))
        names += ["s", "t"]
    table = np.concatenate(columns, axis=1)
    header = f"ply\nformat {'binary_little_endian' if binary else 'ascii'} 1.0\nelement vertex {len(table)}\n"
    header += "".join(f"property float {n}\n" for n in names)
    header += f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    if binary:
        body = table.tobytes() + b"".join(struct.pack("<B3i", 3, *map(int, f)) for f in faces)
    else:
        lines = [" ".join(f"{v:.9g}" for v in row) for row in table]
        lines += [f"3 {f[0]} {f[1]} {f[2]}" for f in faces]
        body = ("\n".join(lines) + "\n").encode()
    path.write_bytes(header.encode() + body)
    return path


def gltf(nodes, *, uvs=None, normals=None) -> dict:
    """A glTF document of the unit square, referenced by `nodes`."""
    buffers = [(SQUARE.astype("<f4").tobytes(), 5126, "VEC3", 4), (np.array([0, 1, 2, 0, 2, 3], "<u4").tobytes(), 5125, "SCALAR", 6)]  # fmt: skip # noqa: E501
    attributes = {"POSITION": 0}
    for name, values, kind in (("TEXCOORD_0", uvs, "VEC2"), ("NORMAL", normals, "VEC3")):
        if values is not None:
            attributes[name] = len(buffers)
            buffers.append((np.asarray(values, "<f4").tobytes(), 5126, kind, 4))
    blob, views, accessors = b"", [], []
    for data, component, kind, count in buffers:
        views.append({"buffer": 0, "byteOffset": len(blob), "byteLength": len(data)})
        accessor = {"bufferView": len(views) - 1, "componentType": component, "type": kind, "count": count}
        if kind == "VEC3" and not accessors:
            accessor |= {"min": [0, 0, 0], "max": [1, 1, 0]}
        accessors.append(accessor)
        blob += data
    return {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": list(range(len(nodes)))}],
        "nodes": nodes,
        "meshes": [{"primitives": [{"attributes": attributes, "indices": 1, "material": 0}]}],
        "buffers": [
            {
                "byteLength": len(blob),
                "uri": "data:application/octet-stream;base64," + base64.b64encode(blob).decode(),
            }
        ],
        "bufferViews": views,
        "accessors": accessors,
        "materials": [{"pbrMetallicRoughness": {"baseColorFactor": [1, 1, 1, 1]}}],
    }


# Files of others


@pytest.mark.data
def test_bunny_is_read_as_it_is(shared_data):
    """Its header says 35,947 vertices and 69,451 faces, no normals: none merged, none invented."""
    path = shared_data / "meshes" / "bunny.ply"
    mesh = load_mesh(path)
    assert mesh.vertices.shape == (35947, 3) and mesh.faces.shape == (69451, 3)
    assert mesh.normals is None and mesh.uvs is None and mesh.dropped == 0
    data = path.read_bytes()
    start = data.index(b"end_header\n") + len(b"end_header\n")
    raw = np.frombuffer(data, "<f4", 35947 * 3, start).reshape(-1, 3)
    np.testing.assert_array_equal(mesh.vertices, raw)
    faces = np.frombuffer(data, np.dtype([("n", "u1"), ("v", "<u4", 3)]), 69451, start + raw.nbytes)
    np.testing.assert_array_equal(mesh.faces, faces["v"])


@pytest.mark.data
def test_suzanne_keeps_its_own_normals_and_coordinates(shared_data):
    path = shared_data / "meshes" / "suzanne.ply"
    mesh = load_mesh(path)
    data = path.read_bytes()
    start = data.index(b"end_header\n") + len(b"end_header\n")
    raw = np.frombuffer(data, "<f4", 35258 * 8, start).reshape(-1, 8)
    assert mesh.faces.shape == (62976, 3)
    np.testing.assert_array_equal(mesh.vertices, raw[:, :3])
    np.testing.assert_allclose(mesh.normals, raw[:, 3:6], atol=1e-5)
    np.testing.assert_array_equal(mesh.uvs, raw[:, 6:])


@pytest.mark.data
def test_glb_is_placed_by_its_node(shared_data):
    """The avocado's node is turned 180 degrees about y: (x, y, z) to (-x, y, -z)."""
    path = shared_data / "meshes" / "avocado_512.glb"
    mesh = load_mesh(path)
    data = path.read_bytes()
    length = struct.unpack_from("<I", data, 12)[0]
    document = json.loads(data[20 : 20 + length])
    attributes = document["meshes"][0]["primitives"][0]["attributes"]

    def accessor(name, width):
        a = document["accessors"][attributes[name]]
        view = document["bufferViews"][a["bufferView"]]
        at = 28 + length + view.get("byteOffset", 0) + a.get("byteOffset", 0)
        return np.frombuffer(data, "<f4", a["count"] * width, at).reshape(-1, width)

    assert len(mesh.faces) == 682
    turn = np.array([-1.0, 1.0, -1.0])
    np.testing.assert_allclose(mesh.vertices, accessor("POSITION", 3) * turn, atol=1e-8)
    np.testing.assert_allclose(mesh.normals, accessor("NORMAL", 3) * turn, atol=1e-5)
    uv = accessor("TEXCOORD_0", 2)
    np.testing.assert_allclose(mesh.uvs, np.stack([uv[:, 0], 1.0 - uv[:, 1]], axis=1), atol=1e-6)


# Files written here


@pytest.mark.parametrize("binary", [True, False])
def test_ply_round_trip(tmp_path, binary):
    ball = uv_sphere(0.3, segments=7, rings=5)
    mesh = load_mesh(
        write_ply(tmp_path / "a.ply", ball.vertices, ball.faces, normals=ball.normals, binary=binary)
    )
    np.testing.assert_allclose(mesh.vertices, ball.vertices, atol=1e-7)
    np.testing.assert_array_equal(mesh.faces, ball.faces)
    np.testing.assert_allclose(mesh.normals, ball.normals, atol=1e-6)


def test_obj_with_quads_coordinates_and_normals(tmp_path):
    path = tmp_path / "a.obj"
    path.write_text(
        "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 0.25\nvt 0 0.25\nvn 0 0 1\n"
        "f 1/1/1 2/2/1 3/3/1 4/4/1\n"
    )
    mesh = load_mesh(path)
    assert len(mesh.faces) == 2 and mesh.face_areas().sum() == pytest.approx(1.0)
    np.testing.assert_allclose(mesh.face_normals(), [[0, 0, 1]] * 2)
    np.testing.assert_array_equal(mesh.normals, [[0, 0, 1]] * len(mesh.vertices))
    # v counts from below: (x, y) goes with (x, y / 4).
    np.testing.assert_allclose(mesh.uvs, mesh.vertices[:, :2] * [1.0, 0.25])


def test_obj_keeps_a_seam_and_its_normals(tmp_path):
    """Two triangles share an edge but not its coordinates and normals: six corners, six vertices."""
    path = tmp_path / "a.obj"
    path.write_text(
        "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 0.5 0\nvt 0.5 1\nvt 0.7 0\nvt 0.7 1\nvt 1 1\n"
        "vn 0 0 1\nvn 0.6 0 0.8\nf 1/1/1 2/2/1 3/3/1\nf 1/4/2 3/5/2 4/6/2\n"
    )
    mesh = load_mesh(path)
    assert len(mesh.vertices) == 6
    corners = mesh.faces.ravel()
    np.testing.assert_array_equal(mesh.vertices[corners], SQUARE[[0, 1, 2, 0, 2, 3]])
    np.testing.assert_allclose(
        mesh.uvs[corners], [[0, 0], [0.5, 0], [0.5, 1], [0.7, 0], [0.7, 1], [1, 1]], rtol=1e-7
    )
    np.testing.assert_allclose(mesh.normals[corners], [[0, 0, 1]] * 3 + [[0.6, 0, 0.8]] * 3, rtol=1e-7)


def test_ply_polygons_are_cut_into_triangles(tmp_path):
    path = tmp_path / "a.ply"
    path.write_text(
        "ply\nformat ascii 1.0\nelement vertex 5\nproperty float x\nproperty float y\nproperty float z\n"
        "element face 2\nproperty list uchar int vertex_indices\nend_header\n"
        "0 0 0\n2 0 0\n2 2 0\n1 3 0\n0 2 0\n5 0 1 2 3 4\n3 0 2 1\n"
    )
    mesh = load_mesh(path)
    assert mesh.face_areas().sum() == pytest.approx(5.0 + 2.0)


def test_ply_keeps_vertex_coordinates_to_the_bit(tmp_path):
    uvs = np.float32([[0.1, 1.0], [1.0, 0.3], [-0.2, 2.5], [0.1, 1.0 - 2.0**-24]])
    path = write_ply(tmp_path / "a.ply", SQUARE, [[0, 1, 2], [0, 2, 3]], uvs=uvs, normals=[[0, 0, 1]] * 4)
    mesh = load_mesh(path)
    np.testing.assert_array_equal(mesh.uvs, uvs)
    np.testing.assert_array_equal(mesh.vertices, SQUARE)
    np.testing.assert_array_equal(mesh.normals, [[0, 0, 1]] * 4)


def test_obj_of_several_groups_is_joined(tmp_path):
    path = tmp_path / "a.obj"
    path.write_text(
        "mtllib missing.mtl\no one\nusemtl a\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
        "o two\nusemtl b\nv 0 0 5\nv 1 0 5\nv 0 1 5\nf -3 -2 -1\n"
    )
    mesh = load_mesh(path)
    assert len(mesh.faces) == 2
    assert sorted(mesh.vertices[mesh.faces][:, 0, 2]) == [0.0, 5.0]
    assert mesh.normals is None


def test_stl_keeps_its_facets(tmp_path):
    side = box((1.0, 2.0, 3.0))
    records = b"".join(struct.pack("<12fH", 0, 0, 0, *side.vertices[f].ravel(), 0) for f in side.faces)
    path = tmp_path / "a.stl"
    path.write_bytes(b"\0" * 80 + struct.pack("<I", 12) + records)
    mesh = load_mesh(path)
    assert len(mesh.faces) == 12 and mesh.normals is None
    assert volume(mesh) == pytest.approx(6.0)


def test_gltf_nodes_place_and_mirror(tmp_path):
    """Two nodes show one mesh; the mirrored one keeps its facets on the side its normals are on."""
    path = tmp_path / "a.gltf"
    uvs = [[0, 0], [1, 0], [1, 1], [0, 1]]
    nodes = [{"mesh": 0, "translation": [5, 0, 0]}, {"mesh": 0, "scale": [-2, 1, 1]}]
    path.write_text(json.dumps(gltf(nodes, uvs=uvs, normals=[[0, 0, 1]] * 4)))
    mesh = load_mesh(path)
    assert len(mesh.faces) == 4
    low, high = mesh.bounds()
    np.testing.assert_allclose([low, high], [[-2, 0, 0], [6, 1, 0]])
    np.testing.assert_allclose(mesh.face_normals(), [[0, 0, 1]] * 4)
    np.testing.assert_allclose(mesh.normals, [[0, 0, 1]] * 8)
    # glTF counts v downwards, the mesh upwards: the corner (0, 0) of the file's picture is its top left.
    at_origin = np.flatnonzero((mesh.vertices == [5, 0, 0]).all(axis=1))
    np.testing.assert_allclose(mesh.uvs[at_origin], [[0.0, 1.0]])


@pytest.mark.case("GEO-04")
def test_geo_04_unusable_triangles_are_dropped_and_counted(tmp_path):
    """GEO-04: zero area, repeated corners, NaN and infinite vertices; the rest is kept bit for bit."""
    vertices = np.concatenate([SQUARE, [[np.nan, 0, 0], [0.5, 0, 0], [0, np.inf, 0]]])
    good = [[0, 1, 2], [0, 2, 3]]
    bad = [[0, 1, 4], [0, 5, 1], [2, 2, 3], [0, 1, 6], [1, 1, 1]]
    mesh = load_mesh(write_ply(tmp_path / "a.ply", vertices, [good[0], *bad, good[1]]))
    assert mesh.dropped == 5
    np.testing.assert_array_equal(mesh.faces, good)
    np.testing.assert_array_equal(mesh.vertices[:4], SQUARE)
    assert np.isfinite(mesh.vertices).all()
    low, high = mesh.bounds()
    np.testing.assert_array_equal([low, high], [[0, 0, 0], [1, 1, 0]])


@pytest.mark.parametrize("scale", [1e-30, 1e30])
def test_small_and_large_triangles_are_not_taken_for_empty(tmp_path, scale):
    mesh = load_mesh(write_ply(tmp_path / "a.ply", SQUARE * scale, [[0, 1, 2], [0, 2, 3]]))
    assert mesh.dropped == 0
    np.testing.assert_allclose(mesh.face_normals(), [[0, 0, 1]] * 2)


# Errors


def test_missing_empty_and_unknown_files(tmp_path):
    with pytest.raises(InputError, match="does not exist"):
        load_mesh(tmp_path / "none.ply")
    (tmp_path / "empty.obj").write_bytes(b"")
    with pytest.raises(InputError, match="empty"):
        load_mesh(tmp_path / "empty.obj")
    (tmp_path / "a.fbx").write_bytes(b"x")
    with pytest.raises(InputError, match="unknown kind"):
        load_mesh(tmp_path / "a.fbx")


def test_mesh_without_faces(tmp_path):
    with pytest.raises(InputError, match="no faces") as caught:
        load_mesh(write_ply(tmp_path / "a.ply", SQUARE, []))
    assert caught.value.exit_code == 3 and caught.value.hint
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\n")
    with pytest.raises(InputError):
        load_mesh(tmp_path / "a.obj")


def test_mesh_of_unusable_triangles_only(tmp_path):
    with pytest.raises(InputError, match="none of the mesh's 2 triangles"):
        load_mesh(write_ply(tmp_path / "a.ply", SQUARE * [1, 0, 0], [[0, 1, 2], [0, 2, 3]]))


def test_index_out_of_range(tmp_path):
    with pytest.raises(InputError):
        load_mesh(write_ply(tmp_path / "a.ply", SQUARE, [[0, 1, 7]]))
    with pytest.raises(InputError):
        load_mesh(write_ply(tmp_path / "b.ply", SQUARE, [[0, 1, -2]]))


def test_ply_header_that_announces_too_much(tmp_path):
    path = write_ply(tmp_path / "a.ply", SQUARE, [[0, 1, 2]])
    path.write_bytes(path.read_bytes().replace(b"element vertex 4", b"element vertex 4000000000"))
    with pytest.raises(InputError, match="announces"):
        load_mesh(path)


@pytest.mark.parametrize("kind", ["ply", "stl", "glb"])
def test_truncated_files_are_refused(tmp_path, kind):
    """Cut anywhere, a binary file is an error and never a smaller mesh."""
    ball = uv_sphere(1.0, segments=5, rings=4)
    whole = tmp_path / f"a.{kind}"
    if kind == "ply":
        write_ply(whole, ball.vertices, ball.faces, normals=ball.normals)
    elif kind == "stl":
        records = b"".join(struct.pack("<12fH", 0, 0, 0, *ball.vertices[f].ravel(), 0) for f in ball.faces)
        whole.write_bytes(b"\0" * 80 + struct.pack("<I", len(ball.faces)) + records)
    else:
        document = gltf([{"mesh": 0}])
        blob = base64.b64decode(document["buffers"][0].pop("uri").split(",")[1])
        text = json.dumps(document).encode()
        text += b" " * (-len(text) % 4)
        blob += b"\0" * (-len(blob) % 4)
        whole.write_bytes(
            struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(blob))
            + struct.pack("<I4s", len(text), b"JSON") + text
            + struct.pack("<I4s", len(blob), b"BIN\0") + blob
        )  # fmt: skip
    assert len(load_mesh(whole).faces) == (2 if kind == "glb" else len(ball.faces))
    data = whole.read_bytes()
    cut = tmp_path / f"cut.{kind}"
    for share in (0.02, 0.1, 0.3, 0.5, 0.7, 0.9, 0.97, 1.0 - 1.5 / len(data)):
        cut.write_bytes(data[: int(share * len(data))])
        with pytest.raises(InputError):
            load_mesh(cut)


# Geometry


def test_angle_weighted_normals_of_a_cube_do_not_see_its_diagonals():
    """At a cube's corner all three sides meet at 90 degrees, however they are cut into triangles."""
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float64)
    faces = np.array(
        [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6],
         [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]], dtype=np.int32,
    )  # fmt: skip
    cube = Mesh(signs, faces)
    assert volume(cube) == pytest.approx(8.0)
    for scale in (1e-20, 1.0, 1e20):
        mesh = Mesh(signs * scale, faces).with_angle_weighted_normals()
        np.testing.assert_allclose(mesh.normals, signs / np.sqrt(3.0), atol=1e-7)


def test_angle_weighted_normals_against_a_loop():
    mesh = uv_sphere(1.0, segments=9, rings=6)
    total = np.zeros((len(mesh.vertices), 3))
    for face in mesh.faces:
        for k in range(3):
            a, b, c = (mesh.vertices[face[(k + j) % 3]] for j in range(3))
            n = np.cross(b - a, c - a)
            cosine = (b - a) @ (c - a) / np.linalg.norm(b - a) / np.linalg.norm(c - a)
            total[face[k]] += np.arccos(cosine) * n / np.linalg.norm(n)
    total /= np.linalg.norm(total, axis=1, keepdims=True)
    got = mesh.with_angle_weighted_normals().normals
    assert got.dtype == np.float32
    np.testing.assert_allclose(got, total, atol=1e-7)


def test_unused_and_cancelling_vertices_get_a_unit_normal():
    mesh = Mesh(np.concatenate([SQUARE, [[9, 9, 9]]]), np.array([[0, 1, 2], [0, 2, 1]], np.int32))
    np.testing.assert_allclose(np.linalg.norm(mesh.with_angle_weighted_normals().normals, axis=1), 1.0)


@pytest.mark.case("GEO-07")
@pytest.mark.parametrize("seed", range(4))
def test_transform_keeps_facets_outward_and_normals_upright(seed):
    rng = np.random.default_rng(seed)
    matrix = np.eye(4)
    matrix[:3, :3] = rng.normal(size=(3, 3)) @ np.diag([1e-3, 1.0, 1e3])
    matrix[:3, 3] = rng.normal(size=3)
    if seed % 2:
        matrix[:3, 0] *= -1.0
    ball = uv_sphere(1.0, segments=40, rings=30)
    moved = ball.transformed(matrix)
    determinant = np.linalg.det(matrix[:3, :3])
    assert volume(moved) == pytest.approx(abs(determinant) * volume(ball), rel=1e-6)
    # The normal of a turned and stretched tangent plane, by its two tangents.
    point = ball.vertices
    u = np.cross(point, [0.3, 0.5, 0.8])
    v = np.cross(point, u)
    tangents = (matrix[:3, :3] @ u.T).T, (matrix[:3, :3] @ v.T).T
    wanted = np.cross(*tangents) * np.sign(determinant)
    wanted /= np.linalg.norm(wanted, axis=1, keepdims=True)
    np.testing.assert_allclose(moved.normals, wanted, atol=1e-6)


def test_transform_refuses_what_is_not_a_placement():
    flat = np.diag([1.0, 1.0, 0.0, 1.0])
    with pytest.raises(ValueError, match="singular"):
        plane(1, 1).transformed(flat)
    for bad in (np.full((4, 4), np.nan), np.ones((4, 4))):
        with pytest.raises(ValueError, match="affine"):
            plane(1, 1).transformed(bad)


def test_shapes():
    ground = plane(2.0, 3.0, centre=(1.0, 0.0, 0.5))
    np.testing.assert_allclose(ground.bounds(), [[0, -1.5, 0.5], [2, 1.5, 0.5]])
    np.testing.assert_allclose(ground.face_normals(), [[0, 0, 1]] * 2)
    np.testing.assert_allclose(ground.uvs, (ground.vertices[:, :2] - [0.0, -1.5]) / [2.0, 3.0])
    crate = box((1.0, 2.0, 3.0), centre=(5.0, 0.0, 0.0))
    assert volume(crate) == pytest.approx(6.0) and is_closed(crate)
    np.testing.assert_allclose(crate.bounds(), [[4.5, -1, -1.5], [5.5, 1, 1.5]])
    np.testing.assert_allclose(
        np.einsum("ij,ij->i", crate.face_normals(), crate.normals[crate.faces[:, 0]]), 1.0
    )
    for ball, triangles in (
        (uv_sphere(2.0, segments=64, rings=32), 64 * 62),
        (icosphere(2.0, subdivisions=4), 20 * 4**4),
    ):
        assert len(ball.faces) == triangles and is_closed(ball)
        assert volume(ball) == pytest.approx(4.0 / 3.0 * np.pi * 8.0, rel=6e-3)
        np.testing.assert_allclose(np.linalg.norm(ball.vertices, axis=1), 2.0)
        np.testing.assert_allclose(ball.normals, ball.vertices / 2.0, atol=1e-7)
    assert ground.size() == pytest.approx(np.sqrt(13.0))


def test_concatenate():
    joined = concatenate([plane(1, 1), Mesh(SQUARE, np.array([[0, 1, 2]], np.int32), dropped=3)])
    assert joined.faces.tolist() == [[0, 1, 2], [0, 2, 3], [4, 5, 6]]
    assert joined.faces.dtype == np.int32 and joined.dropped == 3
    assert joined.normals.shape == (8, 3) and joined.uvs.shape == (8, 2)
    only_later = concatenate([Mesh(SQUARE, np.array([[0, 1, 2]], np.int32)), plane(1, 1)])
    assert only_later.normals.shape == (8, 3)
    with pytest.raises(ValueError):
        concatenate([])
