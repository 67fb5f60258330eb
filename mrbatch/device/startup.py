"""Starting Warp, without its notice that this machine has no CUDA driver."""

from __future__ import annotations

import functools
import os
import sys

import warp as wp

import mrbatch.kernels  # noqa: F401  (sets Warp up)
from mrbatch.errors import ResourceError


def cache_error(error: OSError) -> ResourceError:
    """What a user is told where compiled kernels cannot be kept."""
    return ResourceError(
        f"the folder of compiled kernels cannot be written ({error})",
        hint="set the environment variable WARP_CACHE_PATH to a folder that can be, or free some disk",
    )


@functools.cache
def start() -> None:
    """Initialises Warp once a process.

    Its native part writes "could not find the CUDA driver" to the error stream whatever its log level;
    on a machine that renders on the CPU that is noise, so the stream is shut for this one call.
    Raises ResourceError where the folder of compiled kernels cannot be made.
    """
    try:
        sys.stderr.flush()
        kept = os.dup(2)
    except (OSError, ValueError, AttributeError):
        _init()
        return
    try:
        with open(os.devnull, "wb") as nothing:
            os.dup2(nothing.fileno(), 2)
            _init()
    finally:
        os.dup2(kept, 2)
        os.close(kept)


def _init() -> None:
    try:
        wp.init()
    except OSError as error:
        raise cache_error(error) from error
