"""Composites of the desk sets against another renderer's truth, with the object really there."""

from __future__ import annotations

import pytest
from desk_scene import SETS, desk, judge

from mrbatch.methods.delta_path_tracing import METHOD as DELTA
from mrbatch.methods.image_based_lighting import METHOD as IMAGE_BASED
from mrbatch.methods.one_pass import METHOD as ONE_PASS
from mrbatch.methods.two_pass import METHOD as TWO_PASS

pytestmark = pytest.mark.slow
CASES = [(name, kind, frame) for name in SETS for kind in ("diffuse", "metal") for frame in (0, 4)]


@pytest.mark.parametrize(("name", "kind", "frame"), CASES)
def test_composite_against_the_truth(shared_data, name, kind, frame, capsys):
    scene = desk(shared_data, name, kind)
    found = judge(DELTA, scene, frame, spp=512, max_depth=8)
    baseline = judge(IMAGE_BASED, scene, frame, spp=64)
    test = found.test
    with capsys.disabled():
        interval = f"{100 * test.difference.low:+.3f}..{100 * test.difference.high:+.3f} %"
        print(
            f"\n{name} {kind} {frame}: difference {interval},",
            f"largest z {test.largest:.2f} of {test.limit:.2f}, rms {test.rms:.2f},",
            f"relMSE {found.relmse:.5f} (image-based lighting {baseline.relmse:.4f}),",
            f"variance {found.ours:.2e} (truth {found.theirs:.2e}),",
            f"{found.seconds:.1f} s, {found.rays / 1e6:.0f} Mrays",
        )
    assert test.difference.low > -0.01 and test.difference.high < 0.01
    assert found.ours <= found.theirs
    assert found.relmse < 0.15 * baseline.relmse
    # The truth starts its rays a tenth of a millimetre off: some tiles show it (next test).
    assert found.beyond <= 0.02


@pytest.mark.parametrize(("name", "kind", "frame"), CASES)
def test_no_tile_differs_once_rays_start_where_the_truths_do(shared_data, name, kind, frame, capsys):
    """The proof of the estimator: with the same offset of rays nothing but noise is left.

    The truth's is a tenth of a millimetre here, ours a tenth of a micrometre. It moves the edges of hard
    shadows and takes away the fine shading of the bunny's dents: 0.4 per cent of its light under the lamps,
    and up to 2.5 per cent of a tile's, which is several times the noise of the truth.
    """
    scene = desk(shared_data, name, kind)
    test = judge(DELTA, scene, frame, spp=256, max_depth=8, ray_start="mitsuba").test
    with capsys.disabled():
        figures = f"z {test.largest:.2f} of {test.limit:.2f}, rms {test.rms:.2f}"
        print(f"\n{name} {kind} {frame}, offset of the truth: {figures}")
    assert test.passed
    # The noise is read off the pictures, by up to a half too large. Not everywhere by as much: a tile under
    # the chin of the head, where nothing of ours changes, stands at 3.5, for photo and truth differ there.
    assert 0.5 < test.rms < 1.2


@pytest.mark.parametrize("method", [ONE_PASS, TWO_PASS], ids=lambda m: m.name)
@pytest.mark.parametrize("kind", ["diffuse", "metal"])
def test_baselines_against_the_truth(shared_data, method, kind):
    """The baselines of differential rendering have no bias either; two pictures have more noise."""
    scene = desk(shared_data, "mitsuba_desk_window", kind)
    ours = judge(DELTA, scene, 0, spp=64, max_depth=8)
    found = judge(method, scene, 0, spp=64, max_depth=8)
    assert found.test.difference.low > -0.01 and found.test.difference.high < 0.01
    assert found.test.passed
    if method is ONE_PASS:
        assert found.relmse == pytest.approx(ours.relmse, rel=1e-3)
    else:
        assert found.relmse > 1.2 * ours.relmse
