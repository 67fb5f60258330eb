"""Adding a method is one registry line: a toy shows up in jobs, errors and schema at once."""

from __future__ import annotations

from pathlib import Path

import pytest

from mrbatch.contracts import Method, Participant, Pipeline
from mrbatch.errors import JobError
from mrbatch.job import parse_job
from mrbatch.job.schema import job_schema
from mrbatch.methods import registry
from mrbatch.quantities import Settings

pytestmark = pytest.mark.usefixtures("toys")


class Knobs(Settings):
    size: int = 3


def build(*_):
    return Pipeline()


NEW = Method("new-method", "one more", ("toy-video",), Knobs, build, ("virtual",))
MIST = Participant("mist", "one more", Knobs, build)


def test_registered_toys_are_known_inside_the_block_alone(sample):
    text = sample.replace("{name: toy-method, spp: 64}", "{name: new-method, size: 4}")
    text = text.replace("effects: {shadow: on, glow: off}\n", "").replace("[virtual, depth]", "[virtual]")
    with pytest.raises(JobError, match="unknown method `new-method`"):
        parse_job(text, Path("/x/d.yaml"))
    with registry.register(NEW), registry.register(MIST):
        assert registry.method_names() == ("toy-method", "new-method")
        job = parse_job(text, Path("/x/d.yaml"), ["participants=[{type: mist}, {type: toy-fog}]"])
        assert job.method_name == "new-method" and job.method.size == 4
        assert job.method_object is NEW and job.participant_objects[0] is MIST
        assert "new-method" in str(job_schema()["properties"]["method"])
    assert registry.method_names() == ("toy-method",)
    with pytest.raises(JobError, match="unknown method"):
        registry.method("new-method")


def test_only_what_a_job_names_is_imported(sample, monkeypatch):
    entries = {**registry.METHODS._entries, "broken": "mrbatch.no_such_module:METHOD"}
    monkeypatch.setattr(registry.METHODS, "_entries", entries)
    assert parse_job(sample, Path("/x/d.yaml")).method_name == "toy-method"
    with pytest.raises(ModuleNotFoundError):
        registry.method("broken")
