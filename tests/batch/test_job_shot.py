"""The shot: found once, committed once, and the same for everybody who renders a frame of it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_job import frames_in, write_job

from mrbatch.batch import job_run
from mrbatch.batch import prepare as prepare_module
from mrbatch.batch import render as render_module
from mrbatch.batch.job_run import plan_job, render_job
from mrbatch.batch.prepare import prepare
from mrbatch.batch.shot import from_dict
from mrbatch.device.timing import TimingNode
from mrbatch.errors import InputError, ResourceError
from mrbatch.film.exr import read_frame, write_frame
from mrbatch.job import load_job


def render(path: Path, *overrides: str, out: str = "out"):
    return render_job(load_job(path, [f"output.directory={out}", *overrides]), report=False)


def shot_file(folder: Path) -> Path:
    (path,) = (folder / "shot").glob("*.json")
    return path


def test_a_shot_reads_back_as_it_was(tmp_path):
    path = write_job(tmp_path, (0, 1, 2))
    made = plan_job(load_job(path)).shot
    again = from_dict(json.loads(json.dumps(made.as_dict())))
    assert again.hash == made.hash
    for key, ids in made.plan.tiles.items():
        assert np.array_equal(again.plan.tiles[key], ids) and again.plan.tiles[key].dtype == ids.dtype


def test_planning_writes_nothing(tmp_path):
    path = write_job(tmp_path, (0,))
    plan_job(load_job(path))
    assert not (tmp_path / "out").exists()


def test_a_shot_is_committed_once_and_used_again(tmp_path, monkeypatch):
    path = write_job(tmp_path, (0, 1, 2))
    calls = []
    commit = job_run.commit_shot
    monkeypatch.setattr(job_run, "commit_shot", lambda *given: (calls.append(given), commit(*given)))
    render(path)
    assert len(calls) == 1
    written = shot_file(tmp_path / "out").read_bytes()
    monkeypatch.setattr(prepare_module, "_plan", lambda *given: pytest.fail("planned again"))
    render(path)
    assert shot_file(tmp_path / "out").read_bytes() == written


@pytest.mark.parametrize("damage", [b"", b"{", b'{"version": 1}', b"\xff\xfe"])
def test_a_damaged_shot_is_found_again(tmp_path, damage):
    path = write_job(tmp_path, (0, 1))
    render(path)
    expected, written = frames_in(tmp_path / "out"), shot_file(tmp_path / "out").read_bytes()
    shot_file(tmp_path / "out").write_bytes(damage)
    (tmp_path / "out" / "small.0001.exr").unlink()
    assert render(path).result.rendered == (1,)
    assert frames_in(tmp_path / "out") == expected
    assert shot_file(tmp_path / "out").read_bytes() == written


def test_a_worker_without_the_engine_refuses(tmp_path, monkeypatch):
    """The shot says Embree: a machine without it may not mix its frames in."""
    path = write_job(tmp_path, (0, 1))
    if plan_job(load_job(path)).shot.engine != "embree":
        pytest.skip("Embree is not available here")
    render(path, "frames=0")
    monkeypatch.setattr(prepare_module, "resolve_engine", lambda asked, device="cpu": "warp")
    with pytest.raises(ResourceError, match="Embree") as refused:
        prepare(load_job(path), TimingNode("job"), directory=tmp_path / "out")
    assert refused.value.exit_code == 5 and "engine=warp" in refused.value.hint


def test_motion_goes_to_the_next_frame_that_is_known(tmp_path, monkeypatch):
    """The last frame, and one before a frame without a camera, have pictures; nothing is known to move."""
    path = write_job(tmp_path, (0, 1, 2))

    def most(out: str) -> list[float]:
        """Largest motion of each frame in pixels; projecting in float32 leaves far below 1e-2 of it."""
        render(path, "output.layers=[motion]", out=out)
        frames = [read_frame(p).views[""].channels for p in sorted((tmp_path / out).glob("*.exr"))]
        return [float(np.abs(m["motion.X"]).max()) for m in frames]

    assert [value > 0.1 for value in most("moving")] == [True, True, False]

    def lost(geometry, display):
        raise InputError("the frame has no camera pose")

    monkeypatch.setattr(render_module, "pinholes", lost)
    assert max(most("lost")) < 1e-2


def test_a_stand_in_differs_in_its_numbers_alone(tmp_path):
    """What is read and written again without another number is the same file."""
    path = write_job(tmp_path, (0,), output={"directory": "out", "dtype": "float", "owner": "me"})
    render(path, "output.layers=[virtual,depth,crypto_object,motion,samples]")
    source = tmp_path / "out" / "small.0000.exr"
    write_frame(tmp_path / "again.exr", read_frame(source))
    assert (tmp_path / "again.exr").read_bytes() == source.read_bytes()


def test_hold_last_shows_the_frame_before(tmp_path):
    """Its pixels, under a number of its own and with the number of the frame it was held from."""
    path = write_job(tmp_path, (0, 1, 2), on_error="hold-last")
    picture = tmp_path / "photo_0001.png"
    picture.write_bytes(picture.read_bytes()[:300])
    outcome = render(path)
    assert outcome.exit_code == 4
    first, held, last = (read_frame(tmp_path / "out" / f"small.{n:04d}.exr") for n in range(3))
    for name, values in first.views[""].channels.items():
        assert np.array_equal(held.views[""].channels[name], values)
    assert not np.array_equal(held.views[""].channels["R"], last.views[""].channels["R"])
    assert (held.number, held.metadata["held_from"]) == (1, 0)
    assert dict(held.metadata) == {**first.metadata, "held_from": 0}
    assert render(path).result.findings.stand_ins == (1,)


def test_a_frame_without_one_of_its_channels_is_not_committed(tmp_path, monkeypatch):
    """What is written is read back: a layer that got lost on the way is no finished frame."""
    path = write_job(tmp_path, (0,))
    write = render_module.write_frame

    def lossy(target, image):
        views = {}
        for name, view in image.views.items():
            views[name] = replace(view, channels={c: v for c, v in view.channels.items() if c != "delta.G"})
        write(target, replace(image, views=views))

    monkeypatch.setattr(render_module, "write_frame", lossy)
    outcome = render(path)
    assert frames_in(tmp_path / "out") == {} and outcome.exit_code != 0
    assert "delta.G" in str(outcome.result.failed[0].error)
