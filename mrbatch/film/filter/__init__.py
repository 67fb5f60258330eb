"""Filters that take noise out of a finished frame: see docs/filter.md."""
