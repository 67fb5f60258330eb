"""The report model: round trip, versions, damaged files."""

from __future__ import annotations

import json
import math

import pytest
from pydantic import ValidationError

from mrbatch.errors import InputError, ResourceError
from mrbatch.report.model import (
    Effect,
    Frame,
    Gate,
    Job,
    Note,
    Picture,
    Plan,
    Report,
    Score,
    TimingNode,
    Totals,
    Value,
    load_report,
    save_report,
)


def full_report() -> Report:
    relmse = Score(metric="relmse", scope="tile", value=Value(value=0.02, unit="1"), at=(32, 16))
    return Report(
        job=Job(name="desk ✓", hash="ab" * 32, settings={"spp": 64, "nested": {"list": [1, "two", None]}}),
        versions={"mrbatch": "0.1.0"},
        plan=Plan(
            effects=(
                Effect(name="shadow", state="needed", why="the bunny stands on paper", numbers={"area": 0.3}),
                Effect(name="caustics", state="absent", why="nothing specular", bound=0.0),
            ),
            saved=Value(value=3.5, unit="s", low=3.0, high=4.0, confidence=0.95, repetitions=9),
        ),
        frames=(
            Frame(number=1, state="done", seconds=Value(value=2.0, unit="s"), counters={"rays": 2**40}),
            Frame(number=2, state="failed", message="cannot read the picture", exit=3),
            Frame(
                number=3,
                state="kept",
                outcome="reached",
                error=Value(value=1e-3, unit="1"),
                scores=(relmse,),
            ),
        ),
        timing=TimingNode(
            name="render",
            seconds=10.0,
            children=(TimingNode(name="trace", seconds=7.0, launches=12, counters={"rays": 5}),),
        ),
        totals=Totals(seconds=Value(value=10.0, unit="s"), frames_done=1, frames_kept=1, frames_failed=1),
        notes=(Note(level="warning", text="pose held", frame=3),),
        pictures=(Picture(role="composite", path="previews/1.png", frame=1),),
        gates=(Gate(name="max relMSE", passed=False, text="too large", measured=Value(value=1, unit="1")),),
        exit=4,
    )


def test_round_trip(tmp_path):
    report = full_report()
    save_report(report, tmp_path / "out" / "report.json")
    assert load_report(tmp_path / "out") == report
    assert load_report(tmp_path / "out" / "report.json") == report
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["report.json"]
    data = json.loads((tmp_path / "out" / "report.json").read_text("utf-8"))
    assert data["schema_version"] == "1.3" and data["frames"][0]["counters"]["rays"] == 2**40


def test_infinity_survives_strict_json(tmp_path):
    frame = Frame(number=1, state="done", error=Value(value=math.inf, unit="dB", low=-math.inf))
    save_report(Report(job=Job(name="x"), frames=(frame,)), tmp_path / "report.json")
    text = (tmp_path / "report.json").read_text("utf-8")
    json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))
    loaded = load_report(tmp_path).frames[0].error
    assert loaded is not None and loaded.value == math.inf and loaded.low == -math.inf


def test_a_timing_tree_of_the_device_room_is_taken():
    from mrbatch.device.timing import TimingNode as Measured

    tree = Measured("render")
    with tree.measure("trace") as node:
        node.count("rays", 7)
        node.launches += 2
    taken = TimingNode.model_validate(tree.as_dict())
    assert taken.children[0].name == "trace" and taken.children[0].counters == {"rays": 7}


def test_names_are_checked_when_a_report_is_made():
    with pytest.raises(ValidationError):
        Frame(number=1, state="done", secnds=None)
    with pytest.raises(ValidationError):
        Effect(name="x", state="perhaps", why="")


def write(tmp_path, change):
    data = json.loads(full_report().to_json())
    change(data)
    (tmp_path / "report.json").write_text(json.dumps(data), "utf-8")
    return tmp_path


def test_a_newer_minor_version_is_read_without_its_new_names(tmp_path):
    def change(data):
        data["schema_version"] = "1.7"
        data["moons"] = 3
        data["frames"][1]["colour_of_failure"] = "red"
        data["timing"]["children"][0]["joules"] = 5.0

    loaded = load_report(write(tmp_path, change))
    assert loaded.frames == full_report().frames and loaded.timing == full_report().timing


@pytest.mark.parametrize(
    "change, words",
    [
        (lambda d: d.update(schema_version="2.0"), "schema 2.0, this version reads 1.x"),
        (lambda d: d.update(schema_version="one"), "names no schema version"),
        (lambda d: d.pop("schema_version"), "names no schema version"),
        (lambda d: d.update(schema_version=1), "names no schema version"),
        (lambda d: d.update(moons=3), "moons"),
        (lambda d: d["frames"][0].update(number="x"), r"frames\.0\.number"),
        (lambda d: d.pop("job"), "job"),
        (lambda d: d.update(schema_version="1.9", job=5), "damaged"),
    ],
)
def test_other_versions_and_damage_are_clear_errors(tmp_path, change, words):
    with pytest.raises(InputError, match=words) as caught:
        load_report(write(tmp_path, change))
    assert str(tmp_path / "report.json") in str(caught.value)


@pytest.mark.parametrize("content", [b"", b"{", b"[1]", b"null", b"\xff\xfe", b"[" * 100_000, b'{"a": NaN}'])
def test_what_is_no_report_is_a_clear_error(tmp_path, content):
    (tmp_path / "report.json").write_bytes(content)
    with pytest.raises(InputError):
        load_report(tmp_path)


def test_missing_report_and_unwritable_place(tmp_path):
    with pytest.raises(InputError, match="no report here"):
        load_report(tmp_path)
    (tmp_path / "file").write_text("x")
    with pytest.raises(ResourceError, match="cannot write"):
        save_report(full_report(), tmp_path / "file" / "report.json")
