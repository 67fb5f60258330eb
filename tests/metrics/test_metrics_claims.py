"""Claims on paired timings: exact tests, a family that holds together, and the power to tell."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy import stats

from mrbatch.metrics.claims import (
    ALPHA,
    MARGIN,
    all_pairs,
    fewest_turns,
    holm,
    judge,
    noise_of_pairs,
    signed_rank_p,
    told_apart,
    turns_for,
    verdicts,
)


class Machine:
    """A machine that is used by others: its slowness drifts, has bursts and heavy tails, by slots."""

    def __init__(
        self, seed: int, *, scatter: float = 0.04, drift: float = 0.05, bursts: float = 0.03
    ) -> None:
        self.rng = np.random.default_rng(seed)
        self.scatter, self.drift, self.bursts = scatter, drift, bursts
        self.slow = 0.0

    def slots(self, count: int) -> np.ndarray:
        steps = self.drift * self.rng.standard_normal(count)
        level = np.empty(count)
        for i, step in enumerate(steps):
            self.slow = 0.9 * self.slow + step
            level[i] = self.slow
        tails = self.scatter * self.rng.standard_t(2, count)
        burst = np.where(self.rng.random(count) < self.bursts, self.rng.exponential(1.0, count), 0.0)
        return np.exp(np.clip(level + tails + burst, -3.0, 6.0))


def timings(
    machine: Machine, true: dict[str, float], turns: int, *, shuffled: bool = True
) -> dict[str, list]:
    """Seconds of candidates in turns, in random order (or always the same)."""
    names = list(true)
    spent: dict[str, list[float]] = {name: [] for name in names}
    for _ in range(turns):
        order = machine.rng.permutation(len(names)) if shuffled else np.arange(len(names))
        for slot, slow in zip(order, machine.slots(len(names))):
            spent[names[slot]].append(true[names[slot]] * slow)
    return spent


def outcomes(pairs) -> dict[tuple[str, str], str]:
    return {pair[:2]: outcome for pair, (outcome, _) in zip(pairs, verdicts(pairs), strict=True)}


def wrong(found, true) -> int:
    """Claims that say more than what is so."""
    bad = 0
    for (first, second), outcome in found.items():
        ratio = true[first] / true[second]
        bad += outcome == "more" and ratio <= 1 + MARGIN + 1e-12
        bad += outcome == "less" and ratio >= 1 / (1 + MARGIN) - 1e-12
    return bad


def test_p_values_are_scipys():
    rng = np.random.default_rng(3)
    for n in (5, 12, 30):
        x = rng.standard_t(3, n) + 0.2
        expected = stats.wilcoxon(x, alternative="greater", method="exact").pvalue
        assert signed_rank_p(x) == pytest.approx(expected, rel=1e-9)


def test_ties_are_counted_over_all_signs():
    x = np.array([0.5, -0.5, 0.5, 1.0, 0.0, 2.0, -2.0])
    kept = np.abs(x[x != 0])
    ranks = stats.rankdata(kept)
    observed = ranks[x[x != 0] > 0].sum()
    sums = [np.dot(ranks, signs) for signs in itertools.product((0, 1), repeat=kept.size)]
    assert signed_rank_p(x) == pytest.approx(np.mean(np.array(sums) >= observed - 1e-9))
    assert signed_rank_p([0.0, 0.0]) == 1.0


def test_holm_is_the_published_example():
    """Holm's steps by hand: sorted p times 4, 3, 2, 1, never falling."""
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])


def test_fewest_turns_survive_one_that_went_wrong():
    for claims in (1, 60, 800):
        turns = fewest_turns(claims)
        a, b = np.full(turns, 2.0), np.ones(turns)
        a[0] = 1e-6
        a += np.linspace(0, 1e-3, turns)  # no ties
        even = np.ones(turns) + np.linspace(0, 1e-7, turns)
        rest = [(f"e{i}", f"f{i}", even, even[::-1]) for i in range(claims - 1)]
        pairs = [("a", "b", a, b), *rest]
        found = [outcome for outcome, _ in verdicts(pairs)]
        assert found[0] == "more" and set(found[1:]) <= {"undecided"}
        fewer = [(f, g, x[:-1], y[:-1]) for f, g, x, y in pairs]
        assert verdicts(fewer)[0][0] == "undecided"
    assert fewest_turns(128) <= 26


def test_a_difference_below_the_margin_is_none():
    rng = np.random.default_rng(5)
    a = 1.02 * np.exp(0.001 * rng.standard_normal(40))
    assert judge([("a", "b", a, np.ones(40))])[0].outcome == "undecided"
    assert judge([("a", "b", 1.02 * a, np.ones(40))])[0].outcome == "more"
    assert judge([("b", "a", np.ones(40), 1.02 * a)])[0].outcome == "less"


def test_figures_must_be_positive_and_of_the_same_turns():
    with pytest.raises(ValueError, match="positive"):
        judge([("a", "b", [1.0, 0.0], [1.0, 1.0])])
    with pytest.raises(ValueError, match="same turns"):
        judge([("a", "b", [1.0], [1.0, 1.0])])
    with pytest.raises(ValueError, match="finite"):
        signed_rank_p([np.nan])


SWEEPS = 300
NULL = {"a": 1.0, "b": 1.0, "c": 1.0, "d": 1.0 + MARGIN, "e": 1.0}
"""Five candidates, none of which is beyond the margin of another."""


def _family(seed: int, true: dict[str, float], *, axes: int = 4, shuffled: bool = True, turns: int = 0):
    """All pairs of several axes that were measured one after another on one machine."""
    machine = Machine(seed)
    count = axes * len(true) * (len(true) - 1) // 2
    names, pairs = {}, []
    for axis in range(axes):
        spent = timings(machine, true, turns or fewest_turns(count), shuffled=shuffled)
        own = {f"{axis}{name}": values for name, values in spent.items()}
        names |= {f"{axis}{name}": true[name] for name in true}
        pairs += all_pairs(own)
    return pairs, names


def test_claims_of_a_family_hold_together_on_a_drifting_machine():
    """At 1 % a family of 40 claims with no difference in it: at most 9 of 300 have a wrong one (p 0.001)."""
    failures = 0
    for seed in range(SWEEPS):
        pairs, true = _family(seed, NULL)
        failures += wrong(outcomes(pairs), true) > 0
    assert failures <= 9


def test_the_same_simulation_finds_what_is_wrong_with_a_plain_test():
    """Each pair by itself at 1 % and without margin is wrong far more often: the simulation can fail."""
    failures = 0
    for seed in range(SWEEPS):
        pairs, _ = _family(seed, dict.fromkeys("abcde", 1.0))
        p = [
            min(signed_rank_p(np.log(a / np.array(b))), signed_rank_p(np.log(b / np.array(a))))
            for _, _, a, b in pairs
        ]
        failures += min(p) <= ALPHA / 2
    assert failures > 50


def test_an_order_that_never_changes_is_found_out():
    """What comes after a slow neighbour, always, looks slower than it is: the order must be drawn."""

    def spent(shuffled: bool) -> dict[str, np.ndarray]:
        rng, found = np.random.default_rng(8), {"a": [], "b": [], "big": []}
        for _ in range(30):
            order = rng.permutation(3) if shuffled else np.arange(3)
            before = ""
            for name in (("big", "a", "b")[i] for i in order):
                cold = 1.08 if before == "big" else 1.0
                found[name].append(cold * np.exp(0.01 * rng.standard_t(3)))
                before = name
        return {name: np.array(values) for name, values in found.items()}

    fixed, drawn = (judge([("a", "b", s["a"], s["b"])])[0] for s in (spent(False), spent(True)))
    assert fixed.outcome == "more" and drawn.outcome == "undecided"


STEPS = {"a": 1.0, "b": 1.3, "c": 1.7, "d": 4.0, "e": 1.02}


def test_two_sweeps_agree_and_tell_what_is_a_quarter_apart():
    told = total = contradictions = mistakes = 0
    for seed in range(20):
        twice = []
        for again in (0, 1000):
            machine = Machine(seed + again)
            true = STEPS | {"a again": 1.0}
            claims_made = 10
            turns = fewest_turns(claims_made)
            spent = timings(machine, true, turns)
            # As the sweep does: more turns where the machine is noisy.
            need = min(3 * turns, turns_for(noise_of_pairs(spent["a"], spent["a again"]), claims_made))
            more = timings(machine, true, max(0, need - turns))
            spent = {name: spent[name] + more[name] for name in spent}
            found = outcomes(all_pairs({name: spent[name] for name in STEPS}))
            mistakes += wrong(found, STEPS)
            twice.append(found)
            far = [p for p in found if not 1 / 1.25 <= STEPS[p[0]] / STEPS[p[1]] <= 1.25]
            total += len(far)
            told += sum(found[p] != "undecided" for p in far)
        contradictions += sum({one, twice[1][p]} == {"less", "more"} for p, one in twice[0].items())
    assert mistakes == 0 and contradictions == 0
    assert told >= 0.9 * total, (told, total)


def test_turns_follow_the_noise():
    quiet, busy = turns_for(0.01, 60), turns_for(0.3, 60)
    assert quiet == fewest_turns(60) and busy > 2 * quiet
    assert told_apart(0.3, 60, busy) == pytest.approx(1.25, rel=0.01)
    rng = np.random.default_rng(2)
    a, b = np.exp(0.1 * rng.standard_normal((2, 4000)))
    assert noise_of_pairs(a, b) == pytest.approx(0.1 * np.sqrt(2), rel=0.05)
