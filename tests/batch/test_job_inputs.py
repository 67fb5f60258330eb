"""What a job's hash knows of its inputs: every byte that pixels depend on, and nothing of where it lies."""

from __future__ import annotations

import json
import pickle
import shutil
from pathlib import Path

import numpy as np
import pytest
from pydantic import Field
from small_job import CRATE, codes, frames_in, write_job, write_picture

from mrbatch.batch.job_run import plan_job, render_job
from mrbatch.contracts import Participant, Pipeline
from mrbatch.errors import InputError, JobErrors
from mrbatch.job import check_files, load_job
from mrbatch.methods.registry import PARTICIPANTS
from mrbatch.quantities import InputPath, Settings


def apart(folder: Path) -> Path:
    """The small job with everything that it reads in a folder beside its own."""
    made = write_job(folder / "data", (0, 1))
    content = json.loads(made.read_text(encoding="utf-8"))
    content["capture"] |= {"frames": "../data/photo_####.png", "poses": "../data/poses.json"}
    content["environment"] = {"file": "../data/sky.exr"}
    path = folder / "jobs" / "small.yaml"
    path.parent.mkdir()
    path.write_text(json.dumps(content), encoding="utf-8")
    made.unlink()
    return path


def test_the_same_job_in_two_places_is_the_same_job(tmp_path):
    made = []
    for place in ("here", "there/and/further"):
        job = load_job(apart(tmp_path / place))
        outcome = render_job(job, report=False)
        made.append((outcome.report.job.hash, frames_in(job.output.directory)))
    assert len(made[0][1]) == 2
    assert made[0] == made[1]
    for data in made[0][1].values():
        assert str(tmp_path).encode() not in data and b"../data" not in data


def test_data_named_by_absolute_path_do_not_bind_the_job_to_its_folder(tmp_path):
    data = write_job(tmp_path / "data", (0,))
    content = json.loads(data.read_text(encoding="utf-8"))
    content["capture"] |= {
        "frames": str(tmp_path / "data" / "photo_####.png"),
        "poses": str(tmp_path / "data" / "poses.json"),
    }
    content["environment"] = {"file": str(tmp_path / "data" / "sky.exr")}
    hashes = set()
    for place in ("a", "b/c"):
        (tmp_path / place).mkdir(parents=True)
        path = tmp_path / place / "job.yaml"
        path.write_text(json.dumps(content), encoding="utf-8")
        hashes.add(plan_job(load_job(path)).job_hash)
    assert len(hashes) == 1


def test_files_of_one_name_are_told_apart_by_their_order(tmp_path):
    """Two textures outside, named alike: which object has which is part of the picture."""
    for name, level in (("x", 40), ("y", 200)):
        (tmp_path / name).mkdir()
        write_picture(tmp_path / name / "t.png", np.full((4, 4, 3), level, np.uint8))
    hashes = set()
    for number, order in enumerate(("xyx", "xyy", "yxx", "xxy")):
        folder = tmp_path / f"job{number}"
        objects = [
            CRATE
            | {
                "name": f"c{i}",
                "material": {"type": "diffuse", "reflectance": {"texture": f"../{name}/t.png"}},
            }
            for i, name in enumerate(order)
        ]
        path = write_job(folder, (0,), virtual=objects)
        hashes.add(plan_job(load_job(path)).job_hash)
    assert len(hashes) == 4


def test_a_moved_number_is_another_job(tmp_path):
    first = write_job(tmp_path / "a", (0, 1))
    second = write_job(tmp_path / "b", (0, 1))
    shutil.move(tmp_path / "b" / "photo_0001.png", tmp_path / "b" / "photo_0002.png")
    poses = json.loads((tmp_path / "b" / "poses.json").read_text())
    (tmp_path / "a" / "poses.json").write_text(json.dumps([*poses, poses[1] | {"frame": 2}]))
    (tmp_path / "b" / "poses.json").write_text(json.dumps([*poses, poses[1] | {"frame": 2}]))
    assert plan_job(load_job(first)).job_hash != plan_job(load_job(second)).job_hash


def triangle(folder: Path, name: str = "thing.bin", **more) -> Path:
    """A glTF of one triangle whose buffer is a file beside it."""
    data = (
        np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]], "<f4").tobytes() + np.arange(3, dtype="<u4").tobytes()
    )
    (folder / "thing.bin").write_bytes(data)
    content = {
        "asset": {"version": "2.0"},
        "buffers": [{"uri": name, "byteLength": len(data)}],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": 36},
            {"buffer": 0, "byteOffset": 36, "byteLength": 12},
        ],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5125, "count": 3, "type": "SCALAR"},
        ],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "nodes": [{"mesh": 0}],
        "scenes": [{"nodes": [0]}],
    }
    path = folder / "thing.gltf"
    path.write_text(json.dumps(content | more), encoding="utf-8")
    return path


def test_the_files_that_a_gltf_names_are_inputs(tmp_path):
    path = write_job(tmp_path, (0,), virtual=[{"name": "thing", "mesh": "thing.gltf"}])
    triangle(tmp_path, images=[{"uri": "skin%20a.png"}])
    write_picture(tmp_path / "skin a.png", np.zeros((2, 2, 3), np.uint8))
    hashes = [plan_job(load_job(path)).job_hash]
    data = bytearray((tmp_path / "thing.bin").read_bytes())
    data[13:15] = b"\x01\x3e"
    (tmp_path / "thing.bin").write_bytes(data)
    hashes.append(plan_job(load_job(path)).job_hash)
    write_picture(tmp_path / "skin a.png", np.ones((2, 2, 3), np.uint8))
    hashes.append(plan_job(load_job(path)).job_hash)
    assert len(set(hashes)) == 3


def test_the_frame_of_the_patch_is_an_input_though_it_is_not_rendered(tmp_path):
    path = write_job(tmp_path, (0, 1, 2))
    content = json.loads(path.read_text(encoding="utf-8"))
    content["capture"]["gain"] = {"patch": {"frame": 2, "rectangle": [8, 8, 8, 8], "radiance": 0.5}}
    content["capture"]["subset"] = {"last": 1}
    path.write_text(json.dumps(content), encoding="utf-8")
    picture = np.full_like(codes(2, np.uint8), 90)
    write_picture(tmp_path / "photo_0002.png", picture)
    before = plan_job(load_job(path)).job_hash
    picture[10, 10] = 120
    write_picture(tmp_path / "photo_0002.png", picture)
    assert plan_job(load_job(path)).job_hash != before


@pytest.mark.parametrize("number", [3, 9])
def test_a_patch_frame_that_is_not_there_is_still_named(tmp_path, number):
    path = write_job(tmp_path, (0, 1))
    content = json.loads(path.read_text(encoding="utf-8"))
    content["capture"]["gain"] = {"patch": {"frame": number, "rectangle": [8, 8, 8, 8], "radiance": 0.5}}
    path.write_text(json.dumps(content), encoding="utf-8")
    with pytest.raises(InputError, match="names a frame that is not there"):
        plan_job(load_job(path))


def test_the_files_of_participants_are_inputs(tmp_path):
    class Smoke(Settings):
        grid: InputPath = Field(description="A file")

    smoke = Participant("toy-smoke", "a toy", Smoke, lambda *_: Pipeline())
    (tmp_path / "smoke.vdb").write_bytes(b"one")
    hashes = []
    with PARTICIPANTS.registered("toy-smoke", smoke):
        path = write_job(tmp_path, (0,), participants=[{"type": "toy-smoke", "grid": "smoke.vdb"}])
        for content in (b"one", b"two"):
            (tmp_path / "smoke.vdb").write_bytes(content)
            hashes.append(plan_job(load_job(path)).job_hash)
    assert len(set(hashes)) == 2


@pytest.fixture
def fenced(tmp_path):
    """A job inside of a folder, and things outside that it must not get at."""
    outside = tmp_path / "outside"
    outside.mkdir()
    path = write_job(tmp_path / "inside", (0, 1))
    return path, outside


def confined(path: Path):
    job = load_job(path, confine=path.parent)
    return plan_job(pickle.loads(pickle.dumps(job)))


def test_a_frame_of_a_pattern_may_not_be_a_link_to_the_outside(fenced):
    path, outside = fenced
    confined(path)
    shutil.move(path.parent / "photo_0001.png", outside / "secret.png")
    link(path.parent / "photo_0001.png", outside / "secret.png")
    plan_job(load_job(path))  # only who is confined is refused
    with pytest.raises(JobErrors, match="leads out of"):
        confined(path)
    with pytest.raises(JobErrors, match=r"photo_0001\.png leads out of") as caught:
        check_files(load_job(path, confine=path.parent))
    assert caught.value.errors[0].place.line == 1  # that of `frames` in the job file


def test_a_buffer_of_a_mesh_may_not_be_a_link_to_the_outside(fenced):
    path, outside = fenced
    content = json.loads(path.read_text(encoding="utf-8"))
    content["virtual"] = [{"name": "thing", "mesh": "thing.gltf"}]
    path.write_text(json.dumps(content), encoding="utf-8")
    triangle(path.parent)
    confined(path)
    shutil.move(path.parent / "thing.bin", outside / "secret.bin")
    link(path.parent / "thing.bin", outside / "secret.bin")
    with pytest.raises(JobErrors, match="leads out of"):
        confined(path)


def link(path: Path, target: Path) -> None:
    try:
        path.symlink_to(target)
    except OSError:
        pytest.skip("no symbolic links here")
