"""Animations of glTF files written by hand, against values worked out from the specification."""

from __future__ import annotations

import base64
import json
import struct
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from mrbatch.errors import InputError
from mrbatch.scene.build import build_scene
from mrbatch.scene.channel import Channel
from mrbatch.scene.gltf_animation import load_animation
from mrbatch.scene.motion import Clip, Clock
from mrbatch.scene.settings import VirtualObject

TRIANGLE = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
HALF = np.sqrt(0.5)
QUARTER_TURN = [0, 0, HALF, HALF]
"""About z, x y z w."""


def write(path: Path, nodes: list[dict], animations: list[dict], *, roots=(0,), primitives=1, **more) -> Path:
    """A glTF with one triangle as mesh 0; samplers give arrays in place of accessors."""
    blob, views, accessors = b"", [], []

    def accessor(values, kind: str, component: int = 5126, dtype="<f4", **extra) -> int:
        nonlocal blob
        raw = np.asarray(values, dtype).tobytes()
        views.append({"buffer": 0, "byteOffset": len(blob), "byteLength": len(raw)})
        blob += raw + b"\0" * (-len(raw) % 4)
        count = np.asarray(values).reshape(-1, {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[kind]).shape[0]
        accessors.append(
            {"bufferView": len(views) - 1, "componentType": component, "count": count, "type": kind, **extra}
        )
        return len(accessors) - 1

    positions = accessor(TRIANGLE, "VEC3", min=[0, 0, 0], max=[1, 1, 0])
    normals = accessor(np.tile([0, 0, 1.0], (3, 1)), "VEC3")
    one = {"attributes": {"POSITION": positions, "NORMAL": normals}}
    made = []
    for animation in animations:
        samplers, channels = [], []
        for node, part, times, values, interpolation, *whole in animation["channels"]:
            kind = "VEC4" if part == "rotation" else "SCALAR" if part == "weights" else "VEC3"
            output = accessor(values, kind, *whole)
            samplers.append({"input": accessor(times, "SCALAR"), "output": output})
            if interpolation:
                samplers[-1]["interpolation"] = interpolation
            channels.append({"sampler": len(samplers) - 1, "target": {"node": node, "path": part}})
        made.append({k: v for k, v in animation.items() if k != "channels"})
        made[-1] |= {"samplers": samplers, "channels": channels}
    header = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": list(roots)}],
        "nodes": nodes,
        "meshes": [{"primitives": [one] * primitives}],
        "materials": [],
        "accessors": accessors,
        "bufferViews": views,
        "animations": made,
        **more,
    }
    if path.suffix == ".glb":
        header["buffers"] = [{"byteLength": len(blob)}]
        text = json.dumps(header).encode()
        text += b" " * (-len(text) % 4)
        chunks = (
            struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(blob), b"BIN\0") + blob
        )
        path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)
    else:
        uri = "data:application/octet-stream;base64," + base64.b64encode(blob).decode()
        header["buffers"] = [{"byteLength": len(blob), "uri": uri}]
        path.write_text(json.dumps(header))
    return path


def corners(path: Path, seconds: float, *, rate=10, **clip) -> list[np.ndarray]:
    """World corners of each object that the job's object becomes, at a time of the shot."""
    item = VirtualObject.model_validate({"name": "thing", "mesh": str(path), "clip": clip}, context=None)
    scene = build_scene(None, [], [item])
    clock = Clock(np.array([5.0, 105.0]), np.array([2.0, 2.0 + 100 / rate]), float(rate))
    return [o.mesh.vertices for o in scene.by(clock).at(5 + seconds * rate).objects]


def test_linear_step_and_spline(tmp_path):
    """One node: place on a spline, turn linear, scale in steps."""
    times = [0.0, 1.0, 3.0]
    # Tangent into the key, value, tangent out of it.
    spline = [
        [[9, 9, 9], [0, 0, 0], [1, 0, 0]],
        [[0, 2, 0], [1, 1, 0], [0, 0, 3]],
        [[0, 0, -1], [2, 0, 0], [9, 9, 9]],
    ]
    turns = [[0, 0, 0, 1], QUARTER_TURN, [0, 0, 1, 0]]
    scales = [[1, 1, 1], [2, 2, 2], [3, 1, 1]]
    channels = [
        (0, "translation", times, spline, "CUBICSPLINE"),
        (0, "rotation", times, turns, "LINEAR"),
        (0, "scale", times, scales, "STEP"),
    ]
    path = write(tmp_path / "a.gltf", [{"mesh": 0}], [{"name": "all", "channels": channels}])
    # Halfway into the second interval, 2 s long: h = (1/2, 1/8, 1/2, -1/8), tangents times 2.
    place = 0.5 * np.array([1, 1, 0]) + 0.125 * 2 * np.array([0, 0, 3])
    place = place + 0.5 * np.array([2, 0, 0]) - 0.125 * 2 * np.array([0, 0, -1])
    angle = np.radians(135)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    (found,) = corners(path, 2.0)
    np.testing.assert_allclose(found, (2 * TRIANGLE) @ turn.T + place, atol=1e-6)
    # Tangents that are not scaled by the interval, as a spline of even keys would have them, are elsewhere.
    wrong = place - 0.125 * np.array([0, 0, 3]) + 0.125 * np.array([0, 0, -1])
    assert np.abs(found - ((2 * TRIANGLE) @ turn.T + wrong)).max() > 0.3
    # A quarter into the first.
    s = 0.25
    place = (s**3 - 2 * s**2 + s) * np.array([1, 0, 0]) + (3 * s**2 - 2 * s**3) * np.array([1, 1, 0])
    place = place + (s**3 - s**2) * np.array([0, 2, 0])
    angle = np.radians(22.5)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    np.testing.assert_allclose(corners(path, 0.25)[0], TRIANGLE @ turn.T + place, atol=1e-6)
    # Held before and after.
    np.testing.assert_allclose(corners(path, -1.0)[0], TRIANGLE, atol=1e-6)
    np.testing.assert_allclose(
        corners(path, 9.0)[0], TRIANGLE * [3, 1, 1] * [-1, -1, 1] + [2, 0, 0], atol=1e-6
    )


@pytest.mark.parametrize("suffix", ["gltf", "glb"])
@pytest.mark.parametrize("primitives", [1, 2])
def test_a_node_carries_its_children(tmp_path, suffix, primitives):
    """What hangs on a moving node goes with it; what does not stays."""
    nodes = [
        {"name": "arm", "translation": [0, 0, 1], "children": [1]},
        {"name": "arm", "matrix": np.diag([2.0, 2, 2, 1]).T.ravel().tolist(), "children": [2]},
        {"mesh": 0, "translation": [1, 0, 0]},
        {"mesh": 0, "translation": [7, 0, 0]},
    ]
    channels = [(0, "rotation", [0.0, 2.0], [[0, 0, 0, 1], QUARTER_TURN], "LINEAR")]
    animation = [{"channels": channels}]
    path = write(tmp_path / f"a.{suffix}", nodes, animation, roots=(0, 3), primitives=primitives)
    found = corners(path, 2.0)
    moved = (TRIANGLE + [1, 0, 0]) * 2 @ np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1.0]]) + [0, 0, 1]
    still = TRIANGLE + [7, 0, 0]
    assert len(found) == 2
    for part in found:
        expected = moved if part[0][0] < 5 else still
        np.testing.assert_allclose(part, np.tile(expected, (primitives, 1)), atol=1e-6)
    assert sorted(part[0][0] > 5 for part in found) == [False, True]


def test_whole_numbers_stand_for_fractions(tmp_path):
    """A rotation as normalized shorts."""
    values = np.round(np.array([[0, 0, 0, 1], QUARTER_TURN]) * 32767)
    channels = [(0, "rotation", [0.0, 1.0], values, None, 5122, "<i2")]
    path = write(tmp_path / "a.gltf", [{"mesh": 0}], [{"channels": channels}])
    expected = TRIANGLE @ np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1.0]])
    np.testing.assert_allclose(corners(path, 1.0)[0], expected, atol=1e-4)


def sliding(path: Path) -> Path:
    channels = [(0, "translation", [0.0, 2.0], [[0, 0, 0], [4, 0, 0]], "LINEAR")]
    other = [(0, "translation", [0.0, 1.0], [[0, 0, 0], [0, 9, 0]], "LINEAR")]
    return write(
        path, [{"mesh": 0}], [{"name": "slide", "channels": channels}, {"name": "rise", "channels": other}]
    )


def test_clips_are_chosen_started_repeated_and_sped_up(tmp_path):
    path = sliding(tmp_path / "a.glb")

    def x(seconds, **clip):
        return corners(path, seconds, **{"name": "slide", **clip})[0][0]

    np.testing.assert_allclose(x(0.5), [1, 0, 0], atol=1e-6)
    np.testing.assert_allclose(x(0.5, name="rise"), [0, 4.5, 0], atol=1e-6)
    np.testing.assert_allclose([x(3.0), x(-1.0)], [[4, 0, 0], [0, 0, 0]], atol=1e-6)
    np.testing.assert_allclose([x(2.5, repeat=True), x(-0.5, repeat=True)], [[1, 0, 0], [3, 0, 0]], atol=1e-6)
    # Frame 10 is half a second later.
    np.testing.assert_allclose([x(0.4, start=10), x(1.0, start=10)], [[0, 0, 0], [1, 0, 0]], atol=1e-6)
    np.testing.assert_allclose(x(0.5, speed=2.0), [2, 0, 0], atol=1e-6)


def test_a_clock_follows_the_footage():
    """Frames that are not evenly spaced in time, and times between and beyond them."""
    clock = Clock(np.array([0.0, 1, 2]), np.array([10.0, 10.1, 10.4]), float(Fraction(25)))
    assert [clock.at(f) for f in (0, 1, 1.5, 2)] == pytest.approx([10.0, 10.1, 10.25, 10.4])
    assert clock.at(3.5) == pytest.approx(10.4 + 1.5 / 25) and clock.at(-1) == pytest.approx(10 - 1 / 25)
    clip = Clip(length=1.0, clock=clock)
    assert clip.seconds(1.5) == pytest.approx(0.25)


def test_what_is_scaled_to_nothing_is_not_there(tmp_path):
    channels = [(0, "scale", [0.0, 1.0], [[0, 0, 0], [1, 1, 1]], "STEP")]
    path = write(tmp_path / "a.gltf", [{"mesh": 0}], [{"channels": channels}])
    item = VirtualObject.model_validate({"name": "thing", "mesh": str(path), "clip": {}})
    scene = build_scene(None, [], [item]).by(Clock(np.array([0.0, 9]), np.array([0.0, 0.9]), 10.0))
    hidden, shown = scene.at(3).objects[0], scene.at(10).objects[0]
    assert not hidden.camera and not hidden.cast_shadow and shown.camera and shown.cast_shadow
    assert np.isfinite(scene.shifts(3, 10)).all() and np.isfinite(scene.shifts(10, 3)).all()


def test_motion_vectors_follow_the_nodes(tmp_path):
    """A point of a mesh goes, from one frame to another, to where the animation puts it."""
    nodes = [{"children": [1], "translation": [0, 0, 3]}, {"mesh": 0, "scale": [2, 1, 1]}]
    channels = [
        (0, "rotation", [0.0, 2.0], [[0, 0, 0, 1], QUARTER_TURN], "LINEAR"),
        (1, "translation", [0.0, 2.0], [[0, 0, 0], [1, 2, 0]], "LINEAR"),
    ]
    path = write(tmp_path / "a.gltf", nodes, [{"channels": channels}])
    whole = {"name": "thing", "mesh": str(path), "clip": {}, "transform": {"rotate": ["90 deg", 0, 0]}}
    scene = build_scene(None, [], [VirtualObject.model_validate(whole)])
    scene = scene.by(Clock(np.array([0.0, 20]), np.array([0.0, 2.0]), 10.0))
    before, after = (scene.at(f).objects[0].mesh.vertices - scene.origin for f in (4, 16.5))
    shift = scene.shifts(4, 16.5)[0]
    np.testing.assert_allclose(before @ shift[:3, :3].T + shift[:3, 3], after, atol=1e-6)
    angle = np.radians(90) * 0.2
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    local = (TRIANGLE * [2, 1, 1] + [0.2, 0.4, 0]) @ turn.T + [0, 0, 3]
    np.testing.assert_allclose(before + scene.origin, local[:, [0, 2, 1]] * [1, -1, 1], atol=1e-6)


def test_turns_take_the_shortest_arc():
    channel = Channel(np.array([0.0, 1]), np.array([[0, 0, 0, 1], [0, 0, -HALF, -HALF]]), turns=True)
    np.testing.assert_allclose(channel.at(0.5), [0, 0, np.sin(np.pi / 8), np.cos(np.pi / 8)], atol=1e-12)


def test_refusals_say_what_and_where(tmp_path):
    plain = write(tmp_path / "plain.gltf", [{"mesh": 0}], [])
    two = sliding(tmp_path / "two.gltf")
    morph = write(
        tmp_path / "morph.gltf", [{"mesh": 0}], [{"channels": [(0, "weights", [0.0, 1], [0, 1], None)]}]
    )
    skinned = write(
        tmp_path / "skin.gltf",
        [{"mesh": 0, "skin": 0}, {}],
        [{"channels": [(1, "scale", [0.0], [[1, 1, 1]], None)]}],
        skins=[{"joints": [1]}],
    )
    backwards = write(
        tmp_path / "back.gltf",
        [{"mesh": 0}],
        [{"channels": [(0, "translation", [1.0, 0], [[0, 0, 0], [1, 0, 0]], None)]}],
    )
    short = write(
        tmp_path / "short.gltf",
        [{"mesh": 0}],
        [{"channels": [(0, "translation", [0.0, 1], [[0, 0, 0]], None)]}],
    )
    for path, name, message in (
        (plain, None, "no animation"),
        (two, None, "2 animations: slide, rise"),
        (two, "slid", "no animation `slid`"),
        (morph, None, "morph targets"),
        (skinned, None, "skin"),
        (backwards, None, "cannot be read"),
        (short, None, "cannot be read"),
    ):
        with pytest.raises(InputError, match=message) as refused:
            load_animation(path, name)
        assert refused.value.place is not None and refused.value.exit_code == 3
    with pytest.raises(ValueError, match="glTF file"):
        VirtualObject.model_validate({"name": "thing", "sphere": {"radius": "1 m"}, "clip": {}})
