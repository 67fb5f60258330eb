"""README and docs agree with what they describe."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from mrbatch.cli import COMMANDS

ROOT = Path(__file__).resolve().parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def test_the_manual_of_the_job_file_is_up_to_date():
    from mrbatch.job.manual import manual_text

    stored = (ROOT / "docs" / "job_manual.md").read_text(encoding="utf-8")
    assert stored == manual_text(), "run: mrbatch schema --manual --output docs/job_manual.md"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page):
    targets = re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", page.read_text(encoding="utf-8"))
    local = [target for target in targets if "://" not in target]
    assert not [target for target in local if not (page.parent / target).exists()]


def test_the_index_names_every_page():
    index = (ROOT / "docs" / "README.md").read_text(encoding="utf-8")
    assert not [
        page.name
        for page in (ROOT / "docs").glob("*.md")
        if page.name != "README.md" and f"({page.name})" not in index
    ]


def test_the_architecture_names_every_room():
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    rooms = [path.parent.name for path in (ROOT / "mrbatch").glob("*/__init__.py")]
    assert not [room for room in rooms if f"`{room}/`" not in text]


def test_the_readme_names_every_command_and_no_other():
    assert set(re.findall(r"^\| `mrbatch ([\w-]+)", README, flags=re.MULTILINE)) == set(COMMANDS)


def test_the_jobs_that_the_readme_renders_are_there():
    jobs = re.findall(r"mrbatch render (\S+\.yaml)", README)
    assert jobs
    assert not [job for job in jobs if not (ROOT / job).is_file()]


def test_overrides_that_are_advised_work():
    from mrbatch.job import load_job

    job = ROOT / "configs" / "marker_video.yaml"
    advised = {
        override
        for page in (*PAGES, job)
        for override in re.findall(r"--set '([^']+)'", page.read_text(encoding="utf-8"))
    }
    assert "virtual.golden bunny.material.roughness=0.3" in advised
    assert load_job(job, sorted(advised))


def test_other_settings_are_advised_with_another_folder():
    lines = README.replace("\\\n", " ").splitlines()
    renders = [line for line in lines if line.startswith("    ") and "mrbatch render" in line]
    assert len(renders) >= 3
    for line in renders:
        assert "--output" in line or not re.search(r"--(set|scale|crop|seed|layers)", line), line


def test_continuous_integration_calls_the_test_command_of_the_readme():
    commands = re.findall(r"\.venv/bin/(python -m pytest[^`\n]*)", README)
    assert commands == ["python -m pytest", "python -m pytest -m slow"]
    script = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    assert all(re.search(rf"^{re.escape(command)}", script, flags=re.MULTILINE) for command in commands)


def test_dependencies_are_described():
    import tomllib

    from packaging.requirements import Requirement

    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"]
    lines = [*project["dependencies"], *extras["denoise"], *extras["test"]]
    text = (ROOT / "docs" / "dependencies.md").read_text(encoding="utf-8")
    described = set(re.findall(r"^\| ([\w.-]+)", text, flags=re.MULTILINE)) - {"package", "---"}
    assert described == {Requirement(line).name for line in lines}


CALLED_BY_OTHERS = {"pillow": "trimesh opens pictures with it"}
"""Libraries that the package needs without importing them itself."""


def test_what_is_installed_is_used():
    """Every library to run stands in an import of the package; those of the tests alone are for the tests."""
    import tomllib
    from importlib.metadata import packages_distributions

    from packaging.requirements import Requirement

    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    text = "\n".join(path.read_text(encoding="utf-8") for path in (ROOT / "mrbatch").rglob("*.py"))
    imported = set(re.findall(r"^\s*(?:import|from) ([\w]+(?:\.yaml)?)", text, flags=re.MULTILINE))
    modules: dict[str, set[str]] = {}
    for module, names in packages_distributions().items():
        for name in names:
            modules.setdefault(name.lower().replace("_", "-"), set()).add(module)
    for line in project["dependencies"]:
        name = Requirement(line).name.lower().replace("_", "-")
        found = {"ruamel.yaml"} if name == "ruamel.yaml" else modules.get(name, {name})
        assert found & imported or name in CALLED_BY_OTHERS, f"{name} is installed, but nothing imports it"
        assert Requirement(line).specifier and "<" in line, f"{line} has no upper bound"
