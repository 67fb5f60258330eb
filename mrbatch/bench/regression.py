"""Whether a job still renders what it did: tiny renderings under several seeds, against a stored baseline.

Exact gates: every number is finite, the plan calls for the same effects, and with the same seeds the work
counters are the same to the digit. Statistical gates: means of layers over the frame, and of the composite in
16 x 16 tiles, by Welch's t-test over the seeds, each seed a picture of its own, so that nothing is assumed of
the noise within one. All tests of a job together raise a false alarm with a chance of `FALSE_ALARM`. How many
samples it takes to see `SEEN` of bias in each layer is found when the baseline is made.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mrbatch import __version__
from mrbatch.batch.prepare import Prepared, look_at, open_capture, prepare
from mrbatch.batch.render import ShotRenderer
from mrbatch.batch.shot import content_hash
from mrbatch.bench.baseline import Baseline, FrameBaseline, baseline_path, load_baseline
from mrbatch.bench.regression_gates import FALSE_ALARM, judge
from mrbatch.bench.variants import solved
from mrbatch.device.timing import TimingNode
from mrbatch.errors import EXIT_GATE, JobError, Place, worst_exit_code
from mrbatch.job import load_job, select_frames
from mrbatch.metrics.tiles import tile_edges, tile_sums
from mrbatch.report import numbers
from mrbatch.report.model import Frame, Gate, Job, Note, Picture, Report, Totals
from mrbatch.report.pictures import display_codes

SEEDS = 16
SIZE = 96
"""Pixels of the longer side."""
SEEN = 0.03
"""Relative bias of a layer that shall be seen with a chance of 95 %."""
FIRST_SPP, MOST_SPP = 8, 512
LAYERS = ("virtual", "delta")


@dataclass(frozen=True)
class Measured:
    """A job's tiny renderings; `gaps`: by frame what was not finite; `pictures`: the first seed's composites,
    uint8 RGB by name."""

    baseline: Baseline
    gaps: dict[int, str]
    pictures: dict[str, np.ndarray]


def check_jobs(
    jobs: Sequence[Path],
    *,
    store: Path | None = None,
    update: bool = False,
    settings: Sequence[str] = (),
    seed: int | None = None,
    size: int = SIZE,
    threads: int | None = None,
    told: Callable[[str], None] = lambda text: None,
) -> tuple[Report, dict[str, np.ndarray]]:
    """Renders each job's first, middle and last frame, tiny, and judges them by the baseline; with `update`
    that is written anew, and what would have been judged is told all the same. Gives the report and its
    pictures (uint8 RGB by name). `seed`: of the first of the seeds, in place of the baseline's.

    Raises JobError where there is no baseline, or the job has changed since; MrbatchError for a job that
    cannot be used.
    """
    gates: list[Gate] = []
    notes: list[Note] = []
    frames: list[Frame] = []
    pictures: list[Picture] = []
    images: dict[str, np.ndarray] = {}
    counters: dict[str, int] = {}
    for path in jobs:
        place = baseline_path(path, store)
        stored = load_baseline(place)
        if stored is None and not update:
            raise JobError(
                "this job has no baseline", place=Place(file=str(place)), hint="make one with `--update`"
            )
        made = _measured(path, stored, update, settings, seed, size, threads, told)
        name = made.baseline.job
        found = _finite(made)
        finite = all(gate.passed for gate in found)
        if stored is not None and stored.key == made.baseline.key and stored.scale == made.baseline.scale:
            found += judge(stored, made.baseline)
        elif stored is not None:
            notes.append(Note(level="info", text=f"{name}: the job itself has changed"))
        if update and finite:
            for gate in found:
                if not gate.passed:
                    figures = f": {numbers.quantity(gate.measured)}" if gate.measured else ""
                    notes.append(
                        Note(level="info", text=f"{name}: changed: {gate.text}{figures}", frame=gate.frame)
                    )
            text = "no baseline before" if stored is None else "the baseline is written anew"
            notes.append(
                Note(level="info", text=f"{name}: {text}, {made.baseline.spp} samples a pixel a seed")
            )
            made.baseline.save(place)
            found = [gate for gate in found if gate.passed]
        gates += [gate.model_copy(update={"name": f"{name}: {gate.name}"}) for gate in found]
        for number in made.baseline.frames:
            state = "failed" if number in made.gaps else "done"
            frames.append(Frame(number=number, state=state, message=made.gaps.get(number, "")))
        for rendered in made.baseline.frames.values():
            for counter, values in rendered.counters.items():
                counters[counter] = counters.get(counter, 0) + sum(values)
        for key, shown in made.pictures.items():
            pictures.append(Picture(role="composite", path=f"{name}#{key}", caption=f"{name}, frame {key}"))
            images[f"{name}#{key}"] = shown
    codes = [EXIT_GATE for gate in gates if not gate.passed]
    report = Report(
        kind="ci",
        job=Job(name=", ".join(path.stem for path in jobs)),
        versions={"mrbatch": __version__},
        frames=tuple(frames),
        totals=Totals(
            frames_done=sum(f.state == "done" for f in frames),
            frames_failed=sum(f.state == "failed" for f in frames),
            counters=counters,
        ),
        notes=tuple(notes),
        pictures=tuple(pictures),
        gates=tuple(gates),
        exit=worst_exit_code(codes),
    )
    return report, images


def _measured(
    path: Path,
    stored: Baseline | None,
    update: bool,
    settings: Sequence[str],
    seed: int | None,
    size: int,
    threads: int | None,
    told: Callable[[str], None],
) -> Measured:
    timing = TimingNode("ci")
    plain = ["accuracy.target_error=null", "accuracy.quality=null", "accuracy.time_limit=null"]
    job = load_job(path, [*settings, *plain])
    opened = look_at(job, open_capture(job, timing)[0], timing)
    key = content_hash({name: part for name, part in opened.facts.items() if name != "version"})
    if stored is not None and stored.key != key and not update:
        raise JobError(
            "the job is not the one that the baseline was made of: its settings or its inputs have changed",
            place=Place(file=str(path)),
            hint="look at what changed, then `--update`",
        )
    whole = prepare(job, timing, opened=opened)
    opened = solved(opened, whole)
    # A baseline that is made anew owes the old one nothing.
    kept = None if update else stored
    longest = max(max(pixels) for pixels in whole.display.values())
    scale = min(job.output.scale, job.output.scale * size / longest) if kept is None else kept.scale
    layers = [layer for layer in LAYERS if layer in job.method_object.layers]
    tiny = [f"output.scale={scale!r}", f"output.layers=[{','.join(layers) or 'composite'}]"]
    frames = select_frames(job.frames, whole.shot.frames)
    chosen = sorted({frames[0], frames[len(frames) // 2], frames[-1]})
    first = seed if seed is not None else job.seed if kept is None else kept.seeds[0]
    seeds = tuple((first + n) % (1 << 32) for n in range(SEEDS))

    def measured(spp: int) -> Measured:
        told(f"{job.name}: {len(chosen)} frames, {len(seeds)} seeds, {spp} samples a pixel")
        asked = load_job(path, [*settings, *plain, *tiny, f"method.spp={spp}"])
        prepared = prepare(asked, timing, opened=opened)
        found, gaps, pictures = _frames(prepared, chosen, seeds, threads)
        effects = {name: verdict.state for name, verdict in prepared.shot.plan.effects.items()}
        made = Baseline(
            job=job.name, key=key, scale=scale, spp=spp, seeds=seeds, effects=effects, frames=found
        )
        return Measured(made, gaps, pictures)

    if kept is not None:
        return measured(kept.spp)
    made = measured(FIRST_SPP)
    if made.gaps:
        return made
    short = max(
        (shortfall(frame.means, layer) for frame in made.baseline.frames.values() for layer in layers),
        default=0.0,
    )
    wanted = 2 ** math.ceil(math.log2(max(1.0, short) ** 2 * FIRST_SPP))
    return measured(min(wanted, MOST_SPP)) if wanted > FIRST_SPP else made


def _frames(
    prepared: Prepared, chosen: Sequence[int], seeds: Sequence[int], threads: int | None
) -> tuple[dict[int, FrameBaseline], dict[int, str], dict[str, np.ndarray]]:
    """Of each frame the baseline; by frame what was not finite; the first seed's composites."""
    frames: dict[int, FrameBaseline] = {}
    gaps: dict[int, str] = {}
    pictures: dict[str, np.ndarray] = {}
    with ShotRenderer(prepared, TimingNode("ci"), threads=threads) as shot:
        for number in chosen:
            counters: dict[str, list[int]] = {}
            means: dict[str, list[float]] = {}
            tiles: list[list[float]] = []
            places: list[str] = []
            for seed in seeds:
                rendered = shot.render(number, None, seed=seed)
                places, row = [], []
                for view, image in rendered.image.views.items():
                    title = f"{view} " if view else ""
                    broken = [
                        name for name, values in image.channels.items() if not np.isfinite(values).all()
                    ]
                    if broken:
                        gaps[number] = f"{title}{broken[0]} of seed {seed} is not finite"
                        continue
                    if seed == seeds[0]:
                        pictures[f"{number}{f' {view}' if view else ''}"] = display_codes(
                            rendered.composites[view]
                        )
                    for name, values in image.channels.items():
                        if name.split(".")[0] in LAYERS and name[-1] in "RGB":
                            means.setdefault(title + name, []).append(float(values.mean(dtype=np.float64)))
                    window = prepared.windows[view]
                    sums, where = _tiles(rendered.composites[view], (window.x, window.y))
                    row += sums.ravel().tolist()
                    places += [f"{title}{place} {channel}" for place in where for channel in "RGB"]
                tiles.append(row)
                for name, count in rendered.counters.items():
                    counters.setdefault(name, []).append(int(count))
            if number in gaps:
                means, tiles, places = {}, [[] for _ in seeds], []
            frames[number] = FrameBaseline(
                counters={name: tuple(values) for name, values in counters.items()},
                means={name: tuple(values) for name, values in means.items()},
                tiles=tuple(tuple(row) for row in tiles),
                tile_places=tuple(places),
            )
    return frames, gaps, pictures


def _tiles(picture: np.ndarray, origin: tuple[int, int]) -> tuple[np.ndarray, list[str]]:
    """(tiles, 3) means, and the first pixel of each in words."""
    pixels = tile_sums(np.ones(picture.shape[:2]), origin)
    means = np.stack([tile_sums(picture[..., c], origin) / pixels for c in range(3)], axis=-1)
    rows, columns = tile_edges(picture.shape[0], origin[1]), tile_edges(picture.shape[1], origin[0])
    where = [f"tile at {x + origin[0]}, {y + origin[1]}" for y in rows for x in columns]
    return means.reshape(-1, 3), where


def shortfall(means: dict[str, tuple[float, ...]], layer: str) -> float:
    """By how many times the noise of a layer's best channel is too large for `SEEN` to be seen: what is below
    1 will do. 0 where the layer is black."""
    from scipy.stats import t

    degrees = 2 * (SEEDS - 1)
    tests = max(1, 3 * len(means))
    needed = t.isf(FALSE_ALARM / 4 / tests, degrees) + t.isf(0.05, degrees)
    found = []
    for name, values in means.items():
        mean = abs(float(np.mean(values)))
        if name.rsplit(" ", 1)[-1].startswith(f"{layer}.") and mean > 0.0:
            error = float(np.std(values, ddof=1)) * math.sqrt(2 / len(values))
            found.append(needed * error / (SEEN * mean))
    return min(found, default=0.0)


def _finite(made: Measured) -> list[Gate]:
    return [
        Gate(
            name="finite",
            passed=number not in made.gaps,
            text=made.gaps.get(number, "every number is finite"),
            frame=number,
        )
        for number in made.baseline.frames
    ]


def failures(report: Report) -> list[str]:
    """A sentence for each gate that failed."""
    return [
        f"{gate.name}{f' (frame {gate.frame})' if gate.frame is not None else ''}: {gate.text}"
        + (f": {numbers.quantity(gate.measured)}" if gate.measured else "")
        for gate in report.gates
        if not gate.passed
    ]
