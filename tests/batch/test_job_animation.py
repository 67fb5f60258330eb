"""Objects that move over the frames of a job: each frame as if they stood still where they are then."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from small_job import CRATE, write_job

from mrbatch.batch.job_run import plan_job, render_job
from mrbatch.errors import JobErrors
from mrbatch.film.exr import read_frame
from mrbatch.job import load_job

FRAMES = (0, 1, 2, 3)
KEYS = [
    {"frame": 1, "translate": ["-60 mm", "0 m", "50 mm"]},
    {"frame": 3, "translate": ["60 mm", "0 m", "50 mm"], "rotate": ["0 deg", "0 deg", "90 deg"]},
]
MOVING = {k: v for k, v in CRATE.items() if k != "transform"} | {"animation": KEYS}


def job_with(folder: Path, crate: dict, **more) -> Path:
    folder.mkdir()
    return write_job(folder, FRAMES, virtual=[crate], **more)


def render(path: Path, *overrides: str, out: str = "out", **options) -> Path:
    job = load_job(path, [f"output.directory={out}", "output.layers=[virtual,delta,motion]", *overrides])
    outcome = render_job(job, report=False, **options)
    assert outcome.result.error is None and outcome.exit_code == 0, outcome.result.error
    return path.parent / out


def channels(folder: Path, number: int) -> dict[str, np.ndarray]:
    (path,) = folder.glob(f"*.{number:04d}.exr")
    return dict(next(iter(read_frame(path).views.values())).channels)


def same(a: dict, b: dict, *names: str) -> bool:
    return all(np.array_equal(a[name], b[name]) for name in names)


PARTS = ("R", "G", "B", "virtual.R", "virtual.A", "delta.R")


@pytest.fixture(scope="module")
def moving(tmp_path_factory) -> Path:
    return job_with(tmp_path_factory.mktemp("animation") / "moving", MOVING)


def test_each_frame_is_that_of_an_object_standing_there(moving, tmp_path):
    """Halfway between the keys: the middle place, half of the turn. Before the first key: as at it."""
    out = render(moving)
    places = {
        0: {"translate": ["-60 mm", "0 m", "50 mm"]},
        2: {"translate": ["0 m", "0 m", "50 mm"], "rotate": ["0 deg", "0 deg", "45 deg"]},
        3: {"translate": ["60 mm", "0 m", "50 mm"], "rotate": ["0 deg", "0 deg", "90 deg"]},
    }
    for number, transform in places.items():
        still = render(
            job_with(tmp_path / f"still{number}", CRATE | {"transform": transform}), f"frames={number}"
        )
        a, b = channels(out, number), channels(still, number)
        # Kernels work about another origin, so roundings differ where edges are met, and nothing else.
        for name in PARTS:
            assert np.mean(np.abs(a[name] - b[name]) > 1e-3 * (1 + np.abs(b[name]))) < 0.01
        assert (a["virtual.A"] > 0).sum() == pytest.approx((b["virtual.A"] > 0).sum(), abs=3)
    covered = [channels(out, n)["virtual.A"] > 0 for n in FRAMES]
    assert not np.array_equal(covered[1], covered[3])


@pytest.mark.case("DPT-17")
def test_no_frame_depends_on_which_others_are_rendered(moving):
    whole = render(moving)
    for number in (3, 1):
        alone = render(moving, f"frames={number}", out=f"alone{number}", threads=1, units_per_launch=1)
        assert same(channels(alone, number), channels(whole, number), *PARTS, "motion.X", "motion.Y")


def test_motion_is_the_objects_and_the_cameras(moving, tmp_path):
    """What moves and what stands differ by how far the object goes on the picture."""
    place = {"translate": ["-60 mm", "0 m", "50 mm"]}
    still = render(job_with(tmp_path / "still", CRATE | {"transform": place}))
    a, b = channels(render(moving), 1), channels(still, 1)
    there = (a["virtual.A"] == 1) & (b["virtual.A"] == 1)
    moved = np.hypot(a["motion.X"] - b["motion.X"], a["motion.Y"] - b["motion.Y"])[there]
    # 60 mm and 45 degrees in one frame at about 0.57 m with a focal length of 70 pixels.
    assert there.sum() > 20 and 3 < np.median(moved) < 12
    # Until the first key nothing moves but the camera.
    first, other = channels(render(moving), 0), channels(still, 0)
    np.testing.assert_allclose(first["motion.X"], other["motion.X"], atol=1e-3)


def test_what_is_not_there_is_not_there(tmp_path):
    path = job_with(tmp_path / "shy", CRATE | {"visible": [[1, 1], [3, 9]]})
    out = render(path)
    always = render(job_with(tmp_path / "always", CRATE))
    for number in FRAMES:
        here = channels(out, number)
        if number in (1, 3):
            assert same(here, channels(always, number), *PARTS)
        else:
            assert not here["virtual.A"].any() and not here["delta.R"].any()
    plan = plan_job(load_job(path)).shot.plan
    assert [len(plan.tiles[n, ""]) > 0 for n in FRAMES] == [False, True, False, True]


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"animation": []}, "one key or more"),
        ({"animation": [KEYS[1], KEYS[0]]}, "later frame"),
        ({"animation": KEYS, "transform": {"scale": 2}}, "both given"),
        ({"visible": [[3, 1]]}, "ends before"),
    ],
)
def test_what_cannot_be_is_said(tmp_path, wrong, message):
    crate = {k: v for k, v in CRATE.items() if k != "transform"} | wrong
    with pytest.raises(JobErrors, match=message):
        load_job(job_with(tmp_path / "wrong", crate))


def test_the_last_frame_moves_nowhere(moving):
    """There is no next one to tell motion to: of no object, whatever its number."""
    last = channels(render(moving), FRAMES[-1])
    seen = last["virtual.A"] > 0
    assert seen.any() and np.abs(last["motion.X"][seen]).max() < 1e-3 > np.abs(last["motion.Y"][seen]).max()
