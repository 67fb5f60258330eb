"""Sweep axes of the toy."""

from mrbatch.contracts import Axis

AXES = (Axis("spp", "method.spp", (2, 8, 32), "time ~ N, error ~ N^-1/2", "shades"),)
