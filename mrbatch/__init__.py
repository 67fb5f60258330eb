"""mrbatch: puts virtual objects and volumes into captured datasets, lit by what was captured."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mrbatch.job import load_job

__version__ = "0.1.0"

__all__ = ["__version__", "load_job"]

_HOMES = {
    "load_job": "mrbatch.job",
}
"""Public name to the module that has it; loaded when first used, so that `import mrbatch` is light."""


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module `mrbatch` has no attribute `{name}`")


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOMES})
