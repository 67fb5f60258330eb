"""Effect rules of two-pass differential path tracing: all radiance is traced in full."""

from mrbatch.effects.surface_rules import WHOLE_PATH_RULES

RULES = WHOLE_PATH_RULES
