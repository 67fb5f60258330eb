"""Effect rules of image-based lighting."""

from __future__ import annotations

from mrbatch.contracts import Rule, Verdict
from mrbatch.effects.camera_rules import DEPTH_OF_FIELD, MOTION_BLUR
from mrbatch.effects.facts import ShotFacts
from mrbatch.effects.surface_rules import (
    ALPHA,
    DISTORTION,
    EMISSION,
    ENVIRONMENT,
    GLOSSY,
    HOLDOUT,
    NORMAL_MAPS,
    TEXTURES,
    THIN_GLASS,
    TRANSMISSION,
    VIRTUAL,
)
from mrbatch.effects.verdict import absent, needed


def _occlusion(facts: ShotFacts) -> Verdict:
    if not facts.settings.occlusion:
        return absent("the method's `occlusion` is not set: nothing blocks the map's light")
    return needed("surfaces block the map's light on virtual ones")


RULES = (
    VIRTUAL,
    Rule("occlusion", "light of the map that surfaces block on virtual objects", _occlusion),
    GLOSSY,
    EMISSION,
    TRANSMISSION,
    ALPHA,
    THIN_GLASS,
    NORMAL_MAPS,
    TEXTURES,
    HOLDOUT,
    DISTORTION,
    DEPTH_OF_FIELD,
    MOTION_BLUR,
    ENVIRONMENT,
)
