"""Random small jobs in a process of their own: a crash or a hang costs one job, and is told by its seed."""

from __future__ import annotations

import json
import queue
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator

from mrbatch import __version__
from mrbatch.errors import EXIT_DONE, EXIT_GATE
from mrbatch.report.model import Attempt, HardCase, Job, Report, Totals, Value
from mrbatch.stability.small_job import measure, random_job

PATIENCE = 300.0
"""Seconds that one job may take, kernels that must be compiled included; it takes a tenth of one."""


def check(seed: int) -> str:
    """What is wrong with the job of this seed, in words; empty where nothing is."""
    from mrbatch.stability.run import unsound

    try:
        found = measure(random_job(seed))
    except Exception as error:
        return "raised " + " ".join(f"{type(error).__name__}: {error}".split())
    return unsound(found) or ("" if found.passed else found.measured)


def work(first: int, count: int) -> None:
    """Checks the jobs of `count` seeds; a line of JSON before and after each, for who watches."""
    for seed in range(first, first + count):
        print(json.dumps({"seed": seed}), flush=True)
        print(json.dumps({"seed": seed, "wrong": check(seed)}), flush=True)


def jobs(
    first: int, count: int, *, patience: float = PATIENCE, task: str = "mrbatch.stability.fuzz"
) -> Iterator[tuple[int, str]]:
    """Seed and what is wrong with its job, for `count` seeds from `first` on, in order.

    `task`: the module whose `work(first, count)` a new process runs. Where that ends or says nothing for
    `patience` seconds, the job it was at is told to have crashed or hung, and another goes on behind it.
    """
    at, end = first, first + count
    while at < end:
        code = f"import sys; from {task} import work; work(int(sys.argv[1]), int(sys.argv[2]))"
        command = [sys.executable, "-c", code, str(at), str(end - at)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as child:
            lines: queue.Queue[str] = queue.Queue()
            assert child.stdout is not None
            reader = threading.Thread(target=_read, args=(child.stdout, lines), daemon=True)
            reader.start()
            while at < end:
                try:
                    line = lines.get(timeout=patience)
                except queue.Empty:
                    child.kill()
                    yield at, f"took more than {patience:g} s"
                    at += 1
                    break
                if not line:
                    yield at, f"ended the process, exit code {child.wait()}"
                    at += 1
                    break
                told = json.loads(line) if line.startswith("{") else {}
                if "wrong" in told:
                    yield told["seed"], told["wrong"]
                    at = told["seed"] + 1


def _read(stream, lines: queue.Queue[str]) -> None:
    for line in stream:
        lines.put(line)
    lines.put("")


def fuzz(count: int, *, seed: int = 0, told: Callable[[int, str], None] = lambda seed, wrong: None) -> Report:
    """Renders `count` small random jobs; those of seeds `seed` to `seed + count - 1`.

    `told` is called with each seed and what is wrong with its job. The report has one case for all, and one
    for each job that is not sound; `--fuzz 1 --seed SEED` repeats it.
    """
    began, wrong = time.perf_counter(), []
    for number, text in jobs(seed, count):
        told(number, text)
        if text:
            wrong.append((number, text))
    seconds = Value(value=time.perf_counter() - began, unit="s")
    texts = {
        "title": "small random jobs",
        "setup": f"seeds {seed} to {seed + count - 1}: scale 1e-4 to 1e4, offset 0 to 1e6, odd sizes",
        "oracle": "numbers, no negative light, no crash, no hang",
        "tolerance": "exact",
    }
    whole = HardCase(
        name="FUZZ",
        outcome="failed" if wrong else "passed",
        measured=f"{len(wrong):,} of {count:,} jobs are unsound",
        seconds=seconds,
        **texts,
    )
    cases = [
        HardCase(
            name=f"FUZZ-{number}",
            title="a random job",
            outcome="failed",
            reason=text,
            setup=f"mrbatch stability --fuzz 1 --seed {number}",
            attempts=(Attempt(seed=number, outcome="failed", measured=text),),
        )
        for number, text in wrong
    ]
    return Report(
        kind="stability",
        job=Job(name=f"Hard cases, {count:,} random jobs", seed=seed, settings={"jobs": count}),
        versions={"mrbatch": __version__},
        totals=Totals(seconds=seconds),
        cases=(whole, *cases),
        exit=EXIT_GATE if wrong else EXIT_DONE,
    )
