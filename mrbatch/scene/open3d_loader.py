"""Importing Open3D, which needs a library that a bare machine lacks and takes a second to load."""

from __future__ import annotations

import ctypes
import functools
from types import ModuleType

from mrbatch.errors import ResourceError


@functools.cache
def open3d() -> ModuleType:
    """The module `open3d`, imported when first asked for.

    Its camera drivers link against libusb-1.0, which few machines have; the wheel `libusb-package`
    carries it, and once it is loaded with global names the import finds it. Raises ResourceError where
    Open3D cannot be had.
    """
    try:
        import libusb_package

        found = libusb_package.get_library_path()
        if found is not None:
            ctypes.CDLL(str(found), mode=ctypes.RTLD_GLOBAL)
    except (ImportError, OSError):
        pass  # the machine may have its own; if not, the import below says what is missing
    try:
        import open3d as module
    except (ImportError, OSError) as error:
        raise ResourceError(
            f"Open3D cannot be loaded ({error})",
            hint="install the wheels `open3d` and `libusb-package` again",
        ) from error
    return module
