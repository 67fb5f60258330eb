"""What OpenImageIO has to say of a file."""

from __future__ import annotations

from typing import Any


def library_error(source: Any) -> str:
    """The pending message of an input, output or of the module itself, which is then taken; empty if none.

    It quotes names out of damaged headers, bytes that need not be text.
    """
    try:
        return str(source.geterror())
    except UnicodeDecodeError:
        return "the file's header holds names that are not text"
