"""What the models found wrong, as one plain sentence each, with place, source line and nearest word."""

from __future__ import annotations

import difflib
import types
from collections.abc import Sequence
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError

from mrbatch.document import Document, shorten
from mrbatch.errors import JobError, Place
from mrbatch.job.choice import Choice, Loc

_EXPECTED = {
    "float_type": "a number",
    "float_parsing": "a number",
    "int_type": "a whole number",
    "int_parsing": "a whole number",
    "int_from_float": "a whole number",
    "int_parsing_size": "a smaller whole number",
    "bool_type": "`true` or `false`",
    "bool_parsing": "`true` or `false`",
    "string_type": "text",
    "path_type": "the path of a file",
    "is_instance_of": "the path of a file",
    "list_type": "a list",
    "tuple_type": "a list",
    "set_type": "a list",
    "dict_type": "a mapping",
    "mapping_type": "a mapping",
    "model_type": "a mapping",
    "model_attributes_type": "a mapping",
    "dataclass_type": "a mapping",
    "none_required": "nothing (null)",
}
_WORDS = ("literal_error", "enum")
MAX_LISTED = 8
"""Choices that a sentence lists; more of them go into the hint."""
NEAR = 0.65
"""Least likeness (of `difflib`, 0..1) at which a word is offered for another."""


def job_errors(error: ValidationError, document: Document, model: type[BaseModel]) -> list[JobError]:
    """All findings of one validation, in the order of the file."""
    items = [_Finding(dict(e), document.data) for e in error.errors(include_url=False)]
    result: list[tuple[tuple[int, int], JobError]] = []
    seen = set()
    for item in _settle_unions(_without_echoes(items, document, model)):
        converted = _convert(item, document, model)
        key = str(converted)
        if key not in seen:
            seen.add(key)
            place = converted.place or Place()
            result.append(((place.line or 0, place.column or 0), converted))
    return [converted for _, converted in sorted(result, key=lambda pair: pair[0])]


class _Finding:
    """One error of pydantic with its path cleared of the branches of unions.

    `loc`: path in the document; `union`: path of the union whose branch was tried, with the branch's
    name, or None.
    """

    def __init__(self, error: dict[str, Any], data: Any):
        self.type: str = error["type"]
        self.message: str = error["msg"]
        self.context: dict[str, Any] = error.get("ctx") or {}
        self.input = error.get("input")
        self.union: tuple[Loc, str] | None = None
        parts: list[str | int] = []
        at = data
        last = len(error["loc"]) - 1
        for i, part in enumerate(error["loc"]):
            if _holds(at, part):
                at = at[part]
            elif i == last and self.type == "missing":
                at = None
            else:
                if isinstance(part, str) and not part.startswith("<") and self.union is None:
                    self.union = (tuple(parts), part)
                continue
            parts.append(part)
        self.loc: Loc = tuple(parts)
        if self.type == "missing" and isinstance(error["loc"][last], int):
            self.type = "too_few"
            self.context = {"needed": error["loc"][last] + 1}
            self.loc = self.loc[:-1]
            self.input = _at(data, self.loc)


def _without_echoes(items: Sequence[_Finding], document: Document, model: type[BaseModel]) -> list[_Finding]:
    """Leaves out keys that are missing because they are misspelt: that is one mistake, not two."""
    meant = set()
    needed: dict[Loc, int] = {}
    for item in items:
        if item.type == "too_few":
            needed[item.loc] = max(needed.get(item.loc, 0), item.context["needed"])
        if item.type == "extra_forbidden" and item.loc:
            fields = known_fields(model, item.loc[:-1], document.data)
            for near in difflib.get_close_matches(str(item.loc[-1]), fields, n=1, cutoff=NEAR):
                meant.add((*item.loc[:-1], near))
    return [
        item
        for item in items
        if not (item.type == "missing" and item.loc in meant)
        and not (item.type == "too_few" and item.context["needed"] < needed[item.loc])
    ]


def _settle_unions(items: Sequence[_Finding]) -> list[_Finding]:
    """Of a union tried branch by branch, keeps the branch that was meant, or says what all wanted."""
    result: list[_Finding] = []
    unions: dict[Loc, dict[str, list[_Finding]]] = {}
    for item in items:
        if item.union is None:
            result.append(item)
        else:
            unions.setdefault(item.union[0], {}).setdefault(item.union[1], []).append(item)
    for loc, branches in unions.items():
        # A branch that refused the kind of value outright, or wanted another word, was not meant.
        near = {
            name: found
            for name, found in branches.items()
            if not any(f.loc == loc and (f.type in _EXPECTED or f.type in _WORDS) for f in found)
        }
        words = [c for found in branches.values() for f in found if f.type in _WORDS for c in _words(f)]
        if near or len(branches) == 1:
            near = near or branches
            meant = min(near.values(), key=len)
            for finding in meant:
                if finding.loc == loc and finding.type == "value_error" and words:
                    finding.context = {"error": f"{_plain(finding)}; or {_one_of(words)}"}
            result.extend(meant)
            continue
        wanted = [_EXPECTED[f.type] for found in branches.values() for f in found[:1] if f.type in _EXPECTED]
        first = next(iter(branches.values()))[0]
        first.type, first.loc = "union", loc
        first.context = {"wanted": " or ".join(dict.fromkeys([*wanted, *(f"`{word}`" for word in words)]))}
        result.append(first)
    return result


def _words(finding: _Finding) -> list[str]:
    return _choices(finding.context.get("expected", ""))


def _choices(expected: str) -> list[str]:
    """`'a', 'b' or 'c'` to its words."""
    return [word.strip("'\" ") for word in expected.replace(" or ", ", ").split(", ") if word]


def _convert(finding: _Finding, document: Document, model: type[BaseModel]) -> JobError:
    loc, context = finding.loc, finding.context
    kind = finding.type
    where = dotted(loc)
    value = finding.input
    point_at_key = False
    hint: str | None = None

    if kind == "missing":
        fields = known_fields(model, loc[:-1], document.data)
        meaning = fields.get(str(loc[-1]))
        owner = f" in `{dotted(loc[:-1])}`" if len(loc) > 1 else ""
        hint = f"`{loc[-1]}`: {meaning[0].lower()}{meaning[1:]}" if meaning else None
        return JobError(f"`{loc[-1]}` is missing{owner}", place=document.place(loc[:-1], key=True), hint=hint)
    if kind == "extra_forbidden":
        fields = known_fields(model, loc[:-1], document.data)
        owner = f" in `{dotted(loc[:-1])}`" if len(loc) > 1 else ""
        hint = nearest(str(loc[-1]), list(fields), "keys here")
        return JobError(
            f"unknown key `{shorten(loc[-1])}`{owner}", place=document.place(loc, key=True), hint=hint
        )
    if kind in ("union_tag_invalid", "union_tag_not_found"):
        key = str(context.get("discriminator", "")).strip("'")
        choices = _choices(context.get("expected_tags", "")) or union_tags(model, loc, document.data, key)
        if kind == "union_tag_not_found":
            if not isinstance(value, dict):
                text = f"`{where}`: expected a mapping with the key `{key}`, got {_got(value)}"
            else:
                text = f"`{key}` is missing in `{where}`"
            return JobError(
                text, place=document.place(loc, key=True), hint=nearest("", choices, f"values of `{key}`")
            )
        tag = str(context.get("tag"))
        return JobError(
            f"`{where}.{key}`: unknown value `{shorten(tag)}`",
            place=document.place((*loc, key)),
            hint=nearest(tag, choices, "known"),
        )
    if kind in _WORDS:
        choices = _choices(context.get("expected", ""))
        text = f"expected {_one_of(choices)}, got {_got(value)}"
        if len(choices) > MAX_LISTED:
            text = f"unknown value {_got(value)}"
        near = difflib.get_close_matches(str(value), choices, n=1, cutoff=NEAR)
        hint = f"did you mean `{near[0]}`?" if near else None
        if len(choices) > MAX_LISTED and not near:
            hint = f"known: {', '.join(choices)}"
    elif kind == "problem":
        text = str(context.get("message", finding.message))
        hint = context.get("hint")
        point_at_key = bool(context.get("key"))
        if context.get("choices") is not None and not hint and context.get("choices") != ():
            hint = nearest(str(loc[-1] if point_at_key else value), list(context["choices"]), "known")
    else:
        text = _plain(finding)
    message = f"`{where}`: {text}" if where else text
    return JobError(message, place=document.place(loc, key=point_at_key), hint=hint)


def _plain(finding: _Finding) -> str:
    """The sentence for errors that need no look at the models."""
    kind, context, value = finding.type, finding.context, finding.input
    if kind == "union":
        return f"expected {context['wanted']}, got {_got(value)}"
    if kind in _EXPECTED:
        return f"expected {_EXPECTED[kind]}, got {_got(value)}"
    limits = {"greater_than": ("gt", "above"), "greater_than_equal": ("ge", "at least")}
    limits |= {"less_than": ("lt", "below"), "less_than_equal": ("le", "at most")}
    if kind in limits:
        name, word = limits[kind]
        return f"must be {word} {_number(context[name])}, got {_got(value)}"
    if kind == "finite_number":
        return f"must be a finite number, got {_got(value)}"
    if kind == "multiple_of":
        return f"must be a multiple of {_number(context['multiple_of'])}, got {_got(value)}"
    if kind in ("too_short", "too_long"):
        limit = context.get("min_length" if kind == "too_short" else "max_length")
        word = "at least" if kind == "too_short" else "at most"
        return f"expected {word} {limit} values, got {context.get('actual_length')}"
    if kind == "too_few":
        return f"expected {context['needed']} values, got {len(value or ())}"
    if kind in ("string_too_short", "string_too_long"):
        limit = context.get("min_length" if kind == "string_too_short" else "max_length")
        return f"expected {'at least' if kind == 'string_too_short' else 'at most'} {limit} characters"
    if kind == "string_pattern_mismatch":
        return f"`{shorten(value)}` is not allowed here: use letters, digits, spaces, `_` and `-`"
    if kind in ("value_error", "assertion_error"):
        return str(context.get("error", finding.message))
    text = finding.message.removeprefix("Value error, ").removeprefix("Assertion failed, ")
    text = text.replace("Input should be", "expected").replace("Input should", "should")
    return text[:1].lower() + text[1:]


def _number(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def _got(value: Any) -> str:
    if isinstance(value, (dict, list, tuple)):
        return shorten(value)
    return f"`{shorten(value)}`"


def _one_of(choices: Sequence[str]) -> str:
    quoted = [f"`{choice}`" for choice in choices]
    return quoted[0] if len(quoted) == 1 else f"{', '.join(quoted[:-1])} or {quoted[-1]}"


def nearest(word: str, choices: Sequence[str], what: str) -> str | None:
    """A hint: the nearest choice, else all of them."""
    near = difflib.get_close_matches(word, choices, n=1, cutoff=NEAR)
    if near:
        return f"did you mean `{near[0]}`?"
    return f"{what}: {', '.join(choices)}" if choices else None


def dotted(loc: Loc) -> str:
    return ".".join(shorten(part) for part in loc)


# --- the models along a path -------------------------------------------------------------------


def _expand(annotation: Any, metadata: Sequence[Any], value: Any) -> list[Any]:
    """The plain types that an annotation can stand for; a choice is settled by the data."""
    for item in metadata:
        if isinstance(item, Choice):
            chosen = item.model_for(value)
            return [chosen] if chosen else []
    origin = get_origin(annotation)
    if origin is Annotated:
        inner, *more = get_args(annotation)
        return _expand(inner, more, value)
    if origin in (Union, types.UnionType):
        return [t for arm in get_args(annotation) for t in _expand(arm, (), value)]
    return [annotation]


def _models_at(model: type[BaseModel], loc: Loc, data: Any) -> list[type[BaseModel]]:
    found: list[Any] = [model]
    for part in loc:
        data = _at(data, (part,)) if _holds(data, part) else None
        step: list[Any] = []
        for kind in found:
            if isinstance(kind, type) and issubclass(kind, BaseModel):
                field = kind.model_fields.get(str(part))
                if field:
                    step += _expand(field.annotation, field.metadata, data)
                continue
            origin, arguments = get_origin(kind), get_args(kind)
            if origin is dict:
                step += _expand(arguments[1], (), data)
            elif origin in (tuple, list) and isinstance(part, int):
                if origin is list or arguments[-1] is Ellipsis:
                    step += _expand(arguments[0], (), data)
                elif part < len(arguments):
                    step += _expand(arguments[part], (), data)
        found = step
    models = [kind for kind in found if isinstance(kind, type) and issubclass(kind, BaseModel)]
    return [kind for kind in models if _fits(kind, data)] or models


def _at(data: Any, loc: Loc) -> Any:
    for part in loc:
        data = data[part]
    return data


def _holds(data: Any, part: str | int) -> bool:
    if isinstance(data, dict):
        return part in data
    return isinstance(data, list) and isinstance(part, int) and part < len(data)


def _literals(kind: type[BaseModel]) -> dict[str, tuple[Any, ...]]:
    return {
        name: get_args(field.annotation)
        for name, field in kind.model_fields.items()
        if get_origin(field.annotation) is Literal and len(get_args(field.annotation)) == 1
    }


def _fits(kind: type[BaseModel], data: Any) -> bool:
    """Whether the discriminating fields of a model agree with the data."""
    if not isinstance(data, dict):
        return True
    return all(data[name] in values for name, values in _literals(kind).items() if name in data)


def known_fields(model: type[BaseModel], loc: Loc, data: Any) -> dict[str, str]:
    """Keys with their meaning that the mapping at `loc` may have."""
    return {
        name: field.description or ""
        for kind in _models_at(model, loc, data)
        for name, field in kind.model_fields.items()
    }


def union_tags(model: type[BaseModel], loc: Loc, data: Any, key: str) -> list[str]:
    """What the discriminating `key` of the mapping at `loc` may be."""
    return [str(value) for kind in _models_at(model, loc, data) for value in _literals(kind).get(key, ())]
