"""The JSON Schema of the job file, drawn from the models of the job and of every registered part."""

from __future__ import annotations

from typing import Any

from mrbatch.contracts import Method, Participant
from mrbatch.job.model import FILM_LAYERS, Job
from mrbatch.methods.registry import METHODS, PARTICIPANTS

DIALECT = "https://json-schema.org/draft/2020-12/schema"


def job_schema() -> dict[str, Any]:
    """JSON Schema, draft 2020-12. Imports every registered capture kind, method and participant."""
    Job.model_rebuild(force=True)  # the registries may have grown since the last time
    schema = Job.model_json_schema(mode="validation")
    _tidy(schema)
    _name_choices(schema)
    return {"$schema": DIALECT, **schema, "title": "mrbatch job"}


def _name_choices(schema: dict[str, Any]) -> None:
    """Names of layers and effects: the models look them up in the registries, so the schema does too."""
    methods = [METHODS.get(name) for name in METHODS.names()]
    owners: list[Method | Participant] = [
        *methods,
        *(PARTICIPANTS.get(name) for name in PARTICIPANTS.names()),
    ]
    layers = dict.fromkeys((*FILM_LAYERS, *(layer for method in methods for layer in method.layers)))
    effects = dict.fromkeys(rule.effect for owner in owners for rule in owner.rules)
    listed = {"type": "array", "items": {"enum": list(layers)}, "minItems": 1, "uniqueItems": True}
    schema["$defs"]["Output"]["properties"]["layers"]["anyOf"] = [listed, {"type": "null"}]
    schema["properties"]["effects"]["propertyNames"] = {"enum": sorted(effects)}


_BASE_UNITS = {"(m|": "m", "(deg|": "rad", "(s|": "s"}
"""How the pattern of a quantity tells which it is, and the unit that it has inside the program."""


def _with_unit(default: Any, part: dict[str, Any]) -> Any:
    """A default of a quantity as a person would write it."""
    items = part.get("prefixItems", ())
    if isinstance(default, list) and len(default) == len(items):
        return [_with_unit(value, item) for value, item in zip(default, items)]
    patterns = [branch.get("pattern", "") for branch in part.get("anyOf", ())]
    for mark, unit in _BASE_UNITS.items():
        if isinstance(default, float) and default != 0.0 and any(mark in p for p in patterns):
            return f"{default!r} {unit}"
    return default


def _tidy(node: Any) -> None:
    """Drops the titles that repeat a key, and gives every discriminating key its meaning."""
    if isinstance(node, list):
        for item in node:
            _tidy(item)
    if not isinstance(node, dict):
        return
    for key, value in node.items():
        if key == "properties" and isinstance(value, dict):
            for part in value.values():
                if isinstance(part, dict):
                    part.pop("title", None)
                    if "default" in part:
                        part["default"] = _with_unit(part["default"], part)
                    if "const" in part:
                        part.setdefault("description", "Which one this is")
                    _tidy(part)
        else:
            _tidy(value)
