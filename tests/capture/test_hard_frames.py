"""Frames and poses at the edge: byte orders, the sign of zero, face-on targets near and far."""

from __future__ import annotations

import struct

import cv2
import numpy as np
import OpenImageIO as oiio
import pytest
from rendered_marker import errors
from test_pose import BOARD_POINTS, FAR, K, _orbit, _seen

from mrbatch.capture.marker_video.colour import ColourSettings
from mrbatch.capture.marker_video.markers import marker_corners
from mrbatch.capture.marker_video.pose import _table
from mrbatch.capture.marker_video.pose_solver import pose_covariance, solve
from mrbatch.capture.marker_video.sequence import picture_colour, read_picture
from mrbatch.errors import InputError, Place
from mrbatch.scene.mesh_file import load_mesh
from mrbatch.scene.stored_picture import read_stored


def read(path):
    colour = picture_colour(read_stored(path), ColourSettings(), Place())[0]
    return read_picture(path, colour, ColourSettings(), 7)


def tiff(codes: np.ndarray, order: str) -> bytes:
    """An uncompressed RGB TIFF of 8 or 16 bits, little (<) or big (>) endian, written field by field."""
    height, width, _ = codes.shape
    bits = 8 * codes.dtype.itemsize
    body = codes.astype(codes.dtype.newbyteorder(order)).tobytes()
    fields = [(256, 4, 1, width), (257, 4, 1, height), (258, 3, 3, None), (259, 3, 1, 1), (262, 3, 1, 2)]
    fields += [(273, 4, 1, 8), (277, 3, 1, 3), (278, 4, 1, height), (279, 4, 1, len(body))]
    table = 8 + len(body)
    more = table + 2 + 12 * len(fields) + 4
    data = (b"II" if order == "<" else b"MM") + struct.pack(order + "HI", 42, table) + body
    data += struct.pack(order + "H", len(fields))
    for tag, kind, count, value in fields:
        value = more if value is None else value
        data += struct.pack(order + "HHI", tag, kind, count)
        data += struct.pack(order + ("H2x" if kind == 3 and count == 1 else "I"), value)
    return data + struct.pack(order + "I", 0) + struct.pack(order + "3H", bits, bits, bits)


@pytest.mark.case("IO-08")
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_pictures_of_both_byte_orders_are_the_same(tmp_path, dtype):
    codes = np.random.default_rng(1).integers(0, np.iinfo(dtype).max, (9, 14, 3), dtype=dtype, endpoint=True)
    found = []
    for name, order in (("little", "<"), ("big", ">")):
        path = tmp_path / f"{name}.tif"
        path.write_bytes(tiff(codes, order))
        found.append(read(path).linear)
    assert np.array_equal(found[0], found[1])
    path = tmp_path / "library.png"
    assert cv2.imwrite(str(path), codes[..., ::-1])
    assert np.array_equal(read(path).linear, found[0])


@pytest.mark.case("IO-08")
def test_meshes_of_both_byte_orders_are_the_same(tmp_path):
    corners = np.float32([[0, 0, 0], [1.5, 0, 0], [0, 0.7, 3e-8]])
    found = []
    for name, order in (("little", "<"), ("big", ">")):
        head = f"ply\nformat binary_{name}_endian 1.0\nelement vertex 3\n"
        head += "".join(f"property float {c}\n" for c in "xyz")
        head += "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
        body = corners.astype(order + "f4").tobytes() + struct.pack(order + "B3i", 3, 0, 1, 2)
        path = tmp_path / f"{name}.ply"
        path.write_bytes(head.encode() + body)
        found.append(load_mesh(path))
    assert np.array_equal(found[0].vertices, found[1].vertices) and np.array_equal(found[0].vertices, corners)
    assert np.array_equal(found[0].faces, found[1].faces)


@pytest.mark.case("IO-02")
def test_minus_zero_is_no_negative_light_and_keeps_its_bits(tmp_path):
    values = np.full((3, 4, 3), 0.5, np.float32)
    values[1, 2] = -0.0
    spec = oiio.ImageSpec(4, 3, 3, "float")
    out = oiio.ImageOutput.create(str(tmp_path / "z.exr"))
    assert out.open(str(tmp_path / "z.exr"), spec) and out.write_image(values) and out.close()
    picture = read(tmp_path / "z.exr")
    assert picture.flags == ()
    assert np.array_equal(picture.linear.view(np.uint32), values.view(np.uint32))


LINEAR = (
    "seen face-on, a small tilt moves corners by its square alone: beyond half a metre the covariance, that "
    "of a linear model, is too small (43 % of poses lie within what should hold 95 %)"
)


@pytest.mark.case("MRK-01")
@pytest.mark.parametrize(
    "distance",
    [0.4, *(pytest.param(d, marks=pytest.mark.xfail(reason=LINEAR, strict=True)) for d in (0.8, 1.5, 3.0))],
)
def test_face_on_boards_are_where_their_sigma_says(distance):
    """Each of six parameters lies within two of its stated sigma 95 times in 100, and so do all together."""
    random = np.random.default_rng(int(10 * distance))
    pose = _orbit(0.0, distance, roll=0.3)
    total, deviations, squares = 300, [], []
    for _ in range(total):
        detection = _seen(BOARD_POINTS, pose, FAR, 0.3, random)
        root = solve(detection, FAR)[0]
        covariance = pose_covariance(root, detection, FAR)
        turn = root.world_from_camera[:3, :3].T @ pose[:3, :3]
        w = cv2.Rodrigues(turn.T)[0].ravel()
        off = np.concatenate([w, pose[:3, 3] - root.world_from_camera[:3, 3]])
        deviations.append(np.abs(off) < 2 * np.sqrt(np.diag(covariance)))
        squares.append(off @ np.linalg.solve(covariance, off) < 12.59)
    spread = np.sqrt(0.95 * 0.05 / total)
    assert np.all(np.abs(np.mean(deviations, axis=0) - 0.9545) < 4 * spread)
    assert abs(np.mean(squares) - 0.95) < 4 * spread


@pytest.mark.case("MRK-01", "TRAP-3g")
@pytest.mark.parametrize("distance", [0.4, 0.8, 1.5])
def test_a_face_on_marker_alone_is_refused_or_told(distance):
    """Of one square face-on the two roots run into each other: its normal is off by 5 to 10 degrees, and more
    than a linear sigma says. It is refused, or lies within four of its sigma or of the roots' distance."""
    random = np.random.default_rng(3)
    pose, worst, given = _orbit(0.0, distance), 0.0, 0
    for k in range(60):
        seen = _seen(marker_corners(0.06), pose, FAR, 0.3, random)
        first = errors(solve(seen, FAR)[0].world_from_camera, pose)[0]
        worst = max(worst, first)
        try:
            row = _table([(k, 0.0, seen)], FAR, "skip", None).frames[0]
        except InputError:
            continue
        if row.world_from_camera is None:
            continue
        given += 1
        sigma = np.degrees(np.sqrt(np.trace(row.covariance[:3, :3])))
        between = 0.0 if row.other is None else errors(row.other.world_from_camera, row.world_from_camera)[0]
        assert errors(row.world_from_camera, pose)[0] < max(4 * sigma, between)
    print(f"{distance} m: {given} of 60 given; the first root alone is off by up to {worst:.1f} degrees")
    assert worst > 3.0, "the case is too easy to prove anything"


MIRRORED = (
    "within some 5 degrees of face-on the picture of a board as small as a hand has one best pose, and in "
    "one frame of fifty that leans to the other side: off by twice the tilt, four of its stated sigma"
)


@pytest.mark.case("MRK-02", "TRAP-3g")
@pytest.mark.parametrize(
    "least", [9.0, pytest.param(2.0, marks=pytest.mark.xfail(reason=MIRRORED, strict=True))]
)
def test_a_board_never_flips_on_its_way_through_face_on(least):
    """100 frames, tilts of -20 to 20 degrees: beyond `least` degrees none leans to the wrong side."""
    random = np.random.default_rng(8)
    tilts = np.linspace(-20, 20, 100)
    poses = [_orbit(t, 1.2, sideways=0.02) for t in tilts]
    looked = [(i, i / 25, _seen(BOARD_POINTS, pose, FAR, 0.2, random)) for i, pose in enumerate(poses)]
    table = _table(looked, FAR, "skip", None)
    # Where two roots cannot be told apart the frame is lost, not wrong.
    assert len(table.poses()) >= 90
    for row, pose, tilt in zip(table.frames, poses, tilts, strict=True):
        if row.world_from_camera is not None and abs(tilt) > least:
            assert errors(row.world_from_camera, pose)[0] < abs(tilt), tilt


@pytest.mark.case("MRK-07", "TRAP-3h")
@pytest.mark.parametrize("k1", [-0.4, 0.4])
def test_a_pinhole_would_miss_the_rim_by_pixels(k1):
    """Printed: the lens serves the pose alone, and what is virtual is drawn as by a pinhole."""
    points = marker_corners(0.06) + [0.13, 0.08, 0.0]
    pose = np.linalg.inv(_orbit(0.0, 0.4))
    rvec, tvec = cv2.Rodrigues(pose[:3, :3])[0], pose[:3, 3]
    lens, pinhole = (
        cv2.projectPoints(points, rvec, tvec, K, np.array([k, 0, 0, 0, 0.0]))[0] for k in (k1, 0.0)
    )
    assert np.abs(lens - pinhole).max() > 5.0
