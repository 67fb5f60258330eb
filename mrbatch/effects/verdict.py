"""The commonest verdicts of rules, in short."""

from __future__ import annotations

from mrbatch.contracts import Verdict


def absent(why: str) -> Verdict:
    """Proved: nothing of it exists."""
    return Verdict("absent", why, bound=0.0)


def needed(why: str, **numbers: float) -> Verdict:
    """Simulated."""
    return Verdict("needed", why, numbers)
