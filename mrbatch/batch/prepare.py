"""Prepare: the shot is seen once, whole; what is found goes into `shot/` and to every worker."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mrbatch import __version__
from mrbatch.batch.commit import hash_file
from mrbatch.batch.exposure import Exposure
from mrbatch.batch.framing import data_window, display_size
from mrbatch.batch.history import Segment, cut_segments
from mrbatch.batch.shot import Shot, commit_shot, content_hash, load_shot
from mrbatch.batch.shot_light import KEY, find_turn, needs_a_frame, turned
from mrbatch.capture.frame import CaptureFacts, ViewGeometry
from mrbatch.capture.registry import CAPTURES
from mrbatch.contracts import Capture, Progress, Rule
from mrbatch.device.rays import resolve_engine
from mrbatch.device.timing import TimingNode
from mrbatch.effects.facts import FrameFacts, ShotFacts
from mrbatch.effects.plan import make_plan
from mrbatch.errors import InputError, JobError, Place, ResourceError
from mrbatch.film.exr import choose_colour_type
from mrbatch.film.guides import NEED
from mrbatch.film.layers import needs
from mrbatch.film.window import Window
from mrbatch.job.confine import check_confined
from mrbatch.job.files import there
from mrbatch.job.model import Job
from mrbatch.job.naming import tells_where_named
from mrbatch.job.paths import job_paths
from mrbatch.job.resolve import pixel_relevant, placeless
from mrbatch.scene.build import CameraOf, build_scene, needs_cameras, scene_files
from mrbatch.scene.camera import Camera
from mrbatch.scene.motion import Clock
from mrbatch.scene.scene import Scene


@dataclass(frozen=True)
class Prepared:
    """A job ready to be rendered: opened capture, scene, shot, and the hash that names its pixels."""

    job: Job
    capture: Capture
    facts: CaptureFacts
    scene: Scene
    shot: Shot
    job_hash: str
    display: Mapping[str, tuple[int, int]]
    windows: Mapping[str, Window]
    layers: tuple[str, ...]
    needs: frozenset[str]

    @property
    def exposure(self) -> Exposure:
        """What of each frame is known before its picture is read."""
        shot = self.shot
        return _exposure(self.job, self.capture, shot.table, self.scene, self.display, shot.frames)

    @property
    def absent(self) -> dict[int, InputError]:
        """Frames that belong to the shot and can never be rendered, with the reason."""
        return {
            int(number): InputError(str(message), place=Place(frame=int(number)))
            for number, message in self.shot.table.get("absent", {}).items()
        }


@dataclass(frozen=True)
class Opened:
    """A job whose files have been looked at, before anything is solved or planned.

    `facts`: what the shot is made of, JSON-ready: `settings` that pixels depend on, `inputs` (content hash by
    name), `engine` asked for, `version`; `key`: their hash.
    """

    capture: Capture
    facts: Mapping[str, Any]

    @property
    def key(self) -> str:
        return content_hash(self.facts)


def own_facts(job: Job) -> dict[str, Any]:
    """The part of `Opened.facts` that needs no file."""
    return {"settings": pixel_relevant(job), "engine": job.engine, "version": __version__}


def no_progress(step: str, done: int, total: int, detail: str = "") -> None:
    """For those who do not listen."""


def input_hashes(
    files: Sequence[Path], folder: Path, progress: Progress = no_progress
) -> list[tuple[str, str]]:
    """Name and content hash of every input, in the order in which the settings name them.

    Names say nothing of where folders lie, so two inputs may share one: their order tells them apart, and
    a file named twice stands there twice. Raises InputError.
    """
    digests: dict[Path, str] = {}
    each = list(dict.fromkeys(files))
    for done, path in enumerate(each):
        progress("reading inputs", done, len(each))
        try:
            digests[path] = hash_file(path)
        except OSError as error:
            raise InputError(
                f"cannot read the file: {error.strerror or error}",
                place=Place(file=str(path)),
                hint="check the path, which counts from the job file, and its rights",
            ) from error
    return [(placeless(path, folder), digests[path]) for path in files]


def layer_names(job: Job) -> tuple[str, ...]:
    """The composite, then what the job asks for."""
    return tuple(dict.fromkeys(("composite", *(job.output.layers or ()))))


def output_views(
    job: Job, geometry: Mapping[str, ViewGeometry]
) -> tuple[dict[str, tuple[int, int]], dict[str, Window]]:
    """Picture size and data window by view. Raises InputError for views of different sizes."""
    display = {name: display_size(job.output, view.camera) for name, view in geometry.items()}
    if len(set(display.values())) > 1:
        sizes = ", ".join(f"{name} {w} x {h}" for name, (w, h) in display.items())
        raise InputError(
            f"the views have different sizes: {sizes}",
            hint="the views of a frame share one file: bring them to one size",
        )
    return display, {name: data_window(job.output, size) for name, size in display.items()}


@tells_where_named
def open_capture(job: Job, timing: TimingNode) -> tuple[Capture, tuple[int, ...]]:
    """The capture and the numbers of the frames that it should have. Raises InputError."""
    with timing.measure("open"):
        capture: Capture = CAPTURES.get(job.capture_kind).open(job.capture, job.folder)
        return capture, tuple(int(n) for n in capture.announced_numbers())


@tells_where_named
def look_at(job: Job, capture: Capture, timing: TimingNode, progress: Progress = no_progress) -> Opened:
    """Hashes every input of an opened capture. Raises InputError, JobErrors for files outside the fence."""
    with timing.measure("open"):
        files = [Path(p) for p in capture.inputs()]
        files += scene_files(job.environment, job.real, job.virtual)
        paths = [path for loc, path, _ in job_paths(job) if loc[0] in ("method", "participants")]
        files += [file for path in paths for file in there(path)]
    # Patterns and meshes name files that the job's own paths do not tell.
    check_confined(files, job.fence)
    with timing.measure("hash inputs"):
        inputs = [list(pair) for pair in input_hashes(files, job.folder, progress)]
    return Opened(capture, {**own_facts(job), "inputs": inputs})


@tells_where_named
def prepare(
    job: Job,
    timing: TimingNode,
    *,
    directory: Path | None = None,
    write: bool = False,
    owner: str = "",
    opened: Opened | None = None,
    progress: Progress = no_progress,
) -> Prepared:
    """Opens the capture (unless it is `opened`), solves what the whole shot is needed for, and plans.

    With `directory`, a shot that was written there before is taken as it is; with `write`, a new one
    is committed there. Raises InputError for input that cannot be used, ResourceError for an engine or
    a filter that is not available.
    """
    if job.output.filter.kind == "oidn":
        from mrbatch.film.filter.oidn import load_oidn

        load_oidn()  # better missed now than after the shot is solved
    if opened is None:
        opened = look_at(job, open_capture(job, timing)[0], timing, progress)
    capture, key = opened.capture, opened.key
    scene = None
    probe = needs_a_frame(job.environment)
    if not probe and not needs_cameras(job.real):
        # What is wrong with its files is told before the shot is solved.
        with timing.measure("scene"):
            scene = build_scene(job.environment, job.real, job.virtual)
    shot = load_shot(directory, key) if directory else None
    table = shot.table if shot else None
    if table is None:
        with timing.measure("capture"):
            table = dict(capture.prepare(progress))
        if probe and job.environment is not None:
            with timing.measure("mirror ball"):
                table[KEY] = find_turn(job.environment, capture, table)
    if scene is None:
        with timing.measure("scene"):
            cameras = _cameras(capture, table)
            scene = build_scene(job.environment, job.real, job.virtual, cameras, turned(table))
    facts: CaptureFacts = capture.facts(table)
    if scene.plays:
        scene = scene.by(clock_of(table, facts))
    numbers = shot.frames if shot else tuple(int(n) for n in capture.frame_numbers())
    if not numbers:
        raise InputError("the capture has no usable frame")
    display, windows = output_views(job, _first_geometry(capture, table, numbers))
    layers = layer_names(job)
    wanted = needs(layers) | ({NEED} if job.output.filter.on else frozenset())
    if shot is None:
        progress("planning the effects", 0, len(numbers))
        with timing.measure("plan"):
            shot = _plan(job, key, table, capture, facts, scene, numbers, windows, wanted)
        if directory is not None and write:
            commit_shot(directory, shot, owner)
    elif job.engine != "warp" and shot.engine == "embree" and resolve_engine("auto") != "embree":
        raise ResourceError(
            "this shot was prepared with the ray engine Embree, which is not available here",
            hint="render it all with --set engine=warp, in another folder",
        )
    job_hash = content_hash({"key": key, "shot": shot.hash, "engine": shot.engine, "version": __version__})
    return Prepared(job, capture, facts, scene, shot, job_hash, display, windows, layers, wanted)


def _cameras(capture: Capture, table: Mapping[str, Any]) -> CameraOf:
    """Of a frame's first view."""
    return lambda number: next(iter(capture.geometry(number, table).values())).camera


def _exposure(
    job: Job,
    capture: Capture,
    table: Mapping[str, Any],
    scene: Scene,
    display: Mapping[str, tuple[int, int]],
    numbers: tuple[int, ...],
) -> Exposure:
    """Of the shot's frames, those that cannot be rendered among them."""
    announced = sorted({*numbers, *(int(n) for n in table.get("absent", {}))})
    return Exposure(job, capture, table, scene, display, announced)


def clock_of(table: Mapping[str, Any], facts: CaptureFacts) -> Clock:
    """Which second each frame is shown at. Raises InputError where nothing tells."""
    frames, seconds = (np.asarray(table.get(key, ()), dtype=np.float64) for key in ("frames", "times"))
    if facts.frame_rate is None or not len(frames) or len(frames) != len(seconds):
        raise InputError(
            "the footage does not say how fast it runs, so no `clip` can be played",
            hint="give `capture.frame_rate`",
        )
    return Clock(frames, seconds, float(facts.frame_rate))


def _first_geometry(
    capture: Capture, table: Mapping[str, Any], numbers: tuple[int, ...]
) -> Mapping[str, ViewGeometry]:
    """Of the first frame that can be used; raises the last frame's InputError where none can."""
    for number in numbers[:-1]:
        with contextlib.suppress(InputError):
            return capture.geometry(number, table)
    return capture.geometry(numbers[-1], table)


def first_cameras(prepared: Prepared) -> Mapping[str, Camera]:
    """Cameras by view of the first usable frame."""
    geometry = _first_geometry(prepared.capture, prepared.shot.table, prepared.shot.frames)
    return {name: view.camera for name, view in geometry.items()}


def _usable_facts(exposure: Exposure, numbers: tuple[int, ...]) -> Iterator[FrameFacts]:
    """Of every frame that is not broken; a broken one says so when it is rendered."""
    for number in numbers:
        with contextlib.suppress(InputError):
            yield exposure.frame(number)


def _plan(
    job: Job,
    key: str,
    table: Mapping[str, Any],
    capture: Capture,
    facts: CaptureFacts,
    scene: Scene,
    numbers: tuple[int, ...],
    windows: Mapping[str, Window],
    wanted: frozenset[str],
) -> Shot:
    display, _ = output_views(job, _first_geometry(capture, table, numbers))
    exposure = _exposure(job, capture, table, scene, display, numbers)
    # Where none can be used, the last one says why.
    frames = tuple(_usable_facts(exposure, numbers)) or (exposure.frame(numbers[-1]),)
    shot_facts = ShotFacts(
        scene=scene,
        frames=frames,
        windows=windows,
        settings=job.method,
        layers=wanted,
        half_code=facts.half_code,
        everywhere=bool(job.participants),
    )
    plan = make_plan(_rules(job), shot_facts, job.effects)
    for part, effect in (("lens", "depth-of-field"), ("shutter", "motion-blur")):
        if getattr(job, part) is not None and effect not in plan.effects:
            raise JobError(
                f"the method `{job.method_name}` does not simulate `{part}`", hint=f"leave out `{part}`"
            )
    most_gain = max(float(np.max(g)) for f in frames for g in f.gains.values())
    sources = [float(scene.environment.radiance.max(initial=0.0))]
    # A real lamp counts too: a virtual mirror may show it.
    sources += [float(o.material.most_emission.max()) for o in scene.objects]
    peak = max(sources) * most_gain
    if job.output.dtype == "auto":
        colour_type, reason = choose_colour_type(
            facts.source_bits,
            peak,
            transfer=facts.transfer,
            source_is_half=facts.source_is_float and facts.source_bits == 16,
        )
    else:
        colour_type, reason = job.output.dtype, "asked for by the job"
    return Shot(
        key=key,
        table=table,
        frames=numbers,
        engine=resolve_engine(job.engine),
        colour_type=colour_type,
        colour_reason=reason,
        plan=plan,
        segments=_segments(job, table, numbers),
        notes=(*facts.notes, *scene.notes),
    )


def _rules(job: Job) -> tuple[Rule, ...]:
    """The method's rules and the participants', each looking at the settings of its own."""

    def of(rule: Rule, settings: Any) -> Rule:
        return replace(rule, decide=lambda facts: rule.decide(replace(facts, settings=settings)))

    found = list(job.method_object.rules)
    for participant, settings in zip(job.participant_objects, job.participants, strict=True):
        found += [of(rule, settings) for rule in participant.rules]
    return tuple(found)


def _segments(job: Job, table: Mapping[str, Any], numbers: tuple[int, ...]) -> tuple[Segment, ...]:
    """How far history is carried: never over the capture's cuts, nor further than whoever keeps it says."""
    asked = [job.method_object.segment(job.method)] if job.method_object.history else []
    asked += [
        participant.segment(settings)
        for participant, settings in zip(job.participant_objects, job.participants, strict=True)
        if participant.history
    ]
    lengths = [length for length, _ in asked if length is not None]
    return cut_segments(
        numbers,
        cuts=table.get("cuts", ()),
        length=min(lengths, default=None),
        warm_up=max((warm_up for _, warm_up in asked), default=0),
    )
