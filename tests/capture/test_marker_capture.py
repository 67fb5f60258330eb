"""The marker video as a capture: table, frames, gains, mattes, and what is refused."""

from __future__ import annotations

import json
from types import SimpleNamespace

import cv2
import numpy as np
import OpenImageIO as oiio
import pytest
from pydantic import ValidationError

from mrbatch.capture.marker_video import KIND
from mrbatch.capture.marker_video.capture import MarkerVideoCapture
from mrbatch.capture.marker_video.gain import load_gains
from mrbatch.capture.marker_video.pose_table import FramePose
from mrbatch.capture.marker_video.settings import MarkerVideoSettings
from mrbatch.errors import InputError

W, H = 32, 24
CAMERA = {"matrix": [[40, 0, 15.5], [0, 40, 11.5], [0, 0, 1]], "width": W, "height": H}
TARGET = {"marker": {"dictionary": "DICT_4X4_50", "id": 3, "side": "60 mm"}}


def pose(number):
    result = np.eye(4)
    result[:3, 3] = [0.01 * number, 0.0, -1.0]
    return result


def codes_of(number):
    return np.random.default_rng(number).integers(0, 256, (H, W, 3)).astype(np.uint8)


def write_exr(path, values):
    out = oiio.ImageOutput.create(str(path))
    kind = {"float16": "half", "float32": "float"}[str(values.dtype)]
    out.open(str(path), oiio.ImageSpec(values.shape[1], values.shape[0], values.shape[2], kind))
    out.write_image(values)
    out.close()


@pytest.fixture
def shot(tmp_path):
    """Eight pictures 0..7 and their poses."""
    for n in range(8):
        cv2.imwrite(str(tmp_path / f"p_{n:04d}.png"), codes_of(n)[..., ::-1])
    entries = [{"frame": n, "world_from_camera": pose(n).tolist()} for n in range(8)]
    (tmp_path / "poses.json").write_text(json.dumps(entries))
    return tmp_path


def settings(**changes):
    base = {"frames": "p_####.png", "frame_rate": 25, "camera": CAMERA, "poses": "poses.json"}
    return MarkerVideoSettings.model_validate({k: v for k, v in (base | changes).items() if v is not None})


def opened(folder, solve=None, **changes):
    return MarkerVideoCapture(settings(**changes), folder, solve=solve)


def prepared(folder, solve=None, **changes):
    capture = opened(folder, solve, **changes)
    return capture, json.loads(json.dumps(capture.prepare(), allow_nan=False))


def test_frames_with_given_poses(shot):
    capture = KIND.open(settings(gain=0.55), shot)
    assert list(capture.frame_numbers()) == list(range(8))
    table = json.loads(json.dumps(capture.prepare(), allow_nan=False))
    frame = capture.frame(3, table)
    view = frame.views[""]
    assert (frame.number, frame.time, frame.flags) == (3, 0.12, ())
    np.testing.assert_array_equal(view.codes, codes_of(3))
    v = codes_of(3) / 255.0
    truth = np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4)
    np.testing.assert_allclose(view.background, truth, rtol=1e-6)
    assert view.background.dtype == np.float32
    np.testing.assert_allclose(view.camera.world_from_camera, pose(3), atol=1e-15)
    assert (view.camera.matrix[0, 2], view.camera.matrix[1, 2]) == (16.0, 12.0)  # OpenCV's plus a half
    np.testing.assert_array_equal(view.gain, [0.55] * 3)
    assert view.matte is None
    facts = capture.facts(table)
    assert (facts.source_bits, facts.source_is_float, facts.transfer) == (8, False, "srgb")
    assert facts.frame_rate == 25
    np.testing.assert_array_equal(
        capture.geometry(3, table)[""].camera.world_from_camera, view.camera.world_from_camera
    )


def test_a_frame_is_a_function_of_number_and_table(shot):
    first, table = prepared(shot)
    other = opened(shot)  # another process: never prepared
    for n in (5, 2):
        a, b = first.frame(n, table).views[""], other.frame(n, table).views[""]
        np.testing.assert_array_equal(a.background, b.background)
        np.testing.assert_array_equal(a.camera.world_from_camera, b.camera.world_from_camera)


def test_inputs_name_every_file(shot):
    (shot / "gains.json").write_text(json.dumps({str(n): 0.5 for n in range(8)}))
    for n in range(8):
        cv2.imwrite(str(shot / f"m_{n:04d}.png"), np.zeros((H, W), np.uint8))
    names = {
        p.name for p in opened(shot, gain="gains.json", mattes="m_####.png", subset={"last": 1}).inputs()
    }
    wanted = {"p_0000.png", "p_0001.png", "m_0000.png", "m_0001.png", "poses.json", "gains.json"}
    assert names == wanted


@pytest.mark.parametrize(
    ("subset", "wanted"),
    [
        ({"first": 2, "last": 6}, [2, 3, 4, 5, 6]),
        ({"first": 1, "step": 3}, [1, 4, 7]),
        ({"from_time": "0.1 s", "to_time": "0.2 s"}, [3, 4]),
    ],
)
def test_subsets(shot, subset, wanted):
    capture, table = prepared(shot, subset=subset)
    assert list(capture.frame_numbers()) == table["frames"] == wanted


def test_start_frame_renumbers(shot):
    entries = [{"frame": 1001 + n, "world_from_camera": pose(n).tolist()} for n in range(8)]
    (shot / "poses.json").write_text(json.dumps(entries))
    capture, table = prepared(shot, start_frame=1001)
    assert table["frames"] == list(range(1001, 1009))
    np.testing.assert_array_equal(capture.frame(1004, table).views[""].codes, codes_of(3))
    assert table["times"][3] == 0.12
    with pytest.raises(InputError, match="1 to 8 has a pose in the file, which has 1001 to 1008"):
        prepared(shot, start_frame=1)


def test_missing_numbers_are_noted(shot):
    (shot / "p_0004.png").unlink()
    _, table = prepared(shot)
    assert table["missing"] == [4]
    assert list(table["absent"]) == ["4"]
    assert "missing in the footage: 1 frame (4)" in table["notes"]
    _, table = prepared(shot, subset={"last": 3})
    assert table["missing"] == []


def test_a_lens_that_folds_back_is_told(shot):
    _, table = prepared(shot, camera=CAMERA | {"distortion": [-30.0, 0, 0, 0, 0]})
    assert any("folds back within the picture" in note for note in table["notes"])
    assert not any("folds" in note for note in prepared(shot)[1]["notes"])


def test_world_from_marker_moves_the_cameras(shot):
    move = [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]
    capture, table = prepared(shot, world_from_marker=move)
    got = capture.geometry(2, table)[""].camera.world_from_camera
    np.testing.assert_allclose(got, np.array(move) @ pose(2), atol=1e-15)
    turned = {"rotation": ["0 deg", "0 deg", "90 deg"], "position": ["1 m", "2 m", "3 m"]}
    capture, table = prepared(shot, world_from_marker=turned)
    np.testing.assert_allclose(capture.geometry(2, table)[""].camera.world_from_camera, got, atol=1e-15)


@pytest.mark.parametrize(
    ("lost", "frames", "x", "flag"),
    [
        ("skip", [0, 1, 2, 4, 5, 6, 7], None, None),
        ("hold-last", list(range(8)), 0.02, "pose-held"),
        ("interpolate", list(range(8)), 0.03, "pose-interpolated"),
    ],
)
def test_policies_for_frames_without_a_pose(shot, lost, frames, x, flag):
    entries = [{"frame": n, "world_from_camera": pose(n).tolist()} for n in range(8) if n != 3]
    (shot / "poses.json").write_text(json.dumps(entries))
    capture, table = prepared(shot, lost=lost)
    assert list(capture.frame_numbers()) == table["frames"] == frames
    if x is None:
        assert table["skipped"] == [3]
        with pytest.raises(InputError, match="no camera pose") as caught:
            capture.frame(3, table)
        assert caught.value.place.frame == 3
    else:
        frame = capture.frame(3, table)
        assert frame.views[""].camera.world_from_camera[0, 3] == pytest.approx(x)
        assert flag in frame.flags
    with pytest.raises(InputError, match="no pose for 1 of 8 frames: 3"):
        prepared(shot, lost="stop")


def test_poses_are_solved_from_pictures(shot):
    """The solver gets every picture once, in order, as 16-bit grey codes, and the job's policy."""
    seen = []

    def solve(frames, calibration, target, *, lost, progress):
        rows = []
        for number, time, load in frames:
            grey = load()
            assert (grey.dtype, grey.shape) == (np.uint16, (H, W))
            seen.append((number, time))
            found = pose(number) if number != 2 else None
            rows.append(FramePose(number, time, found, flags=() if number != 2 else ("lost",)))
        assert target.marker.id == 3 and lost == "skip"
        assert (calibration.width, calibration.height) == (W, H)
        return SimpleNamespace(
            frames=tuple(rows),
            median_rms=0.1,
            noise=1.0,
            layout=None,
            as_json=lambda: [{"frame": r.number} for r in rows],
        )

    capture, table = prepared(shot, solve, poses=None, target=TARGET, lost="skip")
    assert [n for n, _ in seen] == list(range(8))
    assert table["frames"] == [0, 1, 3, 4, 5, 6, 7]
    assert list(table["absent"]) == ["2"] and "pose" in table["absent"]["2"]
    assert table["pose_report"]["median_rms_px"] == 0.1


def test_a_broken_picture_costs_its_frame_only(shot):
    data = (shot / "p_0005.png").read_bytes()
    (shot / "p_0005.png").write_bytes(data[: len(data) // 2])

    def solve(frames, calibration, target, *, lost, progress):
        rows = tuple(FramePose(n, t, pose(n)) for n, t, load in frames if load() is not None)
        return SimpleNamespace(frames=rows, median_rms=0.1, noise=1.0, layout=None, as_json=list)

    capture, table = prepared(shot, solve, poses=None, target=TARGET)
    assert table["frames"] == list(range(8))
    assert list(table["broken"]) == ["5"]
    for number in range(8):
        if number == 5:
            with pytest.raises(InputError, match="damaged or cut short") as caught:
                capture.frame(number, table)
            assert caught.value.place.frame == 5
            assert caught.value.exit_code == 3
        else:
            capture.frame(number, table)


def test_gains_of_every_kind(shot):
    _, table = prepared(shot, gain=[0.5, 0.6, 0.7])
    assert table["gains"]["4"] == [0.5, 0.6, 0.7]
    (shot / "g.csv").write_text("frame,gain\n" + "".join(f"{n},{0.5 + n}\n" for n in range(8)))
    assert prepared(shot, gain="g.csv")[1]["gains"]["4"] == [4.5] * 3
    (shot / "g.csv").write_text("frame,r,g,b\n" + "".join(f"{n},1,2,{1 + n}\n" for n in range(8)))
    assert prepared(shot, gain={"file": "g.csv"})[1]["gains"]["4"] == [1, 2, 5]
    (shot / "g.json").write_text(json.dumps([{"frame": n, "gain": 2} for n in range(7)]))
    capture, table = prepared(shot, gain="g.json")
    assert table["broken"] == {"7": "the frame has no gain in g.json"} and table["frames"] == list(range(8))
    capture.frame(6, table)
    with pytest.raises(InputError, match="no gain") as caught:
        capture.frame(7, table)
    assert caught.value.place.frame == 7
    (shot / "g.json").write_text(json.dumps({"1001": 2}))
    with pytest.raises(InputError, match="none of the 8 frames has a gain") as caught:
        prepared(shot, gain="g.json")
    assert "1001" in caught.value.hint


@pytest.mark.parametrize("value", [0, -1, [1, 0, 1], [1, 2], float("nan"), "nan"])
def test_gains_that_no_camera_has(tmp_path, value):
    with pytest.raises(ValidationError):
        settings(gain={"value": value})
    if value != "nan":
        (tmp_path / "g.json").write_text(json.dumps({"7": value}))
        with pytest.raises(InputError, match="gain") as caught:
            load_gains(tmp_path / "g.json")
        assert caught.value.place.frame == 7


@pytest.mark.parametrize(
    "text", ["{", "[]", '[{"frame": 1}]', '{"a": 1}', '{"1": 1, "01": 2}', '{"1": "x"}', '{"1": true}']
)
def test_gain_files_that_cannot_be_read(tmp_path, text):
    (tmp_path / "g.json").write_text(text)
    with pytest.raises(InputError):
        load_gains(tmp_path / "g.json")


def test_gain_from_a_patch(shot):
    """Codes 128, 160, 200 over radiance 0.8 x pi / pi: the gain is the mean linear value over 0.8."""
    picture = codes_of(4)
    picture[5:9, 10:16] = (128, 160, 200)
    cv2.imwrite(str(shot / "p_0004.png"), picture[..., ::-1])
    patch = {"frame": 4, "rectangle": [10, 5, 6, 4], "reflectance": 0.8, "irradiance": float(np.pi)}
    _, table = prepared(shot, gain={"patch": patch})
    truth = [((c / 255 + 0.055) / 1.055) ** 2.4 / 0.8 for c in (128, 160, 200)]
    np.testing.assert_allclose(table["gains"]["0"], truth, rtol=1e-6)
    with pytest.raises(InputError, match="beyond the picture"):
        prepared(shot, gain={"patch": patch | {"rectangle": [30, 5, 6, 4]}})
    with pytest.raises(InputError, match="names a frame that is not there"):
        prepared(shot, gain={"patch": patch | {"frame": 99}})
    picture[5:9, 10:16] = 255
    cv2.imwrite(str(shot / "p_0004.png"), picture)
    with pytest.raises(InputError, match="100 % of the patch's pixels are clipped"):
        prepared(shot, gain={"patch": patch})
    picture[5:9, 10:16] = 0
    cv2.imwrite(str(shot / "p_0004.png"), picture)
    with pytest.raises(InputError, match="above 0"):
        prepared(shot, gain={"patch": patch})


def matte_of(number):
    return np.random.default_rng(100 + number).integers(0, 256, (H, W)).astype(np.uint8)


def test_mattes_keep_soft_edges(shot):
    for n in range(8):
        cv2.imwrite(str(shot / f"m_{n:04d}.png"), matte_of(n))
    capture, table = prepared(shot, mattes="m_####.png")
    matte = capture.frame(6, table).views[""].matte
    np.testing.assert_array_equal(matte, matte_of(6).astype(np.float32) / np.float32(255))
    capture, table = prepared(shot, mattes={"frames": "m_####.png", "invert": True})
    np.testing.assert_array_equal(capture.frame(6, table).views[""].matte, 1 - matte)
    write_exr(shot / "m_0006.exr", matte[..., None])
    capture, table = prepared(shot, mattes={"frames": ["m_0006.exr"]}, subset={"first": 6, "last": 6})
    np.testing.assert_array_equal(capture.frame(6, table).views[""].matte, matte)


def test_a_missing_matte_costs_its_frame_only(shot):
    for n in (0, 1, 2, 4, 5, 6, 7):
        cv2.imwrite(str(shot / f"m_{n:04d}.png"), matte_of(n))
    capture, table = prepared(shot, mattes="m_####.png")
    assert table["broken"] == {"3": "the frame has no matte"} and table["frames"] == list(range(8))
    assert "cannot be used: 1 frame (3)" in table["notes"]
    capture.frame(2, table)
    with pytest.raises(InputError, match="no matte") as caught:
        capture.frame(3, table)
    assert caught.value.place.frame == 3


def test_mattes_that_do_not_fit(shot):
    def check(message, values, name="m_0000.png"):
        if name.endswith("exr"):
            write_exr(shot / name, values)
        else:
            cv2.imwrite(str(shot / name), values)
        capture, table = prepared(shot, mattes={"frames": [name]}, subset={"last": 0})
        with pytest.raises(InputError, match=message) as caught:
            capture.frame(0, table)
        assert caught.value.place.frame == 0

    check("the matte is 31x24, the frame 32x24", np.zeros((H, W - 1), np.uint8))
    check("colour picture", codes_of(1))
    check("expected 0 to 1", np.full((H, W, 1), 1.5, np.float32), "m_0000.exr")
    check("NaN", np.full((H, W, 1), np.nan, np.float32), "m_0000.exr")
    with pytest.raises(InputError, match="none of the 7 frames has a matte, from 1 to 7"):
        prepared(shot, mattes={"frames": ["m_0000.png"]}, subset={"first": 1})
    with pytest.raises(InputError, match="no file matches"):
        opened(shot, mattes="none_####.png")


def test_pictures_of_a_wrong_size(shot):
    cv2.imwrite(str(shot / "p_0002.png"), np.zeros((H, W + 2, 3), np.uint8))
    capture, table = prepared(shot)
    with pytest.raises(InputError, match="34x24, the others are 32x24") as caught:
        capture.frame(2, table)
    assert caught.value.place.frame == 2
    with pytest.raises(InputError, match="calibration"):
        prepared(shot, camera=CAMERA | {"width": W * 2})


def test_nan_in_an_exr_background(tmp_path, shot):
    values = np.ones((H, W, 3), np.float16)
    for n in range(2):
        values[5, 6, 0] = np.nan if n else 1
        write_exr(shot / f"e_{n:04d}.exr", values)
    capture, table = prepared(shot, frames="e_####.exr")
    assert capture.facts(table).source_is_float
    assert capture.frame(0, table).views[""].codes is None
    with pytest.raises(InputError, match="NaN or infinity, the first at x 6, y 5") as caught:
        capture.frame(1, table)
    assert caught.value.place.frame == 1


def test_frames_cut_off_a_video_are_absent(shot):
    """What the file announces beyond its last frame is missing, as a gap in a sequence is."""
    import av

    with av.open(str(shot / "whole.mp4"), "w", options={"movflags": "faststart"}) as container:
        stream = container.add_stream("mpeg4", rate=25, options={"qscale": "1", "g": "1"})
        stream.width, stream.height, stream.pix_fmt = W, H, "yuv420p"
        for n in range(8):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(codes_of(n)[..., :3], format="rgb24")))
        container.mux(stream.encode())
    data = (shot / "whole.mp4").read_bytes()
    (shot / "cut.mp4").write_bytes(data[: -len(data) // 4])
    assert prepared(shot, frames="whole.mp4")[1]["absent"] == {}
    capture, table = prepared(shot, frames="cut.mp4")
    there = len(capture.frame_numbers())
    assert 2 < there < 8
    assert list(table["absent"]) == [str(n) for n in range(there, 8)]
    assert list(capture.announced_numbers()) == list(range(8))
    assert any(note.startswith(f"missing in the footage: {8 - there} frame") for note in table["notes"])
    assert list(prepared(shot, frames="cut.mp4", subset={"last": there})[1]["absent"]) == [str(there)]
    for rate in (25, None):
        until = {"to_time": f"{there / 25} s"}
        assert prepared(shot, frames="cut.mp4", frame_rate=rate, subset=until)[1]["absent"] == {}


def test_missing_video(tmp_path):
    with pytest.raises(InputError, match="there is no such video"):
        opened(tmp_path, frames="shot.mp4").prepare()


def test_a_video_as_capture(shot):
    av = pytest.importorskip("av")
    with av.open(str(shot / "v.mkv"), "w") as container:
        stream = container.add_stream("libx264rgb", rate=25)
        stream.width, stream.height, stream.pix_fmt, stream.options = W, H, "rgb24", {"qp": "0"}
        for n in range(8):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(codes_of(n), "rgb24")))
        container.mux(stream.encode())
    capture, table = prepared(shot, frames="v.mkv", frame_rate=None)
    other = opened(shot, frames="v.mkv", frame_rate=None)
    for n in (6, 1, 2):
        for c in (capture, other):
            np.testing.assert_array_equal(c.frame(n, table).views[""].codes, codes_of(n))
    np.testing.assert_allclose(table["times"], np.arange(8) / 25)
    assert capture.facts(table).frame_rate == 25
    assert [p.name for p in capture.inputs()] == ["v.mkv", "poses.json"]
    conformed, table = prepared(shot, frames="v.mkv", frame_rate="24000/1001")
    assert table["times"][7] == pytest.approx(7 * 1001 / 24000, rel=1e-15)
    capture.close()
    np.testing.assert_array_equal(capture.frame(3, table).views[""].codes, codes_of(3))


@pytest.mark.parametrize(
    "changes",
    [
        {"poses": None},
        {"target": TARGET},
        {"camera": {"width": 3, "height": 4}},
        {"camera": {"matrix": [[0, 0, 1], [0, 1, 1], [0, 0, 1]], "width": 3, "height": 4}},
        {"camera": {"matrix": CAMERA["matrix"]}},
        {"frame_rate": 0},
        {"frame_rate": "a/b"},
        {"frames": []},
        {"frames": ""},
        {"lost": "ignore"},
        {"world_from_marker": [[2, 0, 0, 0], [0, 2, 0, 0], [0, 0, 2, 0], [0, 0, 0, 1]]},
        {"gain": {"patch": {"frame": 0, "rectangle": [0, 0, 1, 1]}}},
        {"colour": {"transfer": "rec709"}},
    ],
)
def test_settings_that_make_no_sense(changes):
    with pytest.raises(ValidationError):
        settings(**changes)


def test_settings_survive_json():
    given = settings(
        gain=0.55, mattes="m_*.png", frame_rate=29.97, world_from_marker={"position": ["1 m", 0, 0]}
    )
    assert given.frame_rate.denominator == 1001
    assert MarkerVideoSettings.model_validate(given.model_dump(mode="json")) == given


def test_a_marker_seen_twice_costs_its_frame_only(tmp_path):
    """Frame 1 of three shows the marker twice; its neighbours keep their poses, both roots of them."""
    from rendered_marker import look_at, marker_page, photograph, render

    size, matrix = (320, 240), np.array([[400.0, 0, 160], [0, 400.0, 120], [0, 0, 1]])
    page, metres = marker_page("DICT_4X4_50", 3, 0.06)
    for n in range(3):
        camera = look_at([0.02 * n, -0.3, 0.4])
        linear = render(page, metres, matrix, camera, size)
        if n == 1:
            beside = np.eye(4)
            beside[0, 3] = 0.1
            linear = render(page, metres, matrix, camera, size, world_from_page=beside, onto=linear)
        codes = photograph(linear)
        cv2.imwrite(str(tmp_path / f"p_{n:04d}.png"), np.repeat(codes[..., None], 3, axis=2))
    camera = {"matrix": matrix.tolist(), "width": 320, "height": 240, "pixel_centres": "half"}
    lift = {"position": [0, 0, "2 m"]}
    for lost in ("stop", "interpolate"):
        capture, table = prepared(
            tmp_path, poses=None, target=TARGET, camera=camera, lost=lost, world_from_marker=lift
        )
        assert list(table["broken"]) == ["1"] and "seen 2 times" in table["broken"]["1"]
        assert sorted(table["poses"]) == ["0", "2"] and table["frames"] == [0, 1, 2]
        with pytest.raises(InputError, match="seen 2 times"):
            capture.frame(1, table)
    for n, row in zip((0, 2), (r for r in table["pose_report"]["frames"] if r["frame"] != 1)):
        other = np.array(row["other_root"]["world_from_camera"])
        own = np.array(table["poses"][str(n)])
        assert row["other_root"]["rms_px"] == pytest.approx(max(row["roots_rms_px"]))
        assert not np.allclose(other, own, atol=1e-3)
        # Both cameras look at the marker, where the job has put it.
        for pose_ in (other, own):
            seen = np.linalg.inv(pose_) @ [0, 0, 2, 1]
            np.testing.assert_allclose(400 * seen[:2] / seen[2], [0, 0], atol=2.0)


@pytest.mark.data
def test_the_desk_set_from_its_marker(shared_data):
    """Poses solved from 8-bit pictures through the whole capture, against the renderer's own."""
    folder = shared_data / "markers" / "mitsuba_desk_window"
    if not folder.is_dir():
        pytest.skip("the desk set is absent")
    scene = json.loads((folder / "scene.json").read_text())
    camera = {"matrix": scene["camera_matrix"], "width": 480, "height": 360, "pixel_centres": "half"}
    target = {"marker": {"dictionary": "DICT_4X4_50", "id": 7, "side": "60 mm"}}
    changes = {"frames": "photo_####.png", "camera": camera, "gain": 0.55}
    given = prepared(folder, **changes, poses="scene.json")[1]
    np.testing.assert_allclose(given["poses"]["4"], scene["world_from_camera"][4], atol=1e-12)
    target["marker"]["id"] = scene.get("marker", {}).get("id", 7)
    solved = prepared(folder, **changes, poses=None, target=target)[1]
    turns, shifts = [], []
    for n in range(6):
        truth, found = np.array(scene["world_from_camera"][n]), np.array(solved["poses"][str(n)])
        cosine = (np.trace(truth[:3, :3].T @ found[:3, :3]) - 1) / 2
        turns.append(np.degrees(np.arccos(min(cosine, 1.0))))
        shifts.append(np.linalg.norm(truth[:3, 3] - found[:3, 3]) / np.linalg.norm(truth[:3, 3]))
    assert np.median(turns) < 0.3
    assert np.median(shifts) < 0.005
