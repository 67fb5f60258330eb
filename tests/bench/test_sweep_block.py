"""Turns of an axis, on stand-ins for renderers: order, seeds, how many turns, and what cannot be rendered."""

from __future__ import annotations

from contextlib import contextmanager
from types import SimpleNamespace

import numpy as np
import pytest

from mrbatch.bench.axes import Choice
from mrbatch.bench.block import AGAIN, MOST, OWN, run_block
from mrbatch.bench.subject import Run
from mrbatch.bench.truth import Truth
from mrbatch.errors import InputError, ResourceError
from mrbatch.metrics.claims import turns_for

TRUTH = Truth(np.ones((8, 8, 3)), np.ones((8, 8), bool), 1e-9, "given", True)


class Stage:
    """Stands in for `Variants`: each subject takes its own seconds times those of a noisy machine."""

    def __init__(self, noise: float, *, broken: str = "", changing: str = "") -> None:
        self.rng = np.random.default_rng(1)
        self.noise, self.broken, self.changing = noise, broken, changing
        self.job = SimpleNamespace(seed=7)
        self.calls: list[tuple[int, int]] = []
        self.made = 0

    @contextmanager
    def subject(self, *settings: str, threads: int = 1):
        if self.broken and self.broken in settings:
            raise ResourceError("no such thing here")
        number, self.made = self.made, self.made + 1
        runs = [0]

        def run(seed: int) -> Run:
            self.calls.append((number, seed))
            runs[0] += 1
            seconds = (2.0 if "slow=1" in settings else 1.0) * np.exp(self.noise * self.rng.standard_normal())
            picture = np.random.default_rng(seed).uniform(0.9, 1.1, (8, 8, 3))
            if self.changing and self.changing in settings:
                picture = picture + runs[0]
            return Run(seconds, seconds, seconds, {"rays": 5}, picture, np.zeros((8, 8)))

        yield SimpleNamespace(run=run, renderer=SimpleNamespace(samples=4))


def choice(name: str) -> Choice:
    return Choice("toy", name, (f"{name}=1",), 1, {"toy": name})


def block(stage: Stage, *names: str, repeats: int | None = None):
    return run_block(
        stage,
        [choice(name) for name in names],
        TRUTH,
        threads=1,
        claims=6,
        repeats=repeats,
        order=np.random.default_rng(3),
    )


def test_each_turn_renders_all_once_by_one_seed_in_an_order_of_its_own():
    stage = Stage(0.01)
    found = block(stage, "slow", "other", repeats=12)
    assert list(found.found) == [OWN, "toy slow", "toy other"] and len(found.again) == 12
    warm, timed = stage.calls[:4], stage.calls[4:]
    assert [number for number, _ in warm] == [0, 1, 2, 3] and {seed for _, seed in warm} == {7}
    turns = [timed[4 * i : 4 * i + 4] for i in range(12)]
    assert all(sorted(n for n, _ in turn) == [0, 1, 2, 3] for turn in turns)
    seeds = [{seed for _, seed in turn} for turn in turns]
    assert all(len(s) == 1 for s in seeds) and len(set.union(*seeds)) == 12 and seeds[0] == {7}
    assert len({tuple(n for n, _ in turn) for turn in turns}) > 6
    # The same seeds draw the same noise: errors are those of the pictures, not of the turn's place.
    assert found.found["toy slow"].relmse == found.found["toy other"].relmse
    assert np.median(found.found["toy slow"].seconds) == pytest.approx(2.0, rel=0.05)


def test_a_busy_machine_gets_more_turns_up_to_a_limit():
    quiet, busy, mad = (len(block(Stage(noise), "slow").again) for noise in (0.01, 0.25, 2.0))
    assert quiet == turns_for(0.0, 6) < busy <= mad == MOST * quiet


def test_what_cannot_be_rendered_is_left_out_with_the_reason():
    found = block(Stage(0.01, broken="other=1"), "slow", "other", repeats=3)
    assert list(found.found) == [OWN, "toy slow"]
    assert found.left_out == {"other": "no such thing here"}
    stage = Stage(0.01)
    stage.subject = lambda *s, threads=1: (_ for _ in ()).throw(InputError("no frame"))
    with pytest.raises(InputError, match="no frame"):
        block(stage, "slow", repeats=3)


def test_bits_that_do_not_repeat_are_seen():
    found = block(Stage(0.01, changing="slow=1"), "slow", "other", repeats=3)
    assert [m.repeats_bits for m in found.found.values()] == [True, False, True]
    assert AGAIN not in found.found
