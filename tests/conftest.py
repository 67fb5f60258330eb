"""Fixtures that all tests share."""

from __future__ import annotations

from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of real captures beside the checkout; tests that need it skip where it is absent."""
    folder = ROOT.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip("the shared captures (shared/data beside the checkout) are absent")
    return folder


@pytest.fixture(scope="session")
def mi():
    """Mitsuba 3, another path tracer, in the variant that needs no compiler; for slow tests."""
    mitsuba = pytest.importorskip("mitsuba", reason="Mitsuba 3 is not installed")
    mitsuba.set_variant("scalar_rgb")
    return mitsuba
