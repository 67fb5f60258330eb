"""Effect rules of the toy."""

from __future__ import annotations

from mrbatch.contracts import Rule, Verdict
from mrbatch.effects.facts import ShotFacts


def _shade(facts: ShotFacts) -> Verdict:
    if facts.settings.darkness == 0.0:
        return Verdict("absent", "no light is taken away", bound=0.0)
    return Verdict("needed", "light is taken away", {"darkness": facts.settings.darkness})


RULES = (Rule("toy-shade", "a random share of the light", _shade),)
