"""The runner of hard cases: what fails a case, what is tried again, what the pages say."""

from __future__ import annotations

import json
from xml.etree import ElementTree

import numpy as np
import pytest
from click.testing import CliRunner

from mrbatch.cli import main
from mrbatch.contracts import Case, Measurement
from mrbatch.errors import JobError
from mrbatch.methods.probe import judge
from mrbatch.stability.registry import FAMILIES, entries
from mrbatch.stability.run import RETRY, check_stability


def measured(passed=True, **more):
    return Measurement(passed, "1", "1", "0", **more)


def toy(run, **more):
    more.setdefault("setup", "nothing at all")
    return Case("TOY-01", "a toy", run, **more)


def outcome(case, **options):
    """The one case's result, run through the registry as a method's or family's author adds it."""
    with FAMILIES.registered("toy", (case,)):
        report = check_stability(["TOY-*"], **options)
    (one,) = report.cases
    assert report.exit == (0 if one.passed else 1)
    return one


def test_a_case_is_added_by_one_entry():
    before = {entry.label for entry in entries()}
    with FAMILIES.registered("toy", (toy(lambda seed: measured(seed == 7)),)):
        assert {entry.label for entry in entries()} - before == {"TOY-01"}
        assert check_stability(["TOY-01"], seed=7).cases[0].outcome == "passed"
        assert check_stability(["TOY-01"], seed=8).exit == 1
    assert {entry.label for entry in entries()} == before


def test_what_is_no_number_or_negative_light_fails_whatever_else_is_measured():
    good, bad = np.ones((2, 3)), np.array([1.0, np.nan, np.inf, -np.inf])
    assert outcome(toy(lambda s: measured(radiance=(good,), signed=(-good,)))).outcome == "passed"
    for given in ({"radiance": (good, bad)}, {"signed": (bad,)}, {"radiance": (np.array([-1e-30]),)}):
        one = outcome(toy(lambda s, given=given: measured(**given), statistical=True))
        assert one.outcome == "failed" and len(one.attempts) == 1, "no second chance for such values"
    assert "3 of 4 signed values" in outcome(toy(lambda s: measured(signed=(bad,)))).reason
    # Minus zero is no negative light.
    assert outcome(toy(lambda s: measured(radiance=(np.array([-0.0]),)))).outcome == "passed"


def test_a_crash_is_a_failure_of_its_case_alone():
    def crash(seed):
        raise ZeroDivisionError("by\nzero")

    other = Case("TOY-02", "another", lambda seed: measured())
    with FAMILIES.registered("toy", (toy(crash, statistical=True), other)):
        first, second = check_stability(["TOY-*"]).cases
    assert (first.outcome, second.outcome) == ("failed", "passed")
    assert first.reason == "raised ZeroDivisionError: by zero" and len(first.attempts) == 1


def test_chance_gets_a_second_seed_and_both_are_told():
    one = outcome(toy(lambda seed: measured(seed >= RETRY), statistical=True), seed=5)
    assert one.outcome == "passed"
    assert [(a.seed, a.outcome) for a in one.attempts] == [(5, "failed"), (5 + RETRY, "passed")]
    one = outcome(toy(lambda seed: measured(False), statistical=True))
    assert one.outcome == "failed" and len(one.attempts) == 2 and "two seeds" in one.reason
    one = outcome(toy(lambda seed: measured(seed >= RETRY)))
    assert one.outcome == "failed" and len(one.attempts) == 1, "what has no chance in it is not tried again"


def test_a_measurement_without_power_is_inconclusive_and_fails():
    one = outcome(toy(lambda s: measured(conclusive=False)))
    assert (one.outcome, one.passed) == ("inconclusive", False)
    assert outcome(toy(lambda s: measured(False, conclusive=False))).outcome == "failed"


def test_cases_are_judged_by_their_numbers_and_their_power():
    """A wrong mean fails; a right one with an interval wider than 1 % of the oracle cannot tell."""
    assert judge(0.5, 1e-4, 0.5003, 0.0).passed and judge(0.5, 1e-4, 0.5003, 0.0).conclusive
    assert not judge(0.5, 1e-4, 0.5005, 0.0).passed
    assert judge(0.5, 1e-4, 0.5005, 1e-4).passed
    wide = judge(0.5, 0.01, 0.5, 0.0)
    assert wide.passed and not wide.conclusive
    assert judge(0.5, 0.01, 0.5, 0.0, sees=0.03).conclusive
    # Student's quantile for 64 observations at 99 % is 2.656.
    assert not judge(0.5, 0.01, 0.5, 0.0, sees=0.0265).conclusive
    for broken in (np.nan, np.inf):
        assert not judge(np.array([0.5, broken]), 0.01, 0.5, 1.0).passed
        assert not judge(0.5, broken, 0.5, 1.0).passed
    # The worst of several is told.
    assert "+0.7 " in judge(np.array([0.5, 0.7, 0.5]), 1e-3, 0.5, 0.0).measured


def test_long_cases_are_left_to_the_full_set():
    case = toy(lambda seed: measured(), quick=False)
    one = outcome(case)
    assert one.outcome == "skipped" and "--set full" in one.reason
    assert outcome(case, cases="full").outcome == "passed"


def test_patterns_are_for_rows_methods_and_further_rows():
    case = toy(lambda seed: measured(), rows=("TRAP-99",))
    with FAMILIES.registered("toy", (case,)):
        assert [c.name for c in check_stability(["TRAP-99"]).cases] == ["TOY-01"]
        with pytest.raises(JobError, match="no case matches `NOPE-"):
            check_stability(["NOPE-*"])


def run(*arguments):
    return CliRunner().invoke(main, ["stability", *map(str, arguments)])


def test_command_and_its_files(tmp_path):
    cases = (
        toy(lambda seed: measured()),
        Case("TOY-02", "fails <b>", lambda s: measured(False), statistical=True),
        Case("TOY-03", "long", lambda s: measured(), quick=False),
    )
    files = [tmp_path / name for name in ("a.json", "a.xml", "a.html", "a.md")]
    options = [x for pair in zip(("--json", "--junit", "--html", "--markdown"), files) for x in pair]
    with FAMILIES.registered("toy", cases):
        found = run("--case", "TOY-*", "--seed", 4, *options)
        assert found.exit_code == 1, found.output
        assert run("--case", "TOY-01").exit_code == 0
    assert "1 passed, 1 failed, 1 skipped" in found.output
    data = json.loads(files[0].read_text("utf-8"))
    assert data["kind"] == "stability" and data["exit"] == 1
    assert [c["outcome"] for c in data["cases"]] == ["passed", "failed", "skipped"]
    assert [a["seed"] for a in data["cases"][1]["attempts"]] == [4, 4 + RETRY]
    suite = ElementTree.parse(files[1]).getroot()[0]
    assert [suite.get(k) for k in ("name", "tests", "failures", "skipped")] == ["cases", "3", "1", "1"]
    assert [len(case.findall("failure")) for case in suite] == [0, 1, 0]
    page = files[2].read_text("utf-8")
    assert "fails &lt;b&gt;" in page and "1 case did not pass" in page and "nothing at all" in page
    assert "TOY\\-02" in files[3].read_text("utf-8") or "TOY-02" in files[3].read_text("utf-8")


def test_a_wrong_pattern_is_wrong_usage():
    found = run("--case", "NOPE-*")
    assert found.exit_code == 2 and "no case matches" in found.output
