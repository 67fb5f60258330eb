"""The contracts of the rooms, by toys: a new method, history, views, a participant on its own domain."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import toy_fog
import toy_history

from mrbatch.batch.job_run import plan_job, render_job
from mrbatch.film.exr import frame_metadata, read_frame
from mrbatch.job import load_job
from mrbatch.job.schema import job_schema
from mrbatch.methods.registry import METHODS, register

SHADE = {"name": "toy-shade"}
FOG = {"type": "toy-fog"}


def render(path: Path, *overrides: str, out: str = "out", **options):
    outcome = render_job(load_job(path, [f"output.directory={out}", *overrides]), report=False, **options)
    assert outcome.result.error is None, outcome.result.error
    return outcome


def files(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.glob("*.exr"))}


def channels(path: Path, view: str = "") -> dict[str, np.ndarray]:
    return dict(read_frame(path).views[view].channels)


# --- one folder and one line ------------------------------------------------------------------------


def test_a_method_is_one_folder_and_one_line(write):
    path = write(SHADE, {"count": 2})
    outcome = render(path)
    assert outcome.exit_code == 0 and outcome.result.rendered == (0, 1)
    made = channels(path.parent / "out" / "toy.0000.exr")
    share = made["delta.G"] / np.where(made["background.G"] > 0, made["background.G"], np.nan)
    assert np.nanmean(share) == pytest.approx(-0.25, abs=0.02)  # half of `darkness`
    told = frame_metadata(path.parent / "out" / "toy.0000.exr")["parts"][0]["mrbatch"]
    assert told["counters"] == {"shades": 40 * 24 * 8}
    assert told["plan"] == {"toy-shade": "needed"}


def test_its_settings_are_in_the_schema_and_its_rule_in_the_plan(write):
    assert "darkness" in str(job_schema())
    path = write(SHADE)
    assert plan_job(load_job(path)).shot.plan.effects["toy-shade"].numbers == {"darkness": 0.5}
    bare = plan_job(load_job(path, ["method.darkness=0"])).shot.plan
    assert bare.effects["toy-shade"].state == "absent"
    off = plan_job(load_job(path, ["effects.toy-shade=off"])).shot.plan
    assert off.effects["toy-shade"].state == "forced-off"


def test_an_effect_that_is_off_leaves_the_photo(write):
    path = write(SHADE, {"count": 1})
    for change in ("method.darkness=0", "effects.toy-shade=off"):
        render(path, change, out=change)
        made = channels(path.parent / change / "toy.0000.exr")
        assert all(np.array_equal(made[c], made[f"background.{c}"]) for c in "RGB")


# --- identical bits ---------------------------------------------------------------------------------

JOBS = {
    "history": ({"name": "toy-history"}, {}, {}),
    "history in segments": ({"name": "toy-history", "segment": 3, "warm_up": 2}, {}, {}),
    "history with a cut": ({"name": "toy-history", "segment": 3, "warm_up": 2}, {"cuts": [2]}, {}),
    "views": (SHADE, {"views": "two"}, {}),
    "participant": (SHADE, {}, {"participants": [FOG]}),
    "participants and views": (
        SHADE,
        {"views": "two"},
        {"participants": [FOG, {**FOG, "density": 0.6}]},
    ),
    "history and participant": ({"name": "toy-history"}, {}, {"participants": [FOG]}),
}


@pytest.mark.parametrize("name", JOBS)
def test_the_bits_do_not_depend_on_how_it_was_run(write, name):
    method, capture, parts = JOBS[name]
    path = write(method, capture, **parts)
    folder = path.parent
    render(path)
    expected = files(folder / "out")
    assert len(expected) == 6 and len(set(expected.values())) == 6
    for threads, units in ((1, 1), (2, 3), (4, 64), (4, 1)):
        out = f"threads{threads}units{units}"
        render(path, out=out, threads=threads, units_per_launch=units)
        assert files(folder / out) == expected, out
    render(path, "frames=3", out="alone")
    assert files(folder / "alone") == {"toy.0003.exr": expected["toy.0003.exr"]}
    render(path, "frames=5", out="alone")
    render(path, "frames=0-4", out="alone", units_per_launch=2)
    assert files(folder / "alone") == expected
    for gone in ((0,), (2, 3), (1, 4, 5)):
        out = f"resumed{gone}"
        shutil.copytree(folder / "out", folder / out)
        for number in gone:
            (folder / out / f"toy.{number:04d}.exr").unlink()
        assert render(path, out=out).result.rendered == gone
        assert files(folder / out) == expected, gone


def test_a_lost_state_is_made_again(write):
    path = write({"name": "toy-history"})
    render(path)
    expected = files(path.parent / "out")
    for state in (path.parent / "out" / "history").iterdir():
        state.write_bytes(b"rubbish")
    (path.parent / "out" / "toy.0004.exr").unlink()
    assert render(path).result.rendered == (4,)
    assert files(path.parent / "out") == expected


def test_a_broken_frame_hands_the_state_on(write):
    path = write({"name": "toy-history"}, {"broken": [2]}, on_error="skip")
    assert render(path).exit_code == 4
    render(path, "frames=5", out="alone")
    assert files(path.parent / "alone")["toy.0005.exr"] == files(path.parent / "out")["toy.0005.exr"]


# --- history ----------------------------------------------------------------------------------------


def running_mean(pictures: list[np.ndarray]) -> np.ndarray:
    """The toy's filter in float64."""
    mean = np.zeros_like(pictures[0], dtype=np.float64)
    for picture in pictures:
        padded = np.pad(mean, ((1, 1), (1, 1), (0, 0)), mode="edge")
        h, w = picture.shape[:2]
        around = sum(padded[y : y + h, x : x + w] for y in range(3) for x in range(3)) / 9
        mean = 0.7 * around + 0.3 * picture
    return mean


@pytest.mark.parametrize(
    ("settings", "capture", "used"),
    [
        ({}, {}, [0, 1, 2, 3, 4]),
        ({"segment": 2}, {}, [4]),
        ({"segment": 2, "warm_up": 1}, {}, [3, 4]),
        ({"segment": 3, "warm_up": 9}, {}, [0, 1, 2, 3, 4]),
        ({}, {"cuts": [3]}, [3, 4]),
        ({"segment": 1, "warm_up": 9}, {"cuts": [3]}, [3, 4]),
    ],
)
def test_a_state_comes_from_the_frames_of_its_segment(write, settings, capture, used):
    """Frame 4 shows the mean of the frames that its segment and warm-up say, and of no others."""
    path = write({"name": "toy-history", "spp": 64, **settings}, capture)
    render(path, "frames=4", "output.dtype=float")
    photo = {n: _photo(load_job(path), n) for n in range(6)}
    expected = running_mean([photo[n] for n in used]) - photo[4]
    found = np.stack([channels(path.parent / "out" / "toy.0004.exr")[f"delta.{c}"] for c in "RGB"], axis=-1)
    # The toy's noise: a factor 0.9 + 0.2 u, one u for the three channels of a sample.
    assert np.abs(found - expected).max() <= 0.2 * np.abs(expected).max()
    other = running_mean([photo[n] for n in used[1:] or [3, 4]]) - photo[4]
    assert np.abs(found - expected).mean() < 0.5 * np.abs(found - other).mean()


def _photo(job, number: int) -> np.ndarray:
    from toy_capture import ToyCapture

    from mrbatch.kernels.transfer import to_linear

    return to_linear(ToyCapture(job.capture).codes(number, ""), "srgb", 8).astype(np.float64)


def test_history_must_be_announced(write):
    silent = replace(toy_history.METHOD, name="toy-silent", history=False)
    with register(silent):
        path = write({"name": "toy-silent"})
        with pytest.raises(ValueError, match="history"):
            render(path)


# --- views ------------------------------------------------------------------------------------------


def test_two_views_are_two_parts(write):
    path = write(SHADE, {"views": "two", "count": 2})
    render(path)
    one = frame_metadata(path.parent / "out" / "toy.0001.exr")["parts"]
    assert [(p["name"], p["view"]) for p in one] == [("left", "left"), ("right", "right")]
    eyes = [np.array(p["mrbatch"]["camera"]["world_from_camera"])[0, 3] for p in one]
    assert eyes == [0.0, 0.065]
    frame = read_frame(path.parent / "out" / "toy.0001.exr")
    left, right = (frame.views[name].channels for name in ("left", "right"))
    assert not np.array_equal(left["background.R"], right["background.R"])
    shares = [v["delta.R"] / np.maximum(v["background.R"], 1e-6) for v in (left, right)]
    bright = (left["background.R"] > 0.1) & (right["background.R"] > 0.1)
    # Random choices of the two views have nothing to do with each other.
    assert abs(np.corrcoef(shares[0][bright], shares[1][bright])[0, 1]) < 0.2


def test_views_of_two_sizes_are_refused(write):
    from mrbatch.errors import InputError

    with pytest.raises(InputError, match="different sizes: left 40 x 24, right 48 x 24"):
        plan_job(load_job(write(SHADE, {"views": "two sizes"})))


# --- participants -----------------------------------------------------------------------------------


def test_a_participant_is_laid_over_the_method(write):
    path = write(SHADE, {"count": 1}, participants=[{**FOG, "density": 0.9}])
    render(path, "output.dtype=float", "output.layers=[composite,background,delta,samples]")
    render(path, "output.dtype=float", "participants=[]", out="bare")
    with_fog, bare = (channels(path.parent / out / "toy.0000.exr") for out in ("out", "bare"))
    # The fog's light is (0.8, 0.9, 1) times its coverage a: C = P + (1 - a) (B + D) gives a back.
    coverage = [
        (with_fog[c] - bare[c]) / np.where(np.abs(v - bare[c]) > 0.2, v - bare[c], np.nan)
        for c, v in zip("RGB", (0.8, 0.9, 1.0))
    ]
    both = ~np.isnan(coverage[0]) & ~np.isnan(coverage[1])
    np.testing.assert_allclose(coverage[0][both], coverage[1][both], atol=2e-5)
    steps = coverage[2][~np.isnan(coverage[2])] * 8
    np.testing.assert_allclose(steps, np.round(steps), atol=2e-4)  # of 8 samples
    assert 0.1 < np.nanmean(coverage[2]) < 0.9


def test_two_participants_of_a_type_have_settings_and_buffers_of_their_own(write):
    one = write(SHADE, {"count": 1}, participants=[FOG, {**FOG, "density": 0}])
    render(one, out="first")
    render(one, "participants=[{type: toy-fog, density: 0}, {type: toy-fog}]", out="second")
    plan = plan_job(load_job(one)).shot.plan
    assert plan.effects["toy-fog"].state == "needed"
    for out in ("first", "second"):
        told = frame_metadata(one.parent / out / "toy.0000.exr")["parts"][0]["mrbatch"]
        # Both run, for the plan knows one effect; cells are filled once a frame, the table once a shot.
        assert told["counters"]["cells"] == 2 * toy_fog.CELLS
    first, second = (channels(one.parent / out / "toy.0000.exr") for out in ("first", "second"))
    np.testing.assert_array_equal(first["R"], second["R"])


def test_a_participant_without_effect_changes_nothing(write):
    path = write(SHADE, {"count": 1}, participants=[{**FOG, "density": 0}])
    render(path)
    render(path, "participants=[]", out="bare")
    made, bare = (channels(path.parent / out / "toy.0000.exr") for out in ("out", "bare"))
    assert all(np.array_equal(made[name], bare[name]) for name in bare)


def test_pipelines_may_not_share_a_buffer(write):
    greedy = replace(
        toy_fog.PARTICIPANT,
        name="toy-greedy",
        build=lambda scene, plan, settings, outputs: toy_fog.build(
            scene, plan, settings, replace(outputs, source="mine")
        ),
    )
    with register(greedy):
        path = write(SHADE, {"count": 1}, participants=[{"type": "toy-greedy"}, {"type": "toy-greedy"}])
        with pytest.raises(ValueError, match="shares the buffer `mine/table`"):
            render(path)


def test_the_registry_is_left_as_it_was():
    assert "toy-silent" not in METHODS.names() and "toy-shade" in METHODS.names()


def test_the_cases_of_a_method_are_found():
    from mrbatch.stability.run import check_stability

    report = check_stability(["*@toy-shade"])
    assert [(c.name, c.owner, c.outcome) for c in report.cases] == [("toy", "toy-shade", "passed")]
