"""mrbatch: puts virtual objects and volumes into captured datasets, lit by what was captured."""

__version__ = "0.1.0"
