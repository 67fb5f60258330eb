"""A part of the job whose settings come from a registry: the capture, the method, participants.

Only what a job names is imported, so that a job is checked in a moment, and an error is reported
against the one model that the user meant.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any, Literal

from pydantic import Field, ValidationError, create_model
from pydantic_core import InitErrorDetails, PydanticCustomError, core_schema

from mrbatch.capture.registry import Registry
from mrbatch.quantities import Settings

Loc = tuple[str | int, ...]


def problem(
    message: str, *, hint: str | None = None, choices: Sequence[str] = (), key: bool = False
) -> PydanticCustomError:
    """An error of a job's part. `choices` gives the nearest one as a hint; `key`: point at the key."""
    return PydanticCustomError(
        "problem", "{message}", {"message": message, "hint": hint, "choices": tuple(choices), "key": key}
    )


def problems(found: Sequence[tuple[Loc, PydanticCustomError, Any]]) -> ValidationError:
    """Several errors in one, each at its path within the part."""
    details: list[InitErrorDetails] = [
        {"type": error, "loc": loc, "input": value} for loc, error, value in found
    ]
    return ValidationError.from_exception_data("job", details)


@cache
def _with_key(settings: type[Settings], key: str, name: str, what: str) -> type[Settings]:
    """`settings` with its discriminating field, which a model may leave out."""
    if key in settings.model_fields:
        return settings
    return create_model(
        settings.__name__,
        __base__=settings,
        __module__=settings.__module__,
        **{key: (Literal[name], Field(default=name, description=f"Which {what} this is"))},  # type: ignore
    )


class Choice:
    """Annotation of such a part: picks the settings model by the value of `key`."""

    def __init__(self, registry: Registry[Any], key: str):
        self.registry = registry
        self.key = key

    def model(self, name: str) -> type[Settings]:
        return _with_key(self.registry.get(name).settings, self.key, name, self.registry.what)

    def model_for(self, value: Any) -> type[Settings] | None:
        """The model that `value` (plain data) asks for, or None."""
        name = value.get(self.key) if isinstance(value, dict) else None
        return self.model(name) if isinstance(name, str) and name in self.registry.names() else None

    def validate(self, value: Any, info: Any) -> Settings:
        what, names = self.registry.what, self.registry.names()
        if isinstance(value, Settings):
            return value
        listed = ", ".join(names) or "none"
        if not isinstance(value, dict):
            raise problem(f"expected a mapping with the key `{self.key}`", hint=f"known {what}s: {listed}")
        if self.key not in value:
            raise problem(f"`{self.key}` is missing", hint=f"known {what}s: {listed}")
        name = value[self.key]
        if not isinstance(name, str) or name not in names:
            error = problem(f"unknown {what} `{str(name)[:60]}`", choices=names)
            raise problems([((self.key,), error, name)])
        return self.model(name).model_validate(value, context=info.context)

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> core_schema.CoreSchema:
        return core_schema.with_info_plain_validator_function(
            self.validate,
            serialization=core_schema.plain_serializer_function_ser_schema(
                lambda value, info: value.model_dump(mode=info.mode), info_arg=True
            ),
        )

    def __get_pydantic_json_schema__(self, schema: core_schema.CoreSchema, handler: Any) -> dict[str, Any]:
        branches = []
        for name in self.registry.names():
            model = self.model(name)
            branches.append(handler(model.__pydantic_core_schema__))
        if not branches:
            return {"not": {}}
        return {"oneOf": branches}
