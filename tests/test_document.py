"""The YAML reader against hostile and odd texts."""

from __future__ import annotations

import math
import re

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ruamel.yaml import YAML

from mrbatch.document import MAX_DEPTH, read_document, shorten
from mrbatch.errors import JobErrors


def errors_of(text: str):
    with pytest.raises(JobErrors) as caught:
        read_document(text, "job.yaml")
    return caught.value.errors


def test_scalars_follow_the_core_schema():
    text = "{a: 1, b: 1.5, c: 1e3, d: .5, e: true, f: ~, g: on, h: no, i: 0x1f, j: 0o17, k: 010, "
    text += "l: '1', m: 1_000}"
    data = read_document(text, "x").data
    assert data == {
        "a": 1, "b": 1.5, "c": 1000.0, "d": 0.5, "e": True, "f": None, "g": "on", "h": "no",
        "i": 31, "j": 15, "k": 10, "l": "1", "m": "1_000",
    }  # fmt: skip
    assert read_document("-.inf", "x").data == -math.inf
    assert math.isnan(read_document("[.nan]", "x").data[0])
    assert read_document("2001-12-14", "x").data == "2001-12-14"
    assert read_document("9" * 5000, "x").data == "9" * 5000


def test_duplicate_key_names_both_places():
    first, second = errors_of("a: 1\nb:\n  c: 1\n  d: 2\n  c: 3\na: 4\n")
    assert (first.place.line, first.place.column) == (5, 3)
    assert "first in line 3, column 3" in first.message
    assert (second.place.line, second.place.column) == (6, 1)
    assert "first in line 1, column 1" in second.message


@pytest.mark.parametrize("tag", ["!!python/object/apply:os.system", "!!int", "!mine", "!!set", "!"])
def test_tags_are_refused(tag):
    error = errors_of(f"ok: 1\nbad: {tag} '3'\n")[0]
    assert "not allowed" in error.message and (error.place.line, error.place.column) == (2, 6)


def test_aliases_are_unfolded_and_refused_when_circular():
    data = read_document("a: &x {t: [1, 2]}\nb: *x\nc: [*x, *x]\n", "x").data
    assert data["b"] == data["a"] and data["c"] == [data["a"]] * 2
    assert "inside its own anchor" in errors_of("a: &x [1, *x]")[0].message
    assert "composer" not in (text := errors_of("a: *nowhere")[0].message) and "nowhere" in text


def test_alias_bomb_is_refused():
    # 9^12 values: a reader that unfolds them never gets here.
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 12)]
    (error,) = errors_of("\n".join(lines))
    assert "aliases unfolded" in error.message


@pytest.mark.parametrize("opening", ["[", "{a: ", "- "])
def test_deep_nesting_is_refused(opening):
    (error,) = errors_of(opening * 20_000)
    assert f"deeper than {MAX_DEPTH}" in error.message or "not valid YAML" in error.message


def test_depth_through_aliases_is_refused():
    lines = ["a0: &a0 [1]"] + [f"a{i}: &a{i} [*a{i - 1}]" for i in range(1, 60)]
    assert "deeper" in errors_of("\n".join(lines))[0].message


@pytest.mark.parametrize(
    ("text", "line", "column"),
    [
        ("a: [1,\nb: 2", 2, None),
        ("a: 1\n\tb: 2", 2, 1),
        ("a: b: c", 1, 5),
        ("x: 1\na: 'x", 2, None),
        ("a: 1\nb: \x07", 2, 4),
        ("a: 1\n--- \nb: 1", 2, 1),
        ("? [1, 2]\n: 3", 1, 3),
        ("<<: {a: 1}", 1, 1),
    ],
)
def test_syntax_errors_have_a_place(text, line, column):
    place = errors_of(text)[0].place
    assert place.line == line and (column is None or place.column == column)


def test_places_of_values_and_keys():
    document = read_document("a:\n  - x: 1\n    y: {z: two}\n", "job.yaml")
    assert str(document.values["a", 0, "y", "z"]) == "job.yaml:3:12"
    assert str(document.keys["a", 0, "y", "z"]) == "job.yaml:3:9"
    assert document.place(("a", 0, "missing")) == document.values["a", 0]


def test_shorten_keeps_terminals_safe():
    assert shorten("a\x1b[31m\n") == "a\\x1b[31m\\x0a"
    assert len(shorten("x" * 1000)) == 60


@settings(max_examples=200, deadline=None)
@given(st.text(alphabet="ab:- \n[]{}&*!'\"#|>%~,?1.\t\\", max_size=60))
def test_any_text_gives_data_or_errors(text):
    try:
        read_document(text, "x")
    except JobErrors as error:
        assert error.errors


plain = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(10**9), 10**9)
    | st.text(alphabet="abc on:yes-#1.{", max_size=8),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.text("abcd", min_size=1), inner, max_size=3)
    ),
    max_leaves=12,
)


@settings(max_examples=100, deadline=None)
@given(plain)
def test_reads_what_another_writer_wrote(data):
    import io

    out = io.StringIO()
    YAML(typ="safe", pure=True).dump(data, out)
    # This writer leaves the quotes off a text such as `: 1` in brackets, which then is no YAML at all.
    if re.search(r"[\[{,:] *:", out.getvalue()):
        return
    assert read_document(out.getvalue(), "x").data == data


@pytest.mark.parametrize(
    "text", ["%YAML 1.3\n---\na: 1\n", "%YAML 1.9999999999\n---\na\n", "%YAML 3.0\n--- a\n"]
)
def test_versions_that_the_library_asserts_are_errors_like_others(text):
    assert "not valid YAML" in errors_of(text)[0].message
