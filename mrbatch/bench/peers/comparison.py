"""A job against another renderer: seconds of whole jobs, start included, at the same noise.

Noise is read off two pictures of different seeds, (a - b)^2 / 2, so each renderer is held against its own
mean and none is charged for what another models differently; how far the means lie apart is told beside it.
Jobs are whole processes that read their files, render all frames and write them, in turns; ours also finds
the marker and decodes the footage, the others are given poses and pictures. Kernels of ours lie compiled on
disk, as after any first run; what others keep, they keep.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from mrbatch.batch.prepare import prepare
from mrbatch.bench.peers.export import export
from mrbatch.device.timing import TimingNode
from mrbatch.errors import MrbatchError
from mrbatch.job import load_job, select_frames
from mrbatch.metrics.errors import image_errors
from mrbatch.metrics.region import region_of_interest
from mrbatch.metrics.statistics import Interval, paired_ratio

Peer = Literal["mitsuba", "blender"]
SCRIPTS = {"mitsuba": "mitsuba_difference.py", "blender": "blender_catcher.py"}
STEPS = 4
CLOSE = 0.15
"""The search for samples ends this near to the noise asked for."""


_Job = Callable[[int, int, Sequence[int]], tuple[float, list[np.ndarray]]]
"""Samples a pixel, seed, frames: seconds, and the pictures of those frames that are looked at."""


@dataclass(frozen=True)
class Side:
    """One renderer: samples a pixel, relMSE of its noise on the region of interest, mean of the frames, and
    seconds of each whole job."""

    name: str
    spp: int
    noise: float
    seconds: tuple[float, ...]


@dataclass(frozen=True)
class PeerComparison:
    """`ratio`: the peer's seconds over ours, in pairs, at the noise that each has; `at_equal_noise`: the same
    times the peer's noise over ours, as if noise fell as 1 / samples. `apart`: relMSE of the means of both
    on the region, less what their noise explains. `region`: pixels of the region, mean of the frames."""

    ours: Side
    peer: Side
    ratio: Interval
    at_equal_noise: Interval
    apart: float
    region: float
    frames: tuple[int, ...]
    target: float


def compare(
    job: Path,
    peer: Peer,
    *,
    folder: Path,
    python: str = sys.executable,
    settings: Sequence[str] = (),
    relmse: float = 1e-3,
    repeats: int = 3,
    spp: tuple[int, int] = (16, 64),
    threads: int = 2,
    noise_of: Sequence[int] = (),
    said: Callable[[str], None] = lambda text: None,
) -> PeerComparison:
    """Looks for the samples a pixel of both, from `spp` (ours, the peer's) on, then times them in turns.

    `python`: the interpreter that has the peer. `noise_of`: numbers of the job's frames whose noise stands
    for all (none: every frame); seconds are those of the whole job. Fewer `repeats` than 3 give an interval
    that says nothing. Raises MrbatchError where a job cannot be exported or a renderer fails.
    """
    settled = load_job(job, list(settings))
    prepared = prepare(settled, TimingNode("bench"))
    numbers = select_frames(settled.frames, prepared.shot.frames)
    if not set(noise_of) <= set(numbers):
        raise MrbatchError(f"the job renders no such frames: {sorted(set(noise_of) - set(numbers))}")
    looked_at = tuple(n for n in numbers if n in noise_of) or numbers
    scene = folder / "scene"
    export(prepared, numbers, scene)
    captured = export(prepared, looked_at, folder / "looked at")
    name = prepared.job.name

    def our_job(samples: int, seed: int, frames: Sequence[int]) -> tuple[float, list[np.ndarray]]:
        output = folder / "ours"
        command = [sys.executable, "-m", "mrbatch", "render", str(job), "--overwrite", "--no-report"]
        command += ["--output", str(output), "--seed", str(seed)]
        command += ["--progress", "none", "--threads", str(threads)]
        command += ["--frames", ",".join(map(str, frames))]
        for setting in (*settings, f"method.spp={samples}"):
            command += ["--set", setting]
        seconds = _run(command)
        return seconds, [_read(output / f"{name}.{n:04d}.exr")[0][..., :3] for n in looked_at]

    def peer_job(samples: int, seed: int, frames: Sequence[int]) -> tuple[float, list[np.ndarray]]:
        output = folder / peer
        script = Path(__file__).parent / SCRIPTS[peer]
        given = scene if frames == numbers else folder / "looked at"
        command = [python, str(script), str(given), str(output), "--spp", str(samples), "--seed", str(seed)]
        seconds = _run(command)
        pictures = []
        for n, (photo, gain) in zip(looked_at, captured):
            pixels, channels = _read(output / f"{n:04d}.exr")
            pictures.append(caught(pixels, channels, photo, gain) if peer == "blender" else pixels[..., :3])
        return seconds, pictures

    said("ours, for the region of interest")
    first = [our_job(max(64, spp[0]), seed, looked_at)[1] for seed in (101, 102)]
    regions = [
        region_of_interest((a + b) / 2, photo, deviation=np.abs(a - b) / 2)
        for a, b, (photo, _) in zip(*first, captured)
    ]
    references = [(a + b) / 2 for a, b in zip(*first)]

    def search(title: str, run: _Job, samples: int) -> _Found:
        for step in range(STEPS):
            a, b = run(samples, 1, looked_at)[1], run(samples, 2, looked_at)[1]
            noise = _mean_relmse([(x - y) / np.sqrt(2) for x, y in zip(a, b)], references, regions)
            said(f"{title}: {samples} samples a pixel, relMSE {noise:.3g}")
            wanted = max(2, 2 * round(samples * noise / relmse / 2))
            if abs(noise / relmse - 1) <= CLOSE or wanted == samples or step == STEPS - 1:
                break
            samples = wanted
        return _Found(samples, noise, [(x + y) / 2 for x, y in zip(a, b)])

    mine = search("ours", our_job, spp[0])
    theirs = search(peer, peer_job, spp[1])
    spent: dict[str, list[float]] = {"ours": [], peer: []}
    for turn in range(repeats):
        order = [("ours", our_job, mine), (peer, peer_job, theirs)]
        for title, run, found in order if turn % 2 == 0 else order[::-1]:
            spent[title].append(run(found.spp, 11 + turn, numbers)[0])
            said(f"{title}: {spent[title][-1]:.2f} s")
    ratio = paired_ratio(spent[peer], spent["ours"], seed=1)
    scale = theirs.noise / mine.noise
    apart = _mean_relmse([x - y for x, y in zip(theirs.mean, mine.mean)], references, regions)
    return PeerComparison(
        ours=Side("mrbatch", mine.spp, mine.noise, tuple(spent["ours"])),
        peer=Side(peer, theirs.spp, theirs.noise, tuple(spent[peer])),
        ratio=ratio,
        at_equal_noise=replace(
            ratio, value=ratio.value * scale, low=ratio.low * scale, high=ratio.high * scale
        ),
        apart=max(0.0, apart - (theirs.noise + mine.noise) / 2),
        region=float(np.mean([r.sum() for r in regions])),
        frames=numbers,
        target=relmse,
    )


@dataclass(frozen=True)
class _Found:
    spp: int
    noise: float
    mean: list[np.ndarray]


def _run(command: Sequence[str]) -> float:
    before = time.perf_counter()
    try:
        done = subprocess.run(command, capture_output=True, text=True)
    except OSError as error:
        raise MrbatchError(f"cannot run {command[0]}: {error.strerror}") from None
    seconds = time.perf_counter() - before
    if done.returncode != 0:
        last = (done.stderr.strip() or done.stdout.strip()).splitlines()[-1:]
        raise MrbatchError(f"{Path(command[1]).name} ended with code {done.returncode}: {' '.join(last)}")
    return seconds


def _read(path: Path) -> tuple[np.ndarray, tuple[str, ...]]:
    import OpenImageIO as oiio

    picture = oiio.ImageBuf(str(path))
    return np.asarray(picture.get_pixels(oiio.FLOAT)), tuple(picture.spec().channelnames)


def caught(pixels: np.ndarray, channels: Sequence[str], photo: np.ndarray, gain: np.ndarray) -> np.ndarray:
    """The composite of Blender's passes: what is virtual over the photo times the catcher pass."""

    def layer(name: str, parts: str) -> np.ndarray:
        places = [i for p in parts for i, c in enumerate(channels) if c.endswith(f"{name}.{p}")]
        if len(places) != len(parts):
            raise MrbatchError(
                f"Blender wrote no pass `{name}`: its version is another than the script is for"
            )
        return pixels[..., places]

    combined, catcher = layer("Combined", "RGBA"), layer("Shadow Catcher", "RGB")
    return np.maximum(combined[..., :3] * gain, 0.0) + (1.0 - combined[..., 3:]) * photo * catcher


def _mean_relmse(
    differences: Sequence[np.ndarray], references: Sequence[np.ndarray], regions: Sequence[np.ndarray]
) -> float:
    errors = []
    for difference, reference, region in zip(differences, references, regions):
        found = image_errors(reference + difference, reference, region=region, flip=False)
        assert found.region is not None
        errors.append(found.region.relmse)
    return float(np.mean(errors))
