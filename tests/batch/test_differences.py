"""What differs between two jobs, in words."""

from __future__ import annotations

from typing import Any

from mrbatch.batch.differences import differences


def facts(**changes: Any) -> dict[str, Any]:
    settings = {
        "method": {"name": "m", "spp": 48},
        "virtual": [{"name": "bunny", "material": {"type": "diffuse"}}, {"name": "face"}],
        "output": {"crop": None, "layers": ["virtual"]},
    }
    made = {
        "settings": settings,
        "engine": "auto",
        "version": "1",
        "inputs": [["a.png", "x"], ["b.ply", "y"]],
    }
    return made | changes


def test_values_by_their_path():
    new = facts()
    new["settings"]["method"]["spp"] = 16
    new["settings"]["virtual"][0]["material"]["type"] = "conductor"
    new["settings"]["output"]["crop"] = [1, 2, 3, 4]
    assert differences(facts(), new) == [
        "method.spp: 48 -> 16",
        "output.crop: null -> [1, 2, 3, 4]",
        'virtual.bunny.material.type: "diffuse" -> "conductor"',
    ]


def test_what_comes_and_goes():
    new = facts(engine="warp", version="2", inputs=[["a.png", "z"], ["c.ply", "y"]])
    del new["settings"]["virtual"][1]
    assert differences(facts(), new) == [
        'virtual.face.name: "face" -> absent',
        "engine: auto -> warp",
        "version: 1 -> 2",
        "a.png: its content has changed",
        "b.ply: no longer read",
        "and 1 more",
    ]


def test_what_one_does_not_say_counts_as_equal():
    assert differences(facts(), facts()) == []
    assert differences({"job_hash": "x"}, facts()) == []
    assert differences(facts(), {"engine": "auto"}) == []
    assert differences(facts(), facts(inputs=[["a.png", "x"], ["a.png", "x"], ["b.ply", "y"]])) == [
        "a.png: its content has changed"
    ]


def test_long_values_are_cut():
    new = facts()
    new["settings"]["output"]["layers"] = ["x" * 200]
    (line,) = differences(facts(), new)
    assert len(line) < 120 and line.endswith("...")
