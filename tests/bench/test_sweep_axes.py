"""Which settings a sweep varies: those of the method, common ones, and what is asked for."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
from small_job import write_job

from mrbatch.bench.axes import axes_of, choose
from mrbatch.contracts import Axis
from mrbatch.errors import JobErrors
from mrbatch.job import load_job
from mrbatch.methods.registry import method, method_names, register
from mrbatch.scene.path_settings import PathSettings


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return write_job(tmp_path_factory.mktemp("job"), (0, 1), dtype=np.float32, spp=16)


def test_every_axis_of_a_method_is_a_setting_of_it(path):
    """An axis that names no setting would be left out without a word."""
    for name in method_names():
        job = load_job(path, [f"method={{name: {name}, spp: 16}}"])
        swept = {c.axis.setting for c in choose(job, (), 1)}
        assert {axis.setting for axis in method(name).axes} <= swept
        names = [axis.name for axis in axes_of(job)]
        assert len(set(names)) == len(names)
        for chosen in choose(job, (), 1):
            for one in chosen.choices:
                load_job(path, [f"method={{name: {name}, spp: 16}}", *one.settings])


def test_the_common_axes_come_by_themselves(path):
    found = {c.axis.name: c for c in choose(load_job(path), (), 1)}
    assert {"spp", "resolution", "filter", "threads", "ray engine", "estimator"} <= set(found)
    assert {"sampler", "strategy", "light sampler"} <= set(found)
    assert (found["estimator"].own, [c.label for c in found["estimator"].choices]) == (
        "delta-path-tracing",
        ["one-pass", "two-pass"],
    )
    # 4 and 64 are neighbours of 16; 256 is asked for by name only.
    assert [c.label for c in found["spp"].choices] == ["4", "64"]
    assert set(found["spp"].left_out) == {"256", "1024"}
    assert all(c.threads > 1 and not c.settings for c in found["threads"].choices)
    assert found["ray engine"].own in ("embree", "warp") and len(found["ray engine"].choices) == 1


def test_axes_are_asked_for_by_name_or_setting(path):
    job = load_job(path)
    spp, depth, size = choose(
        job, ("method.spp=4,256", "depth", "virtual.crate.material.reflectance=[0.1,0.1,0.1],0.5"), 1
    )
    assert [c.settings for c in spp.choices] == [("method.spp=4",), ("method.spp=256",)]
    assert depth.own == "none" and [c.label for c in depth.choices] == ["2", "3", "4", "8"]
    assert len(size.choices) == 2 and size.axis.name == "virtual.crate.material.reflectance"
    for chosen in (spp, depth, size):
        for one in chosen.choices:
            load_job(path, one.settings)
    assert len(choose(job, ("method.max_depth=null,2",), 1)[0].choices) == 1, "the job's own is no neighbour"


def test_what_is_no_axis_is_told_all_at_once(path):
    with pytest.raises(JobErrors) as told:
        choose(load_job(path), ("sppp", "method.spp="), 1)
    text = " ".join(f"{e.message} {e.hint}" for e in told.value.errors)
    assert len(told.value.errors) == 2 and "`sppp`" in text and "estimator" in text
    with pytest.raises(JobErrors, match="twice"):
        choose(load_job(path), ("spp", "method.spp=4"), 1)


class ToySettings(PathSettings):
    name: Literal["toy"] = "toy"
    sparkle: int = 1


def test_a_method_adds_an_axis_by_naming_it(path):
    toy = replace(
        method("delta-path-tracing"),
        name="toy",
        settings=ToySettings,
        axes=(Axis("sparkle", "method.sparkle", (1, 2, 4), "time ~ sparkle", "sparkles"),),
    )
    with register(toy):
        job = load_job(path, ["method={name: toy, spp: 16}"])
        found = {c.axis.name: c for c in choose(job, (), 1)}
        assert [c.settings for c in found["sparkle"].choices] == [
            ("method.sparkle=2",),
            ("method.sparkle=4",),
        ]
        assert found["sparkle"].axis.law == "time ~ sparkle" and "estimator" not in found
        assert "spp" in found
        # Its own axes come first, and nothing else had to be told of it.
        assert next(iter(found)) == "sparkle"
