"""The jobs of the real sets, as their script writes them: every set is there, and every job is valid."""

from __future__ import annotations

import json

import pytest
from real_sets import MATERIALS, april_jobs, charuco_job, desk_jobs

from mrbatch.job import load_job

pytestmark = pytest.mark.data


def test_every_marker_set_has_a_valid_job_and_every_mesh_stands_in_one(shared_data, tmp_path):
    paths = [charuco_job(shared_data, tmp_path), *april_jobs(shared_data, tmp_path)]
    paths += desk_jobs(shared_data, tmp_path)
    text = "".join(path.read_text(encoding="utf-8") for path in paths)
    for folder in ("markers", "meshes"):
        assert not [
            entry.name
            for entry in (shared_data / folder).iterdir()
            if f"{folder}/{entry.name}" not in text.replace("\\\\", "/")
        ]
    used = [item.get("material") for path in paths for item in json.loads(path.read_text())["virtual"]]
    assert not [name for name, material in MATERIALS.items() if material not in used]
    for path in paths:
        job = load_job(path)
        assert job.output.filter.kind == "variance" and job.method.spp == 32
