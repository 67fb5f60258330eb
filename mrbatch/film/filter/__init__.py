"""Filters that take noise out of a finished frame."""
