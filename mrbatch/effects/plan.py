"""The plan of a shot: the state of every effect with its evidence, and the tiles that are done."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from mrbatch.contracts import Rule, Verdict
from mrbatch.effects.facts import ShotFacts
from mrbatch.effects.influence import InfluenceMask
from mrbatch.errors import JobError

ON = ("needed", "unresolved", "forced-on")


@dataclass(frozen=True)
class Plan:
    """What is simulated. `effects`: verdict by effect, in the rules' order. `tiles`: by frame and view
    the ids of the decision tiles that are done, `seen`: those of them where something virtual may be seen;
    `influence`: in words why."""

    effects: Mapping[str, Verdict]
    tiles: Mapping[tuple[int, str], np.ndarray] = field(default_factory=dict)
    seen: Mapping[tuple[int, str], np.ndarray] = field(default_factory=dict)
    influence: Mapping[tuple[int, str], str] = field(default_factory=dict)

    def on(self, effect: str) -> bool:
        """Whether an effect is simulated. Raises KeyError for one that no rule knows."""
        return self.effects[effect].state in ON

    def does(self, effect: str) -> bool:
        """Whether an effect is simulated; one that no rule knows is not."""
        return effect in self.effects and self.on(effect)

    def as_dict(self) -> dict[str, Any]:
        """JSON-ready: the effects with evidence, and the number of tiles by frame and view."""
        return {
            "effects": {
                name: {
                    "state": verdict.state,
                    "why": verdict.why,
                    "bound": verdict.bound,
                    "numbers": dict(verdict.numbers),
                }
                for name, verdict in self.effects.items()
            },
            "frames": [
                {"frame": frame, "view": view, "tiles": len(ids), "why": self.influence[frame, view]}
                for (frame, view), ids in self.tiles.items()
            ],
        }


def make_plan(rules: Sequence[Rule], facts: ShotFacts, forced: Mapping[str, str]) -> Plan:
    """Runs every rule, then the job's own word (`on`, `off`, `auto`), then the tiles of each frame.

    An effect that is absent stays absent, even where the job asks for it: there is nothing to do.
    Raises JobError for an effect that no rule knows.
    """
    known = {rule.effect for rule in rules}
    for name in forced:
        if name not in known:
            raise JobError(
                f"unknown effect `{name}`", hint=f"effects of this method: {', '.join(sorted(known))}"
            )
    effects: dict[str, Verdict] = {}
    for rule in rules:
        verdict = rule.decide(facts)
        word = forced.get(rule.effect, "auto")
        if word == "on" and verdict.state not in ("absent", "needed"):
            verdict = Verdict(
                "forced-on", f"asked for by the job; {verdict.why}", verdict.numbers, verdict.bound
            )
        if word == "off" and verdict.state != "absent":
            verdict = Verdict(
                "forced-off", f"left out by the job; {verdict.why}", verdict.numbers, verdict.bound
            )
        # Two who share an effect: it is simulated where either needs it.
        before = effects.get(rule.effect)
        if before is None or (before.state not in ON and verdict.state in ON):
            effects[rule.effect] = verdict
    tiles: dict[tuple[int, str], np.ndarray] = {}
    seen: dict[tuple[int, str], np.ndarray] = {}
    words: dict[tuple[int, str], str] = {}
    plan = Plan(effects)
    mask = InfluenceMask(facts, light_change=plan.does("light-change"))
    for frame in facts.frames:
        if not plan.does("depth-of-field"):
            frame = frame.without_lens()
        if not plan.does("motion-blur"):
            frame = replace(frame, moments=())
        for view in facts.windows:
            found = mask.tiles(frame, view)
            tiles[frame.number, view] = found.tiles
            seen[frame.number, view] = found.seen
            words[frame.number, view] = found.why
    return Plan(effects, tiles, seen, words)
