"""How much of a pass is ray queries that nothing can save: its rays, cast again by a bare loop."""

from __future__ import annotations

from dataclasses import dataclass

from mrbatch.batch.prepare import Prepared
from mrbatch.bench.subject import Subject
from mrbatch.device.replay import RayLog, replay
from mrbatch.metrics.statistics import Interval, paired_ratio


@dataclass(frozen=True)
class RayShare:
    """`share`: seconds of the bare loop over seconds of the pass, both on one thread, in pairs."""

    share: Interval
    rays: int
    samples: int
    pass_seconds: tuple[float, ...]
    loop_seconds: tuple[float, ...]


def ray_share(prepared: Prepared, frame: int, *, repeats: int = 9) -> RayShare:
    """Notes the rays of one rendering of `frame`, then renders and replays them in turn.

    Raises ValueError where the pass casts no ray or more than fit into memory.
    """
    with Subject(prepared, frame, threads=1) as plain:
        counters = plain.run().counters
        expected = sum(n for name, n in counters.items() if name.endswith("rays"))
        if not expected:
            raise ValueError(f"frame {frame} casts no ray")
        log = RayLog(expected + 1024)
        with Subject(prepared, frame, threads=1, engine="embree-recording") as noting:
            log.attach(noting.scene_data)
            noting.run()
            if log.count > len(log.rays):
                raise ValueError(f"{log.count} rays came where the counters say {expected}")
            rays = log.rays
            replay(rays)
            passes, loops = [], []
            for turn in range(repeats):
                # Taken in turns, and in changing order, so that a slow moment hits both.
                if turn % 2:
                    loops.append(replay(rays).seconds)
                passes.append(plain.run().seconds)
                if not turn % 2:
                    loops.append(replay(rays).seconds)
    return RayShare(
        share=paired_ratio(loops, passes, seed=1),
        rays=len(rays),
        samples=counters.get("samples", 0),
        pass_seconds=tuple(passes),
        loop_seconds=tuple(loops),
    )
