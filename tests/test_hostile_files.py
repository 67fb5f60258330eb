"""Files that somebody sends: cut short, bits flipped, headers that lie. A clear error, or a correct result.

Whatever a reader raises must be an error of ours, with the file's name; what it takes must be usable.
Seeds are fixed, so a failure is the same everywhere.
"""

from __future__ import annotations

import io
import json
import struct
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import OpenImageIO as oiio
import pytest

from mrbatch.capture.marker_video.calibration import load_calibration
from mrbatch.capture.marker_video.gain import load_gains
from mrbatch.capture.marker_video.matte import Mattes
from mrbatch.capture.marker_video.pose_file import load_poses
from mrbatch.capture.marker_video.settings import MatteSettings
from mrbatch.errors import InputError, MrbatchError
from mrbatch.scene.depth_map import load_depth_mesh
from mrbatch.scene.depth_settings import DepthMap
from mrbatch.scene.environment import load_environment
from mrbatch.scene.given_material import _texture
from mrbatch.scene.mesh import icosphere
from mrbatch.scene.mesh_file import load_mesh

K = [[500.25, 0.0, 321.5], [0.0, 501.75, 239.0], [0.0, 0.0, 1.0]]


def picture(suffix: str, kind: str, channels: int = 3, **attributes: Any) -> Callable[[Path], None]:
    def make(path: Path) -> None:
        values = np.random.default_rng(1).random((12, 16, channels))
        if kind == "uint8":
            values = (values * 255).astype(np.uint8)
        spec = oiio.ImageSpec(16, 12, channels, kind)
        for name, value in attributes.items():
            spec.attribute(name, value)
        out = oiio.ImageOutput.create(str(path))
        assert out.open(str(path), spec) and out.write_image(values.astype(kind.replace("half", "float16")))
        assert out.close()

    return make


def ball(kind: str) -> Callable[[Path], None]:
    def make(path: Path) -> None:
        import trimesh

        mesh = icosphere(1.0, subdivisions=1)
        trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(str(path), file_type=kind)

    return make


def text(content: Any) -> Callable[[Path], None]:
    def make(path: Path) -> None:
        path.write_text(content if isinstance(content, str) else json.dumps(content), encoding="utf-8")

    return make


def filestorage(path: Path) -> None:
    storage = cv2.FileStorage(str(path), cv2.FileStorage_WRITE)
    storage.write("image_width", 640)
    storage.write("image_height", 480)
    storage.write("camera_matrix", np.array(K))
    storage.write("distortion_coefficients", np.array([0.1, -0.2, 0.001, -0.002, 0.05]))
    storage.release()


def usable_light(path: Path) -> None:
    radiance = load_environment(path).radiance
    assert np.isfinite(radiance).all() and radiance.min() >= 0.0


def usable_texture(path: Path) -> None:
    _texture.cache_clear()
    pixels, _ = _texture(path, "srgb")
    assert np.isfinite(pixels).all() and pixels.min() >= 0.0 and pixels.max() <= 1.0


def depth(path: Path) -> None:
    values = np.random.default_rng(1).uniform(1.0, 1.01, (12, 16)).astype(np.float32)
    if path.suffix == ".npy":
        np.save(path, values)
        return
    kind = "uint16" if path.suffix == ".png" else "float"
    values = np.round(1e4 * values).astype(np.uint16) if kind == "uint16" else values
    out = oiio.ImageOutput.create(str(path))
    assert out.open(str(path), oiio.ImageSpec(16, 12, 1, kind)) and out.write_image(values) and out.close()


def usable_depth(path: Path) -> None:
    own = {
        "matrix": [[20.0, 0.0, 8.0], [0.0, 20.0, 6.0], [0.0, 0.0, 1.0]],
        "world_from_camera": np.eye(4).tolist(),
    }
    settings = {"file": str(path), "measures": "z", "camera": own}
    unit = "0.1 mm" if path.suffix == ".png" else "1 m"
    mesh, _ = load_depth_mesh(DepthMap.model_validate({**settings, "unit": unit}), None)
    assert np.isfinite(mesh.vertices).all() and len(mesh.faces) > 0
    assert mesh.faces.min() >= 0 and mesh.faces.max() < len(mesh.vertices)


def usable_mesh(path: Path) -> None:
    mesh = load_mesh(path)
    assert np.isfinite(mesh.vertices).all() and len(mesh.faces) > 0
    assert mesh.faces.min() >= 0 and mesh.faces.max() < len(mesh.vertices)
    assert mesh.normals is None or np.isfinite(mesh.normals).all()


def usable_calibration(path: Path) -> None:
    calibration = load_calibration(path)
    assert np.isfinite(calibration.matrix).all() and np.isfinite(calibration.distortion).all()
    assert calibration.matrix[0, 0] > 0 and calibration.matrix[1, 1] > 0
    assert calibration.width is None or calibration.width > 0


def usable_poses(path: Path) -> None:
    for pose in load_poses(path).values():
        np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-9)
        assert np.isfinite(pose).all()


def usable_gains(path: Path) -> None:
    for gain in load_gains(path).values():
        assert len(gain) == 3 and all(np.isfinite(g) and g > 0 for g in gain)


def usable_matte(path: Path) -> None:
    matte = Mattes(MatteSettings.model_validate(str(path))).read(0, 16, 12)
    assert matte.shape == (12, 16) and matte.min() >= 0.0 and matte.max() <= 1.0


@dataclass(frozen=True)
class Reader:
    name: str
    make: Callable[[Path], None]
    use: Callable[[Path], None]


POSES = [{"frame": n, "world_from_camera": np.eye(4).tolist()} for n in range(3)]
POSES.append({"frame": 7, "rvec": [0.1, 0.2, 0.3], "tvec": [1, 2, 3]})
PLAIN = (
    "width: 640\nheight: 480\nfx: 500.25\nfy: 501.75\ncx: 321.5\ncy: 239.0\ndistortion: [0.1, -0.2, 0, 0]\n"
)
READERS = [
    Reader("sky.exr", picture("exr", "half"), usable_light),
    Reader("sky.hdr", picture("hdr", "float"), usable_light),
    Reader("t.png", picture("png", "uint8"), usable_texture),
    Reader("t.jpg", picture("jpg", "uint8"), usable_texture),
    Reader("t.tif", picture("tif", "uint8"), usable_texture),
    Reader("t.exr", picture("exr", "float"), usable_texture),
    Reader("m_0000.png", picture("png", "uint8", 1), usable_matte),
    Reader("m_0000.exr", picture("exr", "half", 1), usable_matte),
    Reader("d.png", depth, usable_depth),
    Reader("d.exr", depth, usable_depth),
    Reader("d.npy", depth, usable_depth),
    Reader("ball.ply", ball("ply"), usable_mesh),
    Reader("ball.obj", ball("obj"), usable_mesh),
    Reader("ball.glb", ball("glb"), usable_mesh),
    Reader("ball.stl", ball("stl"), usable_mesh),
    Reader("c.xml", filestorage, usable_calibration),
    Reader("c.yml", filestorage, usable_calibration),
    Reader("c.yaml", text(PLAIN), usable_calibration),
    Reader("c.json", text({"K": K, "dist": [0.1, 0.2, 0, 0], "image_size": [640, 480]}), usable_calibration),
    Reader("c.npz", lambda path: np.savez(path, mtx=np.array(K), dist=np.zeros(5)), usable_calibration),
    Reader("c.npy", lambda path: np.save(path, np.array(K)), usable_calibration),
    Reader("poses.json", text(POSES), usable_poses),
    Reader("gains.json", text({"1": 0.5, "2": [0.5, 0.6, 0.7], "3": 2}), usable_gains),
    Reader("gains.csv", text("frame,r,g,b\n1,0.5,0.6,0.7\n2,1,2,3\n"), usable_gains),
]


def damaged(data: bytes, random: np.random.Generator, trial: int) -> bytes:
    """Cut short, bits flipped, bytes replaced (headers more often than data), or a piece doubled."""
    broken = bytearray(data)
    way = trial % 4
    span = len(broken) if trial % 3 == 0 else min(len(broken), 200)
    if way == 0:
        return bytes(broken[: random.integers(0, len(broken))])
    if way == 3:
        start, stop = sorted(random.integers(0, len(broken), 2))
        return bytes(broken[:stop] + broken[start:])
    for at in random.integers(0, span, 1 + trial % 5):
        broken[at] = broken[at] ^ (1 << int(random.integers(8))) if way == 1 else random.integers(256)
    return bytes(broken)


@pytest.mark.parametrize("reader", READERS, ids=lambda reader: reader.name)
def test_damaged_files(tmp_path, reader):
    good = tmp_path / reader.name
    reader.make(good)
    reader.use(good)
    data = good.read_bytes()
    random = np.random.default_rng(sum(reader.name.encode()))
    for trial in range(80):
        good.write_bytes(damaged(data, random, trial))
        try:
            reader.use(good)
        except MrbatchError as error:
            assert reader.name in str(error.place), error
            assert len(str(error)) < 2000


HUGE = "1" * 400
DEEP = "[" * 100_000
HOSTILE_JSON = [
    DEEP,
    '{"a":' * 100_000,
    f'[{{"frame": {"9" * 5000}, "world_from_camera": []}}]',
    f'[{{"frame": 1, "world_from_camera": [[{HUGE}, 0, 0, 0]]}}]',
    f'[{{"frame": 1, "rvec": [{HUGE}, 0, 0], "tvec": [0, 0, {HUGE}]}}]',
    '[{"frame": 1, "rvec": [1e200, 1e200, 0], "tvec": [1e308, 1e308, 0]}]',
    '[{"frame": 1, "world_from_camera": [[1e200,1e200,0,0],[-1e200,1e200,0,0],[0,0,1,0],[0,0,0,1]]}]',
    '[{"frame": 1, "world_from_camera": [[1,0,0,1e300],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}]',
    f'{{"{HUGE}": 1}}',
    f'{{"1": {HUGE}}}',
    '{"1": 1e999}',
    '{"1": {"a": 1}}',
    '{"1": [1, [2], 3]}',
    '[{"frame": [1], "gain": 1}]',
    '[{"frame": 1e999, "gain": 1}]',
    '[{"frame": 1.5, "gain": 1}]',
    '{"1": 1, "1": 2}',
    "[NaN, Infinity]",
    "[1, 2, 3]",
    "3",
    '"text"',
    "null",
    '{"K": [[1, 2], [3]], "M": [[[1], 2], 3]}',
    f'{{"K": [[{HUGE}, 0, 1], [0, 1, 1], [0, 0, 1]]}}',
    '{"K": [[1e308, 0, 1], [0, 1e308, 1], [0, 0, 1]]}',
    '{"fx": "a", "fy": 1, "cx": [1], "cy": {}}',
    f'{{"fx": 1, "fy": 1, "cx": 1, "cy": 1, "width": {HUGE}, "height": 1e999}}',
    '{"fx": 1, "fy": 1, "cx": 1, "cy": 1, "width": [], "height": {}}',
    '{"K": [1,0,0,0,1,0,0,0,1], "distortion_model": "odd", "D": [[1], [2, 3]]}',
    '{"K": [1,0,0,0,1,0,0,0,1], "image_size": [[1], [2, 3]], "pixel_centres": [1]}',
    '{"K": {"data": {"data": 1}}, "D": {"data": null}}',
]


@pytest.mark.parametrize("content", HOSTILE_JSON, ids=range(len(HOSTILE_JSON)))
@pytest.mark.parametrize("read", [load_poses, load_gains, load_calibration])
def test_hostile_json(tmp_path, read, content):
    path = tmp_path / "file.json"
    path.write_text(content, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        read(path)
    assert "file.json" in str(caught.value.place) and len(str(caught.value)) < 2000


@pytest.mark.parametrize(
    "content",
    [
        "frame,gain\n1\n",
        "frame,gain\n1,2,3\n",
        "frame,r,g,b\n1,2,3\n",
        f"frame,gain\n{'9' * 5000},1\n",
        f"frame,gain\n1,{'9' * 5000}\n",
        "frame,gain\n1,inf\n",
        "frame,gain\n1.5,1\n",
        f'frame,gain\n1,"{"x" * 200_000}"\n',
        "frame,gain\n",
        "",
        "frame,gain\n1,1\n1,2\n",
    ],
    ids=range(11),
)
def test_hostile_csv(tmp_path, content):
    path = tmp_path / "g.csv"
    path.write_text(content, encoding="utf-8")
    with pytest.raises(InputError):
        load_gains(path)


def bomb_of_aliases() -> str:
    """Nine anchors of nine aliases each: a billion values, were they unfolded."""
    lines = ["a: &a [1,1,1,1,1,1,1,1,1]"]
    for before, name in zip("abcdefgh", "bcdefghi"):
        lines.append(f"{name}: &{name} [{','.join([f'*{before}'] * 9)}]")
    return "\n".join([*lines, "K: *i"])


@pytest.mark.parametrize(
    "content",
    [
        bomb_of_aliases(),
        DEEP,
        "K: !!python/object/apply:os.system [ls]",
        "a: &a [*a]\nK: *a",
        "%YAML:1.0\n---\nK: !!opencv-matrix\n   rows: 100000\n   cols: 100000\n   dt: d\n   data: [ 1. ]\n",
        "%YAML:1.0\n---\nK: !!opencv-matrix\n   sizes: [ 100000, 100000 ]\n   dt: d\n   data: [ 1. ]\n",
        "%YAML:1.0\n---\nK: !!opencv-matrix\n   rows: -3\n   cols: 3\n   dt: d\n   data: [ 1. ]\n",
        # More data than the sizes say: OpenCV's own reader of matrices writes past their end.
        "%YAML:1.0\n---\nK: !!opencv-matrix\n   rows: 1\n   cols: 1\n   dt: d\n   data: [ 1., 2., 3., 4. ]\n",
        "%YAML:1.0\n---\nK: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: 4096d\n   data: [ 1. ]\n",
        "%YAML:1.0\n---\na: opencv-matrix\nb: " + DEEP,
        "%YAML:1.0\n---\na: opencv-matrix\nb:\n   " + "- " * 100_000,
        "<?xml version='1.0'?><opencv_storage>" + "<a>" * 100_000,
        "%YAML:1.0\n---\na: opencv-matrix\n" + "".join(f"k{i}: 1\n" for i in range(100_000)),
        "%YAML:1.0\n---\na: opencv-matrix\nb: [" + "1, " * 300_000 + "1]\n",
        "# all comment\n" * 100_000,
        "fx: 1\n" * 2,
        "x" * (5 << 20),
    ],
    ids=range(17),
)
def test_hostile_calibrations(tmp_path, content):
    path = tmp_path / ("c.xml" if content.startswith("<") else "c.yaml")
    path.write_text(content, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        load_calibration(path)
    assert len(str(caught.value)) < 2000


def npy(shape: str, kind: str = "'<f8'", data: bytes = b"") -> bytes:
    header = f"{{'descr': {kind}, 'fortran_order': False, 'shape': {shape}, }}".encode()
    header += b" " * (63 - (10 + len(header)) % 64) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + data


def zipped(entries: dict[str, bytes], way: int = zipfile.ZIP_DEFLATED) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", way) as archive:
        for name, data in entries.items():
            archive.writestr(name, data)
    return out.getvalue()


@pytest.mark.parametrize(
    "content",
    [
        npy("(1000000, 1000000)"),
        npy("(-1, 3)"),
        npy("(3, 3)", "'|O'", b"\x80\x04."),
        npy("(3, 3)", "[('a', '|O')]", b"\x80\x04."),
        npy("(" * 3000 + ")" * 3000),
        npy("__import__('os').getpid()"),
        npy("(3, 3)", "'<c16'", bytes(144)),
        npy("(3, 3)", "'<M8[s]'", bytes(72)),
        zipped({"K.npy": npy("(1024, 1024, 64)", "'<f8'", bytes(1 << 29 >> 4))}),
        zipped({"K.npy": npy("(100000, 100000)")}),
        zipped({f"{i}.npy": npy("(1,)", data=bytes(8)) for i in range(1000)}),
        zipped({"K.npy": npy("(3, 3)", data=bytes(72))}, zipfile.ZIP_LZMA),
        zipped({"fisheye.npy": npy("(2,)", data=bytes(16)), "K.npy": npy("(3, 3)", data=bytes(72))}),
        zipped({"pixel_centres.npy": npy("(2,)", data=bytes(16)), "K.npy": npy("(3, 3)", data=bytes(72))}),
        b"PK\x03\x04" + bytes(100),
        b"PK\x05\x06" + bytes(18),
    ],
    ids=range(16),
)
@pytest.mark.parametrize("suffix", ["npy", "npz"])
def test_hostile_arrays(tmp_path, content, suffix):
    path = tmp_path / f"c.{suffix}"
    path.write_bytes(content)
    with pytest.raises(InputError):
        load_calibration(path)


def glb(header: Any, data: bytes = b"") -> bytes:
    raw = header if isinstance(header, bytes) else json.dumps(header).encode()
    raw += b" " * (-len(raw) % 4)
    chunks = struct.pack("<I4s", len(raw), b"JSON") + raw + struct.pack("<I4s", len(data), b"BIN\0") + data
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def layout(**more: Any) -> dict[str, Any]:
    """A glTF of one triangle, 36 + 12 bytes, with parts replaced."""
    return {
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": 48}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}, {"buffer": 0, "byteOffset": 36, "byteLength": 12}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5125, "count": 3, "type": "SCALAR"},
        ],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "nodes": [{"mesh": 0}],
        "scenes": [{"nodes": [0]}],
    } | more


TRIANGLE = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4").tobytes() + np.arange(3, dtype="<u4").tobytes()
ZEROS = {"componentType": 5126, "count": 10**10, "type": "VEC3"}


FOURS = [{"buffer": 0, "byteLength": 48}, layout()["bufferViews"][1]]
FOUR = {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC4"}
"""Positions of four numbers: three of them are as many numbers as four positions."""


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.glb", glb(DEEP.encode(), TRIANGLE)),
        ("a.glb", glb([1, 2], TRIANGLE)),
        ("a.glb", glb(layout(accessors=[ZEROS, layout()["accessors"][1]]), TRIANGLE)),
        ("a.glb", glb(layout(accessors=[{"bufferView": 0} | ZEROS]), TRIANGLE)),
        ("a.glb", glb(layout(accessors=[{"count": -1}]), TRIANGLE)),
        ("a.glb", glb(layout(accessors=3), TRIANGLE)),
        ("a.glb", glb(layout(bufferViews=FOURS, accessors=[FOUR, layout()["accessors"][1]]), TRIANGLE)),
        ("a.glb", struct.pack("<4sII", b"glTF", 2, 1000) + struct.pack("<I4s", 2**32 - 1, b"JSON")),
        ("a.gltf", json.dumps(layout(buffers=[{"uri": "../secret.bin", "byteLength": 48}])).encode()),
        ("a.gltf", json.dumps(layout(buffers=[{"uri": "%2e%2e/secret.bin", "byteLength": 48}])).encode()),
        ("a.gltf", json.dumps(layout(buffers=[{"uri": "/etc/passwd", "byteLength": 48}])).encode()),
        ("a.gltf", json.dumps(layout(buffers=[{"uri": "file:///etc/passwd"}])).encode()),
        ("a.gltf", json.dumps(layout(buffers=[{"uri": "http://example.com/a.bin"}])).encode()),
        ("a.gltf", json.dumps(layout(buffers=[{"uri": "gone.bin", "byteLength": 48}])).encode()),
        ("a.glb", glb(layout(buffers=[{"uri": "../secret.bin", "byteLength": 48}]), TRIANGLE)),
        ("a.gltf", b"\xff\xfe{}"),
        (
            "a.ply",
            b"ply\nformat binary_little_endian 1.0\nelement vertex 4000000000\nproperty float x\n"
            b"property float y\nproperty float z\nelement face 1\n"
            b"property list uchar int vertex_indices\nend_header\n" + bytes(64),
        ),
    ],
    ids=range(17),
)
def test_hostile_meshes(tmp_path, name, content):
    folder = tmp_path / "meshes"
    folder.mkdir()
    (tmp_path / "secret.bin").write_bytes(TRIANGLE)
    (folder / name).write_bytes(content)
    with pytest.raises(InputError) as caught:
        load_mesh(folder / name)
    assert len(str(caught.value)) < 2000


def test_the_triangle_itself_is_read(tmp_path):
    """What the hostile ones are changed from."""
    (tmp_path / "a.glb").write_bytes(glb(layout(), TRIANGLE))
    assert len(load_mesh(tmp_path / "a.glb").faces) == 1
    (tmp_path / "a b.bin").write_bytes(TRIANGLE)
    content = layout(buffers=[{"uri": "a%20b.bin", "byteLength": 48}])
    (tmp_path / "a.gltf").write_text(json.dumps(content))
    assert len(load_mesh(tmp_path / "a.gltf").faces) == 1


def exr_header(width: int, channels: int) -> bytes:
    """The header of an EXR (version 2, scan lines) that claims a size, with nothing behind it."""

    def attribute(name: str, kind: str, value: bytes) -> bytes:
        return name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<i", len(value)) + value

    one = struct.pack("<iB3xii", 2, 0, 1, 1)
    names = ["B", "G", "R"] + [f"x{i:03d}" for i in range(channels - 3)]
    listed = b"".join(name.encode() + b"\0" + one for name in names) + b"\0"
    box = struct.pack("<4i", 0, 0, width - 1, width // 2 - 1)
    body = attribute("channels", "chlist", listed) + attribute("compression", "compression", b"\0")
    body += attribute("dataWindow", "box2i", box) + attribute("displayWindow", "box2i", box)
    body += attribute("lineOrder", "lineOrder", b"\0") + attribute("pixelAspectRatio", "float", b"\0\0\x80?")
    body += attribute("screenWindowCenter", "v2f", bytes(8)) + attribute(
        "screenWindowWidth", "float", b"\0\0\x80?"
    )
    return b"\x76\x2f\x31\x01\x02\0\0\0" + body + b"\0" + bytes(4096)


@pytest.mark.parametrize(("width", "channels"), [(10**6, 3), (2**30, 3), (16384, 5000), (20000, 3)])
@pytest.mark.parametrize("use", [usable_light, usable_texture])
def test_pictures_that_claim_too_much(tmp_path, width, channels, use):
    path = tmp_path / "huge.exr"
    path.write_bytes(exr_header(width, channels))
    with pytest.raises(InputError):
        use(path)
