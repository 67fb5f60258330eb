"""`mrbatch doctor` on this machine, and on machines where something is broken."""

from __future__ import annotations

import json
import stat
import sys

import numpy as np
import pytest
from click.testing import CliRunner

from mrbatch.batch import doctor
from mrbatch.cli import main
from mrbatch.cli.doctor import command
from mrbatch.device import embree, self_test
from mrbatch.errors import ResourceError


@pytest.fixture
def told_all(monkeypatch):
    """The findings of this machine, without the seconds of a fresh compiler run."""
    monkeypatch.setattr(self_test, "compile_and_run", lambda: 1.5)
    return {finding.name: finding for finding in doctor.examine()}


def only(monkeypatch, *checks):
    monkeypatch.setattr(doctor, "checks", lambda **_: list(checks))


def test_this_machine_can_run_jobs(told_all):
    bad = {name: finding for name, finding in told_all.items() if finding.verdict == "failed"}
    assert not bad
    assert doctor.exit_code(list(told_all.values())) == 0
    assert told_all["ray engine Embree"].values["isa"] == "avx2"
    assert told_all["engines agree"].values["relative_difference"] <= 64 * np.finfo(np.float32).eps


def test_every_check_says_what_to_do_if_it_fails():
    for check in doctor.checks(thorough=True, folder=None):
        # Cores cannot fail, memory only ever warns, with a hint of its own.
        assert check.hint or check.name in {"cores", "memory"}


def test_a_kernel_is_compiled_each_time_and_leaves_no_trace(monkeypatch):
    import warp as wp

    self_test.start()
    folder = self_test.cache_folder()
    before = {path.name for path in folder.iterdir()}
    assert self_test.compile_and_run() > 0
    assert str(wp.config.kernel_cache_dir) == str(folder)
    assert not [path for path in folder.iterdir() if path.name not in before and "squares" in path.name]


def test_a_failed_check_ends_with_five_and_names_the_cure(monkeypatch):
    def broken():
        raise OSError("no such library")

    only(monkeypatch, doctor.Check("thing", broken, "mend it"))
    result = CliRunner().invoke(command, [], standalone_mode=False)
    assert result.return_value == 5
    assert "failed" in result.output
    assert "OSError: no such library" in result.output
    assert "do: mend it" in result.output
    assert "jobs cannot run here" in result.output


def test_a_check_that_jobs_can_do_without_only_warns(monkeypatch):
    def broken():
        raise ResourceError("Embree is gone", hint="use the other engine")

    only(monkeypatch, doctor.Check("rays", broken, "", needed=False))
    result = CliRunner().invoke(command, ["--json"], standalone_mode=False)
    assert result.return_value == 0
    told = json.loads(result.output)
    assert told["can_run"] is True
    assert told["findings"][0]["verdict"] == "warning"
    assert told["findings"][0]["hint"] == "use the other engine"


def test_without_embree_the_other_checks_still_run(monkeypatch):
    def none():
        raise ResourceError("no AVX2 here", hint="render with --set engine=warp")

    monkeypatch.setattr(embree, "library", none)
    monkeypatch.setattr(self_test, "compile_and_run", lambda: 1.5)
    told = {finding.name: finding for finding in doctor.examine()}
    assert told["ray engine Embree"].verdict == "warning"
    assert told["ray engine Warp"].verdict == "ok"
    assert doctor.exit_code(list(told.values())) == 0


def test_engines_that_differ_are_found(monkeypatch):
    cast = self_test._cast

    def bent(engine, mesh, o, d):
        casts = cast(engine, mesh, o, d)
        return casts if engine == "embree" else self_test.Casts(casts.distance * 1.0001, casts.triangle)

    monkeypatch.setattr(self_test, "_cast", bent)
    with pytest.raises(ResourceError, match="differ"):
        self_test.engines_agree()


def test_a_library_that_is_missing_or_too_old_is_named(monkeypatch):
    monkeypatch.setattr(
        doctor.importlib.metadata, "requires", lambda _: ["no-such-library-at-all>=1", "numpy>=2"]
    )
    check = doctor.Check("libraries", doctor._libraries, "install")
    assert doctor.run_check(check).verdict == "failed"
    assert "no-such-library-at-all is missing" in doctor.run_check(check).detail

    monkeypatch.setattr(doctor.importlib.metadata, "requires", lambda _: ["numpy>=999"])
    assert doctor.run_check(check).verdict == "warning"
    assert "numpy" in doctor.run_check(check).detail

    monkeypatch.setattr(doctor.importlib.metadata, "requires", lambda _: ["numpy>=999; extra == 'test'"])
    assert doctor.run_check(check).verdict == "ok"


@pytest.mark.skipif(sys.platform == "win32", reason="folders have no write permission there")
def test_a_folder_that_cannot_be_written_is_found(tmp_path):
    import os

    shut = tmp_path / "shut"
    shut.mkdir()
    shut.chmod(stat.S_IREAD | stat.S_IEXEC)
    if os.access(shut, os.W_OK):
        pytest.skip("this user may write everywhere")
    findings = [f for f in doctor.examine(folder=shut) if f.name == "disk"]
    assert findings[0].verdict == "failed"


def test_too_little_disk_or_memory_warns(monkeypatch, tmp_path):
    monkeypatch.setattr(doctor, "LEAST_DISK", 2**80)
    monkeypatch.setattr(doctor, "LEAST_MEMORY", 2**80)
    listed = {check.name: check for check in doctor.checks(thorough=False, folder=tmp_path / "new" / "out")}
    for name in ("disk", "memory"):
        finding = doctor.run_check(listed[name])
        assert finding.verdict == "warning"
        assert finding.hint


def test_the_command_is_in_the_group(monkeypatch):
    only(monkeypatch)
    result = CliRunner().invoke(main, ["doctor"])
    assert result.exit_code == 0
    assert result.output.strip() == "jobs can run here"
