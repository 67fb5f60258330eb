"""EXR files: what goes in comes out, headers mean what the standard says, same input gives same bytes.

Headers are checked with a small parser written after the format's specification, so that the library
which writes the files is not asked about itself.
"""

from __future__ import annotations

import hashlib
import os
import struct
import subprocess
import sys
import time
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from held import holds

from mrbatch.errors import InputError, ResourceError
from mrbatch.film import cryptomatte, layers
from mrbatch.film.camera_metadata import world_to_camera, world_to_ndc
from mrbatch.film.exr import (
    FrameImage,
    ViewImage,
    choose_colour_type,
    frame_metadata,
    read_frame,
    write_frame,
)
from mrbatch.film.verification import verify_frame
from mrbatch.film.window import Window
from mrbatch.kernels.transfer import from_linear, to_linear
from mrbatch.scene.camera import Camera
from mrbatch.stability import file_cases
from mrbatch.stability.file_cases import lit


def headers(path: Path) -> list[dict[str, tuple[str, bytes]]]:
    """Attributes of each part as (type, bytes), after "OpenEXR File Layout"."""
    data = path.read_bytes()
    assert data[:4] == b"\x76\x2f\x31\x01"
    multipart = bool(struct.unpack_from("<I", data, 4)[0] & 0x1000)
    at, parts = 8, []

    def text() -> str:
        nonlocal at
        end = data.index(b"\0", at)
        piece, at = data[at:end].decode(), end + 1
        return piece

    while True:
        part: dict[str, tuple[str, bytes]] = {}
        while name := text():
            kind = text()
            (size,) = struct.unpack_from("<i", data, at)
            part[name] = (kind, data[at + 4 : at + 4 + size])
            at += 4 + size
        if not part:
            return parts
        parts.append(part)
        if not multipart:
            return parts


def channel_types(part) -> dict[str, str]:
    raw, at, found = part["channels"][1], 0, {}
    while raw[at]:
        end = raw.index(b"\0", at)
        (kind,) = struct.unpack_from("<i", raw, end + 1)
        found[raw[at:end].decode()] = {0: "uint", 1: "half", 2: "float"}[kind]
        at = end + 1 + 16
    return found


def turned_camera(width=40, height=30) -> Camera:
    rng = np.random.default_rng(5)
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    pose = np.eye(4)
    pose[:3, :3] = q * np.sign(np.linalg.det(q))
    pose[:3, 3] = (1.5, -0.7, 2.2)
    k = np.array([[35.0, 0.1, 21.3], [0, 36.0, 14.2], [0, 0, 1]])
    return Camera(width, height, k, np.zeros(8), pose)


def image(width=40, height=30, *, views=("",), names=("depth", "normal", "samples"), seed=0, **more):
    window = more.get("window") or Window(0, 0, width, height)
    made = {}
    for i, view in enumerate(views):
        rng = np.random.default_rng(seed + i)
        shape = (window.height, window.width)
        a = np.clip(rng.uniform(-0.5, 1.5, shape), 0, 1)
        e = {
            "P": rng.uniform(0, 2, (*shape, 3)) * a[..., None],
            "a": a,
            "B": rng.uniform(0, 1, (*shape, 3)),
            "D": rng.normal(0, 0.3, (*shape, 3)),
            "depth": np.where(a > 0, rng.uniform(1, 2, shape), 1e10),
            "normal": rng.normal(size=(*shape, 3)),
            "samples": np.full(shape, 64),
            "object_ids": rng.choice([cryptomatte.name_id(n) for n in ("a", "b", "c")], (*shape, 4)),
            "object_coverage": rng.uniform(0, 0.25, (*shape, 4)),
        }
        chosen = layers.channels((*layers.DEFAULT_LAYERS, *names), e)
        crypto = cryptomatte.metadata("CryptoObject", ["a", "b", "c"])
        made[view] = ViewImage(chosen, turned_camera(width, height), crypto)
    return FrameImage(1001, made, (width, height), **more)


def test_what_goes_in_comes_out(tmp_path):
    given = image(
        names=("depth", "normal", "crypto_object"),
        frames_per_second=Fraction(30000, 1001),
        owner="Jane Doe",
        metadata={"plan": {"b": [1, 2], "a": "ü"}, "seed": 7, "error": 0.1},
    )
    write_frame(tmp_path / "f.exr", given)
    got = read_frame(tmp_path / "f.exr")
    assert set(got.views) == {""} and set(got.views[""].channels) == set(given.views[""].channels)
    negative = 0
    for name, values in given.views[""].channels.items():
        stored = got.views[""].channels[name]
        expected = values.astype(np.float16).astype(np.float32) if name.split(".")[0] in (
            "R", "G", "B", "A", "virtual", "background", "delta"
        ) else values  # fmt: skip
        assert np.array_equal(stored.view(np.uint32), np.ascontiguousarray(expected).view(np.uint32)), name
        negative += (stored < 0).sum() if name.startswith("delta") else 0
    assert negative > 100, "delta keeps its sign"
    assert np.all(got.views[""].channels["depth.Z"].max() == np.float32(1e10))
    assert got.metadata == given.metadata and got.number == 1001 and got.owner == "Jane Doe"
    assert got.frames_per_second == Fraction(30000, 1001) and got.display == (40, 30)
    assert got.colour_type == "half" and got.views[""].attributes == given.views[""].attributes
    camera, original = got.views[""].camera, given.views[""].camera
    assert camera.model == original.model
    assert np.array_equal(camera.world_from_camera, original.world_from_camera)
    assert np.array_equal(camera.matrix, original.matrix)


@pytest.mark.parametrize("compression", ["none", "rle", "zips", "zip", "piz"])
def test_channel_types_and_compression(tmp_path, compression):
    write_frame(tmp_path / "h.exr", image(compression=compression))
    write_frame(tmp_path / "f.exr", image(compression=compression, colour_type="float"))
    (half,) = headers(tmp_path / "h.exr")
    types = channel_types(half)
    assert {types[c] for c in ("R", "A", "virtual.A", "delta.B", "background.G")} == {"half"}
    assert {types[c] for c in ("depth.Z", "normal.X", "samples")} == {"float"}
    assert set(channel_types(headers(tmp_path / "f.exr")[0]).values()) == {"float"}
    code = {"none": 0, "rle": 1, "zips": 2, "zip": 3, "piz": 4}[compression]
    assert half["compression"] == ("compression", bytes([code]))


def test_header_follows_the_standard(tmp_path):
    write_frame(tmp_path / "f.exr", image(frames_per_second=Fraction(24), owner="me"))
    (part,) = headers(tmp_path / "f.exr")
    kind, raw = part["framesPerSecond"]
    assert kind == "rational" and struct.unpack("<iI", raw) == (24, 1)
    assert part["owner"] == ("string", b"me")
    kind, raw = part["chromaticities"]
    np.testing.assert_allclose(
        struct.unpack("<8f", raw), (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290), rtol=1e-6
    )
    assert part["worldToCamera"][0] == part["worldToNDC"][0] == "m44f"
    unknown = set(part) - {
        "channels", "chromaticities", "compression", "dataWindow", "displayWindow", "framesPerSecond",
        "lineOrder", "owner", "pixelAspectRatio", "screenWindowCenter", "screenWindowWidth",
        "worldToCamera", "worldToNDC", "mrbatch/frame", "mrbatch/camera",
    }  # fmt: skip
    assert all(name.startswith("cryptomatte/") for name in unknown), unknown


def test_matrices_agree_with_the_cameras_own_projection(tmp_path):
    camera = turned_camera()
    write_frame(tmp_path / "f.exr", image())
    (part,) = headers(tmp_path / "f.exr")
    to_camera, to_ndc = (
        np.array(struct.unpack("<16f", part[name][1])).reshape(4, 4)
        for name in ("worldToCamera", "worldToNDC")
    )
    np.testing.assert_allclose(to_camera, world_to_camera(camera), rtol=1e-6, atol=1e-6)
    rng = np.random.default_rng(2)
    eye, view = camera.world_from_camera[:3, 3], camera.world_from_camera[:3, :3]
    points = eye + (rng.uniform((-0.4, -0.3, 1), (0.4, 0.3, 3), (50, 3)) * [1, 1, 1]) @ view.T
    pixels, depth = camera.project(points)
    rows = np.concatenate([points, np.ones((50, 1))], axis=1)
    clip = rows @ to_ndc
    np.testing.assert_allclose(clip[:, :2] / clip[:, 3:] * (40, 30), pixels, atol=2e-4)
    space = rows @ to_camera
    np.testing.assert_allclose(space[:, 2], depth, rtol=1e-5)  # looks along +z
    below = eye + view @ np.array([0.0, 1.0, 2.0])  # y down in our frame is -y in the standard's
    np.testing.assert_allclose((np.append(below, 1) @ to_camera)[:3], (0, -1, 2), atol=1e-5)
    assert np.linalg.det(to_camera[:3, :3]) < 0, "the standard's camera space is left-handed"
    assert np.linalg.matrix_rank(world_to_ndc(camera)) == 4


def test_panorama_camera_space():
    pose = np.eye(4)
    pose[:3, 3] = (1, 2, 3)
    m = world_to_camera(Camera(8, 4, np.eye(3), np.zeros(8), pose, model="equirectangular"))
    # x is the picture's centre, z up; +y lies left of the centre (u = 1/2 - atan2(y, x) / 2 pi).
    for world, space in (((2, 2, 3), (0, 0, 1)), ((1, 3, 3), (-1, 0, 0)), ((1, 2, 4), (0, 1, 0))):
        np.testing.assert_allclose((np.append(world, 1.0) @ m)[:3], space, atol=1e-12)


def test_panorama_has_no_ndc(tmp_path):
    camera = Camera(4, 2, np.eye(3), np.zeros(8), np.eye(4), model="equirectangular")
    write_frame(tmp_path / "p.exr", FrameImage(1, {"": ViewImage(layers.empty([], 2, 4), camera)}, (4, 2)))
    (part,) = headers(tmp_path / "p.exr")
    assert "worldToCamera" in part and "worldToNDC" not in part


@pytest.mark.parametrize("window", [Window(5, 7, 11, 3), Window(-8, -8, 56, 46), Window(39, 29, 1, 1)])
def test_crop_and_overscan_windows(tmp_path, window):
    write_frame(tmp_path / "w.exr", image(window=window))
    (part,) = headers(tmp_path / "w.exr")
    last = (window.x + window.width - 1, window.y + window.height - 1)
    assert struct.unpack("<4i", part["dataWindow"][1]) == (window.x, window.y, *last)
    assert struct.unpack("<4i", part["displayWindow"][1]) == (0, 0, 39, 29)
    got = read_frame(tmp_path / "w.exr")
    assert got.window == window and got.display == (40, 30)
    assert got.views[""].channels["R"].shape == (window.height, window.width)


@pytest.mark.case("IO-07")
@pytest.mark.parametrize(("width", "height"), [(1, 1), (1279, 719), (1, 4096)])
def test_odd_sizes(tmp_path, width, height):
    values = np.arange(width * height, dtype=np.float32).reshape(height, width)
    channels = {**layers.empty(["depth"], height, width), "depth.Z": values}
    write_frame(tmp_path / "o.exr", FrameImage(1, {"": ViewImage(channels)}, (width, height)))
    assert np.array_equal(read_frame(tmp_path / "o.exr").views[""].channels["depth.Z"], values)
    verify_frame(tmp_path / "o.exr", channels)


def test_views_are_parts(tmp_path):
    given = image(views=("left", "right"), metadata={"seed": 3})
    write_frame(tmp_path / "s.exr", given)
    left, right = headers(tmp_path / "s.exr")
    assert left["view"] == ("string", b"left") and right["view"] == ("string", b"right")
    assert left["name"][1] != right["name"][1]
    assert channel_types(left) == channel_types(right)
    assert "worldToCamera" in right and "mrbatch/seed" in left
    got = read_frame(tmp_path / "s.exr")
    assert list(got.views) == ["left", "right"] and got.metadata == {"seed": 3}
    for view in given.views:
        assert np.array_equal(got.views[view].channels["depth.Z"], given.views[view].channels["depth.Z"]), (
            view
        )
    with pytest.raises(InputError, match=r"motion\.X"):
        verify_frame(tmp_path / "s.exr", ["R", "motion.X"])


def test_same_bytes_whatever_the_clock_folder_or_threads(tmp_path, monkeypatch):
    import OpenImageIO as oiio

    def digest(path):
        write_frame(path, image(220, 200, views=("left", "right"), metadata={"b": 1, "a": 2}))
        return hashlib.sha256(Path(path).read_bytes()).hexdigest()

    threads = oiio.get_int_attribute("exr_threads")
    try:
        first = digest(tmp_path / "a.exr")
        (tmp_path / "sub").mkdir()
        monkeypatch.chdir(tmp_path / "sub")
        monkeypatch.setenv("TZ", "Asia/Tokyo")
        time.tzset() if hasattr(time, "tzset") else None
        oiio.attribute("exr_threads", 1)
        time.sleep(1.1)  # a date stamp counts in seconds
        second = digest(Path("other.name.part"))
        oiio.attribute("exr_threads", 5)
        assert digest(tmp_path / "c.exr") == second == first == verify_frame(tmp_path / "a.exr")
    finally:
        oiio.attribute("exr_threads", threads)
        monkeypatch.undo()
        time.tzset() if hasattr(time, "tzset") else None


def test_key_order_of_metadata_does_not_show(tmp_path):
    write_frame(tmp_path / "a.exr", image(metadata={"x": {"p": 1, "q": 2}}))
    write_frame(tmp_path / "b.exr", image(metadata={"x": {"q": 2, "p": 1}}))
    assert (tmp_path / "a.exr").read_bytes() == (tmp_path / "b.exr").read_bytes()


def test_half_loses_12_bit_codes():
    codes = np.arange(4096, dtype=np.uint16)
    linear = to_linear(codes, "srgb", 12)
    wrong = from_linear(linear.astype(np.float16).astype(np.float32), "srgb", 12) != codes
    assert 0.01 < wrong.mean() < 0.05
    assert not np.any(from_linear(linear, "srgb", 12) != codes), "float keeps them"


def test_choice_of_colour_type():
    assert choose_colour_type(8, 1.0)[0] == choose_colour_type(10, 65504.0)[0] == "half"
    assert choose_colour_type(12, 1.0)[0] == choose_colour_type(16, 1.0)[0] == "float"
    assert choose_colour_type(16, 900.0, source_is_half=True)[0] == "half"
    assert choose_colour_type(8, 1.0, transfer="gamma28")[0] == "half"
    assert choose_colour_type(10, 1.0, transfer="gamma28")[0] == "float", "two dark codes would merge"
    for peak in (69120.0, float("inf"), float("nan")):
        kind, why = choose_colour_type(8, peak)
        assert kind == "float" and "65504" in why


@pytest.mark.case("IO-01")
def test_light_above_half_is_never_infinite():
    """IO-01: an error that names the pixel, or 65504 with a note, or float."""
    holds(file_cases.beyond_half(0))


@pytest.mark.case("IO-02")
def test_numbers_that_are_none_are_refused():
    holds(file_cases.no_numbers(0))


def test_wrong_size_is_a_defect(tmp_path):
    channels = layers.empty([], 4, 5)
    with pytest.raises(ValueError, match="shape"):
        write_frame(tmp_path / "n.exr", FrameImage(1, {"": ViewImage(channels)}, (4, 5)))


def test_unwritable_places(tmp_path):
    with pytest.raises(ResourceError, match="No such file") as caught:
        write_frame(tmp_path / "absent" / "f.exr", lit(1.0))
    assert caught.value.exit_code == 5
    with pytest.raises(ResourceError):
        write_frame(tmp_path, lit(1.0))
    assert tmp_path.is_dir()


@pytest.mark.skipif(os.name != "posix", reason="file size limits are POSIX")
@pytest.mark.parametrize("limit", [60, 20_000, "-1", "-3000"])
def test_disk_that_fills_up_while_writing(tmp_path, limit):
    """A file size limit stops writes as a full disk does: a clear error, and no half file stays.

    The last two limits lie just below the whole file's size, so that only the flush on closing fails.
    """
    whole = tmp_path / "whole.exr"
    noise = np.random.default_rng(0).random((200, 200), dtype=np.float32)
    channels = {**layers.empty(["depth"], 200, 200), "depth.Z": noise}
    write_frame(whole, FrameImage(1, {"": ViewImage(channels)}, (200, 200)))
    limit = whole.stat().st_size + int(limit) if isinstance(limit, str) else limit
    script = f"""
import resource, signal, sys
import numpy as np
from pathlib import Path
from mrbatch.errors import ResourceError
from mrbatch.film.exr import FrameImage, ViewImage, write_frame
from mrbatch.film import layers
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, ({limit}, {limit}))
channels = layers.empty(["depth"], 200, 200)
channels["depth.Z"] = np.random.default_rng(0).random((200, 200), dtype=np.float32)
try:
    write_frame(Path(sys.argv[1]), FrameImage(1, {{"": ViewImage(channels)}}, (200, 200)))
except ResourceError as error:
    sys.exit(error.exit_code)
"""
    path = tmp_path / "d.exr"
    assert subprocess.run([sys.executable, "-c", script, str(path)], check=False).returncode == 5
    assert not path.exists()


def test_broken_files_are_named(tmp_path):
    path = tmp_path / "f.exr"
    write_frame(path, image())
    whole = path.read_bytes()
    for broken in (whole[: len(whole) // 2], whole[:-1], whole[:200], b"", b"not a picture at all"):
        path.write_bytes(broken)
        with pytest.raises(InputError) as caught:
            verify_frame(path)
        assert str(path) in str(caught.value) and caught.value.exit_code == 3
    with pytest.raises(InputError, match="no such file"):
        read_frame(tmp_path / "absent.exr")
    path.write_bytes(whole)
    with pytest.raises(InputError, match="limit"):
        read_frame(path, max_values=1000)


def test_damaged_headers_give_an_input_error_or_a_frame(tmp_path):
    path = tmp_path / "f.exr"
    write_frame(path, image(metadata={"plan": {"a": 1}}))
    whole = path.read_bytes()
    rng = np.random.default_rng(11)
    refused = 0
    for _ in range(150):
        damaged = bytearray(whole)
        for at in rng.integers(0, 2500, rng.integers(1, 12)):
            damaged[at] = rng.integers(256)
        path.write_bytes(damaged)
        for read in (frame_metadata, read_frame, verify_frame):
            try:
                read(path)
            except InputError:
                refused += 1
    assert refused > 100


def test_non_finite_files_do_not_pass_verification(tmp_path):
    import OpenImageIO as oiio

    spec = oiio.ImageSpec(4, 4, 3, "float")
    out = oiio.ImageOutput.create("openexr")
    assert out.open(str(tmp_path / "n.exr"), spec)
    pixels = np.zeros((4, 4, 3), np.float32)
    pixels[1, 2, 0] = np.nan
    assert out.write_image(pixels) and out.close()
    with pytest.raises(InputError, match="NaN"):
        verify_frame(tmp_path / "n.exr")


def test_metadata_without_pixels(tmp_path):
    write_frame(tmp_path / "f.exr", image(window=Window(2, 3, 10, 9), metadata={"plan": [1], "seed": 5}))
    told = frame_metadata(tmp_path / "f.exr")
    (part,) = told["parts"]
    assert part["display"] == [0, 0, 40, 30] and part["window"] == [2, 3, 10, 9]
    assert {"name": "depth.Z", "type": "float"} in part["channels"]
    assert {"name": "R", "type": "half"} in part["channels"]
    assert part["mrbatch"]["plan"] == [1] and part["mrbatch"]["frame"] == 1001
    assert len(part["attributes"]["worldToCamera"]) == 16 and part["compression"] == "zip"


def test_an_independent_reader_finds_the_mattes(tmp_path):
    pytest.importorskip("cryptomatte_api", reason="the independent Cryptomatte reader is not installed")
    from cryptomatte_api import Cryptomatte

    given = image(names=("crypto_object",))
    path = tmp_path / "c.exr"
    write_frame(path, given)
    (loaded,) = Cryptomatte.load(str(path))
    for name in "abc":
        ours = cryptomatte.coverage_of(name, given.views[""].channels)
        np.testing.assert_allclose(loaded.mask(name), ours, atol=1e-6)
