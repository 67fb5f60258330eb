"""The catalogue of hard cases: rows of docs/hard_cases.md against the marks `case` of the tests.

python tests/hard_cases.py        writes the tests of each row into the page's last column, and the rows for
                                  `mrbatch stability`
"""

from __future__ import annotations

import ast
import functools
import json
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "hard_cases.md"
ROWS = ROOT / "mrbatch" / "stability" / "rows.json"
LEFT_OUT = "left out: "


@functools.cache
def marked(folder: Path = ROOT / "tests") -> dict[str, list[str]]:
    """`file: test` of every test that carries the mark `case`, by row."""
    found: dict[str, list[str]] = {}
    for path in sorted(folder.rglob("test_*.py")):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if not isinstance(node, ast.FunctionDef) or not node.name.startswith("test_"):
                continue
            for mark in node.decorator_list:
                if isinstance(mark, ast.Call) and ast.unparse(mark.func) == "pytest.mark.case":
                    for row in mark.args:
                        place = f"{path.relative_to(folder).as_posix()}: {node.name}"
                        found.setdefault(ast.literal_eval(row), []).append(place)
    return found


@functools.cache
def rows(page: Path = PAGE) -> dict[str, list[str]]:
    """Cells of each row of the page's tables, by the row's name, which is the first cell."""
    found: dict[str, list[str]] = {}
    for line in page.read_text(encoding="utf-8").splitlines():
        if re.match(r"\| [A-Z]+-\d", line):
            cells = [cell.strip() for cell in line.strip().strip("|").split("|")]
            if cells[0] in found:
                raise ValueError(f"the row {cells[0]} stands twice in {page.name}")
            found[cells[0]] = cells
    return found


def cell(tests: list[str]) -> str:
    """The last cell of a row that has tests: files, and their tests in brackets."""
    files: dict[str, list[str]] = {}
    for place in tests:
        file, _, test = place.partition(": ")
        files.setdefault(file, []).append(test.removeprefix("test_"))
    return "; ".join(f"`{file}` ({', '.join(names)})" for file, names in files.items())


def written(page: Path = PAGE) -> str:
    """The page with the tests that there are in the last cells; rows that are left out stay."""
    tests, lines = marked(), []
    for line in page.read_text(encoding="utf-8").splitlines():
        if re.match(r"\| [A-Z]+-\d", line):
            cells = [c.strip() for c in line.strip().strip("|").split("|")]
            if not cells[-1].startswith(LEFT_OUT):
                cells[-1] = cell(tests.get(cells[0], []))
            line = "| " + " | ".join(cells) + " |"
        lines.append(line)
    return "\n".join(lines) + "\n"


def exported(page: Path = PAGE) -> str:
    """The rows of the page as the product reads them, with the tests that there are."""
    tests, found = marked(), []
    for name, cells in rows(page).items():
        # A trap has no column of how near: what ours gives stands in the one before.
        case, answer, *near, last = cells[1:]
        out = last.removeprefix(LEFT_OUT) if last.startswith(LEFT_OUT) else ""
        found.append(
            {
                "name": name,
                "case": case,
                "answer": answer,
                "near": near[0] if near else "",
                "tests": tests.get(name, []),
                "left_out": f"left out: {out}" if out else "",
            }
        )
    return json.dumps(found, indent=1, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    PAGE.write_text(written(), encoding="utf-8")
    ROWS.write_text(exported(), encoding="utf-8")
