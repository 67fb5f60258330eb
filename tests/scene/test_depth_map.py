"""Surfaces from depth maps: a plane and a box whose depth is known in closed form, a real sensor's picture,
and maps that cannot be used."""

from __future__ import annotations

import numpy as np
import OpenImageIO as oiio
import pytest
from pydantic import ValidationError

from mrbatch.errors import InputError
from mrbatch.scene import settings as given
from mrbatch.scene.build import build_scene
from mrbatch.scene.camera import Camera
from mrbatch.scene.open3d_loader import open3d

WIDTH, HEIGHT = 96, 72
K = np.array([[90.0, 0.0, 47.2], [0.0, 88.0, 36.9], [0.0, 0.0, 1.0]])
BOX = np.array([[-0.12, -0.1, 0.08], [0.1, 0.14, 0.3]])  # hovers over the plane z = 0
EYE, FORWARD = np.array([0.8, -0.9, 0.8]), np.array([-0.8, 0.9, -0.7])


def pose():
    forward = FORWARD / np.linalg.norm(FORWARD)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    matrix[:3, 3] = EYE
    return matrix


def seen():
    """Depth along the axis and range (H, W), and what is seen (H, W): 0 the plane, 1 to 6 the box's sides."""
    x, y = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    rays = np.stack([(x - K[0, 2]) / K[0, 0], (y - K[1, 2]) / K[1, 1], np.ones_like(x)], axis=-1)
    d = rays @ pose()[:3, :3].T
    with np.errstate(divide="ignore"):
        plane = np.where(d[..., 2] < 0.0, -EYE[2] / d[..., 2], np.inf)
        slabs = (BOX[:, None, None] - EYE) / d
    near, far = slabs.min(axis=0), slabs.max(axis=0)
    axis = near.argmax(axis=-1)
    hit = (near.max(axis=-1) < far.min(axis=-1)) & (near.max(axis=-1) < plane)
    z = np.where(hit, near.max(axis=-1), plane)
    return z, z * np.linalg.norm(rays, axis=-1), np.where(hit, 1 + axis, 0)


def camera(**more):
    return {
        "matrix": K.tolist(),
        "pixel_centres": "half",
        "world_from_camera": pose().tolist(),
        **more,
    }


def table(path, **more):
    settings = {"file": str(path), "measures": "z", "unit": "1 m", "camera": camera(), **more}
    if "frame" in more:
        del settings["camera"]
    return given.RealObject.model_validate({"name": "desk", "depth_map": settings, "reflectance": 0.5})


def surface(path, **more):
    scene = build_scene(None, [table(path, **more)], [])
    return scene.objects[0].mesh, scene.notes


def save(path, values, channels=None):
    if path.suffix == ".npy":
        np.save(path, values)
        return path
    values = values.reshape(HEIGHT, WIDTH, -1)
    spec = oiio.ImageSpec(WIDTH, HEIGHT, values.shape[2], str(values.dtype).replace("32", ""))
    if channels:
        spec.channelnames = channels
    out = oiio.ImageOutput.create(str(path))
    assert out.open(str(path), spec) and out.write_image(values) and out.close()
    return path


def off_surface(points):
    """Distances (n,) to the nearest of the plane and the sides of the box that the camera sees."""
    inside = np.all((points > BOX[0] - 1e-3) & (points < BOX[1] + 1e-3), axis=1)
    sides = np.min([np.abs(points - BOX[0]), np.abs(points - BOX[1])], axis=(0, 2))
    return np.where(inside, sides, np.abs(points[:, 2]))


def owners(mesh, what):
    """What each vertex was seen on: by its place in the picture, which the uvs tell."""
    column = np.floor(mesh.uvs[:, 0].astype(float) * WIDTH).astype(int)
    row = np.floor((1.0 - mesh.uvs[:, 1].astype(float)) * HEIGHT).astype(int)
    return what[row, column]


@pytest.mark.parametrize(
    ("name", "measures", "unit"),
    [("d.npy", "z", 1.0), ("d.npy", "range", 1.0), ("d.exr", "z", 1e-3), ("d.exr", "range", 1e-3)],
)
def test_a_plane_and_a_box_come_back(tmp_path, name, measures, unit):
    z, along, what = seen()
    values = ((z if measures == "z" else along) / unit).astype(np.float32)
    mesh, notes = surface(save(tmp_path / name, values), measures=measures, unit=f"{unit} m")
    # Every pixel has its vertex, and it lies on what was seen, to the float32 of the file.
    assert len(mesh.vertices) == WIDTH * HEIGHT
    assert off_surface(mesh.vertices).max() < 2.0**-23 * along.max()
    kinds = owners(mesh, what)[mesh.faces]
    joined = (kinds == 0).any(axis=1) & (kinds > 0).any(axis=1)
    assert (what > 0).sum() > 300 and not joined.any()
    # Nothing but skirts is left out: of four neighbours on one body come two triangles, of three one.
    quads = np.stack([what[:-1, :-1], what[:-1, 1:], what[1:, 1:], what[1:, :-1]], axis=-1) > 0
    count = quads.sum(axis=-1)
    assert len(mesh.faces) == (2 * np.isin(count, (0, 4)) + np.isin(count, (1, 3))).sum()
    # Facets look at the camera.
    middle = mesh.vertices[mesh.faces].mean(axis=1)
    assert np.all(np.einsum("nk,nk->n", mesh.face_normals(), EYE - middle) > 0.0)
    assert f"{len(mesh.faces)} triangles" in notes[0]


def test_without_a_threshold_there_are_skirts(tmp_path):
    """What the test above looks for is there to be found."""
    z, _, what = seen()
    mesh, _ = surface(save(tmp_path / "d.npy", z), edge=1.0)
    kinds = owners(mesh, what)[mesh.faces]
    joined = (kinds == 0).any(axis=1) & (kinds > 0).any(axis=1)
    assert joined.sum() > 50 and mesh.face_areas()[joined].sum() > 0.02


def test_a_blurred_edge_joins_nothing(tmp_path):
    """One pixel halfway between foreground and background, as resampling leaves it."""
    z = np.full((HEIGHT, WIDTH), 1.2)
    z[:, :40] = 1.0
    for between in (1.1, 1.09, 1.15):
        z[:, 40] = between
        mesh, _ = surface(save(tmp_path / "d.npy", z))
        columns = np.floor(mesh.uvs[:, 0].astype(float) * WIDTH)[mesh.faces]
        assert not np.any((columns.min(axis=1) < 40) & (columns.max(axis=1) > 39))
        assert not np.any((columns.min(axis=1) < 41) & (columns.max(axis=1) > 40))


def test_codes_of_16_bits_with_their_unit(tmp_path):
    z, _, what = seen()
    codes = np.round(z / 1e-4).astype(np.uint16)
    codes[:, 40] = 0  # a hole
    mesh, _ = surface(save(tmp_path / "d.png", codes), unit="0.1 mm")
    assert len(mesh.vertices) == (WIDTH - 1) * HEIGHT
    assert off_surface(mesh.vertices).max() < 0.51e-4
    across = (np.abs(mesh.uvs[mesh.faces, 0] * WIDTH - 40.5)).max(axis=1)
    assert across.max() > 10 and not np.any(np.ptp(mesh.uvs[mesh.faces, 0] * WIDTH, axis=1) > 1.5)


def test_a_lens_is_undone(tmp_path):
    """Points of the plane go through `project`, whose formula OpenCV confirms elsewhere."""
    lens = [-0.25, 0.08, 0.001, -0.0005, 0.0]
    seen_by = Camera.from_opencv(WIDTH, HEIGHT, K, np.array(lens), pose(), pixel_centres="half")
    x, y = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    pixels = np.stack([x.ravel(), y.ravel()], axis=1)
    rays = seen_by.directions(pixels)
    there = np.isfinite(rays[:, 0])
    assert there.mean() > 0.99
    back, depth = seen_by.at(np.eye(4)).project(rays[there])
    np.testing.assert_allclose(back, pixels[there], atol=1e-6)
    np.testing.assert_array_equal(depth, 1.0)
    straight = Camera.from_opencv(WIDTH, HEIGHT, K, None, pose(), pixel_centres="half").directions(pixels)
    moved = np.abs(rays - straight)[there].max()
    assert moved > 0.02  # the lens does something here
    d = rays @ pose()[:3, :3].T
    z = (-EYE[2] / d[:, 2]).reshape(HEIGHT, WIDTH)
    z[z < 0] = np.nan
    mesh, _ = surface(save(tmp_path / "d.npy", z), camera=camera(distortion=lens))
    assert np.abs(mesh.vertices[:, 2]).max() < 1e-9


def test_the_frames_camera_at_another_resolution(tmp_path):
    z, _, _ = seen()
    big = Camera.from_opencv(WIDTH, HEIGHT, K, None, pose(), pixel_centres="half").scaled(
        4 * WIDTH, 4 * HEIGHT
    )
    asked = []

    def camera_of(frame):
        asked.append(frame)
        return big

    item = table(save(tmp_path / "d.npy", z), frame=7)
    mesh = build_scene(None, [item], [], camera_of).objects[0].mesh
    assert asked == [7] and off_surface(mesh.vertices).max() < 1e-12

    def lost(frame):
        raise InputError("the frame has no camera pose")

    with pytest.raises(
        InputError, match="`desk` was taken in frame 7, which cannot be used: the frame has no"
    ):
        build_scene(None, [item], [], lost)


@pytest.mark.parametrize(
    ("name", "values", "channels", "more", "words"),
    [
        ("d.npy", np.zeros((HEIGHT, WIDTH), np.float32), None, {}, "no pixel of the depth map has a depth"),
        ("d.npy", np.full((HEIGHT, WIDTH), np.nan), None, {}, "no pixel of the depth map has a depth"),
        ("d.npy", np.ones((HEIGHT, WIDTH, 3)), None, {}, "holds float64 of shape"),
        ("d.npy", np.array([object()]), None, {}, "cannot be read"),
        (
            "d.npy",
            np.full((HEIGHT, WIDTH), 1500.0),
            None,
            {"unit": "1 km"},
            "1.5e.06 m away: its `unit` cannot",
        ),
        (
            "d.npy",
            np.full((HEIGHT, WIDTH), 1.5),
            None,
            {"unit": "0.1 mm"},
            "0.00015 m away: its `unit` cannot",
        ),
        ("d.npy", np.ones((HEIGHT, WIDTH)), None, {"farthest": "0.5 m"}, "makes no surface"),
        ("d.png", np.full((HEIGHT, WIDTH), 9, np.uint8), None, {}, "has 8 bits"),
        ("d.exr", np.random.default_rng(0).random((HEIGHT, WIDTH, 3)).astype("f"), None, {}, "which differ"),
    ],
)
def test_maps_that_cannot_be_used(tmp_path, name, values, channels, more, words):
    path = tmp_path / name
    if values.dtype == object:
        np.save(path, values, allow_pickle=True)
    else:
        save(path, values, channels)
    with pytest.raises(InputError, match=words):
        surface(path, **more)


def test_a_map_of_another_shape_than_the_frame_is_refused(tmp_path):
    z, _, _ = seen()
    other = Camera.from_opencv(640, 360, K, None, pose())
    with pytest.raises(
        InputError, match="has 96 x 72 pixels, the frame 640 x 360: they do not show the same"
    ):
        build_scene(None, [table(save(tmp_path / "d.npy", z), frame=0)], [], lambda frame: other)


def test_a_file_that_is_cut_or_missing(tmp_path):
    z, _, _ = seen()
    path = save(tmp_path / "d.npy", z)
    path.write_bytes(path.read_bytes()[:2000])
    with pytest.raises(InputError, match="cannot be read"):
        surface(path)
    with pytest.raises(InputError, match="no such depth map"):
        surface(tmp_path / "x.npy")
    with pytest.raises(InputError, match="no such depth map"):
        surface(tmp_path / "x.exr")


def test_the_channel_z_is_found_among_others(tmp_path):
    z, along, _ = seen()
    values = np.stack([np.ones_like(z), z * 0.5, along, z], axis=-1).astype(np.float32)
    mesh, _ = surface(save(tmp_path / "d.exr", values, ("R", "G", "B", "Z")))
    assert off_surface(mesh.vertices).max() < 2.0**-22


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"frame": 1, "camera": camera()}, "one of `frame` and `camera`"),
        ({}, "one of `frame` and `camera`"),
        ({"frame": 1, "unit": "0 m"}, "greater than 0"),
        ({"frame": 1, "unit": 1.0}, "unit missing"),
        ({"camera": camera(distortion=[0.1])}, "expected 0, 4, 5 or 8"),
        ({"camera": camera(world_from_camera=np.diag([1.0, 1.0, -1.0, 1.0]).tolist())}, "mirrors"),
    ],
)
def test_settings_that_cannot_be(settings, words):
    base = {"file": "d.exr", "measures": "z", "unit": "1 m"}
    with pytest.raises(ValidationError, match=words):
        given.DepthMap.model_validate(base | settings)


def test_the_camera_is_its_place():
    with pytest.raises(ValidationError, match="leave out `transform`"):
        given.RealObject.model_validate(
            {
                "name": "a",
                "reflectance": 0.5,
                "transform": {"translate": [0, 0, "1 m"]},
                "depth_map": {"file": "d.exr", "measures": "z", "unit": "1 m", "frame": 0},
            }
        )
    with pytest.raises(ValidationError, match="depth_map"):
        given.VirtualObject.model_validate(
            {"name": "a", "depth_map": {"file": "d.exr", "measures": "z", "unit": "1 m", "frame": 0}}
        )


def test_a_real_sensors_picture(shared_data, tmp_path):
    """An organised cloud of a Kinect: its z alone, taken as a depth map, gives its x and y back."""
    path = shared_data / "clouds" / "office_kinect" / "office1.pcd"
    if not path.is_file():
        pytest.skip("the organised cloud office_kinect is absent")
    cloud = open3d().t.io.read_point_cloud(str(path), remove_nan_points=False)
    points = cloud.point.positions.numpy().astype(np.float64).reshape(480, 640, 3)
    there = np.isfinite(points[..., 2])
    # The sensor's own camera, by least squares of its x and y: x = (column - cx) z / f.
    rows, columns = np.nonzero(there)
    x, y, z = points[there].T
    cx, fx = np.linalg.lstsq(np.stack([np.ones_like(z), x / z], axis=1), columns + 0.5, rcond=None)[0]
    cy, fy = np.linalg.lstsq(np.stack([np.ones_like(z), y / z], axis=1), rows + 0.5, rcond=None)[0]
    assert fx == pytest.approx(525.0, abs=2.0) and fy == pytest.approx(525.0, abs=2.0)
    np.save(tmp_path / "kinect.npy", points[..., 2])
    k = [[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]
    own = {"matrix": k, "pixel_centres": "half", "world_from_camera": np.eye(4).tolist()}
    mesh, _ = surface(tmp_path / "kinect.npy", camera=own)
    column = np.floor(mesh.uvs[:, 0].astype(float) * 640).astype(int)
    row = np.floor((1.0 - mesh.uvs[:, 1].astype(float)) * 480).astype(int)
    np.testing.assert_allclose(mesh.vertices, points[row, column], atol=2e-4)
    # Nearly all that was measured is surface, and no triangle spans a jump.
    assert len(mesh.vertices) > 0.97 * there.sum()
    depth = mesh.vertices[mesh.faces][..., 2]
    assert (np.ptp(depth, axis=1) / depth.min(axis=1)).max() < 0.25
