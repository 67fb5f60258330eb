"""The sample's composite against the picture of the scene with the virtual objects really there.

Poses and linear photos are the true ones, so that only Monte Carlo noise stands between the two. The
truth was path traced with all objects on one side, where no light change is ever computed.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "samples"))
from sample_folder import CONFIG, SAMPLE, maker  # noqa: E402

from mrbatch import load_job, render
from mrbatch.contracts import TILE
from mrbatch.film.exr import read_frame
from mrbatch.metrics.errors import relmse_map
from mrbatch.metrics.region import region_of_interest
from mrbatch.metrics.statistics import tile_z_test

pytestmark = pytest.mark.slow

SPP = 256


@dataclass(frozen=True)
class Pictures:
    """(h, w, 3) float64 each; variances are of the pixels' means."""

    composite: np.ndarray
    unclamped: np.ndarray
    variance: np.ndarray
    photo: np.ndarray
    photo_variance: np.ndarray
    truth: np.ndarray
    truth_variance: np.ndarray
    coverage: np.ndarray


def read_exr(name: str) -> np.ndarray:
    import OpenImageIO as oiio

    file = oiio.ImageInput.open(str(SAMPLE / name))
    assert file is not None, oiio.geterror()
    pixels = file.read_image("float")
    file.close()
    return np.asarray(pixels, dtype=np.float64)


def read_variance(name: str) -> np.ndarray:
    """Stored as deviations, roots of means over blocks."""
    n = maker().VARIANCE_BLOCK
    return np.repeat(np.repeat(read_exr(name) ** 2, n, axis=0), n, axis=1)


@pytest.fixture(scope="module")
def pictures(tmp_path_factory) -> dict[int, Pictures]:
    folder = tmp_path_factory.mktemp("sample")
    job = load_job(
        CONFIG,
        [
            # There are pictures of these frames alone; the others of the sequence would count as missing.
            f"frames={','.join(map(str, maker().TRUTH_FRAMES))}",
            f"capture.frames={(SAMPLE / 'photo_linear_####.exr').as_posix()}",
            f"capture.poses={(SAMPLE / 'poses.json').as_posix()}",
            "capture.target=null",
            f"method.spp={SPP}",
            # Independent samples: their scatter is the variance; of stratified ones it is a bound.
            "method.sampler=independent",
            "output.layers=[virtual, background, delta, variance]",
            "output.dtype=float",
            f"output.directory={folder.as_posix()}",
        ],
    )
    outcome = render(job, report=False)
    assert outcome.exit_code == 0
    made = {}
    for number in maker().TRUTH_FRAMES:
        (view,) = read_frame(folder / f"marker_video.{number:04d}.exr").views.values()

        def layer(prefix: str, channels=view.channels) -> np.ndarray:
            return np.stack([channels[prefix + c] for c in "RGB"], axis=-1).astype(np.float64)

        coverage = view.channels["virtual.A"].astype(np.float64)[..., None]
        made[number] = Pictures(
            composite=layer(""),
            unclamped=layer("virtual.") + (1.0 - coverage) * layer("background.") + layer("delta."),
            variance=layer("variance."),
            photo=layer("background."),
            photo_variance=read_variance(f"photo_deviation_{number:04d}.exr"),
            truth=read_exr(f"truth_{number:04d}.exr"),
            truth_variance=read_variance(f"truth_deviation_{number:04d}.exr"),
            coverage=coverage,
        )
    return made


def whole_tiles(mask: np.ndarray) -> np.ndarray:
    """The mask grown to all pixels of the decision tiles that it touches."""
    rows, columns = np.nonzero(mask)
    grown = np.zeros_like(mask)
    for row, column in {(r // TILE, c // TILE) for r, c in zip(rows, columns, strict=True)}:
        grown[row * TILE : (row + 1) * TILE, column * TILE : (column + 1) * TILE] = True
    return grown


def region(p: Pictures) -> np.ndarray:
    deviation = np.sqrt(p.photo_variance + p.truth_variance)
    return whole_tiles(region_of_interest(p.truth, p.photo, deviation=deviation))


def rounding_variance(picture: np.ndarray) -> np.ndarray:
    """Of a picture stored in half floats: noise far above their spacing makes rounding a noise of its own."""
    spacing = np.spacing(picture.astype(np.float16)).astype(np.float64)
    return spacing**2 / 12.0


def total_variance(p: Pictures) -> np.ndarray:
    photo = p.photo_variance + rounding_variance(p.photo)
    return p.variance + (1.0 - p.coverage) ** 2 * photo + p.truth_variance + rounding_variance(p.truth)


@pytest.mark.parametrize("number", maker().TRUTH_FRAMES)
def test_photo_enters_unchanged(pictures, number):
    np.testing.assert_array_equal(pictures[number].photo, read_exr(f"photo_linear_{number:04d}.exr"))


@pytest.mark.parametrize("number", maker().TRUTH_FRAMES)
def test_composite_is_the_truth_within_its_noise(pictures, number):
    p = pictures[number]
    # Without the cut at 0, which is part of the contract but lifts dark noisy pixels.
    found = tile_z_test(p.unclamped, p.truth, total_variance(p), region=region(p), sigma=4.0)
    print(f"frame {number}: largest z {found.largest:.2f} of {found.limit:.2f}, rms {found.rms:.2f}, ")
    print(f"  difference {100 * found.difference.value:.3f} % +- {100 * found.difference.half_width:.3f} %")
    assert found.passed, (found.largest, found.limit, found.worst_tile)
    assert found.rms < 1.3
    assert max(abs(found.difference.low), abs(found.difference.high)) < 0.01


@pytest.mark.parametrize("number", maker().TRUTH_FRAMES)
def test_relmse_is_that_of_the_noise(pictures, number):
    p = pictures[number]
    inside = region(p)
    mean = float(np.abs(p.truth).mean())
    found = relmse_map(p.composite, p.truth, mean)[inside].mean()
    expected = (total_variance(p) / (p.truth**2 + 1e-2 * mean * mean)).mean(axis=2)[inside].mean()
    print(f"frame {number}: relMSE {found:.3e}, of the noise {expected:.3e}")
    assert found < 1.15 * expected
    without = relmse_map(p.photo, p.truth, mean)[inside].mean()
    assert found < 0.05 * without, "the photo alone is far from the truth"


@pytest.mark.parametrize("whole", [False, True])
def test_script_still_traces_the_stored_pictures(whole):
    """A few samples of the middle frame, with other seeds than the stored ones."""
    made = maker()
    number = made.TRUTH_FRAMES[1]
    name = "truth" if whole else "photo"
    stored = read_exr(f"{name}_{number:04d}.exr" if whole else f"{name}_linear_{number:04d}.exr")
    tracer = made.PathTracer()
    # Eight halves in each of four calls: enough to know their scatter.
    picture, variance = tracer.radiance(number, whole=whole, spp=48, seeds=6, first_seed=500)
    deviation = read_variance(f"{name}_deviation_{number:04d}.exr")
    found = tile_z_test(picture, stored, variance, deviation + rounding_variance(stored))
    print(f"{name}: largest z {found.largest:.2f} of {found.limit:.2f}, rms {found.rms:.2f}")
    assert found.passed, (found.largest, found.limit, found.worst_tile)
