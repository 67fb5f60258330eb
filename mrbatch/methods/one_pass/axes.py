"""Sweep axes of one-pass differential path tracing: those of all methods that trace light paths."""

from mrbatch.scene.path_settings import PATH_AXES

AXES = PATH_AXES
