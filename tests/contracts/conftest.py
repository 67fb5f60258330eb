"""The toys, registered; and a job of theirs in a folder of its own."""

from __future__ import annotations

import json
from contextlib import ExitStack
from pathlib import Path

import pytest
import toy_capture
import toy_fog
import toy_history

from mrbatch.capture.registry import register as register_capture
from mrbatch.methods.registry import METHODS
from mrbatch.methods.registry import register as register_method


@pytest.fixture(autouse=True)
def toys():
    with ExitStack() as stack:
        stack.enter_context(register_capture(toy_capture.KIND))
        stack.enter_context(METHODS.registered("toy-shade", "toy_method:METHOD"))
        stack.enter_context(register_method(toy_history.METHOD))
        stack.enter_context(register_method(toy_fog.PARTICIPANT))
        yield


@pytest.fixture
def write(tmp_path):
    """`write(method, capture, **parts)`: a job file."""

    def made(method: dict, capture: dict | None = None, **parts) -> Path:
        job = {
            "name": "toy",
            "capture": {"kind": "toy-capture", **(capture or {})},
            "method": method,
            "output": {"directory": "out", "preview": {"contact_sheet": False, "video": False}},
        }
        path = tmp_path / "toy.yaml"
        path.write_text(json.dumps(job | parts), encoding="utf-8")
        return path

    return made
