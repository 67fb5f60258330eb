"""What a fuzzing process may do: work, crash, hang; for tests of the process that watches it."""

from __future__ import annotations

import json
import os
import time

import numpy as np


def work(first: int, count: int) -> None:
    for seed in range(first, first + count):
        print(json.dumps({"seed": seed}), flush=True)
        if seed == 3:
            os._exit(11)
        if seed == 5:
            time.sleep(60)
        print("a word of a library", flush=True)
        wrong = "no number" if seed == 6 and np.isnan(np.nan) else ""
        print(json.dumps({"seed": seed, "wrong": wrong}), flush=True)
