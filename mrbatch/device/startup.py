"""Starting Warp, without its notice that this machine has no CUDA driver."""

from __future__ import annotations

import functools
import os
import sys

import warp as wp

import mrbatch.kernels  # noqa: F401  (sets Warp up)


@functools.cache
def start() -> None:
    """Initialises Warp once a process.

    Its native part writes "could not find the CUDA driver" to the error stream whatever its log level;
    on a machine that renders on the CPU that is noise, so the stream is shut for this one call.
    """
    try:
        sys.stderr.flush()
        kept = os.dup(2)
    except (OSError, ValueError, AttributeError):
        wp.init()
        return
    try:
        with open(os.devnull, "wb") as nothing:
            os.dup2(nothing.fileno(), 2)
            wp.init()
    finally:
        os.dup2(kept, 2)
        os.close(kept)
