"""The JSON Schema and the manual: complete, valid, and at one with the models."""

from __future__ import annotations

import json
import re

import pytest

from mrbatch.capture.registry import CAPTURES
from mrbatch.document import read_document
from mrbatch.job import parse_job, resolved
from mrbatch.job.manual import manual_text, write_manual
from mrbatch.job.schema import DIALECT, job_schema
from mrbatch.methods.registry import METHODS


def properties(node, path=""):
    """Every property of every object in a schema, with its path."""
    if isinstance(node, list):
        for i, item in enumerate(node):
            yield from properties(item, f"{path}[{i}]")
    elif isinstance(node, dict):
        for key, value in node.items():
            if key == "properties":
                for name, part in value.items():
                    yield f"{path}.{name}", part
            yield from properties(value, f"{path}.{key}")


def agree(data, schema, definitions) -> bool:
    """A light check of data against the parts of JSON Schema that job schemas use."""
    if "$ref" in schema:
        return agree(data, definitions[schema["$ref"].rpartition("/")[2]], definitions)
    for key in ("anyOf", "oneOf"):
        if key in schema and not any(agree(data, branch, definitions) for branch in schema[key]):
            return False
    if "const" in schema and data != schema["const"]:
        return False
    if "enum" in schema and data not in schema["enum"]:
        return False
    kinds = {"string": str, "boolean": bool, "integer": int, "number": (int, float), "array": list}
    kind = schema.get("type")
    if kind in kinds and (not isinstance(data, kinds[kind]) or isinstance(data, bool) != (kind == "boolean")):
        return False
    if kind == "null":
        return data is None
    if "pattern" in schema and isinstance(data, str) and not re.search(schema["pattern"], data):
        return False
    if isinstance(data, (int, float)) and not (
        schema.get("minimum", data) <= data <= schema.get("maximum", data)
    ):
        return False
    if isinstance(data, list):
        if len(data) < schema.get("minItems", 0):
            return False
        parts = schema.get("prefixItems") or [schema.get("items", {})] * len(data)
        return len(parts) == len(data) and all(agree(d, p, definitions) for d, p in zip(data, parts))
    if "propertyNames" in schema and isinstance(data, dict):
        others = schema.get("additionalProperties", {})
        return all(
            agree(name, schema["propertyNames"], definitions) and agree(value, others, definitions)
            for name, value in data.items()
        )
    if "properties" in schema:
        if not isinstance(data, dict) or not set(schema.get("required", ())) <= set(data):
            return False
        return all(
            name in schema["properties"] and agree(value, schema["properties"][name], definitions)
            for name, value in data.items()
        )
    return True


WRONG = [
    ("60 mm", "60"),
    ("60 mm", "60 furlongs"),
    ("endpoints", "endpoint"),
    ("video:", "vidoe:"),
    ("roughness: 0.15", "roughness: 1.5"),
    ("photo}", "foto}"),
    ("spp: 64", "spp: many"),
    ("toy-method", "toy-methd"),
    ("glow: off", "glow: never"),
    ("{shadow: on", "{shadwo: on"),
    ("[virtual, depth]", "[virtul, depth]"),
    ("[virtual, depth]", "[]"),
]


@pytest.mark.usefixtures("toys")
def test_sample_agrees_and_wrong_jobs_do_not(sample, tmp_path):
    schema = job_schema()
    definitions = schema["$defs"]
    data = read_document(sample, "x").data
    assert agree(data, schema, definitions)
    assert agree(resolved(parse_job(sample, tmp_path / "x.yaml")), schema, definitions)
    for old, new in WRONG:
        assert not agree(read_document(sample.replace(old, new, 1), "x").data, schema, definitions), new


@pytest.mark.usefixtures("toys")
def test_full_check_where_jsonschema_is_installed(sample):
    jsonschema = pytest.importorskip("jsonschema")
    schema = job_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    validator = jsonschema.Draft202012Validator(schema)
    assert [e.message for e in validator.iter_errors(read_document(sample, "x").data)] == []
    for old, new in WRONG:
        assert not validator.is_valid(read_document(sample.replace(old, new, 1), "x").data), new


@pytest.mark.usefixtures("toys")
def test_every_field_is_described_and_defaults_are_jobs():
    schema = job_schema()
    assert schema["$schema"] == DIALECT
    found = dict(properties(schema))
    assert len(found) > 60
    assert [path for path, part in found.items() if not part.get("description")] == []
    for path, part in found.items():
        if "default" in part:
            assert agree(json.loads(json.dumps(part["default"])), part, schema["$defs"]), path


def test_registered_parts_are_described():
    try:
        for registry in (CAPTURES, METHODS):
            for name in registry.names():
                registry.get(name)
    except (ModuleNotFoundError, AttributeError) as missing:
        pytest.skip(f"not built yet: {missing}")
    found = dict(properties(job_schema()))
    assert [path for path, part in found.items() if not part.get("description")] == []


@pytest.mark.usefixtures("toys")
def test_manual_names_every_key(tmp_path):
    write_manual(tmp_path / "m.md")
    text = (tmp_path / "m.md").read_text(encoding="utf-8")
    assert text == manual_text()
    for path, _ in properties(job_schema()):
        assert f"`{path.rpartition('.')[2]}`" in text, path
    assert "## capture: toy-video" in text and "## method: toy-method" in text
