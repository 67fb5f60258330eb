"""The flicker of a still film: measured on noise that is known, and held against a film that stands still."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest
from click.testing import CliRunner
from small_job import pose, write_job

from mrbatch.batch.previews import composite_of
from mrbatch.bench.__main__ import main
from mrbatch.bench.flicker import BLUR, LUMA, flicker, flicker_of
from mrbatch.bench.variants import Variants
from mrbatch.film.preview import preview_codes

SETTINGS = ["method.spp=4", "output.scale=0.5"]


@pytest.fixture(scope="module")
def job(tmp_path_factory):
    return write_job(tmp_path_factory.mktemp("job"), (0,))


@pytest.fixture(scope="module")
def found(job):
    # No filter that a machine may lack.
    return flicker(Variants(job, SETTINGS), pictures=12, kinds=("none", "bilateral", "variance"))


def test_known_noise_is_measured():
    """White noise of 3 codes, a patch that breathes by 2 codes as a whole, a still one; all of known size."""
    random = np.random.default_rng(5)
    pictures = np.full((64, 96, 192), 100.0)
    white, patch, still = (np.zeros(pictures.shape[1:], bool) for _ in range(3))
    white[:, :96] = patch[:, 112:144] = still[:, 177:] = True
    pictures[:, :, :96] += random.normal(0, 3.0, (64, 96, 96))
    pictures[:, :, 96:160] += random.normal(0, 2.0, (64, 1, 1))
    inner = white & (np.arange(192) < 80)
    grain, breathing, none = flicker_of(pictures, [inner, patch, still])
    assert grain.fine == pytest.approx(3.0, rel=0.02)
    # Away from the picture's border: there a blur averages over fewer pixels.
    inner[:16] = inner[-16:] = False
    inner[:, :16] = False
    (grain,) = flicker_of(pictures, [inner])
    assert grain.coarse == pytest.approx(3.0 / (2 * np.sqrt(np.pi) * BLUR), rel=0.05)
    assert grain.above == 1.0 and grain.rare > 3.5
    scale = np.std(pictures[:, 0, 120], ddof=1)
    assert breathing.fine == pytest.approx(scale) and breathing.rare == pytest.approx(scale)
    assert breathing.coarse == pytest.approx(scale, rel=1e-3), "a blur takes nothing from a patch"
    assert (none.fine, none.above, none.pixels) == (0.0, 0.0, 96 * 15)
    assert none.coarse < 1e-9
    (empty,) = flicker_of(pictures, [np.zeros_like(still)])
    assert empty.pixels == 0 and np.isnan([empty.fine, empty.coarse, empty.above, empty.rare]).all()


def test_it_is_what_frames_of_a_still_film_do(tmp_path, found, job):
    """Twelve frames of one photo from one place, rendered as a job with one seed: the same figures."""
    from mrbatch import load_job, render

    film = write_job(tmp_path, range(12))
    for number in range(1, 12):
        shutil.copy(tmp_path / "photo_0000.png", tmp_path / f"photo_{number:04d}.png")
    poses = [{"frame": n, "world_from_camera": pose(0).tolist()} for n in range(12)]
    (tmp_path / "poses.json").write_text(json.dumps(poses))
    render(load_job(film, SETTINGS), report=False)
    frames = [composite_of(path) for path in sorted((tmp_path / "out").glob("*.exr"))]
    assert len(frames) == 12
    lumas = np.stack([preview_codes(frame, "srgb") @ LUMA for frame in frames])
    plain = found.rows[0]
    parts = (plain.real, plain.virtual, plain.edges)
    assert min(part.pixels for part in parts) > 20
    # What is outside of the region hardly varies, so sums over it and over the whole picture are alike.
    # Either root scatters by 4 % from seed to seed (eight tried).
    told = sum(part.pixels * part.fine**2 for part in parts)
    filmed = np.sum(lumas.var(axis=0, ddof=1))
    assert np.sqrt(told) == pytest.approx(np.sqrt(filmed), rel=0.2)
    # Nothing carries over from one frame to the next.
    apart = lumas - lumas.mean(axis=0)
    assert abs(np.sum(apart[1:] * apart[:-1])) < 0.15 * np.sum(apart**2)


def test_filters_take_grain_away(found):
    assert [row.kind for row in found.rows] == ["none", "bilateral", "variance"]
    assert (found.pictures, found.spp, found.frame, found.missing) == (12, 4, 0, ())
    none, *filtered = found.rows
    for row in filtered:
        assert row.real.pixels == none.real.pixels and row.virtual.pixels == none.virtual.pixels
        assert row.real.fine < 0.8 * none.real.fine
        assert row.virtual.fine < 0.8 * none.virtual.fine


def test_more_samples_flicker_less(job, found):
    many = flicker(Variants(job, [*SETTINGS, "method.spp=64"]), pictures=12, kinds=("none",))
    # 16 times the samples: a quarter of the noise, less where samples are evenly spread; codes round.
    assert many.rows[0].virtual.fine < 0.3 * found.rows[0].virtual.fine


def test_the_command_prints_a_table(job):
    options = ["--pictures", "2", "--kind", "none", "--kind", "variance"]
    settings = [word for setting in SETTINGS for word in ("--set", setting)]
    result = CliRunner().invoke(main, ["flicker", str(job), *options, *settings])
    assert result.exit_code == 0, result.output
    for word in ("none", "variance", "real", "virtual", "edges", "blurred", "2 pictures"):
        assert word in result.output


def test_what_cannot_be_measured_is_told(job, tmp_path):
    empty = write_job(tmp_path, (0,), virtual=False)
    result = CliRunner().invoke(main, ["flicker", str(empty), "--pictures", "2"])
    assert result.exit_code == 1 and "change nothing" in result.output
    with pytest.raises(ValueError, match="two pictures"):
        flicker(Variants(job, SETTINGS), pictures=1)
