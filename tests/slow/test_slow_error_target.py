"""Whether frames are as good as asked, by a converged reference: 40 seeds, three scenes, four targets."""

from __future__ import annotations

import numpy as np
import pytest
from small_job import CRATE, write_job

from mrbatch.bench.variants import Reference, Variants, converged
from mrbatch.metrics.errors import image_errors

pytestmark = pytest.mark.slow

SEEDS = 40
MATERIALS = {
    "matt": CRATE["material"],
    "rough metal": {"type": "conductor", "reflectance": [0.9, 0.8, 0.6], "roughness": 0.3},
    "rough plastic": {"type": "principled", "reflectance": [0.7, 0.2, 0.1], "roughness": 0.3},
}


@pytest.fixture(scope="module", params=list(MATERIALS))
def scene(request, tmp_path_factory) -> tuple[Variants, Reference, float]:
    """The scene, its reference, and the error after the first batch of samples."""
    path = write_job(
        tmp_path_factory.mktemp("scene"),
        (0,),
        dtype=np.float32,
        virtual=[{**CRATE, "material": MATERIALS[request.param]}],
    )
    variants = Variants(path)
    reference = converged(variants, 16384, threads=2)
    with variants.subject("method.spp=16", threads=2) as subject:
        assert subject.renderer.prepared.job.method.batch == 8
        first = [relmse(picture(subject, seed)[0], reference) for seed in range(SEEDS)]
    return variants, reference, float(np.median(first))


def picture(subject, seed: int) -> tuple[np.ndarray, dict]:
    rendered = subject.renderer.render(0, None, seed=seed)
    return next(iter(rendered.composites.values())), rendered.details


def relmse(found: np.ndarray, reference: Reference) -> float:
    errors = image_errors(found, reference.picture, region=reference.changed, flip=False)
    assert errors.region is not None
    return errors.region.relmse


@pytest.mark.parametrize("asked", ["1/4", "1/16", "1/64", "0.001"])
def test_true_errors_are_below_the_target_and_not_far(scene, asked):
    variants, reference, first = scene
    target = first / int(asked[2:]) if "/" in asked else float(asked)
    own = relmse(reference.picture + reference.noise, reference)
    assert own < target / 10
    errors, less = [], []
    settings = (f"accuracy.target_error={target!r}", "accuracy.max_spp=65536")
    with variants.subject(*settings, threads=2) as subject:
        for seed in range(SEEDS):
            found, details = picture(subject, seed)
            assert details["accuracy"]["outcome"] == "reached"
            errors.append(relmse(found, reference))
            less.append(details["accuracy"]["rounds"] == 1)
    under, middle = float(np.mean(np.array(errors) <= target)), float(np.median(errors))
    print(f"\n{asked}: target {target:.3g}: under in {100 * under:.0f} %, median {middle / target:.2f} of it")
    assert under >= 0.9
    # A target that the first batch already meets cannot be met by less.
    assert middle > target / 2 or np.mean(less) > 0.5
