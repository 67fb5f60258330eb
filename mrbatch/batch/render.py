"""Rendering one frame of a prepared job: a pure function of job, shot and frame number."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Mapping
from dataclasses import astuple, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from mrbatch import __version__
from mrbatch.batch.composited import composited, judged, laid_over, variance_of
from mrbatch.batch.error_target import ErrorTarget, Judged
from mrbatch.batch.exposure import looks_at, pinholes
from mrbatch.batch.framing import framed
from mrbatch.batch.prepare import Prepared, first_cameras
from mrbatch.batch.time_limit import Referee, TimeShare
from mrbatch.device.runner import Runner
from mrbatch.device.timing import TimingNode
from mrbatch.errors import InputError
from mrbatch.film.accumulator import Developed
from mrbatch.film.cryptomatte import name_id
from mrbatch.film.exr import FrameImage, ViewImage, write_frame
from mrbatch.film.filter.apply import filtered, smoother
from mrbatch.film.first_hit import first_hit_estimates
from mrbatch.film.guides import guides_of
from mrbatch.film.layers import CRYPTOMATTES, channels, data_behind_matte
from mrbatch.film.outputs import Outputs, ViewInput, ViewOutput
from mrbatch.film.rendering import FrameRenderer, Source
from mrbatch.film.window import Window
from mrbatch.job.resolve import pixel_relevant
from mrbatch.metrics.noise import Noise, noise_between, noise_map, noise_of, relative_square
from mrbatch.scene.camera import Camera
from mrbatch.scene.scene_data import upload


@dataclass(frozen=True)
class RenderedFrame:
    """A frame in memory; what `mrbatch.batch.request.FrameResult` asks for."""

    image: FrameImage
    counters: Mapping[str, int]
    seconds: float
    history: Mapping[str, np.ndarray] | None
    details: Mapping[str, Any]
    composites: Mapping[str, np.ndarray] = field(default_factory=dict)
    """By view the finished picture (h, w, 3) float32 on the data window, for previews."""

    def write(self, path: Path) -> None:
        write_frame(path, self.image)


class ShotRenderer:
    """Scene on the device, compiled kernels, and `render(number, history)`."""

    def __init__(
        self,
        prepared: Prepared,
        timing: TimingNode,
        *,
        threads: int | None = None,
        units_per_launch: int | None = None,
        progress: Callable[[int, float], None] = lambda number, share: None,
        referee: Callable[[int], Referee] | None = None,
    ) -> None:
        """`referee(number)` is asked when the samples of a frame begin, where the job has a limit of time."""
        self.referee = referee
        self.prepared = prepared
        self.timing = timing
        self.progress = progress
        job, shot = prepared.job, prepared.shot
        self.runner = Runner(threads, units_per_launch=units_per_launch)
        cameras = first_cameras(prepared)
        # One kernel does all views and frames: where any of them is distorted, all are taken as such.
        told = shot.plan.effects.get("lens-distortion")
        distorted = told.state != "absent" if told else any(np.any(c.distortion) for c in cameras.values())
        views = tuple(
            ViewOutput(
                name,
                index,
                prepared.windows[name],
                camera.model,
                distorted,
                picture=Window(0, 0, *prepared.display[name]),
            )
            for index, (name, camera) in enumerate(cameras.items())
        )
        self.outputs = Outputs(
            views,
            prepared.needs,
            job.seed,
            shot.engine,  # type: ignore[arg-type]
            lens=shot.plan.does("depth-of-field"),
            shutter=shot.plan.does("motion-blur"),
        )
        self.exposure = prepared.exposure
        with timing.measure("upload"):
            self.scene = upload(prepared.scene, shot.engine)  # type: ignore[arg-type]
        with timing.measure("build"):
            sources = [
                Source("method", job.method_object.build(self.scene, shot.plan, job.method, self.outputs))
            ]
            for number, (participant, settings) in enumerate(
                zip(job.participant_objects, job.participants, strict=True)
            ):
                name = f"{participant.name}.{number}"
                outputs = replace(self.outputs, source=name)
                pipeline = participant.build(self.scene, shot.plan, settings, outputs)
                sources.append(Source(name, pipeline))
        self._smooth = smoother(job.output.filter, self.runner.threads) if job.output.filter.on else None
        self.renderer = FrameRenderer(self.runner, sources, self.outputs, timing)
        says = job.method_object.history or any(p.history for p in job.participant_objects)
        if self.has_history and not says:
            raise ValueError("a pipeline holds history buffers, but nothing in the job says `history`")
        self._names = {
            "object": [o.name for o in prepared.scene.objects],
            "material": [o.material.name or o.name for o in prepared.scene.objects],
        }
        self._ids = {
            kind: np.array([name_id(name) for name in names], dtype=np.uint32)
            for kind, names in self._names.items()
        }
        self._settings = pixel_relevant(job)
        self._versions = pixel_versions(shot.engine, job.output.filter.kind)

    @property
    def has_history(self) -> bool:
        return self.renderer.has_history

    def close(self) -> None:
        self.runner.close()

    def __enter__(self) -> ShotRenderer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _next_number(self, number: int) -> int | None:
        """Of the frame that motion is told to, where it is asked for."""
        frames = self.prepared.shot.frames
        at = frames.index(number) + 1
        return frames[at] if "motion" in self.outputs.needs and at < len(frames) else None

    def _next_cameras(self, later: int | None) -> Mapping[str, Camera]:
        if later is None:
            return {}
        try:
            geometry = self.prepared.capture.geometry(later, self.prepared.shot.table)
            return pinholes(geometry, self.prepared.display)
        except InputError:
            return {}  # the next frame has no camera, so nothing is known to move

    def _show(self, time: float, number: int) -> None:
        """Puts the scene where it is at a moment of a frame."""
        with self.renderer.timing.measure("move"):
            self.scene.show(time, number)

    def render(
        self, number: int, history: Mapping[str, np.ndarray] | None, *, seed: int | None = None
    ) -> RenderedFrame:
        """One frame; `seed` in place of the job's. Raises InputError where its picture cannot be read."""
        start = time.perf_counter()
        prepared = self.prepared
        timing = TimingNode(f"frame {number}")
        with timing.measure("read"):
            exposed = self.exposure.frame(number)
            data = prepared.capture.frame(number, prepared.shot.table)
            next_number = self._next_number(number)
            later = self._next_cameras(next_number)
            shifts = None
            if later and next_number is not None and prepared.scene.moves:
                shifts = prepared.scene.shifts(number, next_number)
            views: dict[str, ViewInput] = {}
            mattes: dict[str, np.ndarray | None] = {}
            for view in self.outputs.views:
                given = data.views[view.name]
                size, window = prepared.display[view.name], prepared.windows[view.name]
                photo = framed(given.background, size, view.whole)
                views[view.name] = ViewInput(
                    camera=exposed.cameras[view.name],
                    background=framed(photo, size, window),
                    gain=np.asarray(given.gain, dtype=np.float64),
                    next_camera=later.get(view.name),
                    photo=photo,
                    shifts=shifts,
                )
                mattes[view.name] = None if given.matte is None else framed(given.matte, size, window)
        with timing.measure("move"):
            self.scene.show(number)
        tiles = {view.name: prepared.shot.plan.tiles[number, view.name] for view in self.outputs.views}
        seen = {view.name: prepared.shot.plan.seen[number, view.name] for view in self.outputs.views}
        self.renderer.timing = timing
        steering = self._steering(number, views, mattes)
        rendered = self.renderer.render(
            number,
            views,
            self.samples,
            steering=steering,
            tiles=tiles,
            seen=seen,
            history=history,
            looks=looks_at(exposed, prepared.scene, views, self._show) if self.outputs.shutter else (),
            seed=seed,
            progress=lambda share: self.progress(number, share),
        )
        smoothed: dict[str, Developed] = {}
        if self._smooth is not None:
            with timing.measure("filter"):
                for view in self.outputs.views:
                    guides = guides_of(view, rendered.buffers)
                    method = rendered.estimates[view.name]["method"]
                    smoothed[view.name] = filtered(method, guides, self._smooth)
        with timing.measure("develop"):
            images: dict[str, ViewImage] = {}
            composites: dict[str, np.ndarray] = {}
            noise: dict[str, Noise] = {}
            maps: dict[str, dict[str, object]] = {}
            for view in self.outputs.views:
                given, matte = views[view.name], mattes[view.name]
                estimates, relative, changed = self._estimates(
                    view, given, matte, rendered, smoothed.get(view.name)
                )
                made = channels(prepared.layers, estimates)
                images[view.name] = ViewImage(made, views[view.name].camera, self._cryptomatte_attributes())
                composites[view.name] = np.stack([made["R"], made["G"], made["B"]], axis=-1)
                window = view.window
                told = steering.noise if steering is not None else None
                noise[view.name] = (
                    told[view.name] if told else noise_of(relative, changed, (window.x, window.y))
                )
                maps[view.name] = noise_map(relative, changed).as_dict()
        targeted = steering is not None and steering.noise is not None
        counters = timing.total_counters()
        flags = (*data.flags, *(self.exposure.flags(number) if self.outputs.shutter else ()))
        job, shot = prepared.job, prepared.shot
        metadata = {
            "job_hash": prepared.job_hash,
            "frame": number,
            "time": data.time,
            "method": job.method_name,
            "settings": self._settings,
            "plan": {name: v.state for name, v in shot.plan.effects.items()},
            "influence": {view.name: shot.plan.influence[number, view.name] for view in self.outputs.views},
            "counters": counters,
            "seed": job.seed if seed is None else seed,
            "engine": shot.engine,
            "colour_type": shot.colour_reason,
            "error_estimate": {
                "relMSE": {name: found.relmse for name, found in noise.items()},
                "interval": {name: found.interval for name, found in noise.items()},
                "of": "noise, where something virtual changes the picture, from two halves of the samples; "
                "95 % interval" + ("" if targeted else ", from 16x16 tiles"),
            },
            "versions": self._versions,
            "flags": list(flags),
        }
        if steering is not None:
            metadata["accuracy"] = steering.as_dict()
        if self._smooth is not None:
            metadata["filter"] = {
                "kind": job.output.filter.kind,
                "radius": job.output.filter.reach,
                "of": "virtual light and light change; error_estimate and variance are those before it",
            }
        image = FrameImage(
            number=number,
            views=images,
            display=next(iter(prepared.display.values())),
            window=next(iter(prepared.windows.values())),
            colour_type=shot.colour_type,  # type: ignore[arg-type]
            compression=job.output.compression,
            frames_per_second=prepared.facts.frame_rate,
            owner=job.output.owner,
            metadata=metadata,
        )
        seconds = time.perf_counter() - start
        timing.seconds, timing.calls = seconds, 1
        self.timing.child("frames").merge(_renamed(timing, "frames"))
        worst = max(noise.values(), key=lambda found: found.relmse)
        details = {
            "time": data.time,
            "flags": list(flags),
            "threads": self.runner.threads,
            "units_per_launch": self.runner.units_per_launch or "by number of units and threads",
            "error": worst.relmse,
            "error_interval": worst.interval,
            "samples": self.samples if steering is None else steering.spp,
            "display": list(image.display),
            "window": list(astuple(image.data_window)),
            "changed_pixels": worst.pixels,
            "noise": maps,
            "timing": timing.as_dict(),
        }
        if steering is not None:
            details["accuracy"] = steering.as_dict()
        return RenderedFrame(image, counters, seconds, rendered.history or None, details, composites)

    @property
    def samples(self) -> int:
        return int(getattr(self.prepared.job.method, "spp", 2))

    def _steering(
        self, number: int, views: Mapping[str, ViewInput], mattes: Mapping[str, np.ndarray | None]
    ) -> ErrorTarget | TimeShare | None:
        """What decides over the samples, where the job asks for an error or has a limit of time."""
        job = self.prepared.job
        unit = job.shutter.samples if job.shutter is not None and self.outputs.shutter else 1
        referee: Referee | None = None
        if job.accuracy.time_limit is not None and self.referee is not None:
            referee = self.referee(number)
        if job.accuracy.target is None:
            most = (self.samples + 1) // 2
            return TimeShare(referee, most=most, unit=unit) if referee is not None else None

        def judge(name: str, sources: Mapping[str, Developed]) -> Judged:
            return judged(views[name].background, mattes[name], sources)

        return ErrorTarget(
            job.accuracy.target,
            {view.name: view.window for view in self.outputs.views},
            judge,
            batch=max(source.pipeline.batch for source in self.renderer.sources),
            limit=job.accuracy.max_spp // 2,
            unit=unit,
            referee=referee,
        )

    def _estimates(
        self,
        view: ViewOutput,
        given: ViewInput,
        matte: np.ndarray | None,
        rendered: Any,
        smoothed: Developed | None,
    ) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray]:
        """Host arrays by `layers.ESTIMATES`; relative squared noise (h, w); which pixels changed (h, w).

        `smoothed`: what a filter made of the method's estimate. The noise is that of the samples, before it.
        """
        sources = rendered.estimates[view.name]
        laid = laid_over(sources if smoothed is None else {**sources, "method": smoothed}, matte)
        estimates = {
            "P": laid.P,
            "a": laid.a,
            "D": laid.D,
            "B": given.background,
            "variance": variance_of(sources, matte, lambda d: (d.variance, d.a)),
            "samples": np.maximum.reduce([developed.samples for developed in sources.values()]),
        }
        if laid.D_indirect is not None:
            estimates["D_indirect"] = laid.D_indirect
        data = first_hit_estimates(view, self.outputs, rendered.buffers, self._ids)
        estimates.update(data if matte is None else data_behind_matte(data, matte))
        made = composited(given.background, matte, sources)
        noise = relative_square(made.picture, noise_between(*made.halves), made.changed)
        return estimates, noise, made.changed

    def _cryptomatte_attributes(self) -> dict[str, str]:
        from mrbatch.film import cryptomatte

        found: dict[str, str] = {}
        for layer, name in CRYPTOMATTES.items():
            if layer in self.prepared.layers:
                found.update(cryptomatte.metadata(name, self._names[layer.removeprefix("crypto_")]))
        return found


def pixel_versions(engine: str, filtering: str) -> dict[str, str]:
    """Of this program and the libraries that a frame's bytes go through."""
    from importlib.metadata import PackageNotFoundError, version

    found = {"mrbatch": __version__}
    parts = [("embreex", engine == "embree"), ("scipy", filtering != "none"), ("pyoidn", filtering == "oidn")]
    for name in ("warp-lang", "numpy", "OpenImageIO", *(name for name, used in parts if used)):
        with contextlib.suppress(PackageNotFoundError):
            found[name] = version(name)
    return found


def _renamed(node: TimingNode, name: str) -> TimingNode:
    return TimingNode(
        name, node.seconds, node.thread_seconds, node.calls, node.launches, node.counters, node.children
    )
