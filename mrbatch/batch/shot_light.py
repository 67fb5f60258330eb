"""The turn of the environment map where a frame has to tell it: by a mirror ball in its picture."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mrbatch.contracts import Capture
from mrbatch.errors import InputError, Place
from mrbatch.scene.build import Turned
from mrbatch.scene.environment import load_environment
from mrbatch.scene.light_probe import align_by_ball
from mrbatch.scene.mirror_ball import ball_pixels
from mrbatch.scene.settings import Environment

KEY = "environment"
"""Of the shot's table: what was found, so that every worker turns the map alike."""


def needs_a_frame(environment: Environment | None) -> bool:
    """Whether the map's turn is to be found in a frame."""
    return environment is not None and environment.align is not None and environment.align.probe is not None


def find_turn(environment: Environment, capture: Capture, table: Mapping[str, Any]) -> dict[str, Any]:
    """`world_from_map` (3 rows) and `note`, JSON-ready.

    Raises InputError: a frame that has no picture or pose, a ball that is not in it, and what
    `light_probe.align_by_ball` refuses.
    """
    assert environment.align is not None and environment.align.probe is not None
    probe = environment.align.probe
    try:
        view = next(iter(capture.frame(probe.frame, table).views.values()))
    except InputError as error:
        raise InputError(
            f"the mirror ball is to be seen in frame {probe.frame}, which cannot be used: {error.message}",
            place=error.place,
            hint="name a frame of the shot in `environment.align.probe`",
        ) from None
    place = Place(file=str(environment.file), frame=probe.frame)
    try:
        ball = probe.view(view.camera)
    except ValueError as error:
        raise InputError(f"the mirror ball cannot be found: {error}", place=place) from None
    light = load_environment(environment.file, rows=environment.rows)
    found = align_by_ball(
        light,
        view.background,
        ball_pixels(view.camera, ball),
        tolerance=environment.align.tolerance,
        upright=probe.upright,
        place=place,
    )
    off = ", ".join(f"{angle:.2f}" for angle in np.degrees(found.residuals))
    return {
        "world_from_map": found.world_from_map.tolist(),
        "note": f"the environment map is turned to meet {len(found.residuals)} lamps that a mirror ball "
        f"shows in frame {probe.frame}: they are {off} degrees off; ball and map correlate by "
        f"{found.likeness:.2f}"
        + ("" if found.whole else "; some are half hidden behind the ball: look twice"),
    }


def turned(table: Mapping[str, Any]) -> Turned | None:
    """What `find_turn` put into a shot's table."""
    if KEY not in table:
        return None
    return np.array(table[KEY]["world_from_map"], dtype=np.float64), str(table[KEY]["note"])
