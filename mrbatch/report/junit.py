"""The report as JUnit XML, for CI: a gate is a test case, and so are a frame and a hard case."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

from mrbatch.report.model import Report, write_text
from mrbatch.report.numbers import quantity

_FORBIDDEN = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def render_junit(report: Report) -> str:
    """The XML as text: suites `gates`, `cases` and `frames`; what did not pass is a failure."""
    root = ElementTree.Element("testsuites", name=_clean(report.job.name))
    classname = f"mrbatch.{report.kind}"
    if report.gates:
        suite = _suite(root, "gates", len(report.gates), sum(not gate.passed for gate in report.gates))
        for gate in report.gates:
            name = gate.name if gate.frame is None else f"{gate.name} (frame {gate.frame})"
            case = ElementTree.SubElement(
                suite, "testcase", classname=f"{classname}.gates", name=_clean(name)
            )
            figures = f"measured {quantity(gate.measured)}" if gate.measured else ""
            figures += f", limit {quantity(gate.limit)}" if gate.limit else ""
            if not gate.passed:
                failure = ElementTree.SubElement(case, "failure", message=_clean(gate.text), type="gate")
                failure.text = _clean(figures)
            elif figures:
                ElementTree.SubElement(case, "system-out").text = _clean(figures)
    if report.frames:
        failed = sum(f.state == "failed" for f in report.frames)
        skipped = sum(f.state == "skipped" for f in report.frames)
        suite = _suite(root, "frames", len(report.frames), failed, skipped)
        for frame in report.frames:
            case = ElementTree.SubElement(
                suite, "testcase", classname=f"{classname}.frames", name=f"frame {frame.number}"
            )
            if frame.seconds is not None:
                case.set("time", f"{frame.seconds.value:.6f}")
            if frame.state == "failed":
                message = _clean(frame.message or "the frame failed")
                failure = ElementTree.SubElement(case, "failure", message=message, type=f"exit {frame.exit}")
                failure.text = _clean(frame.hint)
            elif frame.state == "skipped":
                ElementTree.SubElement(case, "skipped", message=_clean(frame.message))
    if report.cases:
        _cases(root, report, f"{classname}.cases")
    for key in ("tests", "failures", "skipped"):
        root.set(key, str(sum(int(suite.get(key, "0")) for suite in root)))
    ElementTree.indent(root)
    return "<?xml version='1.0' encoding='utf-8'?>\n" + ElementTree.tostring(root, encoding="unicode") + "\n"


def _cases(root: ElementTree.Element, report: Report, classname: str) -> None:
    failed = sum(not case.passed for case in report.cases)
    skipped = sum(case.outcome == "skipped" for case in report.cases)
    suite = _suite(root, "cases", len(report.cases), failed, skipped)
    for one in report.cases:
        name = " ".join(filter(None, (one.name, one.owner, one.title)))
        case = ElementTree.SubElement(suite, "testcase", classname=classname, name=_clean(name))
        if one.seconds is not None:
            case.set("time", f"{one.seconds.value:.6f}")
        told = [f"measured {one.measured}", f"oracle {one.oracle}", f"tolerance {one.tolerance}"]
        if len(one.attempts) > 1:
            told += [f"seed {a.seed}: {a.outcome}, {a.measured}" for a in one.attempts]
        if not one.passed:
            message = one.reason or one.outcome
            failure = ElementTree.SubElement(case, "failure", message=_clean(message), type=one.outcome)
            failure.text = _clean("\n".join(told))
        elif one.outcome == "skipped":
            ElementTree.SubElement(case, "skipped", message=_clean(one.reason))
        else:
            ElementTree.SubElement(case, "system-out").text = _clean("\n".join(told))


def write_junit(report: Report, path: Path) -> None:
    """Write the XML in one step. Raises ResourceError where it cannot be written."""
    write_text(Path(path), render_junit(report))


def _suite(
    root: ElementTree.Element, name: str, tests: int, failures: int, skipped: int = 0
) -> ElementTree.Element:
    counts = {"tests": str(tests), "failures": str(failures), "errors": "0", "skipped": str(skipped)}
    return ElementTree.SubElement(root, "testsuite", {"name": name, **counts})


def _clean(text: str) -> str:
    """XML 1.0 has no way to write most control characters: they become the replacement character."""
    return _FORBIDDEN.sub("\ufffd", text)
