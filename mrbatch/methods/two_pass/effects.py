"""Effect rules of two-pass differential path tracing: both radiances are traced in full, so fewer effects
can be left out than where only their change is."""

from __future__ import annotations

from mrbatch.effects.surface_rules import (
    DISTORTION,
    EMISSION,
    ENVIRONMENT,
    GLOSSY,
    HOLDOUT,
    LIGHT_CHANGE,
    NORMAL_MAPS,
    PHOTO_REFLECTANCE,
    RECEIVE,
    TEXTURES,
    VIRTUAL,
)

RULES = (
    VIRTUAL,
    LIGHT_CHANGE,
    GLOSSY,
    EMISSION,
    NORMAL_MAPS,
    TEXTURES,
    PHOTO_REFLECTANCE,
    HOLDOUT,
    RECEIVE,
    DISTORTION,
    ENVIRONMENT,
)
