"""Runs the pipelines of a shot, frame by frame: the four lists of passes, the halves, the counts."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from mrbatch.contracts import Buffer, Pipeline
from mrbatch.device.runner import Runner
from mrbatch.device.timing import TimingNode
from mrbatch.film.accumulator import Developed
from mrbatch.film.outputs import FrameInput, Outputs, ViewInput
from mrbatch.film.steering import Steering, groups


@dataclass(frozen=True)
class Source:
    """A pipeline by the name under which its film is kept: `method`, or a participant's."""

    name: str
    pipeline: Pipeline


@dataclass(frozen=True)
class Look:
    """One of the moments at which a frame is looked at while the shutter is open: `show` puts the scene
    where it then is, `views` hold the cameras where they then are."""

    show: Callable[[], None]
    views: Mapping[str, ViewInput]


@dataclass(frozen=True)
class RenderedViews:
    """`estimates`: by view, then by source. `buffers`: arrays as the passes left them. `history`: host
    copies of the history buffers, or empty."""

    estimates: Mapping[str, Mapping[str, Developed]]
    buffers: Mapping[str, Any]
    history: Mapping[str, np.ndarray]


class FrameRenderer:
    """Holds compiled pipelines and their buffers; `render` gives one frame.

    `samples` of a frame are split evenly between the halves; `tiles` names the decision tiles of each
    view that are done (None: all), `seen` those where something virtual may be seen (None: as `tiles`).
    """

    def __init__(
        self, runner: Runner, sources: Sequence[Source], outputs: Outputs, timing: TimingNode
    ) -> None:
        self.runner = runner
        self.sources = tuple(sources)
        self.outputs = outputs
        self.timing = timing
        pipelines = [source.pipeline for source in self.sources]
        runner.compile(pipelines, timing)
        buffers: dict[str, Buffer] = {}
        for source in self.sources:
            taken = [b.name for b in source.pipeline.buffers if b.name in buffers]
            if taken:
                raise ValueError(f"`{source.name}` shares the buffer `{taken[0]}` with another pipeline")
            buffers.update({b.name: b for b in source.pipeline.buffers})
        for source in self.sources:
            for view in outputs.views:
                for b in outputs.layout(view, source.name).buffers():
                    buffers[b.name] = b
        self._descriptions = buffers
        self.buffers = runner.allocate(tuple(buffers.values()))
        self._shot_timing = timing
        self._shot_done = False

    @property
    def has_history(self) -> bool:
        return any(b.lifetime == "history" for b in self._descriptions.values())

    def render(
        self,
        number: int,
        views: Mapping[str, ViewInput],
        samples: int,
        *,
        steering: Steering | None = None,
        tiles: Mapping[str, np.ndarray] | None = None,
        seen: Mapping[str, np.ndarray] | None = None,
        history: Mapping[str, np.ndarray] | None = None,
        looks: Sequence[Look] = (),
        seed: int | None = None,
        progress: Callable[[float], None] = lambda share: None,
    ) -> RenderedViews:
        """One frame; `samples` a pixel, both halves together (rounded up to an even number).

        `progress(share)` is called before the first batch and after each. The first batch of the shot is
        a single pair of samples, so that its time is known early; batches change no bit.

        `looks`: moments that share the samples of each half evenly, one after another, so that those of each
        are a run of the sequence; `views` are then those of the frame's own time, at which the scene stands.
        Raises ValueError where the samples of a half cannot be shared.

        `steering`, if there, decides over the samples in place of `samples`; `seed` takes the job's place.
        """
        frame = FrameInput(number, views, self.buffers, seed=seed)
        for name, description in self._descriptions.items():
            if description.lifetime in ("frame", "pass"):
                self.buffers[name].zero_()
            elif description.lifetime == "history":
                if history is not None and name in history:
                    wp.copy(self.buffers[name], wp.array(history[name], dtype=self.buffers[name].dtype))
                else:
                    self.buffers[name].zero_()
        own = bound = self._bound(frame)

        def run(kind: str, *, each_moment: bool | None = None, **counts: int) -> None:
            for source in self.sources:
                for step in getattr(source.pipeline, kind):
                    if each_moment is not None and step.each_moment != each_moment:
                        continue
                    units = None
                    done = seen if step.seen and seen is not None else tiles
                    if step.domain.kind == "pixels" and done is not None and not step.everywhere:
                        units = done.get(step.domain.view)
                    self.runner.run(
                        step, bound[source.name], self.buffers, self.timing, units=units, **counts
                    )

        first_of_shot = not self._shot_done
        if first_of_shot:
            self._run_shot()
        run("frame")
        batch = max((source.pipeline.batch for source in self.sources), default=1)
        progress(0.0)
        moments = looks or (None,)

        def look_at(at: int) -> None:
            nonlocal bound
            if (look := moments[at]) is not None:
                look.show()
                bound = self._bound(FrameInput(number, look.views, self.buffers, at, len(looks), seed))

        if steering is None:
            per_half = (samples + 1) // 2
            share = per_half // len(moments)
            if share * len(moments) != per_half:
                raise ValueError(f"{per_half} samples of a half cannot be shared by {len(looks)} moments")
            done = 0
            for at in range(len(moments)):
                look_at(at)
                end = done + share
                while done < end:
                    count = min(1 if first_of_shot and done == 0 else batch, end - done)
                    for half in (0, 1):
                        run("refine", half=half, first_sample=done, samples=count)
                    done += count
                    progress(done / per_half)
                if looks:
                    run("finish", each_moment=True)
        else:
            self._steer(steering, views, tiles, len(moments), look_at, lambda: bound, progress)
            for at in range(len(looks)):
                look_at(at)
                run("finish", each_moment=True)
        bound = own
        run("finish", each_moment=False if looks else None)
        estimates = self._developed(views)
        kept = {
            name: self.buffers[name].numpy().copy()
            for name, description in self._descriptions.items()
            if description.lifetime == "history"
        }
        return RenderedViews(estimates, self.buffers, kept)

    def _steer(
        self,
        steering: Steering,
        views: Mapping[str, ViewInput],
        tiles: Mapping[str, np.ndarray] | None,
        moments: int,
        look_at: Callable[[int], None],
        bound: Callable[[], Mapping[str, Any]],
        progress: Callable[[float], None],
    ) -> None:
        """Rounds of `refine` until the steering asks for no more."""
        ids = {
            view.name: np.arange(view.window.domain().units, dtype=np.int32)
            if tiles is None or view.name not in tiles
            else tiles[view.name]
            for view in self.outputs.views
        }
        done = {name: np.zeros((2, len(units)), dtype=np.int64) for name, units in ids.items()}
        # Passes that run over no tiles get as many samples as the busiest tile.
        elsewhere = np.zeros((2, 1), dtype=np.int64)
        estimates = None
        while True:
            more = steering.more(estimates, ids, done)
            most = np.max([counts.max(axis=1, initial=0) for counts in more.values()], axis=0)[:, None]
            if not most.any():
                return
            before, added = {**done, None: elsewhere}, {**more, None: most}
            for at in range(moments):
                look_at(at)
                for half, source in itertools.product((0, 1), self.sources):
                    for step in source.pipeline.refine:
                        by_tile = step.domain.kind == "pixels" and not step.everywhere
                        view = step.domain.view if by_tile else None
                        for first, count, chosen in groups(before[view][half], added[view][half]):
                            share = count // moments
                            self.runner.run(
                                step,
                                bound()[source.name],
                                self.buffers,
                                self.timing,
                                units=None if view is None else ids[view][chosen],
                                half=half,
                                first_sample=first + share * at,
                                samples=share,
                            )
            elsewhere = elsewhere + most
            done = {name: done[name] + more[name] for name in done}
            if steering.looks:
                estimates = self._developed(views, scatter=True)
            if steering.share > 0.0:
                progress(steering.share)

    def _developed(
        self, views: Mapping[str, ViewInput], *, scatter: bool = False
    ) -> dict[str, dict[str, Developed]]:
        """By view, then by source: what the film holds."""
        return {
            view.name: {
                source.name: self.outputs.layout(view, source.name).develop(
                    self.buffers, views[view.name].background, scatter=scatter
                )
                for source in self.sources
            }
            for view in self.outputs.views
        }

    def _bound(self, frame: FrameInput) -> dict[str, Any]:
        return {source.name: source.pipeline.bind(frame) for source in self.sources}

    def _run_shot(self) -> None:
        """Runs the passes of the shot: over their whole domains, with nothing of any frame, and timed as
        the shot's, so that which frame came first does not show."""
        for source in self.sources:
            for step in source.pipeline.shot:
                self.runner.run(step, None, self.buffers, self._shot_timing)
        self._shot_done = True
