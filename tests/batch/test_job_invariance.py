"""Whole jobs on the real capture kind: what must not change a bit of the frames, and what must."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from small_job import CRATE, HEIGHT, WIDTH, codes, write_job

from mrbatch.batch import job_run
from mrbatch.batch.job_run import plan_job, render_job
from mrbatch.film.exr import read_frame
from mrbatch.job import load_job
from mrbatch.kernels.transfer import from_linear, to_linear

FRAMES = (0, 1, 2, 3)


def render(path: Path, *overrides: str, out: str = "out", **options):
    """Renders the job into a folder beside it; gives the outcome."""
    job = load_job(path, [f"output.directory={out}", *overrides])
    outcome = render_job(job, report=options.pop("report", False), **options)
    assert outcome.result.error is None and outcome.exit_code == 0, outcome.result.error
    return outcome


def files(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.glob("*.exr"))}


def channels(path: Path) -> dict[str, np.ndarray]:
    return dict(next(iter(read_frame(path).views.values())).channels)


@pytest.fixture(scope="module")
def shot(tmp_path_factory) -> Path:
    """A job with four frames, rendered once in the usual way."""
    path = write_job(tmp_path_factory.mktemp("shot"), FRAMES)
    render(path)
    return path


def test_the_shot_is_worth_testing(shot):
    """Something virtual shows, something real changes, and something is left alone, in every frame."""
    for name in files(shot.parent / "out"):
        found = channels(shot.parent / "out" / name)
        assert (found["virtual.A"] > 0).mean() > 0.02
        assert (found["delta.R"] != 0).mean() > 0.05
        untouched = (found["virtual.A"] == 0) & (found["delta.R"] == 0)
        assert untouched.mean() > 0.1


@pytest.mark.case("RNG-01")
@pytest.mark.parametrize(
    "options",
    [{"threads": 1}, {"threads": 4}, {"units_per_launch": 1}, {"units_per_launch": 64, "threads": 1}],
    ids=str,
)
def test_threads_and_launches_do_not_show(shot, options):
    out = f"out_{'_'.join(map(str, options))}_{'_'.join(map(str, options.values()))}"
    render(shot, out=out, **options)
    assert files(shot.parent / out) == files(shot.parent / "out")


@pytest.mark.parametrize("batch", [1, 2])
def test_batches_change_no_pixel(shot, batch):
    """The batch is a setting, so its number stands in the metadata; the channels are the same bits."""
    render(shot, f"method.batch={batch}", "frames=2", out=f"batch{batch}")
    expected = channels(shot.parent / "out" / "small.0002.exr")
    for name, values in channels(shot.parent / f"batch{batch}" / "small.0002.exr").items():
        np.testing.assert_array_equal(values, expected[name], err_msg=name)


@pytest.mark.case("DPT-17")
def test_a_frame_alone_and_any_order(shot):
    render(shot, "frames=3", out="alone")
    expected = files(shot.parent / "out")
    assert files(shot.parent / "alone") == {"small.0003.exr": expected["small.0003.exr"]}
    render(shot, "frames=1", out="alone")
    render(shot, out="alone")
    assert files(shot.parent / "alone") == expected


def test_resume_after_deleting_and_damage(shot):
    out = shot.parent / "resumed"
    shutil.copytree(shot.parent / "out", out)
    (out / "small.0001.exr").unlink()
    whole = (out / "small.0002.exr").read_bytes()
    (out / "small.0002.exr").write_bytes(whole[: len(whole) // 2])
    outcome = render(shot, out="resumed")
    assert outcome.result.rendered == (1, 2) and outcome.result.kept == (0, 3)
    assert files(out) == files(shot.parent / "out")


@pytest.mark.parametrize("crop", [(16, 16, 32, 16), (5, 3, 37, 29), (50, 40, 14, 8)], ids=str)
def test_a_crop_is_the_full_frames_crop(shot, crop):
    x, y, w, h = crop
    out = "crop" + "_".join(map(str, crop))
    render(shot, f"output.crop=[{x},{y},{w},{h}]", "frames=1", out=out)
    expected = channels(shot.parent / "out" / "small.0001.exr")
    found = read_frame(shot.parent / out / "small.0001.exr")
    assert (found.display, found.window.x, found.window.y) == ((WIDTH, HEIGHT), x, y)
    for name, values in channels(shot.parent / out / "small.0001.exr").items():
        np.testing.assert_array_equal(values, expected[name][y : y + h, x : x + w], err_msg=name)


def tiles_done(path: Path, *overrides: str) -> tuple[set[tuple[int, int]], set[tuple[int, int]]]:
    """Absolute columns and rows of the tiles that a job does, and of all tiles of its window."""
    prepared = plan_job(load_job(path, overrides))
    window = prepared.windows[""]
    (x, y), (columns, rows) = window.first_tile, window.tiles
    ids = prepared.shot.plan.tiles[0, ""]
    return {(int(i) % columns + x, int(i) // columns + y) for i in ids}, {
        (x + i, y + j) for i in range(columns) for j in range(rows)
    }


@pytest.mark.slow
def test_a_crop_decides_as_the_full_frame_does(tmp_path):
    """Light so faint that many tiles lie near half a code value: a tile cut by the crop is still whole."""
    table = [{"name": "table", "plane": {"size": ["3 m", "3 m"]}, "reflectance": 0.4}]
    pebble = [{"name": "pebble", "box": {"size": ["8 mm", "6 mm", "10 mm"]}}]
    path = write_job(tmp_path, (0,), width=320, height=240, real=table, virtual=pebble)
    for scale in (1e-3, 1e-2, 0.03, 0.1, 0.3, 1.0, 3.0):
        faint = f"environment.scale={scale}"
        full, there = tiles_done(path, faint)
        if len(full) > 0.15 * len(there):
            break
    assert 0.15 * len(there) < len(full) < 0.9 * len(there)
    for x in range(0, 300, 11):
        found, inside = tiles_done(path, faint, f"output.crop=[{x},{x // 2},19,21]")
        assert found == full & inside, x


def test_the_inside_of_overscan_is_the_frame(shot):
    render(shot, "output.overscan=9", "frames=1", out="overscan")
    expected = channels(shot.parent / "out" / "small.0001.exr")
    found = channels(shot.parent / "overscan" / "small.0001.exr")
    for name, values in found.items():
        assert values.shape == (HEIGHT + 18, WIDTH + 18)
        np.testing.assert_array_equal(values[9:-9, 9:-9], expected[name], err_msg=name)
    assert not found["background.R"][:9].any()


PHOTO_TABLE = [
    {"name": "table", "plane": {"size": ["0.4 m", "0.4 m"]}, "reflectance": "photo"},
    {
        "name": "wall",
        "plane": {"size": ["0.3 m", "0.2 m"]},
        "transform": {"translate": [0, "0.15 m", "0.1 m"], "rotate": ["90 deg", 0, 0]},
        "reflectance": "photo",
    },
]


@pytest.mark.slow
def test_a_crop_with_reflectance_from_the_photo(tmp_path):
    """Light comes from beyond the crop: the whole photo is read, whatever part is rendered."""
    path = write_job(tmp_path, (1,), real=PHOTO_TABLE)
    render(path)
    render(path, "output.crop=[20,17,21,14]", out="crop")
    render(path, "output.overscan=5", out="overscan", threads=1, units_per_launch=1)
    expected = channels(tmp_path / "out" / "small.0001.exr")
    crop, overscan = (channels(tmp_path / out / "small.0001.exr") for out in ("crop", "overscan"))
    assert (expected["delta.R"] != 0).mean() > 0.05
    for name, values in expected.items():
        np.testing.assert_array_equal(crop[name], values[17:31, 20:41], err_msg=name)
        np.testing.assert_array_equal(overscan[name][5:-5, 5:-5], values, err_msg=name)


def test_the_seed_changes_the_noise_alone(shot):
    render(shot, "seed=7", "frames=1", out="seed7")
    one, other = (channels(shot.parent / out / "small.0001.exr") for out in ("out", "seed7"))
    there = one["delta.R"] != 0
    assert np.count_nonzero(one["delta.R"] != other["delta.R"]) > 0.5 * np.count_nonzero(there)
    np.testing.assert_array_equal(one["background.R"], other["background.R"])


def test_the_engine_is_part_of_the_job_hash(shot):
    hashes = {
        engine: plan_job(load_job(shot, [f"engine={engine}"])).job_hash
        for engine in ("auto", "embree", "warp")
    }
    assert hashes["embree"] != hashes["warp"]
    assert plan_job(load_job(shot, ["engine=auto"])).job_hash == hashes["auto"]


def test_what_cannot_change_a_pixel_is_not_in_the_job_hash(shot):
    plain = plan_job(load_job(shot)).job_hash
    for change in ("frames=2", "output.preview.png=true", "name=other", "output.directory=elsewhere"):
        assert plan_job(load_job(shot, [change])).job_hash == plain, change
    for change in ("method.spp=6", "seed=1", "output.dtype=float", "output.overscan=1", "capture.gain=0.6"):
        assert plan_job(load_job(shot, [change])).job_hash != plain, change


def test_the_job_hash_follows_the_content_of_inputs(tmp_path):
    path = write_job(tmp_path / "a", (0, 1))
    before = plan_job(load_job(path)).job_hash
    assert plan_job(load_job(write_job(tmp_path / "b", (0, 1)))).job_hash == before
    (tmp_path / "a" / "photo_0001.png").write_bytes((tmp_path / "a" / "photo_0000.png").read_bytes())
    assert plan_job(load_job(path)).job_hash != before


# --- nothing virtual ---------------------------------------------------------------------------------


@pytest.mark.case("DPT-01", "IO-03")
@pytest.mark.parametrize("dtype", ["uint8", "uint16"])
def test_without_virtual_objects_the_code_values_come_back(tmp_path, dtype):
    path = write_job(tmp_path, (0, 1), dtype=dtype, virtual=False)
    render(path)
    bits = np.iinfo(dtype).bits
    for number in (0, 1):
        frame = read_frame(tmp_path / "out" / f"small.{number:04d}.exr")
        assert frame.colour_type == ("half" if bits == 8 else "float")
        made = frame.views[""].channels
        linear = np.stack([made[c] for c in "RGB"], axis=-1)
        assert np.array_equal(from_linear(linear, "srgb", bits), codes(number, dtype))
        assert (made["A"] == 1).all()


def test_a_real_lamp_beyond_half_floats_makes_float_frames(tmp_path):
    # The camera may see it in a virtual mirror.
    lamp = {"name": "lamp", "box": CRATE["box"], "transform": {"translate": [0, 0, "2 m"]}}
    lamp |= {"reflectance": 0.0, "emission": 2e5}
    path = write_job(tmp_path, (0,))
    assert plan_job(load_job(path)).shot.colour_type == "half"
    table = {"name": "table", "plane": {"size": ["0.3 m", "0.3 m"]}, "reflectance": [0.4, 0.3, 0.2]}
    assert plan_job(load_job(write_job(tmp_path, (0,), real=[table, lamp]))).shot.colour_type == "float"


def test_without_virtual_objects_linear_floats_come_back(tmp_path):
    path = write_job(tmp_path, (0,), dtype="float32", virtual=False)
    render(path)
    frame = read_frame(tmp_path / "out" / "small.0000.exr")
    assert frame.colour_type == "float"
    linear = np.stack([frame.views[""].channels[c] for c in "RGB"], axis=-1)
    assert np.array_equal(linear.view(np.uint32), codes(0, np.float32).view(np.uint32))


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float32"])
def test_pixels_that_nothing_influences_keep_their_bits(tmp_path, dtype):
    path = write_job(tmp_path, (2,), dtype=dtype)
    render(path)
    frame = read_frame(tmp_path / "out" / "small.0002.exr")
    made = frame.views[""].channels
    untouched = (made["virtual.A"] == 0) & np.all([made[f"delta.{c}"] == 0 for c in "RGB"], axis=0)
    assert 0.1 < untouched.mean() < 0.95
    composite = np.stack([made[c] for c in "RGB"], axis=-1)[untouched]
    given = codes(2, dtype)[untouched]
    if dtype == "float32":
        assert np.array_equal(composite.view(np.uint32), given.view(np.uint32))
    else:
        assert np.array_equal(from_linear(composite, "srgb", np.iinfo(dtype).bits), given)


@pytest.mark.case("IO-04")
def test_the_layers_give_the_composite(shot):
    """`max(0, virtual over background + delta)` within 2^-10 of what is added (half colour)."""
    made = channels(shot.parent / "out" / "small.0000.exr")
    a = made["virtual.A"].astype(np.float64)
    assert ((a > 0) & (a < 1)).any()
    for c in "RGB":
        p, b, d = (made[f"{layer}.{c}"].astype(np.float64) for layer in ("virtual", "background", "delta"))
        again = np.maximum(0, p + (1 - a) * b + d)
        assert np.all(np.abs(again - made[c]) <= 2.0**-10 * (np.abs(p) + np.abs(b) + np.abs(d)))


# --- previews and report -----------------------------------------------------------------------------


@pytest.mark.parametrize("dtype", ["uint8", "uint16"])
def test_previews_keep_the_codes(tmp_path, dtype):
    import cv2

    path = write_job(tmp_path, (0,), dtype=dtype, virtual=False)
    render(path, "output.preview.png=true", report=True)
    shown = cv2.imread(str(tmp_path / "out" / "small.0000.png"), cv2.IMREAD_UNCHANGED)[..., ::-1]
    assert shown.dtype == np.uint8
    given = codes(0, dtype)
    if dtype == "uint16":
        given = from_linear(to_linear(given, "srgb", 16), "srgb", 8)
    assert np.array_equal(shown, given)


def test_what_depends_on_the_machine_is_in_the_journal(tmp_path):
    """Threads and size of launches; frames carry versions of libraries, and no time but the footage's."""
    path = write_job(tmp_path, (1,))
    render_job(load_job(path), threads=2, units_per_launch=3, report=False)
    (journal,) = (tmp_path / "out" / "journal").iterdir()
    frame, run = (json.loads(line) for line in journal.read_text(encoding="utf-8").splitlines())
    assert (frame["details"]["threads"], frame["details"]["units_per_launch"]) == (2, 3)
    assert run["kind"] == "run" and run["machine"]["cores"]
    told = read_frame(tmp_path / "out" / "small.0001.exr").metadata
    assert {"mrbatch", "warp-lang", "numpy", "OpenImageIO"} <= told["versions"].keys()
    assert "seconds" not in told and told["time"] == 0.0


def test_the_report_is_whole(tmp_path):
    path = write_job(tmp_path, (0, 1))
    outcome = render(path, report=True)
    told = json.loads((tmp_path / "out" / job_run.REPORT).read_text(encoding="utf-8"))
    assert [f["state"] for f in told["frames"]] == ["done", "done"]
    assert told["job"]["hash"] == outcome.report.job.hash
    assert told["totals"]["predicted_seconds"]["value"] > 0
    assert (tmp_path / "out" / job_run.PAGE).is_file()
    again = render(path, report=True)
    assert again.result.kept == (0, 1) and not again.result.rendered


# --- tiles in which nothing virtual is seen ------------------------------------------------------------


def test_data_layers_look_only_where_something_virtual_may_be_seen(tmp_path):
    path = write_job(
        tmp_path, (0,), virtual=[{**CRATE, "transform": {"translate": ["6 cm", "6 cm", "50 mm"]}}]
    )
    layers = "output.layers=[virtual,depth,normal,crypto_object]"
    outcome = render(path, layers)
    plan = plan_job(load_job(path, [layers])).shot.plan
    seen, done = plan.seen[0, ""], plan.tiles[0, ""]
    assert 0 < len(seen) < len(done) and set(seen) <= set(done)
    children = outcome.result.entries[0].details["timing"]["children"]
    first = next(node for node in children if node["name"] == "first hits")
    assert first["counters"]["camera rays"] == 32 * 16 * 16 * len(seen)
    made = channels(tmp_path / "out" / "small.0000.exr")
    rows, columns = np.nonzero(made["virtual.A"])
    assert set((rows // 16) * (WIDTH // 16) + columns // 16) <= set(seen.tolist())
    normal = np.stack([made[f"normal.{c}"] for c in "XYZ"])
    assert ((made["depth.Z"] < 1e9) == (normal != 0).any(axis=0)).all()
