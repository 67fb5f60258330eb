"""What differs between the job that holds a folder and this one, in words."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

MOST = 5
"""Differences that are named; the others are counted."""
ABSENT = "absent"


def differences(held: Mapping[str, Any], ours: Mapping[str, Any]) -> list[str]:
    """Lines such as `method.spp: 48 -> 16`, at most `MOST` and a count of the rest.

    Both are facts as `job.json` keeps them: `settings` (nested), `inputs` (pairs of name and
    content hash), `engine` and `version`. What one of them does not say counts as equal.
    Empty where nothing differs.
    """
    lines = []
    if isinstance(held.get("settings"), Mapping) and isinstance(ours.get("settings"), Mapping):
        old, new = _flat(held["settings"]), _flat(ours["settings"])
        for key in sorted(old.keys() | new.keys()):
            if old.get(key, ABSENT) != new.get(key, ABSENT):
                lines.append(f"{key}: {old.get(key, ABSENT)} -> {new.get(key, ABSENT)}")
    for key in ("engine", "version"):
        if key in held and key in ours and held[key] != ours[key]:
            lines.append(f"{key}: {held[key]} -> {ours[key]}")
    if "inputs" in held and "inputs" in ours:
        before, now = _by_name(held["inputs"]), _by_name(ours["inputs"])
        for name in sorted(before.keys() | now.keys()):
            if name not in now:
                lines.append(f"{name}: no longer read")
            elif name not in before:
                lines.append(f"{name}: read now, not then")
            elif before[name] != now[name]:
                lines.append(f"{name}: its content has changed")
    if len(lines) > MOST:
        lines = [*lines[:MOST], f"and {len(lines) - MOST} more"]
    return lines


def _by_name(inputs: Any) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for name, digest in inputs:
        found.setdefault(name, []).append(digest)
    return found


def _flat(value: Any, path: str = "") -> dict[str, str]:
    """Leaves by dotted path; items of a list by their `name`, where they have one, or position."""
    if isinstance(value, Mapping) and value:
        parts = list(value.items())
    elif isinstance(value, list) and any(isinstance(item, (dict, list)) for item in value):
        parts = [
            (item["name"] if isinstance(item, dict) and isinstance(item.get("name"), str) else i, item)
            for i, item in enumerate(value)
        ]
    else:
        text = json.dumps(value, ensure_ascii=False)
        return {path: text if len(text) <= 60 else f"{text[:57]}..."}
    found: dict[str, str] = {}
    for key, item in parts:
        found |= _flat(item, f"{path}.{key}" if path else str(key))
    return found
