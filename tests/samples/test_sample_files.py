"""The sample is whole, small, what its script makes, and renders."""

from __future__ import annotations

import hashlib
import json

import numpy as np
import pytest
from sample_folder import CONFIG, SAMPLE, maker, pose_errors

from mrbatch import load_job
from mrbatch.job import check_files

MOST_BYTES, MOST_BYTES_IN_ALL = 2_000_000, 10_000_000


def test_manifest_names_every_file_with_size_and_hash():
    manifest = json.loads((SAMPLE / "manifest.json").read_text(encoding="utf-8"))
    there = {p.name: p for p in SAMPLE.iterdir() if p.name != "manifest.json"}
    assert sorted(manifest) == sorted(there)
    for name, entry in manifest.items():
        content = there[name].read_bytes()
        assert len(content) == entry["bytes"], name
        assert hashlib.sha256(content).hexdigest() == entry["sha256"], name


def test_sample_is_small():
    sizes = [p.stat().st_size for p in SAMPLE.iterdir()]
    assert max(sizes) < MOST_BYTES
    assert sum(sizes) < MOST_BYTES_IN_ALL


def test_job_is_valid_and_its_files_are_there():
    job = load_job(CONFIG)
    check_files(job)
    assert job.output.layers == ("virtual", "background", "delta", "shadow", "depth")


def test_footage_is_tagged():
    import av

    made = maker()
    with av.open(str(SAMPLE / "footage.mp4")) as file:
        stream = file.streams.video[0]
        context = stream.codec_context
        assert (context.width, context.height) == (made.WIDTH, made.HEIGHT)
        assert stream.average_rate == made.RATE
        # bt709 primaries and matrix, the sRGB curve, limited range.
        assert (context.color_primaries, context.color_trc, context.colorspace) == (1, 13, 1)
        assert context.color_range == 1
        assert sum(1 for _ in file.decode(stream)) == made.FRAMES


def test_planes_are_bt709_limited_range():
    # Corners of the R'G'B' cube in BT.709, 8 bits, as the recommendation's integers have them.
    made = maker()
    known = {
        (0, 0, 0): (16, 128, 128),
        (255, 255, 255): (235, 128, 128),
        (255, 0, 0): (63, 102, 240),
        (0, 255, 0): (173, 42, 26),
        (0, 0, 255): (32, 240, 118),
    }
    for codes, expected in known.items():
        planes = made.to_planes(np.full((4, 6, 3), codes, np.uint8))
        assert [p.shape for p in planes] == [(4, 6), (2, 3), (2, 3)]
        for plane, value in zip(planes, expected, strict=True):
            assert np.all(plane == value), (codes, expected)


def test_script_makes_what_is_stored(tmp_path):
    """The parts that take no rendering, from scratch; floats may differ in their last digits."""
    import cv2
    import trimesh

    made = maker()
    made.write_calibration(tmp_path / "calibration.yaml")
    assert (tmp_path / "calibration.yaml").read_text() == (SAMPLE / "calibration.yaml").read_text()

    stored = json.loads((SAMPLE / "poses.json").read_text(encoding="utf-8"))
    np.testing.assert_allclose([p["world_from_camera"] for p in stored], made.camera_path(), atol=1e-12)

    made.printed.write_page(tmp_path / "page.png")
    pages = [cv2.imread(str(folder / "page.png")) for folder in (tmp_path, SAMPLE)]
    np.testing.assert_array_equal(*pages)

    made.figures.write_mug(tmp_path / "mug.ply")
    meshes = [trimesh.load(folder / "mug.ply", process=False) for folder in (tmp_path, SAMPLE)]
    np.testing.assert_array_equal(meshes[0].faces, meshes[1].faces)
    np.testing.assert_allclose(meshes[0].vertices, meshes[1].vertices, atol=1e-7)


@pytest.mark.parametrize("name, height_mm", [("bunny", 117.7), ("mug", 92.0)])
def test_figures_stand_on_the_ground_and_face_outward(name, height_mm):
    from mrbatch.scene.mesh_file import load_mesh

    mesh = load_mesh(SAMPLE / f"{name}.ply")
    low, high = mesh.bounds()
    assert low[2] == 0.0
    assert high[2] == pytest.approx(1e-3 * height_mm, abs=1e-3)
    assert mesh.normals is not None and mesh.dropped == 0
    facets = mesh.face_normals()
    corner = mesh.normals[mesh.faces[:, 0]]
    assert np.mean(np.einsum("ij,ij->i", facets, corner) > 0.5) > 0.995
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    assert np.einsum("ij,ij->i", a, np.cross(b, c)).sum() > 0.0, "the signed volume is positive"


def test_poses_of_the_footage():
    degrees, shares = pose_errors()
    assert len(degrees) == maker().FRAMES
    assert np.median(degrees) < 0.1 and max(degrees) < 0.2, (np.median(degrees), max(degrees))
    assert np.median(shares) < 0.003 and max(shares) < 0.006, (np.median(shares), max(shares))


def test_first_frame_renders_small(tmp_path):
    from mrbatch import render
    from mrbatch.film.exr import read_frame

    job = load_job(
        CONFIG,
        ["frames=0", "output.scale=1/4", "method.spp=4", f"output.directory={tmp_path.as_posix()}"],
    )
    outcome = render(job, report=False)
    assert outcome.exit_code == 0
    (view,) = read_frame(tmp_path / "marker_video.0000.exr").views.values()
    picture = np.stack([view.channels[c] for c in "RGB"], axis=-1)
    photo = np.stack([view.channels[f"background.{c}"] for c in "RGB"], axis=-1)
    made = maker()
    assert picture.shape == ((made.HEIGHT + 2) // 4, made.WIDTH // 4, 3)
    assert np.isfinite(picture).all()
    covered = view.channels["virtual.A"] > 0
    assert 0.02 < covered.mean() < 0.15
    # The bunny's clay: on it red is far above blue, where the page behind is nearly grey.
    bunny = picture[view.channels["virtual.A"] == 1]
    assert np.median(bunny[:, 0] / bunny[:, 2]) > 1.8
    # Its shadow falls on the page: somewhere light is taken away, and nowhere much is added.
    change = (picture - photo)[~covered]
    assert change.min() < -0.2
    assert view.channels["shadow"].max() > 0.5
    # Depth has camera rays of its own: a sliver of an object may be in one layer and not in the other.
    depth = view.channels["depth.Z"][view.channels["virtual.A"] == 1]
    assert 0.3 < depth.min() < depth.max() < 0.6
