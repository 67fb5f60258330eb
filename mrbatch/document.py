"""YAML text to plain data that remembers where each key and value stood.

The text is hostile until proved otherwise: size, depth, and the number of nodes that aliases unfold
to are limited; tags, directives and further documents are refused; a key given twice is an error.
Scalars are read by YAML 1.2's core schema, so `on`, `off`, `yes` and `no` are plain words.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError, YAMLError
from ruamel.yaml.events import (
    AliasEvent,
    DocumentStartEvent,
    MappingEndEvent,
    MappingStartEvent,
    NodeEvent,
    ScalarEvent,
    SequenceEndEvent,
    SequenceStartEvent,
)
from ruamel.yaml.reader import ReaderError

from mrbatch.errors import JobError, JobErrors, MrbatchError, Place

MAX_BYTES = 1 << 20
MAX_DEPTH = 32
MAX_NODES = 100_000
"""Nodes of a document, each alias counted with all that it stands for."""
MAX_SHOWN = 200
"""Longest source line that is quoted under a message."""

Loc = tuple[str | int, ...]

_INTEGER = re.compile(r"[-+]?[0-9]+\Z")
_BASED = re.compile(r"0o[0-7]+\Z|0x[0-9a-fA-F]+\Z")
_FLOAT = re.compile(r"[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?\Z")
_WORDS: dict[str, Any] = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL"), None),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
    **dict.fromkeys((".nan", ".NaN", ".NAN"), float("nan")),
    **dict.fromkeys((".inf", ".Inf", ".INF", "+.inf", "+.Inf", "+.INF"), float("inf")),
    **dict.fromkeys(("-.inf", "-.Inf", "-.INF"), float("-inf")),
}


@dataclass
class Document:
    """Plain data (dict, list, str, int, float, bool, None) and the places of its parts.

    `keys` and `values` give the place of a key and of a value by its path, such as
    `("virtual", 0, "material")`.
    """

    data: Any
    keys: dict[Loc, Place] = field(default_factory=dict)
    values: dict[Loc, Place] = field(default_factory=dict)

    def place(self, loc: Loc, *, key: bool = False) -> Place | None:
        """Of the key or the value at `loc`, or of the nearest node that holds it."""
        if key and loc in self.keys:
            return self.keys[loc]
        while loc not in self.values:
            if not loc:
                return None
            loc = loc[:-1]
            if loc in self.keys:
                return self.keys[loc]
        return self.values[loc]


def scalar(text: str) -> Any:
    """A plain scalar by YAML 1.2's core schema."""
    if text in _WORDS:
        return _WORDS[text]
    if len(text) > 40:  # no number that anyone means; int() of thousands of digits is slow
        return text
    if _INTEGER.match(text):
        return int(text)
    if _BASED.match(text):
        return int(text, 0)
    if _FLOAT.match(text):
        return float(text)
    return text


def read_document(text: str, file: str) -> Document:
    """Parses `text`; `file` names it in messages. Raises JobErrors."""
    return _Reader(text, file).read()


class _Reader:
    def __init__(self, text: str, file: str):
        self.text = text
        self.file = file
        self.lines = text.splitlines()
        self.document = Document(None)
        self.errors: list[MrbatchError] = []
        self.anchors: dict[str, list[Any]] = {}
        self.open_anchors: set[str] = set()
        self.nodes = 0

    def place(self, mark: Any) -> Place:
        return self.place_at(mark.line, mark.column)

    def place_at(self, line: int, column: int) -> Place:
        source = self.lines[line] if line < len(self.lines) else ""
        source = source.replace("\t", " ")
        shown = source[:MAX_SHOWN] if column < MAX_SHOWN else None
        return Place(file=self.file, line=line + 1, column=column + 1, source=shown)

    def fail(self, message: str, mark: Any, hint: str | None = None) -> JobErrors:
        return JobErrors([*self.errors, JobError(message, place=self.place(mark), hint=hint)])

    def read(self) -> Document:
        if len(self.text.encode("utf-8", "surrogatepass")) > MAX_BYTES:
            raise JobErrors(
                [JobError(f"the file is larger than {MAX_BYTES >> 10} KiB", place=Place(file=self.file))]
            )
        try:
            self._read()
        except ReaderError as error:
            before = self.text[: error.position]
            line = before.count("\n")
            column = len(before) - (before.rfind("\n") + 1)
            place = self.place_at(line, column)
            place = Place(file=place.file, line=place.line, column=place.column)
            code = ord(error.character) if isinstance(error.character, str) else int(error.character)
            message = f"the character U+{code:04X} is not allowed in YAML"
            raise JobErrors([JobError(message, place=place)]) from None
        except MarkedYAMLError as error:
            mark = error.problem_mark or error.context_mark
            message = f"this is not valid YAML: {error.problem or error.context}"
            raise self.fail(message, mark, _syntax_hint(str(error.problem))) from None
        except YAMLError as error:
            raise JobErrors([JobError(f"this is not valid YAML: {error}", place=Place(self.file))]) from None
        if self.errors:
            raise JobErrors(self.errors)
        return self.document

    def _read(self) -> None:
        self.document.values[()] = self.place_at(0, 0)
        documents = 0
        events = self._events()
        for event in events:
            if isinstance(event, DocumentStartEvent):
                documents += 1
                if documents > 1:
                    raise self.fail("a second document starts here", event.start_mark, "a file holds one")
            elif isinstance(event, NodeEvent):
                self.document.data = self._node(event, events, ())

    def _events(self) -> Iterator[Any]:
        """Events with limits and refusals applied before anything is built from them."""
        yaml = YAML(typ="rt", pure=True)
        depth = 0
        parsed = yaml.parse(self.text)
        while True:
            try:
                event = next(parsed)
            except StopIteration:
                return
            except YAMLError:
                raise
            except Exception as error:  # the library asserts, too, what a text may get wrong
                raise JobErrors(
                    [JobError(f"this is not valid YAML: {shorten(error, 200)}", place=Place(self.file))]
                ) from None
            if isinstance(event, (MappingStartEvent, SequenceStartEvent)):
                depth += 1
                if depth > MAX_DEPTH:
                    raise self.fail(f"nested deeper than {MAX_DEPTH} levels", event.start_mark)
            elif isinstance(event, (MappingEndEvent, SequenceEndEvent)):
                depth -= 1
            if not isinstance(event, AliasEvent) and getattr(event, "tag", None) is not None:
                self.errors.append(
                    JobError(
                        f"tags such as `{_tag_name(event.tag)}` are not allowed",
                        place=self.place(event.start_mark),
                        hint="leave it out: only plain data are read",
                    )
                )
            yield event

    def _node(self, event: Any, events: Iterator[Any], loc: Loc) -> Any:
        if len(loc) > MAX_DEPTH:
            raise self.fail(f"nested deeper than {MAX_DEPTH} levels", event.start_mark)
        self.nodes += 1
        if self.nodes > MAX_NODES:
            raise self.fail(f"more than {MAX_NODES} values, aliases unfolded", event.start_mark)
        if isinstance(event, AliasEvent):
            if event.anchor in self.open_anchors:
                raise self.fail(f"the alias `*{event.anchor}` stands inside its own anchor", event.start_mark)
            if event.anchor not in self.anchors:
                raise self.fail(f"there is no anchor `&{event.anchor}` above", event.start_mark)
            replay = iter(self.anchors[event.anchor])
            return self._node(next(replay), replay, loc)
        if event.anchor:
            recorded: list[Any] = [event]
            self.open_anchors.add(event.anchor)
            value = self._content(event, _recording(events, recorded), loc)
            self.open_anchors.discard(event.anchor)
            # Its own anchor is dropped from the copy: unfolding an alias defines nothing new.
            self.anchors[event.anchor] = recorded
            return value
        return self._content(event, events, loc)

    def _content(self, event: Any, events: Iterator[Any], loc: Loc) -> Any:
        self.document.values[loc] = self.place(event.start_mark)
        if isinstance(event, ScalarEvent):
            return scalar(event.value) if event.implicit[0] else event.value
        if isinstance(event, SequenceStartEvent):
            items: list[Any] = []
            for item in events:
                if isinstance(item, SequenceEndEvent):
                    break
                items.append(self._node(item, events, (*loc, len(items))))
            return items
        return self._mapping(events, loc)

    def _mapping(self, events: Iterator[Any], loc: Loc) -> dict[str, Any]:
        result: dict[str, Any] = {}
        for event in events:
            if isinstance(event, MappingEndEvent):
                break
            if not isinstance(event, ScalarEvent):
                raise self.fail("a key must be a plain word", event.start_mark)
            key = event.value
            child = (*loc, key)
            if key in result:
                first = self.document.keys[child]
                self.errors.append(
                    JobError(
                        f"the key `{shorten(key)}` is given twice, first in line {first.line}, "
                        f"column {first.column}",
                        place=self.place(event.start_mark),
                        hint="keep one of the two",
                    )
                )
                self._node(next(events), events, (*loc, f"\0{key}"))
                continue
            if key == "<<":
                self.errors.append(
                    JobError("merge keys (`<<`) are not supported", place=self.place(event.start_mark))
                )
            self.document.keys[child] = self.place(event.start_mark)
            result[key] = self._node(next(events), events, child)
        return result


def _recording(events: Iterator[Any], record: list[Any]) -> Iterator[Any]:
    for event in events:
        record.append(event)
        yield event


def _tag_name(tag: Any) -> str:
    return shorten(str(tag).replace("tag:yaml.org,2002:", "!!"))


def _syntax_hint(problem: str) -> str | None:
    if "'\\t'" in problem:
        return "indent with spaces, not tabs"
    if "mapping values are not allowed" in problem:
        return "check the indentation, and put text that holds `: ` into quotes"
    return None


def shorten(value: Any, limit: int = 60) -> str:
    """A value as it is quoted in messages: one short line without control characters."""
    if value is None:
        text = "null"
    elif isinstance(value, bool):
        text = str(value).lower()
    elif isinstance(value, dict):
        text = "a mapping"
    elif isinstance(value, (list, tuple)):
        text = f"a list of {len(value)}"
    else:
        text = "".join(c if c.isprintable() else f"\\x{ord(c):02x}" for c in str(value)[: limit + 1])
    return text if len(text) <= limit else text[: limit - 1] + "…"
