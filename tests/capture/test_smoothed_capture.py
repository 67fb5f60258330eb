"""A capture with smoothed poses: settings, table, notes, and frames rendered alone."""

from __future__ import annotations

import json

import numpy as np
import pytest
from small_job import pose, write_job

from mrbatch.batch.job_run import plan_job
from mrbatch.capture.marker_video.settings import MarkerVideoSettings
from mrbatch.capture.marker_video.told import smoothing_notes, told
from mrbatch.errors import InputError, JobErrors
from mrbatch.job import load_job

FRAMES = tuple(range(12))
SIGMA = {"sigma_angle": "0.3 deg", "sigma_place": "2 mm"}


def shaky_job(folder, *, without=(), **capture):
    """Twelve frames whose given poses shake by the sigma that the job states."""
    path = write_job(folder, FRAMES, spp=2)
    random = np.random.default_rng(0)
    entries = []
    for n in FRAMES:
        found = pose(n)
        found[:3, 3] += random.normal(0.0, 2e-3, 3)
        if n not in without:
            entries.append({"frame": n, "world_from_camera": found.tolist()})
    (folder / "poses.json").write_text(json.dumps(entries))
    job = json.loads(path.read_text())
    job["capture"] |= capture
    path.write_text(json.dumps(job))
    return path


def places(table):
    return np.array([np.array(p)[:3, 3] for p in table["poses"].values()])


def table_of(path, *overrides):
    return plan_job(load_job(path, overrides)).shot.table


def test_smoothing_is_off_unless_asked_for(tmp_path):
    table = table_of(shaky_job(tmp_path))
    given = json.loads((tmp_path / "poses.json").read_text())
    wanted = [e["world_from_camera"] for e in given]
    np.testing.assert_allclose(list(table["poses"].values()), wanted, rtol=0, atol=1e-14)
    assert "smoothing" not in table["pose_report"]


def test_given_poses_are_smoothed_and_the_shift_is_told(tmp_path):
    path = shaky_job(tmp_path)
    before = places(table_of(path))
    path = shaky_job(tmp_path, smoothing=SIGMA)
    table = table_of(path)
    truth = np.array([pose(n)[:3, 3] for n in FRAMES])
    after = places(table)
    assert np.sqrt(np.mean((after - truth) ** 2)) < 0.7 * np.sqrt(np.mean((before - truth) ** 2))
    report = table["pose_report"]["smoothing"]
    moved = 1e3 * np.linalg.norm(after - before, axis=1)
    assert report["mm"]["largest"] == pytest.approx(moved.max())
    assert report["mm"]["rms"] == pytest.approx(np.sqrt(np.mean(moved**2)))
    assert any(note.startswith("smoothing moved poses by") for note in table["notes"])
    facts = told(table)
    assert any(name == "smoothing" and "mm" in text for name, text, _ in facts.facts)
    assert facts.frames[3]["pose moved"] == (report["frames"]["3"]["mm"], "mm")


def test_a_frame_alone_has_the_pose_it_has_in_the_shot(tmp_path):
    path = shaky_job(tmp_path, smoothing=SIGMA)
    whole, alone = plan_job(load_job(path)), plan_job(load_job(path, ["frames=7"]))
    assert alone.shot.table == whole.shot.table
    poses = [p.capture.geometry(7, p.shot.table)[""].camera.world_from_camera for p in (whole, alone)]
    np.testing.assert_array_equal(*poses)


def test_policies_for_lost_frames_hold(tmp_path):
    def table(lost):
        return table_of(shaky_job(tmp_path, without=(5, 11), smoothing=SIGMA, lost=lost))

    skipped = table("skip")
    assert skipped["skipped"] == [5, 11] and "5" not in skipped["poses"]
    filled = table("interpolate")
    assert filled["flags"] == {
        "5": ["pose-lost", "pose-interpolated"],
        "11": ["pose-lost", "pose-held"],
    }
    assert np.linalg.norm(np.array(filled["poses"]["5"])[:3, 3] - pose(5)[:3, 3]) < 3e-3
    held = table("hold-last")
    assert held["poses"]["5"] == held["poses"]["4"] == skipped["poses"]["4"]
    with pytest.raises(InputError, match="no pose for 2 of 12 frames"):
        table("stop")


@pytest.mark.parametrize(
    ("smoothing", "words"),
    [
        ("constant-velocity", "needs `sigma_angle` and `sigma_place`"),
        ({"sigma_angle": "1 deg"}, "go together"),
        ({"model": "spline"}, "got `spline`"),
        ({**SIGMA, "sigma_place": "0 mm"}, "at least 1e-09"),
        ({**SIGMA, "sigma_angle": "200 deg"}, "at most 3.14"),
    ],
)
def test_what_makes_no_sense_is_refused_in_its_place(tmp_path, smoothing, words):
    path = shaky_job(tmp_path, smoothing=smoothing)
    with pytest.raises(JobErrors) as caught:
        load_job(path)
    assert words in str(caught.value)
    assert all(error.place.line and error.place.column for error in caught.value.errors)


def test_sigma_is_for_given_poses_only():
    base = {
        "frames": "a_####.png",
        "camera": "calibration.yaml",
        "target": {"marker": {"dictionary": "DICT_4X4_50", "id": 3, "side": "60 mm"}},
    }
    found = MarkerVideoSettings.model_validate({**base, "smoothing": "constant-acceleration"})
    assert found.smoothing is not None and found.smoothing.order == 3
    assert MarkerVideoSettings.model_validate(found.model_dump(mode="json")) == found
    with pytest.raises(ValueError, match="leave out"):
        MarkerVideoSettings.model_validate({**base, "smoothing": SIGMA})


def test_notes():
    shift = {"rms": 1.0, "largest": 2.0, "largest_frame": 7}
    base = {"segments": [0], "still": [], "far": [], "frames": {"7": {}}, "mm": shift, "deg": shift}
    assert len(smoothing_notes(base)) == 1
    assert "stands still: one" in smoothing_notes({**base, "still": [0]})[1]
    notes = smoothing_notes({**base, "segments": [0, 9], "still": [9], "far": [7]})
    assert "from frame 9 on" in notes[1] and "at frame 9" in notes[2] and "three sigma" in notes[3]
    assert smoothing_notes({**base, "frames": {}}) == ["too few frames have a pose to smooth them"]
